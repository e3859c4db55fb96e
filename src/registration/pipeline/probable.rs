//! Where a structure may be: the share of a registration's samples in which it is at each voxel.

use crate::error::Result;
use crate::field::Chain;
use crate::geometry::Grid;
use crate::sampling::SampleSet;
use crate::volume::contour::{Polygon, trace};
use crate::volume::distance::squared_distance;
use crate::volume::{Volume, region};
use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;
use std::ops::Range;

/// Every so many voxels samples are asked how far they reach.
const STRIDE: usize = 4;
/// Samples are looked for this much farther than they were found to reach, mm.
const SPARE_MM: f64 = 2.0;
/// A polygon smaller than this is none, mm^2.
const LEAST_MM2: f64 = 0.1;
/// They are not looked for beyond, mm.
const MOST_MM: f64 = 40.0;

/// A structure of the planning scan that a registration carries to the fraction.
pub struct CarriedStructure<'a> {
    /// How much of a small box around a place of planning it fills, 0 to 1.
    pub inside: &'a (dyn Fn(&Point3<f64>) -> f64 + Sync),
    /// From the fraction to planning.
    pub back: &'a Chain<'a>,
    /// Samples of the registration.
    pub samples: &'a SampleSet,
}

impl CarriedStructure<'_> {
    /// Share of the samples in which the structure is at each voxel, on the part of `grid` (of the fraction) around the voxels
    /// `around` in which it was found. `None` where that part is empty.
    ///
    /// # Errors
    /// Only for internal inconsistency of grids.
    pub fn probability(&self, grid: &Grid, around: &[Range<usize>; 3]) -> Result<Option<Volume<f32>>> {
        if around.iter().any(Range::is_empty) {
            return Ok(None);
        }
        let reach = self.reach(grid, around).min(MOST_MM) + SPARE_MM;
        let spacing = grid.spacing();
        let wide: [Range<usize>; 3] = std::array::from_fn(|a| {
            let more = (reach / spacing[a]).ceil() as usize;
            around[a].start.saturating_sub(more)..(around[a].end + more).min(grid.size()[a])
        });
        let part = region::part_of_grid(grid, &wide)?;
        let found: Vec<f32> = (0..part.len())
            .into_par_iter()
            .map(|l| (self.inside)(&self.back.map(&part.centre(part.voxel(l))).point) as f32)
            .collect();
        let mask = Volume::new(part.clone(), found.iter().map(|f| *f > 0.5).collect())?;
        let [to_it, out_of_it] = [true, false].map(|target| squared_distance(&mask, target));
        let near = |l: usize| to_it.data()[l].max(out_of_it.data()[l]) <= (reach * reach) as f32;
        let plane = part.strides()[2];
        let mut out = vec![0f32; part.len()];
        out.par_chunks_mut(plane).enumerate().for_each_init(
            || vec![Vector3::zeros(); self.samples.number()],
            |room, (k, out)| {
                for (n, out) in out.iter_mut().enumerate() {
                    let l = k * plane + n;
                    *out = if near(l) { self.share(&part.centre(part.voxel(l)), room) } else { found[l] };
                }
            },
        );
        Ok(Some(Volume::new(part, out)?))
    }

    /// The farthest that a sample moves anything around the structure, mm.
    fn reach(&self, grid: &Grid, around: &[Range<usize>; 3]) -> f64 {
        let of = |k: usize| {
            let mut room = vec![Vector3::zeros(); self.samples.number()];
            let mut most = 0f64;
            for j in around[1].clone().step_by(STRIDE) {
                for i in around[0].clone().step_by(STRIDE) {
                    let y = grid.centre([i, j, k]);
                    self.samples.at(&self.back.map(&y).point, &y, &mut room);
                    most = room.iter().map(Vector3::norm).fold(most, f64::max);
                }
            }
            most
        };
        let planes: Vec<usize> = around[2].clone().step_by(STRIDE).collect();
        planes.into_par_iter().map(of).reduce(|| 0.0, f64::max)
    }

    /// Share of the samples in which the structure is at a place of the fraction.
    fn share(&self, y: &Point3<f64>, room: &mut [Vector3<f64>]) -> f32 {
        // What a sample adds at the place that the registration shows there; then, closer, at the place that the sample shows.
        self.samples.at(&self.back.map(y).point, y, room);
        let one = |(n, first): (usize, &Vector3<f64>)| {
            let moved = y - first;
            let x = self.back.map(&moved).point;
            (self.inside)(&self.back.map(&(y - self.samples.one(n, &x, &moved))).point)
        };
        let sum: f64 = room.iter().enumerate().map(one).sum();
        (sum / room.len().max(1) as f64) as f32
    }
}

