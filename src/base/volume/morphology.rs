//! Masks that grow and shrink by a ball of millimetres on anisotropic grids, 64 voxels of a row at a time.
//!
//! A ball is a stack of rows of voxels, each as long as the ball is wide there. MorphologyRows of bits are widened voxel by voxel, and each
//! width goes to the rows at whose distance the ball has it.
//!
//! Nothing is known outside the image: its edge is neither foreground nor background, so that a patient who is
//! cut by the edge is not eroded there.

use super::{Mask, Volume};
use rayon::prelude::*;

/// Voxels in a word.
const BITS: usize = u64::BITS as usize;

/// All voxels within `radius` mm of the mask, centre to centre.
pub fn dilate(mask: &Mask, radius: f64) -> Mask {
    grown(mask, true, radius).unpacked(mask, true)
}

/// All voxels of the mask farther than `radius` mm from its outside. The image's edge is not outside.
pub fn erode(mask: &Mask, radius: f64) -> Mask {
    grown(mask, false, radius).unpacked(mask, false)
}

/// MorphologyRows of voxels, row after row in storage, each from a word of its own on.
struct MorphologyRows {
    words: Vec<u64>,
    /// Words of a row.
    length: usize,
    /// The voxels in the last word of a row.
    tail: u64,
}

impl MorphologyRows {
    /// The voxels whose value is `target`.
    fn packed(mask: &Mask, target: bool) -> Self {
        let ni = mask.grid().size()[0];
        let length = ni.div_ceil(BITS);
        let tail = u64::MAX >> (length * BITS - ni);
        let mut words = vec![0; mask.data().len() / ni * length];
        words.par_chunks_mut(length).zip(mask.data().par_chunks(ni)).for_each(|(row, voxels)| {
            for (word, voxels) in row.iter_mut().zip(voxels.chunks(BITS)) {
                *word = voxels.iter().rev().fold(0, |word, v| word << 1 | u64::from(*v == target));
            }
        });
        Self { words, length, tail }
    }

    /// A mask of the same grid as `like`: `set` where the bit is.
    fn unpacked(&self, like: &Mask, set: bool) -> Mask {
        let ni = like.grid().size()[0];
        let mut out = vec![false; like.data().len()];
        out.par_chunks_mut(ni).zip(self.words.par_chunks(self.length)).for_each(|(voxels, row)| {
            for (voxels, word) in voxels.chunks_mut(BITS).zip(row) {
                for (n, v) in voxels.iter_mut().enumerate() {
                    *v = (word >> n & 1 == 1) == set;
                }
            }
        });
        Volume::of(like.grid().clone(), out)
    }

    /// Each row by a voxel to both sides.
    fn widen(&mut self) {
        self.words.par_chunks_mut(self.length).with_min_len(256).for_each(|row| {
            let mut before = 0;
            for n in 0..row.len() {
                let (word, after) = (row[n], row.get(n + 1).copied().unwrap_or(0));
                row[n] = word | word << 1 | before >> (BITS - 1) | word >> 1 | after << (BITS - 1);
                before = word;
            }
            if let Some(last) = row.last_mut() {
                *last &= self.tail;
            }
        });
    }
}

