//! How far the result may be trusted, in mm, at every place: a length such that about two thirds of the errors are
//! smaller.
//!
//! Where both images show a place, two things tell an error (docs/decisions/uncertainty.md has what was compared):
//! *disagreement*, the distance `d` between the field and the one of the bones alone (with the own uncertainty of
//! the bones around, in quadrature), and *mismatch*, the remaining difference of the images over their gradient, `q`, both averaged over 4 mm.
//! Neither alone does, and the product does in all cases: `0.5 ((d + 0.1) (q + 0.1)^2)^(1/3)`. Where images say nothing (outside the fraction's view, or when they take no
//! part), error grows with the distance to the nearest bone, beside that bone's own uncertainty.
//!
//! Outside the patient, and where it would exceed [`LIMIT_MM`], nothing is known: the map holds [`UNKNOWN`] there, which
//! every reader can read, where not every one reads what is no number.

mod seen;
mod side;

pub use side::PlanningSide;

use super::jacobian::TISSUE_HU;
use crate::error::Result;
use crate::field::PushField;
use crate::stats::{Bins, Summary};
use crate::volume::extent::extent;
use crate::volume::{LabelMap, Mask, Spans, Volume, axis_pairs};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What the map says in short.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct UncertaintyReport {
    /// Uncertainty over soft tissue (body above -500 HU, no bone).
    pub soft_tissue_mm: SoftTissue,
    /// Share of soft tissue where no image speaks, percent.
    pub without_images_percent: f64,
    /// Share of soft tissue of which nothing is known, percent: further off than bones tell.
    #[serde(default)]
    pub unknown_percent: f64,
    /// Soft tissue with more than 2 mm or unknown, ml: beyond what AAPM TG-132 asks of a registration.
    pub above_2mm_ml: f64,
    /// The same over lung; none where there is hardly any.
    #[serde(default)]
    pub lung: Option<Lung>,
}

/// Uncertainty over what of the patient is at most -500 HU, bones left out: lung, with airways.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Lung {
    /// Its volume, ml.
    pub ml: f64,
    /// Uncertainty over it.
    pub mm: SoftTissue,
    /// What of it has more than 2 mm or is unknown, ml.
    pub above_2mm_ml: f64,
}

/// Less is no lung but an airway, ml.
const LEAST_LUNG_ML: f64 = 200.0;

/// Uncertainty over soft tissue, mm. Median and percentile are of all of it, and what is unknown counts as larger than all
/// that is known; the other figures are of what is known.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SoftTissue {
    /// Number of voxels that are known.
    pub n: usize,
    /// Mean of what is known.
    pub mean: f64,
    /// Standard deviation of what is known.
    pub std: f64,
    /// Median of all; none (`null`) where it is unknown: above [`LIMIT_MM`].
    pub median: Option<f64>,
    /// 95th percentile of all; none (`null`) where it is unknown: above [`LIMIT_MM`].
    pub p95: Option<f64>,
    /// Smallest value.
    pub min: f64,
    /// Largest value of what is known.
    pub max: f64,
}

impl SoftTissue {
    /// Of what is known, beside so many voxels of which nothing is.
    fn of(known: &[&[f32]], unknown: usize) -> Self {
        let s = Summary::of_singles(known);
        let [median, p95] = if unknown == 0 {
            [Some(s.median), Some(s.p95)]
        } else {
            [50.0, 95.0].map(|p| among_all(known, s.n, unknown, p))
        };
        Self { n: s.n, mean: s.mean, std: s.std, median, p95, min: s.min, max: s.max }
    }
}

/// The `p`-th percentile of `n` known values and of unknown ones, which are larger; none where it falls among these.
fn among_all(known: &[&[f32]], n: usize, unknown: usize, p: f64) -> Option<f64> {
    let place = p / 100.0 * (n + unknown - 1) as f64;
    let (low, high) = (place.floor() as usize, place.ceil() as usize);
    let all = |_: f32| true;
    (high < n).then(|| {
        let [low, high] = Bins::of(known, all).ranks([low, high], known, all).map(f64::from);
        low + (high - low) * place.fract()
    })
}

