//! How far the images agree: as scanned, with a couch shift, and registered; bones and soft tissue apart.
//!
//! The measure is the correlation in windows of 20 mm (local normalised cross-correlation), so that neither the scale of HU nor
//! slow shading of a cone-beam CT counts. Only windows with something to compare count: where planning is uniform, no
//! image can tell whether tissue lies right.

use super::pair::{displacement, inner, nearest};
use crate::geometry::Grid;
use crate::volume::region::part;
use crate::volume::{Mask, Volume, trilinear};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Distance of the places that are compared, mm: the images' own detail beyond it is mostly noise.
const STEP_MM: f64 = 4.0;
/// Half a window, in such steps.
/// In windows of 15 mm correlations differ by some hundredths.
const REACH: usize = 2;
/// Share of a window's places that must be known.
const KNOWN: f64 = 0.3;
/// Planning's standard deviation in a window, HU, from which there is something to compare.
const CONTRAST_HU: [f64; 2] = [60.0, 15.0];
/// A window is worse off than with the couch shift when its correlation is lower by more; less is noise.
const WORSE: f64 = 0.1;
/// So many windows, at least, tell something of an image.
const FEWEST: usize = 50;

/// Agreement of one kind of tissue.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct TissueAgreement {
    /// Volume whose surroundings have something to compare, ml.
    pub compared_ml: f64,
    /// Mean correlation as scanned; `None` where the scans hardly overlap.
    pub before: Option<f64>,
    /// The same with the couch shift alone.
    pub couch: Option<f64>,
    /// The same registered.
    pub after: f64,
    /// Share of the volume whose correlation is lower than with the couch shift by more than 0.1, percent.
    pub worse_percent: f64,
}

/// The one shift that a registration is compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Alone {
    /// The couch shift, matched on bones.
    #[default]
    Couch,
    /// The mean displacement of a field where no bones are known.
    Mean,
}

impl Alone {
    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Couch => "couch shift",
            Self::Mean => "mean shift",
        }
    }
}

/// Agreement of the images in the patient.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Agreement {
    /// In and at bones; `None` where too little can be compared, or no bones are known.
    pub bones: Option<TissueAgreement>,
    /// Away from bones; `None` where too little can be compared.
    pub soft_tissue: Option<TissueAgreement>,
    /// The shift of `couch`.
    #[serde(default)]
    pub alone: Alone,
}

/// What is compared, in the fraction's frame.
pub struct Images<'a> {
    /// Fraction to planning, at fraction voxels, LPS mm.
    pub pull: &'a Volume<[f32; 3]>,
    /// Planning CT, HU.
    pub planning: &'a Volume<f32>,
    /// Fraction CT; no number where nothing was measured.
    pub fraction: &'a Volume<f32>,
    /// The patient, in planning.
    pub body: &'a Mask,
    /// Labels in planning, and which of them are bones: a map may hold organs and muscles, too.
    pub bones: Option<(&'a Volume<u16>, &'a [u16])>,
    /// One shift of the whole, planning to fraction, LPS mm.
    pub couch: Vector3<f64>,
    /// Which shift it is.
    pub alone: Alone,
}

/// Values at one place: the fraction, and planning as scanned, shifted and registered; no number where there is none.
#[derive(Clone, Copy)]
struct Place {
    fraction: f32,
    planning: [f32; 3],
    /// In the patient, as registered.
    patient: bool,
    bone: bool,
}

/// Compares the images of a registration.
pub fn evaluate(images: &Images<'_>) -> Agreement {
    let grid = images.fraction.grid().coarsened(STEP_MM);
    let place = |l: usize| images.at(&grid, l);
    let all = (0..grid.len()).into_par_iter().with_min_len(1 << 10).map(place).collect();
    let patient = Volume::new(grid.clone(), all).ok().and_then(|all| patient_alone(&all));
    let Some(patient) = patient else { return Agreement::default() };
    let (grid, places) = (patient.grid(), patient.data());
    let near = near_bone(places, grid);
    let tissue = |bone: bool| {
        // At a bone's surface is its contrast; soft tissue is judged apart from it.
        let counts = |l: usize| places[l].patient && near[l] == bone;
        let centre = |l: usize| places[l].patient && if bone { places[l].bone } else { !near[l] };
        of_tissue(places, grid, &counts, &centre, CONTRAST_HU[usize::from(!bone)])
    };
    let bones = images.bones.and_then(|_| tissue(true));
    Agreement { bones, soft_tissue: tissue(false), alone: images.alone }
}

impl Images<'_> {
    fn at(&self, grid: &Grid, l: usize) -> Place {
        let none = Place { fraction: f32::NAN, planning: [f32::NAN; 3], patient: false, bone: false };
        let y = grid.centre(grid.voxel(l));
        let Some(v) = displacement(self.pull, &y) else { return none };
        let x = y + v;
        if !nearest(self.body, &x) {
            return none;
        }
        let shifts = [Vector3::zeros(), -self.couch, v];
        let fraction = mean(self.fraction, &y, grid);
        let planning = shifts.map(|by| mean(self.planning, &(y + by), grid));
        let bone = self.bones.is_some_and(|(labels, bones)| bones.contains(&nearest(labels, &x)));
        Place { fraction, planning, patient: fraction.is_finite() && planning[2].is_finite(), bone }
    }
}

