//! The patient in an MR, and his grey values freed of the coil's bias.

use super::fill;
use crate::error::{Error, Result};
use crate::volume::components::{Components, Connectivity};
use crate::volume::morphology::{dilate, erode};
use crate::volume::{Counted, Mask, Volume, gaussian_ratio};

/// Tissue is brighter than this share of the way from dark to bright (Smith 2002).
const SHARE: f64 = 0.1;
/// Dark and bright: these shares of the voxels are darker.
const DARK: f64 = 0.02;
const BRIGHT: f64 = 0.98;
/// What a ball of this radius does not fit into is noise, mm.
const OPENING_MM: f64 = 3.0;
/// Air does not enter the patient through openings narrower than twice this, mm.
const CLOSING_MM: f64 = 8.0;
/// A part apart from the largest is patient from this share of it on: the other leg.
const LIMB: f64 = 0.1;
/// A dark end slice shows this share of the patient in the next one at most; that one cuts him, where he is this much as wide as
/// so many slices on.
const NOISE_SHARE: f64 = 0.05;
const CUT_SHARE: f64 = 0.8;
const ON: usize = 3;
/// Width (sigma) of the neighbourhood whose mean is the coil's bias, mm.
/// With the bias left in, 4 of 15 bones are found (docs/decisions/mr.md).
const BIAS_MM: f64 = 40.0;
/// Grey value of what is dark in the patient, on a scale like that of HU: most of his tissue lies in the window of soft tissue.
pub const DARKEST: f32 = -150.0;
/// How much more the mean of a neighbourhood has, and the most that counts.
const MEAN: f32 = 165.0;
const BRIGHTEST: f32 = 800.0;
/// Outside of the patient.
const OUTSIDE: f32 = -1000.0;
/// Voxels are counted by every so many.
const EVERY: usize = 7;

/// Grey value below which a share of them lies.
fn quantile(sorted: &[f32], share: f64) -> f32 {
    sorted.get((share * (sorted.len() - 1) as f64) as usize).copied().unwrap_or(0.0)
}

/// The patient in an MR, with airway and other cavities filled.
///
/// # Errors
/// When nothing in the image is thick enough to be a patient.
pub fn find(mr: &Volume<f32>) -> Result<Mask> {
    let mut values: Vec<f32> = mr.data().iter().copied().step_by(EVERY).filter(|v| v.is_finite()).collect();
    values.sort_by(f32::total_cmp);
    let [dark, bright] = [DARK, BRIGHT].map(|share| quantile(&values, share));
    let threshold = dark + SHARE as f32 * (bright - dark);
    let solid = mr.map(|&v| v > threshold);
    let finest = 1.01 * mr.grid().spacing().into_iter().fold(f64::INFINITY, f64::min);
    let opening = OPENING_MM.max(finest);
    let core = erode(&solid, opening);
    let parts = Components::of(&core, false, Connectivity::Face);
    let largest = parts.largest().ok_or_else(|| {
        Error::input(
            "MR",
            format!("no patient: nothing brighter than {threshold} holds a ball of {opening} mm radius"),
            "give an MR that shows the patient",
        )
    })?;
    let least = LIMB * parts.sizes[largest] as f64;
    let core = parts.select(&core, |n| parts.sizes[n] as f64 >= least);
    let near = dilate(&core, opening);
    let mut body = Volume::from_fn(near.grid().clone(), |l| near.data()[l] && solid.data()[l]);
    clear_dark_ends(&mut body);
    let mut body = fill::cavities(&body, CLOSING_MM);
    // Marrow within its cortical bone, which the scan's ends leave open along the slices.
    for slice in 0..body.grid().size()[2] {
        fill::seal_face(&mut body, 2, slice, 0.0);
    }
    Ok(body)
}

/// Clears the end slices that hold no more of the patient than noise beside him, where the next one cuts him.
fn clear_dark_ends(body: &mut Mask) {
    let [ni, nj, nk] = body.grid().size();
    let plane = ni * nj;
    let held: Vec<f64> = body.data().chunks(plane).map(|s| s.iter().filter(|inside| **inside).count() as f64).collect();
    let dark = |from_end: &dyn Fn(usize) -> usize| {
        let at = |n: usize| held[from_end(n)];
        let cut = |n: usize| at(n) > CUT_SHARE * at(n + ON) && at(n) > 0.0;
        (1..nk.saturating_sub(ON)).find(|n| cut(*n)).filter(|n| (0..*n).all(|m| at(m) < NOISE_SHARE * at(*n)))
    };
    let low = dark(&|n| n).unwrap_or(0);
    let high = dark(&|n| nk - 1 - n).unwrap_or(0);
    for slice in (0..low).chain(nk - high..nk) {
        body.data_mut()[slice * plane..][..plane].fill(false);
    }
}

/// An MR on a scale on which air is told from the patient.
#[derive(Debug, Clone)]
pub struct TissueScale {
    /// The coil's bias taken out: [`DARKEST`] where the patient is dark, brighter where he is bright, and a CT's air outside of him.
    pub image: Volume<f32>,
    /// Grey values of the MR that shares of `DARK` and `BRIGHT` of the patient are darker than.
    pub range: [f32; 2],
}

