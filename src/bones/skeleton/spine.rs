//! Local frames of the spine, vertebral bodies and their endplates.
//!
//! The up direction at a vertebra follows from its neighbours, so that a tilted or bent patient is no special case.
//! Front and back come from LPS, which is defined by the patient (DICOM PS3.3 C.7.6.2.1.1), whether supine, prone
//! or decubitus: the frame is LPS turned by the shortest way to the up direction.

use super::anatomy::{C1, C2, SKULL};
use super::shape::{Shape, mean};
use crate::geometry::Grid;
use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use std::collections::BTreeMap;

/// A vertebra's frame and what is known of its body.
#[derive(Debug, Clone)]
pub(super) struct Vertebra {
    /// Columns: left, back, up.
    pub(super) frame: Matrix3<f64>,
    /// Middle of the body; of the whole bone where no body was found.
    pub(super) middle: Point3<f64>,
    /// Middle of the upper endplate; `None` where there is none or the image's edge cuts it.
    pub(super) upper: Option<Point3<f64>>,
    /// Middle of the lower endplate, likewise.
    pub(super) lower: Option<Point3<f64>>,
    /// Whether a body was found in front of the canal.
    pub(super) has_body: bool,
}

/// Turns LPS by the shortest way so that its third axis is `up`. Columns: left, back, up.
pub(super) fn frame(up: &Vector3<f64>) -> Matrix3<f64> {
    Rotation3::rotation_between(&Vector3::z(), up).map_or_else(Matrix3::identity, Rotation3::into_inner)
}

/// The vertebrae (and sacrum) by level, without the skull.
pub(super) fn vertebrae(shapes: &BTreeMap<u8, &Shape>, grid: &Grid) -> BTreeMap<u8, Vertebra> {
    let shapes: BTreeMap<u8, &Shape> = shapes.iter().filter(|(l, _)| **l < SKULL).map(|(l, s)| (*l, *s)).collect();
    let mut middles: BTreeMap<u8, Point3<f64>> = shapes.iter().map(|(l, s)| (*l, s.centroid)).collect();
    let mut out: BTreeMap<u8, Vertebra> = BTreeMap::new();
    // The second pass has the bodies' own middles, which lie on the spine's axis better than the centroids; a
    // vertebra whose body the image's edge cuts off takes its direction from the others.
    for _ in 0..2 {
        out =
            shapes.iter().map(|(&level, shape)| (level, vertebra(shape, level, &up(&middles, level), grid))).collect();
        let sound = out.iter().filter(|(l, v)| v.has_body || **l == C1);
        let sound: BTreeMap<u8, Point3<f64>> = sound.map(|(l, v)| (*l, v.middle)).collect();
        if sound.len() >= 2 {
            middles = sound;
        }
    }
    out
}

/// Up direction at a level: from the nearest known level below to the nearest above, at the ends between the two
/// nearest; LPS up when fewer than two are known.
fn up(middles: &BTreeMap<u8, Point3<f64>>, level: u8) -> Vector3<f64> {
    let own = middles.get_key_value(&level);
    let (mut below, mut above) = (middles.range(..level).rev(), middles.range(level + 1..));
    let ends = match (below.next(), above.next()) {
        (Some(b), Some(a)) => Some((b, a)),
        (Some(b), None) => own.map(|o| (b, o)).or_else(|| below.next().map(|c| (c, b))),
        (None, Some(a)) => own.map(|o| (o, a)).or_else(|| above.next().map(|c| (a, c))),
        (None, None) => None,
    };
    ends.and_then(|((_, b), (_, a))| (a - b).try_normalize(1.0)).unwrap_or_else(Vector3::z)
}

/// Half width of the strip along the midline in which body and canal are told apart, mm.
const STRIP: f64 = 5.0;
/// Half width of the middle part of an endplate; the uncinate processes lie outside, mm.
const PLATE: f64 = 7.0;
/// A gap of this length behind the body is the canal, mm.
const CANAL: f64 = 4.0;
/// No vertebral body is deeper, mm.
const DEEPEST: f64 = 45.0;

