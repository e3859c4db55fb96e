//! Order statistics of millions of values in two passes over them where they lie: the first counts them in bins, the second
//! takes out those of the bins that are asked for.

use rayon::prelude::*;

/// Bits that tell values of one bin apart: around 1 a bin is 1/64 wide.
const FINER: u32 = 17;
/// Bins of all single-precision numbers.
const BINS: usize = 1 << (32 - FINER);
/// Values that are looked through together.
const CHUNK: usize = 16;

/// The bin of a value; bins are in the order of the values.
#[inline(always)]
fn bin(value: f32) -> usize {
    place(value) as usize
}

/// The same without a branch and in 32 bits: several are found at a time.
#[inline(always)]
fn place(value: f32) -> u32 {
    let bits = value.to_bits();
    // Negative numbers are ordered backwards.
    let negative = ((bits as i32) >> 31) as u32;
    (bits ^ (negative | 1 << 31)) >> FINER
}

/// Values in a row that are counted apart.
const TURNS: usize = 4;
/// Fewer values are counted by one thread in one place: clearing and adding up more places would take longer.
const MANY: usize = 1 << 17;

/// How many of the values of a sample lie in each bin.
#[derive(Debug, Clone)]
pub struct Bins(Vec<u32>);

impl Bins {
    /// Counts the values in `parts` that are to be kept.
    pub fn of(parts: &[&[f32]], keep: impl Fn(f32) -> bool + Sync) -> Self {
        if parts.iter().map(|values| values.len()).sum::<usize>() < MANY {
            let mut bins = vec![0; BINS];
            parts.iter().flat_map(|values| *values).filter(|v| keep(**v)).for_each(|v| bins[bin(*v)] += 1);
            return Self(bins);
        }
        // Neighbours mostly lie in one bin: counted in one place, each would wait for the one before.
        let count = |mut bins: Vec<[u32; TURNS]>, values: &&[f32]| {
            for values in values.chunks(TURNS) {
                for (turn, v) in values.iter().enumerate().filter(|(_, v)| keep(**v)) {
                    bins[bin(*v)][turn] += 1;
                }
            }
            bins
        };
        let none = || vec![[0; TURNS]; BINS];
        let added = |mut a: Vec<[u32; TURNS]>, b: Vec<[u32; TURNS]>| {
            a.as_flattened_mut().iter_mut().zip(b.as_flattened()).for_each(|(a, b)| *a += b);
            a
        };
        let bins = parts.par_iter().fold(none, count).reduce(none, added);
        Self(bins.into_iter().map(|turns| turns.iter().sum()).collect())
    }

    /// The counts of two samples together.
    pub fn with(mut self, other: &Self) -> Self {
        self.0.iter_mut().zip(&other.0).for_each(|(a, b)| *a += b);
        self
    }

    /// Number of values.
    pub fn count(&self) -> usize {
        self.0.iter().map(|&c| c as usize).sum()
    }

    /// The values of these ranks, from 0, among those in `parts` that were counted; 0 where there is none.
    pub fn ranks<const N: usize>(
        &self,
        ranks: [usize; N],
        parts: &[&[f32]],
        keep: impl Fn(f32) -> bool + Sync,
    ) -> [f32; N] {
        let places = ranks.map(|rank| {
            let (mut before, mut wanted) = (0, 0);
            while wanted + 1 < BINS && before + self.0[wanted] as usize <= rank {
                before += self.0[wanted] as usize;
                wanted += 1;
            }
            (wanted, rank - before)
        });
        let wanted = places.map(|p| p.0);
        let within = |v: f32| wanted.iter().fold(false, |any, w| any | (place(v) == *w as u32));
        let take = |mut held: Vec<f32>, values: &&[f32]| {
            // Most chunks hold none.
            for chunk in values.chunks(CHUNK).filter(|chunk| chunk.iter().fold(false, |any, v| any | within(*v))) {
                held.extend(chunk.iter().filter(|v| within(**v) && keep(**v)));
            }
            held
        };
        let joined = |mut a: Vec<f32>, b: Vec<f32>| {
            a.extend(b);
            a
        };
        let held = parts.par_iter().fold(Vec::new, take).reduce(Vec::new, joined);
        places.map(|(wanted, rank)| {
            let mut held: Vec<f32> = held.iter().copied().filter(|v| bin(*v) == wanted).collect();
            if rank < held.len() { *held.select_nth_unstable_by(rank, f32::total_cmp).1 } else { 0.0 }
        })
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "the same values, found in another way")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn ranks_are_those_of_sorted_values(
            mut values in prop::collection::vec(prop_oneof![any::<i16>().prop_map(f32::from), -1e-3f32..1e-3, 0.99f32..1.01], 1..300),
            width in 1usize..9, rank in 0usize..400,
        ) {
            let (above, all) = (|v: f32| v > -0.5, |_: f32| true);
            let parts: Vec<&[f32]> = values.chunks(width).collect();
            let bins = Bins::of(&parts, above);
            let [least, one] = bins.ranks([0, rank], &parts, above);
            let [greatest] = Bins::of(&parts, all).ranks([values.len() - 1], &parts, all);
            prop_assert_eq!(bins.clone().with(&bins).count(), 2 * bins.count());
            prop_assert_eq!(greatest, values.iter().copied().fold(f32::MIN, f32::max));
            values.retain(|v| above(*v));
            values.sort_by(f32::total_cmp);
            prop_assert_eq!(bins.count(), values.len());
            let at = |n: usize| values.get(n).copied().unwrap_or(0.0);
            prop_assert_eq!([least, one], [at(0), at(rank)]);
        }
    }
}
