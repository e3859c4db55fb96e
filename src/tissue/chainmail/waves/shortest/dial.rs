//! A wave as a shortest path search: Dial's algorithm with buckets as wide as they may be (Dinitz), over the cells of a
//! [`Medium`] or of some of its planes.

use super::super::super::variants::LinkTime;
use super::super::front::{FrontRules, MOST_TICKS, TICKS_ZERO};
use super::arrival::Medium;
use super::brick::{Brick, CELLS, value};
use crate::geometry::vectorised;
use std::ops::Range;

/// A wave on its way.
///
/// A cell's key is when the wave comes to it, and below that from which bone: time shifted by some bits, or'ed with the bone.
/// The least key is the least time, and of equal times the first bone, without asking for either.
pub(super) struct Search<'a> {
    medium: &'a Medium,
    /// The first brick that is looked at.
    pub(super) first: usize,
    /// Bricks whose cells hand on what they are told, counted from the first.
    pub(super) own: Range<usize>,
    /// Key of each cell.
    pub(super) keys: Vec<Brick<i32>>,
    /// Bits of a key below its time.
    shift: u32,
    /// Latest time that counts.
    pub(super) limit: i32,
    latest: Option<&'a [Brick<i32>]>,
    /// Whether it was too late somewhere.
    pub(super) pruned: bool,
    /// Cells that were told something and do not hand it on.
    pub(super) told: Vec<u32>,
    /// Whether cells may have handed on already what now changes.
    again: bool,
}

impl<'a> Search<'a> {
    /// Before the wave: `bricks` are looked at, all of which hand on. `latest`: a time for each cell, after which the wave does
    /// not enter it. `room`: where keys are written, whatever it holds.
    pub(super) fn new(
        medium: &'a Medium,
        bricks: Range<usize>,
        latest: Option<&'a [Brick<i32>]>,
        room: Vec<Brick<i32>>,
    ) -> Self {
        let (first, own, mut keys) = (bricks.start, 0..bricks.len(), room);
        keys.clear();
        keys.extend_from_slice(&medium.rest[bricks]);
        let (limit, told) = (medium.limit, Vec::new());
        Self { medium, first, own, keys, shift: 0, limit, latest, pruned: false, told, again: false }
    }

    /// Tells apart the bones up to this one: the more there are, the sooner times end, at 2^30 ticks by 2 to the bits that
    /// a bone takes (half a kilometre at relative shear 1 for 42 bones).
    pub(super) fn telling(self, last: u16) -> Self {
        let shift = u16::BITS - last.leading_zeros();
        Self { shift, limit: self.limit.min(i32::MAX >> (shift + 1)), ..self }
    }

    /// Time and bone of a key.
    pub(super) fn told_by(&self, key: i32) -> (i32, u16) {
        (key >> self.shift, (key & !(-1 << self.shift)) as u16)
    }

    /// Only the cells of these bricks hand on what they are told.
    pub(super) fn handing_on(self, own: Range<usize>) -> Self {
        Self { own, ..self }
    }

    /// Runs until nothing changes, from cells whose keys are set, earliest first: (key, cell).
    pub(super) fn run(&mut self, seeds: &[(i32, u32)]) {
        match self.medium.rules.time {
            LinkTime::FastInStiff => vectorised(
                #[inline(always)]
                || self.spread::<true>(seeds),
            ),
            LinkTime::SlowInStiff | LinkTime::Literal => vectorised(
                #[inline(always)]
                || self.spread::<false>(seeds),
            ),
        }
        self.again = true;
    }

    #[inline(always)]
    fn spread<const FAST: bool>(&mut self, seeds: &[(i32, u32)]) {
        let [quickest, slowest] = self.medium.ticks;
        let mut ring = Ring::new([quickest, slowest.min(self.limit + 1)]);
        let mut offers = vec![Offers::default(); BATCH * CELLS];
        let shift = self.shift;
        let mut seeds = seeds.iter().map(|&(key, cell)| (key >> shift, cell)).peekable();
        while let Some(next) = if ring.waiting > 0 { Some(ring.base) } else { seeds.peek().map(|s| s.0) } {
            ring.begin_at(next);
            if ring.base > self.limit {
                break;
            }
            let mut bucket = std::mem::take(&mut ring.buckets[ring.slot]);
            ring.waiting -= bucket.len();
            while let Some(seed) = seeds.next_if(|s| s.0 < ring.base + ring.width) {
                bucket.push(seed.1);
            }
            self.keep_due(&mut bucket, ring.base);
            for cells in bucket.chunks(BATCH) {
                let found = self.expand::<FAST>(cells, &mut offers);
                for offer in &offers[..found] {
                    self.offer(offer, &mut ring);
                }
            }
            bucket.clear();
            ring.advance(bucket);
        }
    }

    /// Keeps the cells of a bucket that are due in it: those with a time before it were dealt with in their own. Cells that do
    /// not hand on are told, and go as well.
    #[inline(always)]
    fn keep_due(&mut self, bucket: &mut Vec<u32>, base: i32) {
        let mut kept = 0;
        for at in 0..bucket.len() {
            let n = bucket[at];
            let now = value(&self.keys, n as usize) >> self.shift;
            let due = (now >= base) & (now <= self.limit);
            let own = self.own.contains(&(n as usize / CELLS));
            if due && !own {
                self.told.push(n);
            }
            bucket[kept] = n;
            kept += usize::from(due & own);
        }
        bucket.truncate(kept);
    }