/// The voxels within `radius` mm of one whose value is `target`.
fn grown(mask: &Mask, target: bool, radius: f64) -> MorphologyRows {
    let [ni, nj, nk] = mask.grid().size();
    let [si, sj, sk] = mask.grid().spacing();
    // With room for rounding, so that a radius of whole voxels counts as reached.
    let limit = radius * radius * (1.0 + 1e-5);
    let reach = |n: usize, step: f64| ((limit.sqrt() / step) as usize).min(n - 1) as isize;
    let (reach_j, reach_k) = (reach(nj, sj), reach(nk, sk));
    // MorphologyRows at which the ball has each half width, in voxels.
    let mut of_width: Vec<Vec<[isize; 2]>> = Vec::new();
    for k in -reach_k..=reach_k {
        for j in -reach_j..=reach_j {
            let rest = limit - (j as f64 * sj).powi(2) - (k as f64 * sk).powi(2);
            if rest >= 0.0 {
                // Wider than the image is as wide as it.
                let width = ((rest.sqrt() / si) as usize).min(ni - 1);
                of_width.resize(of_width.len().max(width + 1), Vec::new());
                of_width[width].push([j, k]);
            }
        }
    }
    let mut wide = MorphologyRows::packed(mask, target);
    let (length, plane) = (wide.length, nj * wide.length);
    let mut out = MorphologyRows { words: vec![0; wide.words.len()], ..wide };
    for (width, rows) in of_width.iter().enumerate() {
        if width > 0 {
            wide.widen();
        }
        out.words.par_chunks_mut(plane).enumerate().for_each(|(k, out)| {
            for &[dj, dk] in rows {
                let Some(from) = k.checked_add_signed(dk).filter(|k| *k < nk) else { continue };
                // MorphologyRows that lie in the image at both ends of the way.
                let (first, last) = ((-dj).max(0) as usize, nj - dj.max(0) as usize);
                let source = &wide.words[from * plane + first.saturating_add_signed(dj) * length..];
                for (o, w) in out[first * length..last * length].iter_mut().zip(source) {
                    *o |= w;
                }
            }
        });
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use crate::volume::distance::tests::{brute, scene};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn grows_and_shrinks_by_what_lies_within_the_radius(mask in scene(), radius in 0.3f64..9.0) {
            let (near, inner) = (brute(&mask, true), brute(&mask, false));
            let limit = radius * radius;
            for (l, (dilated, eroded)) in dilate(&mask, radius).data().iter().zip(erode(&mask, radius).data()).enumerate() {
                // Rounding may decide on the sphere itself.
                prop_assert!(*dilated == (near[l] <= limit) || (near[l] / limit - 1.0).abs() < 2e-5);
                prop_assert!(*eroded == (inner[l] > limit) || (inner[l] / limit - 1.0).abs() < 2e-5);
            }
        }

        #[test]
        fn opening_shrinks_and_closing_grows(mask in scene(), radius in 0.3f64..5.0) {
            let (opened, closed) = (dilate(&erode(&mask, radius), radius), erode(&dilate(&mask, radius), radius));
            for ((&m, &o), &c) in mask.data().iter().zip(opened.data()).zip(closed.data()) {
                prop_assert!((m || !o) && (c || !m));
            }
        }
    }

    #[test]
    fn rows_longer_than_a_word_grow_across_it_and_not_beyond_their_end() {
        for ni in [63, 64, 65, 128, 130, 200] {
            let grid = Grid::axis_aligned([ni, 3, 1], [1.0, 2.0, 3.0], [0.0; 3]).unwrap();
            for at in [0, 1, 62, 63, 64, ni - 1].into_iter().filter(|at| *at < ni) {
                let mask = Volume::from_fn(grid.clone(), |l| l == at + ni);
                let got = dilate(&mask, 3.0);
                for (l, got) in got.data().iter().enumerate() {
                    let [i, j, _] = grid.voxel(l);
                    let far = (i as f64 - at as f64).hypot(2.0 * (j as f64 - 1.0));
                    assert_eq!(*got, far <= 3.0, "{ni} {at} {i} {j}");
                }
            }
        }
    }

    #[test]
    fn opening_cuts_a_sheet_and_keeps_what_the_image_edge_cuts() {
        // A block that leaves the image at i = 0, with a sheet of one voxel standing on it.
        let grid = Grid::axis_aligned([30, 20, 10], [1.0, 1.0, 3.0], [0.0; 3]).unwrap();
        let inside = |[i, j, _]: [usize; 3]| (i < 15 && (4..16).contains(&j)) || j == 10;
        let mask = Volume::from_fn(grid.clone(), |l| inside(grid.voxel(l)));
        let opened = dilate(&erode(&mask, 3.0), 3.0);
        assert!(opened.at([0, 4, 5]) & opened.at([0, 10, 0]) & opened.at([13, 10, 5]));
        assert!(!opened.at([20, 10, 5]) && !opened.at([16, 10, 5]));
    }
}
