//! Where a push field is anything at all: beyond, it moves nothing and holds no tissue, and what comes to lie there is what was there.

use super::super::PushField;
use crate::geometry::vectorised;
use crate::volume::extent::{extent, union};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::ops::Range;

/// Rows of a field that are looked at for one row of places; a row that crosses more of them is not looked at at all.
const MOST_ROWS: usize = 16;
/// Indices this near to the edge may be taken for either side of it.
const ROUNDING: f64 = 1e-3;
/// Places more at either end: what rounding could take across.
const MARGIN: f64 = 1.0;

/// The extents of a push field's rows.
pub(in crate::field) struct Reach {
    size: [usize; 3],
    /// From the first to the last voxel of each row that is moved or was computed.
    rows: Vec<Range<usize>>,
}

impl Reach {
    pub(in crate::field) fn new(push: &PushField) -> Self {
        let size = push.displacement.grid().size();
        let rows = push.displacement.data().par_chunks(size[0]).zip(push.computed.data().par_chunks(size[0]));
        let of_row = |(moved, computed): (&[[f32; 3]], &[bool])| {
            vectorised(
                #[inline(always)]
                || {
                    // All bits but the sign's.
                    let bits = |any: u32, c: &f32| any | (c.to_bits() << 1);
                    let moved = extent(moved, |part| part.as_flattened().iter().fold(0, bits) != 0);
                    union(&moved, &extent(computed, |part| part.iter().fold(false, |any, set| any | set)))
                },
            )
        };
        Self { size, rows: rows.map(of_row).collect() }
    }

    /// Those of `places` places, `along` apart from `first` on in indices of the field's grid, where the field, continued by its edge
    /// values, may be something.
    pub(in crate::field) fn of_places(
        &self,
        first: &Vector3<f64>,
        along: &Vector3<f64>,
        places: usize,
    ) -> Range<usize> {
        let all = 0..places;
        let last = first + along * (places.max(1) - 1) as f64;
        let (low, high) = (first.inf(&last), first.sup(&last));
        let most = self.size.map(|n| (n - 1) as f64);
        let of_axis =
            |a: usize| low[a].clamp(0.0, most[a]).floor() as usize..=high[a].clamp(0.0, most[a]).ceil() as usize;
        if of_axis(1).count() * of_axis(2).count() > MOST_ROWS {
            return all;
        }
        let rows = of_axis(2).flat_map(|k| of_axis(1).map(move |j| (j, k)));
        let span = rows.fold(0..0, |span, (j, k)| union(&span, &self.rows[j + k * self.size[1]]));
        if span.is_empty() {
            return 0..0;
        }
        // What lies at an edge goes on beyond it.
        let from = if span.start == 0 { f64::NEG_INFINITY } else { span.start as f64 - 1.0 };
        let to = if span.end == self.size[0] { f64::INFINITY } else { span.end as f64 };
        let place = |index: f64| (index - first.x) / along.x;
        let (a, b) = (place(from), place(to));
        if a.is_nan() || b.is_nan() {
            return all;
        }
        let (start, end) = (a.min(b).floor() - MARGIN, a.max(b).ceil() + MARGIN + 1.0);
        // Negative places become 0.
        let end = (end as usize).min(places);
        (start as usize).min(end)..end
    }

    /// Whether places from `first` to `last`, indices of the field's grid, lie within it, however they are rounded.
    pub(in crate::field) fn holds(&self, first: &Vector3<f64>, last: &Vector3<f64>) -> bool {
        (0..3).all(|a| [first, last].iter().all(|p| p[a] >= ROUNDING && p[a] <= (self.size[a] - 1) as f64 - ROUNDING))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use crate::volume::{Volume, trilinear_vector};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn beyond_the_reach_the_field_is_nothing(
            voxels in prop::collection::vec(0usize..30 * 9 * 7, 0..4), first in prop::array::uniform3(-0.2f64..1.1),
            last in prop::array::uniform3(-0.2f64..1.1), level in any::<bool>(), places in 1usize..60,
        ) {
            let grid = Grid::axis_aligned([30, 9, 7], [1.0; 3], [0.0; 3]).unwrap();
            let displacement = Volume::from_fn(grid.clone(), |l| if voxels.contains(&l) { [0.0, -1e-30, 0.0] } else { [0.0, -0.0, 0.0] });
            let computed = Volume::from_fn(grid.clone(), |l| l == 777);
            let push = PushField { displacement, computed };
            let ends = [first, last].map(|p| Vector3::from_fn(|a, _| p[a] * (grid.size()[a] - 1) as f64));
            let (first, mut last) = (ends[0], ends[1]);
            if level {
                (last.y, last.z) = (first.y, first.z);
            }
            let along = (last - first) / (places.max(2) - 1) as f64;
            let reach = Reach::new(&push).of_places(&first, &along, places);
            prop_assert!(reach.end <= places);
            for n in (0..places).filter(|n| !reach.contains(n)) {
                let at = first + along * n as f64;
                let inside = at.zip_map(&Vector3::from(grid.size().map(|n| (n - 1) as f64)), |x, most| x.clamp(0.0, most));
                let u = trilinear_vector(&push.displacement, &inside).unwrap_or_default();
                prop_assert!(u.iter().all(|c| c.abs() < f64::MIN_POSITIVE), "{} is moved by {}", at, u);
                let near = [inside.x, inside.y, inside.z].map(|c| (c + 0.5) as usize);
                prop_assert!(!push.computed.at(near), "{} was computed", at);
            }
        }
    }
}