    /// What settled cells have to offer to their neighbours: how many bricks hold one for which it is early enough.
    ///
    /// Whether an offer is early enough is as good as random, and a branch for each would be mispredicted as often, with all
    /// that was begun after it: so first the offers of some cells are computed, without a branch, and then those are made
    /// that were early.
    #[inline(always)]
    fn expand<const FAST: bool>(&self, cells: &[u32], offers: &mut [Offers]) -> usize {
        // What comes later than the limit does not count, however much later.
        let most = MOST_TICKS.min((self.limit + 1) as f32);
        let (shift, keys) = (self.shift, &self.keys[..]);
        let shear = &self.medium.shear[self.first..][..keys.len()];
        let mut found = 0;
        for &n in cells {
            let (brick, at) = (n as usize / CELLS, n as usize % CELLS);
            let own = shear[brick].0[at];
            let now = keys[brick].0[at].wrapping_sub(TICKS_ZERO << shift);
            for links in &self.medium.links[at] {
                let to = links.from(brick);
                let (Some(shears), Some(keys)) = (shear.get(to), keys.get(to)) else { continue };
                let (mut due, mut bits) = ([0; CELLS], [0; CELLS]);
                for l in 0..CELLS {
                    let ticks = FrontRules::ticks_above_zero::<FAST>(links.factor[l], own + shears.0[l], most);
                    due[l] = now.wrapping_add(ticks << shift);
                    bits[l] = -i32::from(due[l] < keys.0[l]) & links.open[l];
                }
                let [a, b, c, d, e, f, g, h] = bits;
                let early = (((a | e) | (c | g)) | ((b | f) | (d | h))) as u32;
                offers[found] = Offers { due, brick: to as u32, early };
                found += usize::from(early != 0);
            }
        }
        found
    }

    /// Makes offers to cells of a brick that they do not refuse for being late.
    #[inline(always)]
    fn offer(&mut self, offers: &Offers, ring: &mut Ring) {
        let brick = offers.brick as usize;
        let mut early = offers.early;
        while early != 0 {
            let at = early.trailing_zeros() as usize % CELLS;
            early &= early - 1;
            let (due, held) = (offers.due[at], self.keys[brick].0[at]);
            let [time, before] = [due, held].map(|key| key >> self.shift);
            if due >= held {
                continue;
            }
            if self.latest.is_some_and(|latest| time > latest[brick].0[at]) {
                self.pruned = true;
                continue;
            }
            self.keys[brick].0[at] = due;
            // What waits in that bucket already is not put there twice.
            if self.again || !ring.holds(before, time) {
                ring.put(CELLS * brick + at, time);
            }
        }
    }
}

/// So many cells are looked at before anything is written.
const BATCH: usize = 32;

/// What a cell has to offer to those of one brick.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(32))]
struct Offers {
    due: [i32; CELLS],
    brick: u32,
    /// Bit `l` is set where cell `l` had nothing as early.
    early: u32,
}

/// Buckets are no wider, ticks: times up to 2^32 / [`WIDEST`] after a bucket are then divided exactly.
const WIDEST: i32 = 256;

/// Cells that wait, in a ring of buckets as wide as the quickest link: no offer goes into the bucket that is being emptied, so
/// that all times in it are final, and neighbours that arrive within it are looked at one after the other.
///
/// Buckets begin at multiples of their width, also after a gap in which nothing waits. A seed that is not in the ring yet may
/// have been made earlier within its bucket and then is not put there ([`Ring::holds`]): it comes with the bucket, which
/// therefore has to begin where it would have begun without the gap.
struct Ring {
    buckets: Vec<Vec<u32>>,
    /// The bucket that is being emptied, and the time at which it begins.
    slot: usize,
    base: i32,
    width: i32,
    /// 2^32 / width, rounded up: the quotient without a division.
    reciprocal: u64,
    waiting: usize,
}

impl Ring {
    fn new([quickest, slowest]: [i32; 2]) -> Self {
        let width = quickest.clamp(1, WIDEST);
        let buckets = vec![Vec::new(); (slowest / width) as usize + 2];
        Self { buckets, slot: 0, base: 0, width, reciprocal: (1u64 << 32).div_ceil(width as u64), waiting: 0 }
    }

    /// Goes on to the bucket of time `next`, which is not before the present one. Where that is another, nothing may wait.
    fn begin_at(&mut self, next: i32) {
        self.base += (next - self.base) / self.width * self.width;
    }

    /// How many buckets ahead a time belongs.
    #[inline(always)]
    fn ahead(&self, due: i32) -> i32 {
        (((due - self.base) as u64 * self.reciprocal) >> 32) as i32
    }

    /// Whether the bucket of time `due` is also that of the later time `held`, or a later one than that.
    #[inline(always)]
    fn holds(&self, held: i32, due: i32) -> bool {
        held - self.base < (self.ahead(due) + 1) * self.width
    }

    /// Puts a cell where its time belongs.
    #[inline(always)]
    fn put(&mut self, cell: usize, due: i32) {
        let to = self.slot + self.ahead(due) as usize;
        let to = if to >= self.buckets.len() { to - self.buckets.len() } else { to };
        self.buckets[to].push(cell as u32);
        self.waiting += 1;
    }

    /// Takes back the emptied bucket and goes on to the next.
    fn advance(&mut self, emptied: Vec<u32>) {
        self.buckets[self.slot] = emptied;
        self.base += self.width;
        self.slot = if self.slot + 1 == self.buckets.len() { 0 } else { self.slot + 1 };
    }
}