/// The smallest box of places around the patient; nothing where he is in none.
fn patient_alone(all: &Volume<Place>) -> Option<Volume<Place>> {
    let mut ends = [[usize::MAX, 0]; 3];
    for (l, _) in all.data().iter().enumerate().filter(|(_, place)| place.patient) {
        for ([from, to], at) in ends.iter_mut().zip(all.grid().voxel(l)) {
            (*from, *to) = ((*from).min(at), (*to).max(at + 1));
        }
    }
    let [from, to] = ends[0];
    if from < to { part(all, &ends.map(|[from, to]| from..to)).ok() } else { None }
}

/// Mean of four points around a place, the corners of a tetrahedron: less noise than at one.
fn mean(volume: &Volume<f32>, at: &Point3<f64>, grid: &Grid) -> f32 {
    let [x, y, z] = grid.spacing().map(|s| s / 4.0);
    let corners = [[x, y, z], [x, -y, -z], [-x, y, -z], [-x, -y, z]];
    let point = |by: [f64; 3]| trilinear(volume, &inner(volume.grid(), &(at + Vector3::from(by))));
    let sum: Option<f64> = corners.into_iter().map(point).sum();
    sum.map_or(f32::NAN, |sum| (sum / 4.0) as f32)
}

/// Places in or beside a bone.
fn near_bone(places: &[Place], grid: &Grid) -> Vec<bool> {
    let ones: Vec<[f64; 1]> = places.iter().map(|p| [f64::from(u8::from(p.bone))]).collect();
    boxed(ones, grid, 1).into_iter().map(|[n]| n > 0.0).collect()
}

/// Agreement in the windows around the places that are `centre`, of what `counts` in them.
fn of_tissue(
    places: &[Place],
    grid: &Grid,
    counts: &(dyn Fn(usize) -> bool + Sync),
    centre: &(dyn Fn(usize) -> bool + Sync),
    contrast: f64,
) -> Option<TissueAgreement> {
    let correlation = |of: usize| correlations(places, grid, counts, of);
    let [before, couch, after] = [0, 1, 2].map(correlation);
    let compared: Vec<usize> = (0..places.len())
        .filter(|&l| {
            centre(l) && after[l].is_some_and(|(_, deviations)| deviations[0] >= contrast && deviations[1] > 0.0)
        })
        .collect();
    if compared.len() < FEWEST {
        return None;
    }
    let share = |n: usize, of: usize| n as f64 / of as f64;
    let mean = |all: &[Option<(f64, [f64; 2])>]| {
        let known: Vec<f64> = compared.iter().filter_map(|&l| Some(all[l]?.0)).collect();
        (share(known.len(), compared.len()) >= 0.5).then(|| known.iter().sum::<f64>() / known.len() as f64)
    };
    let pairs: Vec<(f64, f64)> = compared.iter().filter_map(|&l| Some((couch[l]?.0, after[l]?.0))).collect();
    let worse = pairs.iter().filter(|(couch, after)| *after < couch - WORSE).count();
    Some(TissueAgreement {
        compared_ml: compared.len() as f64 * grid.voxel_volume() / 1000.0,
        before: mean(&before),
        couch: mean(&couch),
        after: mean(&after).unwrap_or(0.0),
        worse_percent: 100.0 * share(worse, pairs.len().max(1)),
    })
}

/// Correlation in each window, with the standard deviations of planning and fraction, HU; 0 where one is uniform, `None` where too
/// little is known.
fn correlations(
    places: &[Place],
    grid: &Grid,
    counts: &(dyn Fn(usize) -> bool + Sync),
    of: usize,
) -> Vec<Option<(f64, [f64; 2])>> {
    let product = |(l, place): (usize, &Place)| {
        let (a, b) = (f64::from(place.planning[of]), f64::from(place.fraction));
        if !counts(l) || !a.is_finite() || !b.is_finite() { [0.0; 6] } else { [1.0, a, b, a * a, b * b, a * b] }
    };
    let products: Vec<[f64; 6]> = places.par_iter().enumerate().with_min_len(1 << 10).map(product).collect();
    let most = (2 * REACH + 1).pow(3) as f64;
    let correlation = |[n, a, b, aa, bb, ab]: [f64; 6]| {
        if n < KNOWN * most {
            return None;
        }
        let (a, b) = (a / n, b / n);
        let [va, vb] = [(aa / n - a * a).max(0.0), (bb / n - b * b).max(0.0)];
        // What is left of rounding in a uniform window is no contrast.
        let uniform = va < 1e-3 || vb < 1e-3;
        let r = if uniform { 0.0 } else { ((ab / n - a * b) / (va * vb).sqrt()).clamp(-1.0, 1.0) };
        Some((r, [va.sqrt(), if vb < 1e-3 { 0.0 } else { vb.sqrt() }]))
    };
    boxed(products, grid, REACH).into_par_iter().map(correlation).collect()
}