/// Brings an MR to that scale.
///
/// # Errors
/// As [`find`].
pub fn tissue_scale(mr: &Volume<f32>) -> Result<TissueScale> {
    let body = find(mr)?;
    let inside = Volume::from_fn(mr.grid().clone(), |l| if body.data()[l] { mr.data()[l].max(0.0) } else { -1.0 });
    let value = |v: f32| v.max(0.0);
    let count = |v: f32| if v < 0.0 { 0.0 } else { 1.0 };
    let ratio = |sum: f32, n: f32| if n > 1e-3 { sum / n } else { 0.0 };
    let patient = Counted { image: &inside, value: count };
    let mean = gaussian_ratio(&Counted { image: &inside, value }, &patient, BIAS_MM, |_| false, ratio);
    let of = |l: usize| match body.data()[l] {
        true => (DARKEST + MEAN * inside.data()[l] / mean.data()[l].max(f32::MIN_POSITIVE)).min(BRIGHTEST),
        false => OUTSIDE,
    };
    let image = Volume::from_fn(mr.grid().clone(), of);
    let mut patient: Vec<f32> = inside.data().iter().copied().filter(|v| *v >= 0.0).step_by(EVERY).collect();
    patient.sort_by(f32::total_cmp);
    Ok(TissueScale { image, range: [DARK, BRIGHT].map(|share| quantile(&patient, share)) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    /// A thigh along z of 60 mm radius, brighter towards x, with a dark bone, and a dark slice at either end, in noise.
    fn thigh(slice_mm: f64) -> Volume<f32> {
        let grid = Grid::axis_aligned([80, 80, 30], [2.0, 2.0, slice_mm], [-79.0, -79.0, 0.0]).unwrap();
        Volume::from_fn(grid.clone(), |l| {
            let (p, k) = (grid.centre(grid.voxel(l)), grid.voxel(l)[2]);
            let noise = (l * 7919 % 37) as f32;
            let (r, shaft) = (p.x.hypot(p.y), (p.x - 10.0).hypot(p.y));
            if k == 0 || k == 29 || r > 60.0 || (10.0..14.0).contains(&shaft) {
                return noise;
            }
            let tissue = if r > 50.0 || shaft < 10.0 { 900.0 } else { 350.0 };
            tissue * (1.0 + p.x as f32 / 200.0) + noise
        })
    }

    #[test]
    fn the_patient_is_found_with_his_dark_bone_and_without_noise() {
        let mr = thigh(4.0);
        let body = find(&mr).unwrap();
        for l in 0..mr.data().len() {
            let (p, k) = (mr.grid().centre(mr.grid().voxel(l)), mr.grid().voxel(l)[2]);
            let r = p.x.hypot(p.y);
            let inside = r < 58.0 && k > 0 && k < 29;
            assert!(!inside || body.data()[l], "{p} is patient");
            assert!(r < 63.0 && k > 0 && k < 29 || !body.data()[l], "{p} is none");
        }
        let dark = Volume::filled(mr.grid().clone(), 0.0f32);
        assert!(find(&dark).unwrap_err().to_string().contains("no patient"));
    }

    #[test]
    fn noise_beside_the_patient_hides_no_dark_end() {
        // Of each dark slice a few voxels are as bright as noise is at times.
        let mut mr = thigh(2.5);
        let plane = 80 * 80;
        for slice in [0, 29] {
            for n in (0..plane).step_by(97) {
                mr.data_mut()[slice * plane + n] = 200.0;
            }
        }
        let TissueScale { image, .. } = tissue_scale(&mr).unwrap();
        for slice in [0, 29] {
            assert!(image.data()[slice * plane..][..plane].iter().all(|v| (v - OUTSIDE).abs() < 1e-3), "{slice}");
        }
        assert_eq!(crate::view::View::of_ends(&image).report.blank, [[0, 0], [0, 0], [1, 1]]);
    }

    #[test]
    fn a_patient_who_ends_within_the_scan_keeps_his_tip() {
        // A head that ends in three small slices under one of air, and is cut below.
        let grid = Grid::axis_aligned([60, 60, 24], [2.0, 2.0, 3.0], [-59.0, -59.0, 0.0]).unwrap();
        let head = |l: usize| {
            let (p, k) = (grid.centre(grid.voxel(l)), grid.voxel(l)[2]);
            p.x.hypot(p.y) < [6.0, 12.0, 24.0].get(22usize.wrapping_sub(k)).copied().unwrap_or(45.0) && k < 23
        };
        let mr = Volume::from_fn(grid.clone(), |l| if head(l) { 500.0f32 } else { 10.0 });
        let body = find(&mr).unwrap();
        let held = |slice: usize| body.data()[slice * 3600..][..3600].iter().filter(|b| **b).count();
        assert!(held(22) > 20 && held(21) > 80 && held(0) > 1500 && held(23) == 0, "{} {}", held(22), held(21));
    }

    #[test]
    fn the_same_tissue_is_as_bright_on_both_sides_and_air_is_air() {
        let TissueScale { image, range: [dark, bright] } = tissue_scale(&thigh(4.0)).unwrap();
        let at = |x: f64| *image.at(image.grid().index(&[x, 0.0, 60.0].into()).map(|c| c.round() as usize).into());
        // Muscle; the MR itself has 1.6 times as much on one side.
        assert!(((at(40.0) - DARKEST) / (at(-40.0) - DARKEST) - 1.0).abs() < 0.25, "{} {}", at(40.0), at(-40.0));
        assert!(
            (at(75.0) - OUTSIDE).abs() < 1e-3 && at(22.0) < at(40.0) && at(10.0) > at(40.0),
            "{} {}",
            at(22.0),
            at(10.0)
        );
        assert!(dark < 100.0 && bright > 800.0, "{dark} {bright}");
    }
}
