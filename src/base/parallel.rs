//! Rank 0: work on all threads, with one copy of the machinery for each type of value instead of one for each closure.
//!
//! Half of what the compiler had to do was rayon's machinery for loops that differ in their closure alone. A closure is called once
//! for each part of the work here, so that the loop inside it is as quick as any.

use rayon::prelude::*;

/// Calls `fill` with each part of `out`, `length` values long but for the last, and the place of its first value.
pub fn fill<T: Send>(out: &mut [T], length: usize, fill: &(dyn Fn(usize, &mut [T]) + Sync)) {
    let length = length.max(1);
    out.par_chunks_mut(length).enumerate().for_each(|(n, part)| fill(n * length, part));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_value_is_made_once_in_its_place() {
        for (count, length) in [(0, 4), (1, 4), (7, 3), (9, 3), (5, 0)] {
            let mut out = vec![0; count];
            fill(&mut out, length, &|start, part| part.iter_mut().enumerate().for_each(|(n, v)| *v += start + n));
            assert_eq!(out, (0..count).collect::<Vec<_>>());
        }
    }
}