/// A figure of the uncertainty in mm, with these digits; `> 30` where it is unknown.
pub fn in_mm(mm: Option<f64>, digits: usize) -> String {
    mm.map_or_else(|| format!("> {LIMIT_MM:.0}"), |mm| format!("{mm:.digits$}"))
}

/// What the map is made from; all in the planning frame but `fraction`.
#[derive(Debug, Clone, Copy)]
pub struct Evidence<'a> {
    /// What is known before there is a fraction.
    pub side: &'a PlanningSide,
    /// Fraction CT, HU.
    pub fraction: &'a Volume<f32>,
    /// The patient in the planning CT.
    pub body: &'a Mask,
    /// The planning CT, HU: what of the patient is denser than [`TISSUE_HU`] counts as tissue.
    pub planning: &'a Volume<f32>,
    /// Bone labels.
    pub bones: &'a LabelMap,
    /// Standard deviation of each bone's position, mm, by its label.
    pub bone_mm: &'a BTreeMap<u16, f64>,
    /// The result.
    pub push: &'a PushField,
    /// Factor on all of it but bones: above 1 where the run gives reason to doubt it as a whole.
    pub doubt: f64,
    /// Displacements of the bones alone on any grid; `None` when images took no part in soft tissue.
    pub bones_alone: Option<&'a Volume<[f32; 3]>>,
    /// Where images say nothing though they show something, on any grid: they misled there.
    pub misled: Option<&'a Mask>,
}

/// What the map holds where nothing is known.
pub const UNKNOWN: f32 = -1.0;
/// The greatest uncertainty that is told, mm: with more, nothing is known.
pub const LIMIT_MM: f64 = 30.0;

/// A value of the map from an estimate, mm.
fn told(mm: f32) -> f32 {
    if f64::from(mm) <= LIMIT_MM { mm } else { UNKNOWN }
}

/// Error of the bones alone per mm of distance to a bone, and the distance at which a bone's surface counts as.
/// Where images say nothing, errors correlate with that distance by 0.69 to 0.77.
const PER_MM: f64 = 0.034;
const AT_BONE_MM: f64 = 5.0;

/// The map on the planning grid, mm ([`UNKNOWN`] outside the patient), and its summary.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn map(e: &Evidence<'_>) -> Result<(Spans<f32>, UncertaintyReport)> {
    let side = e.side;
    let seen = e.bones_alone.map(|alone| seen::seen(e, alone)).transpose()?;
    let bone_mm = |label: u16| e.bone_mm.get(&label).copied().unwrap_or(0.0);
    let unseen = |n: usize| {
        let by_distance = PER_MM * (f64::from(side.far.data()[n]) + AT_BONE_MM);
        by_distance.hypot(bone_mm(side.owner.data()[n])) as f32
    };
    let doubt = e.doubt as f32;
    let of = |n: usize| match seen.as_ref().and_then(|s| s[n]) {
        Some(mm) => (doubt * mm, true),
        None => (doubt * unseen(n), false),
    };
    let (coarse, speaks): (Vec<f32>, Vec<bool>) = (0..side.grid.len()).into_par_iter().map(of).unzip();
    Ok(fine(e, &coarse, &speaks))
}

/// A plane of the map in short.
#[derive(Default)]
struct Plane {
    /// Of its soft tissue.
    values: Vec<f32>,
    /// Soft tissue where no image speaks.
    silent: usize,
    /// Soft tissue with more than 2 mm.
    above: usize,
    /// Soft tissue of which nothing is known.
    unknown: usize,
    /// Of its lung.
    lung: Vec<f32>,
}

