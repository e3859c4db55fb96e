//! A wave as a shortest path search: Dial's algorithm with buckets as wide as they may be (Dinitz), over the cells of a
//! [`Medium`] or of some of its planes.

use super::arrival::{Medium, SPAN};
use super::front::{FrontRules, LinkTime, MOST_TICKS};
use crate::geometry::vectorised;
use std::ops::Range;

/// A wave on its way.
///
/// A cell's key is when the wave comes to it, and below that from which bone: time shifted by some bits, or'ed with the bone.
/// The least key is the least time, and of equal times the first bone, without asking for either.
pub(super) struct Search<'a> {
    medium: &'a Medium,
    /// The first cell that is looked at.
    pub(super) first: usize,
    /// Cells that hand on what they are told, counted from the first.
    pub(super) own: Range<usize>,
    /// Key of each cell.
    pub(super) keys: Vec<i32>,
    /// Bits of a key below its time.
    shift: u32,
    /// Latest time that counts.
    pub(super) limit: i32,
    latest: Option<&'a [i32]>,
    /// Cells that were told something and do not hand it on.
    pub(super) told: Vec<u32>,
    /// Whether cells may have handed on already what now changes.
    again: bool,
}

impl<'a> Search<'a> {
    /// Before the wave: `cells` are looked at, all of which hand on. `latest`: a time for each cell, after which the wave does
    /// not enter it.
    pub(super) fn new(medium: &'a Medium, cells: Range<usize>, latest: Option<&'a [i32]>) -> Self {
        let own = 0..cells.len();
        // Room at the end for the last row's span.
        let keys = medium.rest[cells.start..cells.end + SPAN].to_vec();
        let (limit, told) = (medium.limit, Vec::new());
        Self { medium, first: cells.start, own, keys, shift: 0, limit, latest, told, again: false }
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

    /// Only these cells hand on what they are told.
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
        let shift = self.shift;
        let mut seeds = seeds.iter().map(|&(key, cell)| (key >> shift, cell)).peekable();
        while let Some(next) = if ring.waiting > 0 { Some(ring.base) } else { seeds.peek().map(|s| s.0) } {
            if next > self.limit {
                break;
            }
            ring.base = next;
            let mut bucket = std::mem::take(&mut ring.buckets[ring.slot]);
            ring.waiting -= bucket.len();
            while let Some(seed) = seeds.next_if(|s| s.0 < ring.base + ring.width) {
                bucket.push(seed.1);
            }
            for n in bucket.drain(..) {
                let cell = n as usize;
                let now = self.keys[cell] >> shift;
                // A time before this bucket was dealt with in its own.
                if now < ring.base || now > self.limit {
                    continue;
                }
                if self.own.contains(&cell) {
                    self.expand::<FAST>(cell, &mut ring);
                } else {
                    self.told.push(n);
                }
            }
            ring.advance(bucket);
        }
    }

    /// Offers the time of a settled cell to its neighbours.
    ///
    /// Whether an offer is early enough is as good as random, so that a branch for each would cost more than to compute a
    /// row's four at a time and ask once.
    #[inline(always)]
    fn expand<const FAST: bool>(&mut self, n: usize, ring: &mut Ring) {
        let (now, shift) = (self.keys[n], self.shift);
        // What comes later than the limit does not count, however much later.
        let most = MOST_TICKS.min((self.limit + 1) as f32);
        let all = &self.medium.shear[self.first..];
        let shear = all[n];
        for row in &self.medium.rows {
            let first = n.wrapping_add_signed(row.offset);
            let shears = all.get(first..).and_then(|s| s.first_chunk::<SPAN>());
            let keys = self.keys.get(first..).and_then(|t| t.first_chunk::<SPAN>());
            let (Some(shears), Some(keys)) = (shears, keys) else { continue };
            let mut due = [0; SPAN];
            let mut early = 0;
            for l in 0..SPAN {
                let ticks = FrontRules::ticks_of::<FAST>(row.factor[l], shear + shears[l], most);
                due[l] = now + ((ticks as i32) << shift);
                early |= u32::from(due[l] < keys[l]) << l;
            }
            early &= row.open;
            while early != 0 {
                let l = early.trailing_zeros() as usize;
                early &= early - 1;
                self.offer(first + l, due[l % SPAN], ring);
            }
        }
    }

    /// Makes an offer to a neighbour that it will not refuse for being late.
    #[inline(always)]
    fn offer(&mut self, cell: usize, due: i32, ring: &mut Ring) {
        let [held, time] = [self.keys[cell], due].map(|key| key >> self.shift);
        if self.latest.is_some_and(|latest| time > latest[cell]) {
            return;
        }
        self.keys[cell] = due;
        // What waits in that bucket already is not put there twice.
        if self.again || !ring.holds(held, time) {
            ring.put(cell, time);
        }
    }
}

/// Buckets are no wider, ticks: times up to 2^32 / [`WIDEST`] after a bucket are then divided exactly.
const WIDEST: i32 = 256;

/// Cells that wait, in a ring of buckets as wide as the quickest link: no offer goes into the bucket that is being emptied, so
/// that all times in it are final, and neighbours that arrive within it are looked at one after the other.
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
