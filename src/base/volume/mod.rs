//! Rank 2: values on a grid, as flat arrays with `i` fastest.

mod blocks;
pub mod components;
pub mod contour;
pub mod distance;
pub mod extent;
pub mod interpolation;
pub mod label;
pub mod morphology;
mod outline;
pub mod ranges;
pub mod region;
pub mod signed;
mod smooth;
mod spans;
mod window;

pub use blocks::{COARSE_MM, block_means, block_within, blocks, blur_after};
pub use interpolation::{Surrounding, axis_pairs, cubic, place, trilinear, trilinear_vector};
pub use label::{LabelMap, LabelSpans};
pub use outline::{AROUND_MM, Outline};
pub use smooth::{Counted, gaussian, gaussian_ratio};
pub use spans::Spans;
pub use window::Window;

use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::parallel;
use ndarray::{ArrayView3, ShapeBuilder};
use rayon::prelude::*;
use std::sync::Arc;

/// Values on a [`Grid`], `i` fastest in storage. Clones share their values until one of them is written to.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume<T> {
    grid: Grid,
    data: Arc<Vec<T>>,
}

/// Voxels that one thread takes at least: fewer are not worth handing over.
const LEAST: usize = 1 << 14;

/// A yes or no for each voxel.
pub type Mask = Volume<bool>;

impl<T> Volume<T> {
    /// A volume from its grid and values in storage order.
    ///
    /// # Errors
    /// When the number of values is not the number of voxels.
    pub fn new(grid: Grid, data: Vec<T>) -> Result<Self> {
        if grid.len() != data.len() {
            return Err(Error::Internal(format!("{} values for a grid of {:?}", data.len(), grid.size())));
        }
        Ok(Self::of(grid, data))
    }

    /// A volume of as many values as the grid has voxels.
    fn of(grid: Grid, data: Vec<T>) -> Self {
        Self { grid, data: Arc::new(data) }
    }

    /// A volume with `value(storage position)` everywhere.
    pub fn from_fn(grid: Grid, value: impl Fn(usize) -> T + Sync + Send) -> Self
    where
        T: Clone + Default + Send,
    {
        let mut data = vec![T::default(); grid.len()];
        parallel::fill(&mut data, LEAST, &|start, part| {
            part.iter_mut().zip(start..).for_each(|(to, n)| *to = value(n));
        });
        Self::of(grid, data)
    }

    /// The grid.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }
    /// The values in storage order.
    pub fn data(&self) -> &[T] {
        &self.data
    }
    /// The values in storage order, writable: a copy of them where a clone shares them.
    pub fn data_mut(&mut self) -> &mut [T]
    where
        T: Clone,
    {
        Arc::make_mut(&mut self.data).as_mut_slice()
    }
    /// The values, without their grid: a copy of them where a clone shares them.
    pub fn into_data(self) -> Vec<T>
    where
        T: Clone,
    {
        Arc::unwrap_or_clone(self.data)
    }
    /// The same values, moved by a vector, LPS mm.
    pub fn shifted(self, by: &nalgebra::Vector3<f64>) -> Self {
        Self { grid: self.grid.shifted(by), data: self.data }
    }
    /// The value of a voxel.
    pub fn at(&self, voxel: [usize; 3]) -> &T {
        &self.data[self.grid.linear(voxel)]
    }
    /// A volume of the same grid with `f` of each value.
    pub fn map<U: Clone + Default + Send>(&self, f: impl Fn(&T) -> U + Sync + Send) -> Volume<U>
    where
        T: Sync,
    {
        let values = self.data();
        let mut data = vec![U::default(); values.len()];
        parallel::fill(&mut data, LEAST, &|start, part| {
            part.iter_mut().zip(&values[start..]).for_each(|(to, from)| *to = f(from));
        });
        Volume::of(self.grid.clone(), data)
    }
    /// The values as an ndarray view of shape (i, j, k).
    pub fn view(&self) -> ArrayView3<'_, T> {
        let [ni, nj, nk] = self.grid.size();
        ArrayView3::from_shape((ni, nj, nk).f(), &self.data).expect("length was checked on construction")
    }
}

impl<T: Clone> Volume<T> {
    /// A volume with one value everywhere.
    pub fn filled(grid: Grid, value: T) -> Self {
        let data = vec![value; grid.len()];
        Self::of(grid, data)
    }
}

impl Volume<f32> {
    /// Smallest and largest value; values that are no number are passed over.
    pub fn extremes(&self) -> [f32; 2] {
        const LANES: usize = 16;
        const EMPTY: [f32; 2] = [f32::INFINITY, f32::NEG_INFINITY];
        let wider = |[low, high]: [f32; 2], [l, h]: [f32; 2]| [low.min(l), high.max(h)];
        let of_part = |part: &[f32]| {
            // Comparisons lane by lane become vector instructions; a fold of `f32::max` does not.
            let (mut low, mut high) = ([EMPTY[0]; LANES], [EMPTY[1]; LANES]);
            let (blocks, rest) = part.as_chunks::<LANES>();
            for block in blocks {
                for l in 0..LANES {
                    low[l] = if block[l] < low[l] { block[l] } else { low[l] };
                    high[l] = if block[l] > high[l] { block[l] } else { high[l] };
                }
            }
            let lanes = low.into_iter().zip(high).map(|(l, h)| [l, h]);
            lanes.chain(rest.iter().map(|&v| [v, v])).fold(EMPTY, wider)
        };
        self.data.par_chunks(1 << 16).map(of_part).reduce(|| EMPTY, wider)
    }
}

impl Mask {
    /// Number of voxels that are set.
    pub fn count(&self) -> usize {
        self.data.par_iter().with_min_len(LEAST).filter(|&&v| v).count()
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values that are exact by construction")]
mod tests {
    use super::*;

    #[test]
    fn extremes_are_found_wherever_they_lie_and_past_what_is_no_number() {
        let grid = Grid::axis_aligned([17, 11, 7], [1.0; 3], [0.0; 3]).unwrap();
        for (low, high) in [(0, 1308), (1308, 0), (700, 16), (1307, 1306)] {
            let mut v = Volume::from_fn(grid.clone(), |n| (n % 13) as f32);
            (v.data_mut()[low], v.data_mut()[high], v.data_mut()[333]) = (-4.5, 99.25, f32::NAN);
            assert_eq!(v.extremes(), [-4.5, 99.25]);
        }
    }
}