fn vertebra(shape: &Shape, level: u8, up: &Vector3<f64>, grid: &Grid) -> Vertebra {
    let frame = frame(up);
    let plain = Vertebra { frame, middle: shape.centroid, upper: None, lower: None, has_body: false };
    if level == C1 {
        return plain;
    }
    let to_local = frame.transpose();
    let local: Vec<Vector3<f64>> = shape.points.iter().map(|p| to_local * (p - shape.centroid)).collect();
    let Some([front, wall]) = body_depth(&local, grid) else { return plain };
    let middle = (front + wall) / 2.0;
    let body: Vec<&Vector3<f64>> =
        local.iter().filter(|v| v.x.abs() <= PLATE && (front..=wall).contains(&v.y)).collect();
    let (top, bottom) = plates(&body, grid);
    let at = |height: f64| shape.centroid + frame * Vector3::new(0.0, middle, height);
    // Half a voxel's extent along the axis lies beyond the outermost centres.
    let half = 0.5 * (grid.step().transpose() * up).abs().max();
    let inside = |p: Point3<f64>, out: f64| grid.contains(&grid.index(&(p + up * out * (2.0 * half + 0.5))));
    let upper = Some(at(top + half)).filter(|p| level != C2 && inside(*p, 1.0));
    let lower = Some(at(bottom - half)).filter(|p| inside(*p, -1.0));
    Vertebra { frame, middle: at((top + bottom) / 2.0), upper, lower, has_body: true }
}

/// Front and back of the body along the strip at the midline, local mm; `None` where no canal follows a body.
fn body_depth(local: &[Vector3<f64>], grid: &Grid) -> Option<[f64; 2]> {
    let bin = grid.spacing().into_iter().fold(f64::INFINITY, f64::min).max(1.0);
    let strip: Vec<f64> = local.iter().filter(|v| v.x.abs() <= STRIP).map(|v| v.y).collect();
    let least = strip.iter().copied().min_by(f64::total_cmp)?;
    let mut counts = vec![0usize; 200];
    for y in &strip {
        if let Some(c) = counts.get_mut(((y - least) / bin) as usize) {
            *c += 1;
        }
    }
    let most = *counts.iter().max()?;
    let first = counts.iter().position(|&c| 4 * c >= most)?;
    let gap = (CANAL / bin).ceil() as usize;
    let length = counts[first..].windows(gap).position(|w| w.iter().all(|&c| 10 * c <= most))?;
    let [front, wall] = [first, first + length].map(|n| least + n as f64 * bin);
    let behind = strip.iter().any(|y| *y > wall + CANAL);
    (behind && wall - front <= DEEPEST && wall - front >= 4.0).then_some([front, wall])
}

/// Median height of the highest and the lowest voxels of a body's columns, local mm.
fn plates(body: &[&Vector3<f64>], grid: &Grid) -> (f64, f64) {
    let bin = grid.spacing().into_iter().fold(2.0, f64::max);
    let mut columns: BTreeMap<(i32, i32), (f64, f64)> = BTreeMap::new();
    for v in body {
        let key = ((v.x / bin).floor() as i32, (v.y / bin).floor() as i32);
        let c = columns.entry(key).or_insert((v.z, v.z));
        *c = (c.0.max(v.z), c.1.min(v.z));
    }
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        crate::stats::percentile(&values, 50.0)
    };
    (median(columns.values().map(|c| c.0).collect()), median(columns.values().map(|c| c.1).collect()))
}

/// Middle of the part of the dens that stands within the ring of the atlas, at the height of the atlas's centroid.
pub(super) fn dens(c1: &Shape, c2: &Shape, frame: &Matrix3<f64>) -> Option<Point3<f64>> {
    let to_local = frame.transpose();
    let within = |p: &&Point3<f64>| {
        let v = to_local * (*p - c1.centroid);
        v.z.abs() <= 5.0 && v.x.abs() <= 10.0
    };
    let dens: Vec<Point3<f64>> = c2.points.iter().filter(within).copied().collect();
    (!dens.is_empty()).then(|| mean(&dens))
}
