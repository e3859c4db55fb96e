//! A structure by itself: a mask on the part of a scan's grid around it, so that structures may lie over each other.

use super::region::part;
use super::{LabelMap, Mask, Volume};
use nalgebra::Vector3;
use std::ops::Range;

/// How far around a structure its mask goes, as far as its scan does, mm.
pub const AROUND_MM: f64 = 40.0;

/// A structure with the voxels that lie in it.
#[derive(Debug, Clone)]
pub struct Outline {
    /// Its name.
    pub name: String,
    /// Its voxels, on the part of its scan's grid that lies within [`AROUND_MM`] of them; LPS mm.
    pub inside: Mask,
}

impl Outline {
    /// Of the voxels whose value satisfies `inside`; `None` when there are none.
    pub fn of<T: Copy + Sync>(
        name: &str,
        volume: &Volume<T>,
        inside: impl Fn(T) -> bool + Send + Sync,
    ) -> Option<Self> {
        let grid = volume.grid();
        let mut found: Option<[Range<usize>; 3]> = None;
        for (n, _) in volume.data().iter().enumerate().filter(|(_, v)| inside(**v)) {
            let at = grid.voxel(n);
            let known = found.unwrap_or_else(|| at.map(|c| c..c + 1));
            found = Some(std::array::from_fn(|a| known[a].start.min(at[a])..known[a].end.max(at[a] + 1)));
        }
        let own = found?;
        let around: [Range<usize>; 3] = std::array::from_fn(|a| {
            let more = (AROUND_MM / grid.spacing()[a]).ceil() as usize;
            own[a].start.saturating_sub(more)..(own[a].end + more).min(grid.size()[a])
        });
        let inside = part(volume, &around).ok()?.map(|v| inside(*v));
        Some(Self { name: name.to_owned(), inside })
    }

    /// The named structures of a label map that have voxels, in the order of their labels.
    pub fn all(map: &LabelMap) -> Vec<Self> {
        map.names.iter().filter_map(|(label, name)| Self::of(name, &map.volume, |l| l == *label)).collect()
    }

    /// Whether the edge of its scan cuts it.
    pub fn is_cut(&self) -> bool {
        let (grid, size) = (self.inside.grid(), self.inside.grid().size());
        let on_edge = |n: usize| grid.voxel(n).iter().zip(size).any(|(&c, size)| c == 0 || c + 1 == size);
        self.inside.data().iter().enumerate().any(|(n, inside)| *inside && on_edge(n))
    }

    /// Its volume, ml.
    pub fn volume_ml(&self) -> f64 {
        self.inside.count() as f64 * self.inside.grid().voxel_volume() / 1000.0
    }

    /// The same elsewhere.
    #[must_use]
    pub fn shifted(self, by: &Vector3<f64>) -> Self {
        Self { inside: self.inside.shifted(by), ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn a_structure_keeps_its_place_and_says_when_its_scan_cuts_it() {
        let grid = Grid::axis_aligned([60, 12, 12], [4.0; 3], [10.0, 0.0, -5.0]).unwrap();
        let ball = |x: usize| {
            Volume::from_fn(grid.clone(), |n| {
                let [i, j, k] = grid.voxel(n);
                i.abs_diff(x) < 3 && (4..8).contains(&j) && (4..8).contains(&k)
            })
        };
        let outline = Outline::of("gland", &ball(30), |v| v).unwrap();
        assert!(!outline.is_cut() && outline.inside.grid().size() == [25, 12, 12]);
        assert!((outline.volume_ml() - 5.0 * 16.0 * 0.064).abs() < 1e-9);
        let held: Vec<_> = (0..outline.inside.data().len()).filter(|&n| outline.inside.data()[n]).collect();
        for n in held {
            let at = outline.inside.grid().centre(outline.inside.grid().voxel(n));
            assert!(*ball(30).at(grid.voxel_at(&at).unwrap()));
        }
        assert!(Outline::of("gland", &ball(1), |v| v).unwrap().is_cut());
        assert!(Outline::of("gland", &ball(30), |_| false).is_none());
    }
}