/// The coarse map on the planning grid: bones have their own uncertainty, and outside the patient nothing is known.
///
/// Trilinear: between rows of the coarse grid first, so that a voxel costs one step along its row.
fn fine(e: &Evidence<'_>, coarse: &[f32], speaks: &[bool]) -> (Spans<f32>, UncertaintyReport) {
    let (grid, nodes) = (e.body.grid(), &e.side.grid);
    let ([ni, nj, _], size) = (grid.size(), nodes.size());
    let axes = axis_pairs(nodes, grid);
    let mut bone_mm = vec![None; usize::from(u16::MAX) + 1];
    e.bone_mm.iter().for_each(|(label, mm)| bone_mm[usize::from(*label)] = Some(*mm as f32));
    let row = |j: usize, k: usize| &coarse[nodes.linear([0, j, k])..][..size[0]];
    let mix = |a: f32, b: f32, t: f64| a * (1.0 - t as f32) + b * t as f32;
    let nearest = |(low, high, way): (usize, usize, f64)| if way < 0.5 { low } else { high };
    let spans: Vec<_> = e.body.data().par_chunks(ni).map(|row| extent(row, |part| part.contains(&true))).collect();
    let (map, planes) = Spans::by_planes(grid.clone(), UNKNOWN, &spans, Vec::new, |line, k, mut rest| {
        let mut plane = Plane { values: Vec::with_capacity(rest.len()), ..Plane::default() };
        for (j, span) in spans[nj * k..nj * (k + 1)].iter().enumerate().filter(|(_, span)| !span.is_empty()) {
            let first = grid.linear([0, j, k]);
            let ((j0, j1, tj), (k0, k1, tk)) = (axes[1][j], axes[2][k]);
            let (a, b, c, d) = (row(j0, k0), row(j1, k0), row(j0, k1), row(j1, k1));
            line.clear();
            line.extend((0..size[0]).map(|n| mix(mix(a[n], b[n], tj), mix(c[n], d[n], tj), tk)));
            let heard = &speaks[nodes.linear([0, nearest(axes[1][j]), nearest(axes[2][k])])..][..size[0]];
            let out;
            (out, rest) = rest.split_at_mut(span.len());
            for (value, i) in out.iter_mut().zip(span.clone()) {
                if !e.body.data()[first + i] {
                    *value = UNKNOWN;
                    continue;
                }
                if let Some(mm) = bone_mm[usize::from(e.bones.volume.data()[first + i])] {
                    *value = told(mm);
                    continue;
                }
                let (low, high, way) = axes[0][i];
                *value = told(mix(line[low], line[high], way));
                if e.planning.data()[first + i] > TISSUE_HU {
                    plane.values.push(*value);
                    plane.silent += usize::from(!heard[nearest(axes[0][i])]);
                    plane.above += usize::from(*value > 2.0);
                    plane.unknown += usize::from(*value < 0.0);
                } else {
                    plane.lung.push(*value);
                }
            }
        }
        plane
    });
    (map, report(&planes, grid.voxel_volume()))
}