/// Sums over boxes that reach so far to each side of every place.
fn boxed<const N: usize>(mut values: Vec<[f64; N]>, grid: &Grid, reach: usize) -> Vec<[f64; N]> {
    let (size, strides) = (grid.size(), grid.strides());
    for axis in 0..3 {
        let (n, stride) = (size[axis], strides[axis]);
        let sum = |l: usize| {
            let at = l / stride % n;
            let range = l - at.min(reach) * stride..=l + (n - 1 - at).min(reach) * stride;
            values[range].iter().step_by(stride).fold([0.0; N], |mut sum, value| {
                sum.iter_mut().zip(value).for_each(|(s, v)| *s += v);
                sum
            })
        };
        values = (0..values.len()).into_par_iter().with_min_len(1 << 10).map(sum).collect();
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Grid {
        Grid::axis_aligned([40, 36, 30], [3.0; 3], [-60.0, 20.0, 0.0]).unwrap()
    }

    /// Tissue with detail everywhere, a bone along the middle.
    fn hu(p: &Point3<f64>) -> f64 {
        let bone = bone(p);
        let wave = (p.x / 7.0).sin() + (p.y / 6.0).cos() * (p.z / 8.0).sin();
        if bone { 600.0 + 250.0 * wave } else { 40.0 + 60.0 * wave }
    }

    fn bone(p: &Point3<f64>) -> bool {
        (p.x.powi(2) + (p.y - 72.0).powi(2)).sqrt() < 14.0
    }

    /// The images of a patient who has moved by `moved`, registered by a field of `found`, couch shift `couch`.
    fn measured(
        moved: [f64; 3],
        found: [f64; 3],
        couch: [f64; 3],
        shown: impl Fn(f64, usize) -> f64 + Sync,
    ) -> Agreement {
        let grid = grid();
        let at = |l: usize| grid.centre(grid.voxel(l));
        let planning = Volume::from_fn(grid.clone(), |l| hu(&at(l)) as f32);
        let fraction = Volume::from_fn(grid.clone(), |l| shown(hu(&(at(l) - Vector3::from(moved))), l) as f32);
        let pull = Volume::filled(grid.clone(), found.map(|c| -c as f32));
        // Beside the bone lies an organ with a label of its own.
        let labels = Volume::from_fn(grid.clone(), |l| u16::from(bone(&at(l))) + 9 * u16::from(at(l).x > 30.0));
        let body = Volume::filled(grid.clone(), true);
        evaluate(&Images {
            pull: &pull,
            planning: &planning,
            fraction: &fraction,
            body: &body,
            bones: Some((&labels, &[1])),
            couch: couch.into(),
            alone: Alone::Couch,
        })
    }

    #[test]
    fn the_right_field_agrees_wholly_and_a_wrong_one_is_worse_than_the_couch() {
        let moved = [6.0, -3.0, 3.0];
        let right = measured(moved, moved, [3.0, 0.0, 0.0], |hu, _| hu);
        for tissue in [right.bones.unwrap(), right.soft_tissue.unwrap()] {
            assert!(tissue.after > 0.98 && tissue.worse_percent == 0.0, "{tissue:?}");
            assert!(tissue.before.unwrap() < tissue.couch.unwrap() && tissue.couch.unwrap() < 0.9, "{tissue:?}");
        }
        let wrong = measured(moved, [-6.0, 9.0, 0.0], moved, |hu, _| hu);
        for tissue in [wrong.bones.unwrap(), wrong.soft_tissue.unwrap()] {
            assert!(tissue.couch.unwrap() > 0.98 && tissue.after < 0.6 && tissue.worse_percent > 60.0, "{tissue:?}");
        }
    }

    #[test]
    fn scale_and_offset_do_not_count_and_a_mirrored_contrast_does() {
        let moved = [3.0, 0.0, 0.0];
        let plain = measured(moved, moved, [0.0; 3], |hu, _| hu);
        let scaled = measured(moved, moved, [0.0; 3], |hu, _| 0.6 * hu - 200.0);
        let after = |a: Agreement| [a.bones.unwrap().after, a.soft_tissue.unwrap().after];
        for (a, b) in after(plain).into_iter().zip(after(scaled)) {
            assert!((a - b).abs() < 1e-3, "{a} {b}");
        }
        assert!(after(measured(moved, moved, [0.0; 3], |hu, _| -hu)).into_iter().all(|r| r < -0.9));
    }

    #[test]
    fn what_was_not_measured_or_has_no_contrast_takes_no_part() {
        let plane = grid().strides()[2];
        let still = [0.0; 3];
        let half = measured(still, still, still, |hu, l| if l / plane < 15 { f64::NAN } else { hu });
        let whole = measured(still, still, still, |hu, _| hu);
        let (half, whole) = (half.soft_tissue.unwrap(), whole.soft_tissue.unwrap());
        assert!(half.compared_ml < 0.6 * whole.compared_ml && half.after > 0.98, "{half:?} {whole:?}");
        let flat = measured(still, still, still, |_, _| 0.0);
        assert_eq!((flat.bones, flat.soft_tissue), (None, None));
    }
}
