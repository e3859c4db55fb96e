//! Connected components of equal values, found by joining runs along the first axis.

use super::{Mask, Volume};
use std::cmp::Ordering;
use std::ops::Range;

/// Which voxels touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Connectivity {
    /// Voxels that share a face (6 neighbours).
    Face,
    /// Voxels that share at least a corner (26 neighbours).
    Corner,
}

/// A stretch of voxels of one component along the first axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Run {
    /// Storage position of the first voxel.
    pub start: usize,
    /// Storage position after the last voxel.
    pub end: usize,
    /// The component it belongs to.
    pub component: usize,
}

/// The connected components of a volume, numbered in storage order of their first voxel.
#[derive(Debug, Clone)]
pub struct Components<T> {
    /// All runs, in storage order.
    pub runs: Vec<Run>,
    /// Value of each component.
    pub values: Vec<T>,
    /// Number of voxels of each component.
    pub sizes: Vec<usize>,
}

impl<T: Copy + PartialEq> Components<T> {
    /// Components of equal values other than `background`.
    pub fn of(volume: &Volume<T>, background: T, connectivity: Connectivity) -> Self {
        let (mut runs, rows) = runs(volume, background);
        let value = |r: &Run| volume.data()[r.start];
        let [ni, nj, nk] = volume.grid().size();
        // ComponentRows (j, k) that come earlier in storage, as steps back in k and in j.
        let (slack, earlier) = match connectivity {
            Connectivity::Face => (0, &[(0, 1), (1, 0)][..]),
            Connectivity::Corner => (1, &[(0, 1), (1, 0), (1, 1), (1, -1)][..]),
        };
        for (k, j) in (0..nk).flat_map(|k| (0..nj).map(move |j| (k, j))) {
            for &(dk, dj) in earlier {
                let other_j = j.wrapping_add_signed(-dj);
                if k >= dk && other_j < nj {
                    let (row, other) = (j + nj * k, other_j + nj * (k - dk));
                    let pair = ComponentRows { shift: (row - other) * ni, slack };
                    pair.join(&mut runs, rows[other]..rows[other + 1], rows[row]..rows[row + 1], value);
                }
            }
        }
        Self::number(runs, value)
    }

    /// Gives consecutive numbers to the trees of joined runs.
    fn number(mut runs: Vec<Run>, value: impl Fn(&Run) -> T) -> Self {
        let (mut values, mut sizes) = (Vec::new(), Vec::new());
        for n in 0..runs.len() {
            // A tree's root is its earliest run, so that it was numbered before.
            let parent = runs[n].component;
            let component = if parent == n {
                values.push(value(&runs[n]));
                sizes.push(0);
                values.len() - 1
            } else {
                runs[parent].component
            };
            runs[n].component = component;
            sizes[component] += runs[n].end - runs[n].start;
        }
        Self { runs, values, sizes }
    }

    /// Number of components.
    pub fn len(&self) -> usize {
        self.sizes.len()
    }
    /// Whether there is no component at all.
    pub fn is_empty(&self) -> bool {
        self.sizes.is_empty()
    }
    /// The component with most voxels (the first among equals); `None` without components.
    pub fn largest(&self) -> Option<usize> {
        (0..self.len()).rev().max_by_key(|&c| self.sizes[c])
    }
    /// Mask of the components that `keep` accepts, on the grid of `like`.
    pub fn select<U>(&self, like: &Volume<U>, keep: impl Fn(usize) -> bool) -> Mask {
        let mut out = Volume::filled(like.grid().clone(), false);
        for run in self.runs.iter().filter(|r| keep(r.component)) {
            out.data_mut()[run.start..run.end].fill(true);
        }
        out
    }
}

/// All runs, each its own component, and the number of the first run of every row (one more entry at the end).
fn runs<T: Copy + PartialEq>(volume: &Volume<T>, background: T) -> (Vec<Run>, Vec<usize>) {
    let ni = volume.grid().size()[0];
    let mut runs: Vec<Run> = Vec::new();
    let mut rows = Vec::with_capacity(volume.data().len() / ni + 1);
    for (n, row) in volume.data().chunks(ni).enumerate() {
        rows.push(runs.len());
        let mut start = 0;
        for part in row.chunk_by(|a, b| a == b) {
            let end = start + part.len();
            if part[0] != background {
                runs.push(Run { start: n * ni + start, end: n * ni + end, component: runs.len() });
            }
            start = end;
        }
    }
    rows.push(runs.len());
    (runs, rows)
}