/// The polygons around the voxels whose value is above `level`, on the planes of a volume, along its own in-plane axes: with the
/// axes, their normal and points in mm.
pub fn polygons_above(volume: &Volume<f32>, level: f64, axes: &Matrix3<f64>) -> Vec<Polygon> {
    let grid = volume.grid();
    let [ni, nj, nk] = grid.size();
    let plane = |k: usize| {
        let values: Vec<f64> = volume.data()[k * ni * nj..][..ni * nj].iter().map(|v| f64::from(*v) - level).collect();
        let place = |[i, j]: [f64; 2]| axes.transpose() * grid.world(&Vector3::new(i, j, k as f64)).coords;
        let height = place([0.0, 0.0]).z;
        let polygon = |points: Vec<[f64; 2]>| {
            let points = points.into_iter().map(place).map(|p| [p.x, p.y]).collect();
            Polygon { height, points }
        };
        let large = |p: &Polygon| area(&p.points) >= LEAST_MM2;
        trace(&values, [ni, nj]).into_iter().map(polygon).filter(large).collect::<Vec<_>>()
    };
    (0..nk).into_par_iter().map(plane).collect::<Vec<_>>().concat()
}

/// Area within a polygon, mm^2.
fn area(points: &[[f64; 2]]) -> f64 {
    let next = points.iter().cycle().skip(1);
    let twice: f64 = points.iter().zip(next).map(|([x, y], [u, v])| x * v - u * y).sum();
    0.5 * twice.abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::{InvertOptions, Link, Motion};
    use crate::geometry::{Rigid, about};
    use crate::sampling::Drawn;

    /// Samples that move everything by these millimetres to the left.
    fn shifted(grid: &Grid, by: &[f32]) -> SampleSet {
        let labels = Volume::filled(grid.clone(), 0u16);
        let nodes = grid.coarsened(5.0);
        let drawn: Vec<Drawn> = by
            .iter()
            .map(|mm| Drawn { bones: vec![Rigid::identity()], tissue: Volume::filled(nodes.clone(), [*mm, 0.0, 0.0]) })
            .collect();
        SampleSet::new(&labels, &[1], &drawn).unwrap()
    }

    #[test]
    fn a_box_is_where_the_samples_put_it() {
        let grid = Grid::axis_aligned([60, 40, 20], [1.0, 1.0, 2.0], [0.0; 3]).unwrap();
        let samples = shifted(&grid, &[-6.0, -3.0, 0.0, 3.0, 6.0]);
        // 10 mm to the left, and from there by each sample.
        let motion = Motion::Rigid(about(&Point3::origin(), Vector3::zeros(), Vector3::x() * 10.0));
        let links = [Link { name: "m".into(), from: "p".into(), to: "f".into(), motion }];
        let back = Chain::between(&links, "f", "p", &InvertOptions::default()).unwrap();
        let inside = |p: &Point3<f64>| {
            f64::from(u8::from((14.5..30.5).contains(&p.x) && (9.5..25.5).contains(&p.y) && (9.0..27.0).contains(&p.z)))
        };
        let carried = CarriedStructure { inside: &inside, back: &back, samples: &samples };
        let found = carried.probability(&grid, &[25..41, 10..26, 5..14]).unwrap().unwrap();
        let at = |x: f64| {
            let voxel = found.grid().voxel_at(&Point3::new(x, 18.0, 18.0)).unwrap();
            f64::from(*found.at(voxel))
        };
        // The right end lies at 24.5 mm, and 3 and 6 mm to both sides.
        for (x, wanted) in [(18.0, 0.0), (19.0, 0.2), (22.0, 0.4), (25.0, 0.6), (28.0, 0.8), (33.0, 1.0), (47.0, 0.0)] {
            assert!((at(x) - wanted).abs() < 1e-6, "{x}: {} for {wanted}", at(x));
        }
        let width = |level: f64| {
            let all = polygons_above(&found, level, &Matrix3::identity());
            let points = all.iter().filter(|p| (p.height - 18.0).abs() < 0.1).flat_map(|p| &p.points);
            let [low, high] = points.fold([f64::MAX, f64::MIN], |[l, h], p| [l.min(p[0]), h.max(p[0])]);
            high - low
        };
        // In all samples, in most, in any.
        assert!((width(0.95) - 4.0).abs() < 1.1 && (width(0.5) - 16.0).abs() < 1.1 && (width(0.05) - 28.0).abs() < 1.1);
        assert!(carried.probability(&grid, &[3..3, 0..2, 0..2]).unwrap().is_none());
    }
}