fn report<'a>(planes: &'a [Plane], voxel_mm3: f64) -> UncertaintyReport {
    let parts: Vec<&'a [f32]> = planes.iter().map(|p| p.values.as_slice()).collect();
    let soft: usize = parts.iter().map(|p| p.len()).sum();
    let sum = |which: fn(&Plane) -> usize| planes.iter().map(which).sum::<usize>();
    let (silent, above, unknown) = (sum(|p| p.silent), sum(|p| p.above), sum(|p| p.unknown));
    // Runs of what is known, where they lie.
    let known = |part: &&'a [f32]| part.split(|v| *v < 0.0).filter(|run| !run.is_empty());
    let runs = |parts: &[&'a [f32]]| parts.iter().flat_map(known).collect::<Vec<&[f32]>>();
    let lung: Vec<&'a [f32]> = planes.iter().map(|p| p.lung.as_slice()).collect();
    let counted = |which: fn(&f32) -> bool| lung.iter().flat_map(|part| part.iter()).filter(|v| which(v)).count();
    let ml = |voxels: usize| voxels as f64 * voxel_mm3 / 1000.0;
    let lung_ml = ml(counted(|_| true));
    let lung = (lung_ml >= LEAST_LUNG_ML).then(|| Lung {
        ml: lung_ml,
        mm: SoftTissue::of(&runs(&lung), counted(|v| *v < 0.0)),
        above_2mm_ml: ml(counted(|v| *v < 0.0 || *v > 2.0)),
    });
    UncertaintyReport {
        without_images_percent: 100.0 * silent as f64 / soft.max(1) as f64,
        unknown_percent: 100.0 * unknown as f64 / soft.max(1) as f64,
        above_2mm_ml: ml(above + unknown),
        soft_tissue_mm: SoftTissue::of(&runs(&parts), unknown),
        lung,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use crate::volume::Window;
    use nalgebra::{Point3, Vector3};

    const WINDOW: Window = Window { low: -250.0, high: 300.0, thin: 0.0 };

    /// A box of tissue with stripes in its left half and nothing in its right half; a bone in the middle. The fraction is the
    /// same, shifted by `error` beyond what the field says, and shows only z < 60.
    fn scene(error: f64, images: bool) -> (Spans<f32>, UncertaintyReport) {
        beside(0.25, error, images)
    }

    /// The same, where the bone is known to so many mm.
    fn beside(bone_mm: f64, error: f64, images: bool) -> (Spans<f32>, UncertaintyReport) {
        doubted(bone_mm, error, images, 1.0)
    }

    /// The same of a run that is doubted as a whole by this factor.
    fn doubted(bone_mm: f64, error: f64, images: bool, doubt: f64) -> (Spans<f32>, UncertaintyReport) {
        among(&BTreeMap::from([(5, bone_mm)]), error, images, doubt)
    }

    /// The same with these bones: 5 in the middle, 6 above it where it is named.
    fn among(bone_mm: &BTreeMap<u16, f64>, error: f64, images: bool, doubt: f64) -> (Spans<f32>, UncertaintyReport) {
        let grid = Grid::axis_aligned([40, 30, 40], [3.0, 3.0, 2.0], [0.0; 3]).unwrap();
        let seen = Grid::axis_aligned([50, 40, 31], [3.0, 3.0, 2.0], [-12.0, -12.0, 0.0]).unwrap();
        let inside = |p: &Point3<f64>| p.x > 6.0 && p.x < 110.0 && p.y > 6.0 && p.y < 80.0;
        let hu = |p: &Point3<f64>| match inside(p) {
            false => -1000.0,
            true if p.x < 55.0 => (200.0 * (p.x / 4.0).sin()) as f32,
            true => 20.0,
        };
        let planning = Volume::from_fn(grid.clone(), |l| hu(&grid.centre(grid.voxel(l))));
        let fraction =
            Volume::from_fn(seen.clone(), |l| hu(&(seen.centre(seen.voxel(l)) - Vector3::new(error, 0.0, 0.0))) + 15.0);
        let body = Volume::from_fn(grid.clone(), |l| inside(&grid.centre(grid.voxel(l))));
        let label = |l: usize| {
            let [i, j, k] = grid.voxel(l);
            let bone = if k >= 20 && bone_mm.contains_key(&6) { 6 } else { 5 };
            u16::from((18..=20).contains(&i) && (14..=16).contains(&j)) * bone
        };
        let bones = LabelMap { volume: Volume::from_fn(grid.clone(), label), names: BTreeMap::new() };
        let displacement = Volume::filled(grid.clone(), [0.0f32; 3]);
        // The field of the bones alone disagrees by 1 mm.
        let alone = Volume::filled(grid.clone(), [0.0, 1.0, 0.0]);
        let push = PushField { displacement, computed: Volume::filled(grid, true) };
        let side = PlanningSide::new(&planning, &body, &bones, WINDOW, |l| l >= 5).unwrap();
        let e = Evidence {
            side: &side,
            fraction: &fraction,
            body: &body,
            planning: &planning,
            bones: &bones,
            bone_mm,
            push: &push,
            doubt,
            bones_alone: images.then_some(&alone),
            misled: None,
        };
        map(&e).unwrap()
    }

    #[test]
    fn lung_is_told_apart_where_there_is_some() {
        let lung = |voxels| Plane {
            values: vec![1.0; 1000],
            lung: (0..voxels).map(|n| if n % 10 == 0 { UNKNOWN } else { 5.0 }).collect(),
            ..Plane::default()
        };
        let told = report(&[lung(200_000), lung(100_000)], 1.0);
        let of = told.lung.unwrap();
        assert!((of.ml - 300.0).abs() < 1e-9 && (of.above_2mm_ml - 300.0).abs() < 1e-9, "{of:?}");
        // A tenth of it is unknown, so its 95th percentile is, too; soft tissue has nothing of it.
        assert_eq!((of.mm.median, of.mm.p95, told.soft_tissue_mm.p95), (Some(5.0), None, Some(1.0)));
        assert_eq!(report(&[lung(100_000)], 1.0).lung, None);
    }

    #[test]
    fn mismatch_raises_it_and_views_and_bones_keep_their_own() {
        let ((good, report), (bad, _)) = (scene(0.0, true), scene(2.0, true));
        let at = |m: &Spans<f32>, v: [usize; 3]| m.at(v);
        let stripes = [10, 20, 12];
        // A grey value offset alone is no mismatch: 0.5 (1.1 * 0.1^2)^(1/3), and a little for partial volume.
        assert!((0.11..0.4).contains(&at(&good, stripes)), "{}", at(&good, stripes));
        assert!(at(&bad, stripes) > 2.0 * at(&good, stripes), "{} {}", at(&bad, stripes), at(&good, stripes));
        assert!((at(&good, [19, 15, 12]) - 0.25).abs() < 1e-6);
        assert!(at(&good, [0, 0, 5]) == UNKNOWN, "nothing is known outside the patient");
        // Outside the fraction's view the distance to the bone speaks.
        let far = at(&good, [33, 15, 38]);
        let want = (0.034f64 * (39.0 + 5.0)).hypot(0.25);
        assert!((f64::from(far) - want).abs() < 0.15, "{far} {want}");
        assert!((10.0..40.0).contains(&report.without_images_percent), "{report:?}");
    }

    #[test]
    fn tissue_in_view_is_less_known_beside_a_bone_that_is_not() {
        let ((known, _), (guessed, _)) = (beside(0.25, 0.0, true), beside(9.0, 0.0, true));
        let ratio = guessed.at([10, 20, 12]) / known.at([10, 20, 12]);
        let want = ((1f64.hypot(9.0) + 0.1) / (1f64.hypot(0.25) + 0.1)).cbrt();
        assert!((f64::from(ratio) - want).abs() < 1e-3, "{ratio} {want}");
    }

    /// At the top of a view tissue hangs on the bone above it, too, though another one is nearer.
    #[test]
    fn tissue_beside_a_known_bone_is_less_known_towards_one_that_is_not() {
        let of = |above: f64| among(&BTreeMap::from([(5, 0.2), (6, above)]), 0.0, true, 1.0).0;
        let (known, guessed) = (of(0.2), of(9.0));
        // Bone 6 begins at slice 20, 40 mm: 8 mm below it, and 32 mm.
        let ratio = |k: usize| guessed.at([10, 20, k]) / known.at([10, 20, k]);
        assert!(ratio(16) > 1.4 && ratio(4) < 1.1, "{} {}", ratio(16), ratio(4));
        assert!((guessed.at([19, 15, 12]) - 0.2).abs() < 1e-6, "a bone keeps its own");
    }

    #[test]
    fn doubt_makes_all_but_bones_less_known() {
        let [sure, unsure] = [1.0, 1.5].map(|doubt| doubted(0.25, 0.0, true, doubt).0);
        // In view, beyond it, and in the bone.
        for (at, factor) in [([10, 20, 12], 1.5), ([33, 15, 38], 1.5), ([19, 15, 12], 1.0)] {
            let ratio = unsure.at(at) / sure.at(at);
            assert!((ratio - factor).abs() < 1e-3, "{at:?}: {ratio}");
        }
    }

    /// Of 100 voxels the five worst are unknown, then six, then all.
    #[test]
    fn what_is_unknown_counts_as_more_than_all_that_is_known() {
        let of = |known: usize| {
            let plane = Plane {
                values: (0..100).map(|n| if n < known { n as f32 / 10.0 } else { UNKNOWN }).collect(),
                unknown: 100 - known,
                ..Plane::default()
            };
            report(&[plane], 1.0)
        };
        let (five, six, all) = (of(95), of(94), of(0));
        assert_eq!(five.soft_tissue_mm.p95, None, "between the last known one and an unknown one");
        assert_eq!((six.soft_tissue_mm.p95, all.soft_tissue_mm.p95, all.soft_tissue_mm.median), (None, None, None));
        assert!((of(100).soft_tissue_mm.p95.unwrap() - 9.405).abs() < 1e-6);
        assert!((of(96).soft_tissue_mm.p95.unwrap() - 9.405).abs() < 1e-6, "of all, not of the 96 that are known");
        assert!(
            (six.soft_tissue_mm.median.unwrap() - 4.95).abs() < 1e-6 && (six.soft_tissue_mm.max - 9.3).abs() < 1e-6
        );
        assert_eq!((in_mm(None, 1), in_mm(Some(2.345), 1)), ("> 30".to_owned(), "2.3".to_owned()));
        let written = serde_json::to_value(six).unwrap();
        assert!(written["soft_tissue_mm"]["p95"].is_null());
        assert_eq!(serde_json::from_value::<UncertaintyReport>(written).unwrap(), six);
    }

    #[test]
    fn without_images_distance_alone_decides() {
        let (map, report) = scene(2.0, false);
        assert!((report.without_images_percent - 100.0).abs() < 1e-9);
        assert!(map.at([30, 15, 12]) > map.at([24, 15, 12]));
        assert_eq!(map.at([10, 20, 12]).to_bits(), scene(0.0, false).0.at([10, 20, 12]).to_bits());
    }

    #[test]
    fn lies_where_the_scan_lies() {
        // 74 mm of slices on nodes of 3 mm: the nodes' grid reaches half a millimetre beyond the scan at either end.
        let grid = Grid::axis_aligned([21, 21, 38], [3.0, 3.0, 2.0], [0.0; 3]).unwrap();
        let label = |l: usize| u16::from((18..=19).contains(&grid.voxel(l)[2]));
        let bones = LabelMap { volume: Volume::from_fn(grid.clone(), label), names: BTreeMap::new() };
        let planning = Volume::filled(grid.clone(), 0.0);
        let all = Volume::filled(grid.clone(), true);
        let side = PlanningSide::new(&planning, &all, &bones, WINDOW, |l| l == 1).unwrap();
        let push = PushField { displacement: Volume::filled(grid.clone(), [0.0; 3]), computed: all.clone() };
        let e = Evidence {
            side: &side,
            fraction: &planning,
            body: &all,
            planning: &planning,
            bones: &bones,
            bone_mm: &BTreeMap::from([(1, 0.1)]),
            push: &push,
            doubt: 1.0,
            bones_alone: None,
            misled: None,
        };
        let (map, _) = map(&e).unwrap();
        let differ = |k: usize| (map.at([10, 10, k]) - map.at([10, 10, 37 - k])).abs();
        assert!((0..38).all(|k| differ(k) < 1e-3), "{:?}", (0..38).map(differ).collect::<Vec<_>>());
    }
}