/// Two rows: their distance in storage, and the number of voxels by which touching runs may miss each other.
struct ComponentRows {
    shift: usize,
    slack: usize,
}

impl ComponentRows {
    /// Joins the runs `a` of the earlier and `b` of the later row that touch and have the same value.
    fn join<T: PartialEq>(
        &self,
        runs: &mut [Run],
        mut a: Range<usize>,
        mut b: Range<usize>,
        value: impl Fn(&Run) -> T,
    ) {
        let Self { shift, slack } = *self;
        let mut join_one = |m: usize, n: usize| {
            let (p, q) = (runs[m], runs[n]);
            let touch = p.start + shift < q.end + slack && q.start < p.end + shift + slack;
            if touch && value(&p) == value(&q) {
                let (x, y) = (root(runs, m), root(runs, n));
                runs[x.max(y)].component = x.min(y);
            }
            (p.end + shift).cmp(&q.end)
        };
        while !a.is_empty() && !b.is_empty() {
            match join_one(a.start, b.start) {
                Ordering::Less => a.start += 1,
                Ordering::Greater => b.start += 1,
                Ordering::Equal => {
                    // Runs that end together may each still touch the other row's next run by a corner.
                    if b.len() > 1 {
                        join_one(a.start, b.start + 1);
                    }
                    a.start += 1;
                }
            }
        }
    }
}

/// Root of a run's tree; halves the path on the way.
fn root(runs: &mut [Run], mut n: usize) -> usize {
    while runs[n].component != n {
        runs[n].component = runs[runs[n].component].component;
        n = runs[n].component;
    }
    n
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use crate::geometry::stencil::{NEIGHBOURS_6, NEIGHBOURS_26};
    use proptest::prelude::*;

    /// Component numbers by flood fill in storage order.
    fn flood(volume: &Volume<u16>, offsets: &[[i32; 3]]) -> (Vec<Option<usize>>, usize) {
        let grid = volume.grid();
        let mut out = vec![None; grid.len()];
        let mut count = 0;
        for seed in 0..grid.len() {
            if volume.data()[seed] == 0 || out[seed].is_some() {
                continue;
            }
            let mut stack = vec![seed];
            out[seed] = Some(count);
            while let Some(l) = stack.pop() {
                let v = grid.voxel(l);
                for d in offsets {
                    let w: [i32; 3] = std::array::from_fn(|a| v[a] as i32 + d[a]);
                    if (0..3).all(|a| (0..grid.size()[a] as i32).contains(&w[a])) {
                        let m = grid.linear(w.map(|c| c as usize));
                        if out[m].is_none() && volume.data()[m] == volume.data()[l] {
                            out[m] = Some(count);
                            stack.push(m);
                        }
                    }
                }
            }
            count += 1;
        }
        (out, count)
    }

    proptest! {
        #[test]
        fn equals_flood_fill(size in prop::array::uniform3(1usize..8),
                             values in prop::collection::vec(0u16..3, 512)) {
            let grid = Grid::axis_aligned(size, [1.0; 3], [0.0; 3]).unwrap();
            let volume = Volume::from_fn(grid, |l| values[l]);
            let both = [(Connectivity::Face, &NEIGHBOURS_6[..]), (Connectivity::Corner, &NEIGHBOURS_26[..])];
            for (connectivity, offsets) in both {
                let (expected, count) = flood(&volume, offsets);
                let got = Components::of(&volume, 0, connectivity);
                let mut numbers = vec![None; expected.len()];
                for run in &got.runs {
                    numbers[run.start..run.end].fill(Some(run.component));
                }
                prop_assert_eq!(&numbers, &expected);
                prop_assert_eq!(got.len(), count);
                for c in 0..count {
                    prop_assert_eq!(got.sizes[c], expected.iter().filter(|e| **e == Some(c)).count());
                }
            }
        }
    }

    #[test]
    fn largest_is_selected() {
        let grid = Grid::axis_aligned([6, 1, 1], [1.0; 3], [0.0; 3]).unwrap();
        let mask = Volume::new(grid, vec![true, false, true, true, false, true]).unwrap();
        let parts = Components::of(&mask, false, Connectivity::Face);
        assert_eq!(parts.largest(), Some(1));
        assert_eq!(parts.select(&mask, |c| c == 1).data(), [false, false, true, true, false, false]);
        let none = Components::of(&mask.map(|_| false), false, Connectivity::Face);
        assert!(none.is_empty() && none.largest().is_none());
    }
}
