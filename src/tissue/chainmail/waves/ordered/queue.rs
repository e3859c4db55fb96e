//! Which element is processed next: the queues behind the propagation.

use super::super::super::variants::{Order, Structures};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// A queue of offers. The rank of an offer says how early it is processed, and holds the time of its path.
pub trait Queue {
    /// Smaller is processed first.
    type Rank: Copy + Ord + Send + Sync;
    /// Rank of initiators: time 0, before everything else.
    const START: Self::Rank;
    /// Rank of an element that has no offer; above every other.
    const NEVER: Self::Rank;

    /// Whether ranks depend on how far an offer moves its element.
    fn by_shift(&self) -> bool;
    /// Whether offers to one element are averaged; [`Queue::informed`] then ranks instead of [`Queue::rank`].
    fn averages(&self) -> bool;
    /// Rank of an offer along a path of `time` ticks that moves its element by `shift` mm.
    fn rank(&mut self, time: u32, shift: f32) -> Self::Rank;
    /// Rank of an element that has `informations` offers, the first at `time`, and lies `steps` along the front from
    /// where offers first met.
    fn informed(&self, time: u32, informations: u8, steps: u16) -> Self::Rank;
    /// Time in a rank.
    fn time(rank: Self::Rank) -> u32;
    /// Times of all elements.
    fn times(ranks: Vec<Self::Rank>) -> Vec<u32>;
    /// Puts an offer in. A better offer to the same element makes this one stale; the caller skips stale ones.
    fn push(&mut self, rank: Self::Rank, node: u32);
    /// Takes the earliest out.
    fn pop(&mut self) -> Option<(Self::Rank, u32)>;
}

/// Dial's bucket queue: timestamps only, one bucket per tick.
pub struct BucketQueue {
    buckets: Vec<Vec<u32>>,
    now: u32,
    slot: usize,
    waiting: usize,
}

impl BucketQueue {
    /// A queue for links that take so many ticks at most.
    pub fn new(slowest: u32) -> Self {
        Self { buckets: vec![Vec::new(); slowest as usize + 1], now: 0, slot: 0, waiting: 0 }
    }
}

impl Queue for BucketQueue {
    type Rank = u32;
    const START: u32 = 0;
    const NEVER: u32 = u32::MAX;

    fn by_shift(&self) -> bool {
        false
    }
    fn averages(&self) -> bool {
        false
    }
    fn rank(&mut self, time: u32, _: f32) -> u32 {
        time
    }
    fn informed(&self, time: u32, _: u8, _: u16) -> u32 {
        time
    }
    fn time(rank: u32) -> u32 {
        rank
    }
    fn times(ranks: Vec<u32>) -> Vec<u32> {
        ranks
    }
    fn push(&mut self, rank: u32, node: u32) {
        let slot = rank as usize % self.buckets.len();
        self.buckets[slot].push(node);
        self.waiting += 1;
    }
    fn pop(&mut self) -> Option<(u32, u32)> {
        while self.waiting > 0 {
            if let Some(node) = self.buckets[self.slot].pop() {
                self.waiting -= 1;
                return Some((self.now, node));
            }
            self.now += 1;
            self.slot = if self.slot + 1 == self.buckets.len() { 0 } else { self.slot + 1 };
        }
        None
    }
}

/// What ranks offers in a [`HeapQueue`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Ranking {
    /// Largest constraint violation first (eq. 2.7).
    Violation,
    /// First moved, first processed; elements that need not move come last. Holds the number of the last offer.
    FirstMoved(u32),
    /// Time, then number of informations; with `true` then the least steps along the front.
    Fronts(bool),
}

/// Binary heap for every other order. Equal ranks come out in a fixed scrambled order, since the thesis processes them
/// "in a random order" (Fig. 21) and storage order would favour one direction.
pub struct HeapQueue {
    ranking: Ranking,
    heap: BinaryHeap<Reverse<(u64, u32, u32)>>,
}

impl HeapQueue {
    /// The queue of an order with its criteria for structures.
    pub fn new(order: Order, structures: Structures) -> Self {
        let ranking = match order {
            Order::Timestamps => Ranking::Fronts(structures == Structures::ThirdCriterion),
            Order::ConstraintViolation => Ranking::Violation,
            Order::FirstMoved => Ranking::FirstMoved(0),
        };
        Self { ranking, heap: BinaryHeap::new() }
    }
}

/// A fixed permutation of 32-bit numbers (the finaliser of MurmurHash3).
fn scrambled(mut n: u32) -> u32 {
    n ^= n >> 16;
    n = n.wrapping_mul(0x85eb_ca6b);
    n ^= n >> 13;
    n = n.wrapping_mul(0xc2b2_ae35);
    n ^ n >> 16
}

impl Queue for HeapQueue {
    /// The order's criterion above; in violation and first-moved order the time below.
    type Rank = u64;
    const START: u64 = 0;
    const NEVER: u64 = u64::MAX;

    fn by_shift(&self) -> bool {
        matches!(self.ranking, Ranking::Violation | Ranking::FirstMoved(_))
    }
    fn averages(&self) -> bool {
        matches!(self.ranking, Ranking::Fronts(_))
    }
    fn rank(&mut self, time: u32, shift: f32) -> u64 {
        let first = match &mut self.ranking {
            // The bits of a float that is not negative ascend with it.
            Ranking::Violation => u32::MAX - shift.to_bits(),
            Ranking::FirstMoved(last) => {
                *last = last.saturating_add(1).min(u32::MAX / 2 - 1);
                if shift > 0.0 { *last } else { *last + u32::MAX / 2 }
            }
            Ranking::Fronts(_) => 0,
        };
        u64::from(first) << 32 | u64::from(time)
    }
    fn informed(&self, time: u32, informations: u8, steps: u16) -> u64 {
        let steps = if self.ranking == Ranking::Fronts(true) { steps } else { 0 };
        u64::from(steps) << 40 | u64::from(u8::MAX - informations) << 56 | u64::from(time)
    }
    fn time(rank: u64) -> u32 {
        rank as u32
    }
    fn times(ranks: Vec<u64>) -> Vec<u32> {
        ranks.into_iter().map(|r| r as u32).collect()
    }
    fn push(&mut self, rank: u64, node: u32) {
        // Fronts hold the time below like the others, but go by it first.
        let key = if self.averages() { rank.rotate_left(32) } else { rank };
        self.heap.push(Reverse((key, scrambled(node), node)));
    }
    fn pop(&mut self) -> Option<(u64, u32)> {
        let Reverse((key, _, node)) = self.heap.pop()?;
        Some((if self.averages() { key.rotate_right(32) } else { key }, node))
    }
}
