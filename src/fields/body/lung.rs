//! Aerated tissue inside the patient: lungs, with their airways.

use crate::geometry::Grid;
use crate::volume::components::{Components, Connectivity};
use crate::volume::morphology::{dilate, erode};
use crate::volume::{LabelMap, Mask, Volume};

/// Less dense than this is air or lung, HU; as the least HU of tissue elsewhere.
const THIN_HU: f32 = -500.0;
/// Lung on the mean, HU, emphysema included: what is thinner is air alone.
const LUNG_HU: std::ops::Range<f64> = -970.0..-500.0;
/// Smaller cavities are airways, sinuses and bowel gas, mm^3.
const LEAST_MM3: f64 = 100_000.0;
/// What a ball of this radius does not fit into is the partial volume of a surface, or an airway, mm.
const CORE_MM: f64 = 4.0;
/// Of the six ways along the axes from a place in a lung, so many on the mean end at the patient, not at the image's border.
const ENCLOSED: f64 = 3.5;

/// The patient with lungs that the image's border cuts open: denser than air on the mean, and with the patient on most sides.
pub(super) fn with_lungs(ct: &Volume<f32>, body: Mask) -> Mask {
    let grid = ct.grid();
    let aerated = Volume::from_fn(grid.clone(), |l| !body.data()[l] && ct.data()[l] < THIN_HU);
    let enough = |count: usize| count as f64 * grid.voxel_volume() >= LEAST_MM3;
    if !enough(aerated.count()) {
        return body;
    }
    let cores = erode(&aerated, CORE_MM);
    if !enough(cores.count()) {
        return body;
    }
    let near = dilate(&cores, CORE_MM);
    let thick = Volume::from_fn(grid.clone(), |l| near.data()[l] && aerated.data()[l]);
    let parts = Components::of(&thick, false, Connectivity::Face);
    let means = means(ct, &parts);
    let sides = Sides::of(&body).sides(&parts);
    let is_lung = |n: usize| enough(parts.sizes[n]) && LUNG_HU.contains(&means[n]) && sides[n] >= ENCLOSED;
    let lung = parts.select(&thick, is_lung);
    Volume::from_fn(grid.clone(), |l| body.data()[l] || lung.data()[l])
}

/// Where the patient begins and ends along each line of voxels, axis by axis.
struct Sides<'a> {
    grid: &'a Grid,
    ends: [Vec<[usize; 2]>; 3],
}

impl<'a> Sides<'a> {
    fn of(body: &'a Mask) -> Self {
        let grid = body.grid();
        let lines = |a: usize| grid.len() / grid.size()[a];
        let mut ends: [Vec<[usize; 2]>; 3] = std::array::from_fn(|a| vec![[usize::MAX, 0]; lines(a)]);
        for l in (0..grid.len()).filter(|l| body.data()[*l]) {
            let at = grid.voxel(l);
            for (a, ends) in ends.iter_mut().enumerate() {
                let [first, last] = &mut ends[line(grid, at, a)];
                (*first, *last) = ((*first).min(at[a]), (*last).max(at[a]));
            }
        }
        Self { grid, ends }
    }

    /// Ways along the axes that end at the patient, on the mean over each component.
    fn sides(&self, parts: &Components<bool>) -> Vec<f64> {
        let mut sums = vec![0usize; parts.len()];
        for run in &parts.runs {
            for l in run.start..run.end {
                let at = self.grid.voxel(l);
                let hits = |a: usize| {
                    let [first, last] = self.ends[a][line(self.grid, at, a)];
                    usize::from(first < at[a]) + usize::from(last > at[a])
                };
                sums[run.component] += (0..3).map(hits).sum::<usize>();
            }
        }
        sums.iter().zip(&parts.sizes).map(|(sum, size)| *sum as f64 / *size as f64).collect()
    }
}

/// Which line along axis `a` a voxel lies on.
fn line(grid: &Grid, at: [usize; 3], a: usize) -> usize {
    let (b, c) = ((a + 1) % 3, (a + 2) % 3);
    at[b] + grid.size()[b] * at[c]
}

/// The lungs of a patient in a CT (HU) with the air in them, on the grid of both; `None` where there is none.
pub fn lung(ct: &Volume<f32>, body: &Mask) -> Option<Mask> {
    let thin = Volume::from_fn(ct.grid().clone(), |l| body.data()[l] && ct.data()[l] < THIN_HU);
    let parts = Components::of(&thin, false, Connectivity::Face);
    let means = means(ct, &parts);
    let voxel = ct.grid().voxel_volume();
    let is_lung = |n: usize| parts.sizes[n] as f64 * voxel >= LEAST_MM3 && LUNG_HU.contains(&means[n]);
    (0..parts.len()).any(is_lung).then(|| parts.select(&thin, is_lung))
}

/// Labels that slide as one with the lung along the wall of chest and belly.
pub const SLIDING_ORGANS: [&str; 3] = ["liver", "spleen", "stomach"];

/// Vessels and airways up to twice this width belong to the lung, mm.
/// At 3 mm a chest errs by 1.825 mm for 1.820, at 12 nothing changes.
const VESSELS_MM: f64 = 6.0;

/// Whether organs of these names are labelled: then all of the surface along which they and the lung slide is known.
pub fn organs_labelled(labels: &LabelMap, organs: &[String]) -> bool {
    labels.names.values().any(|name| organs.contains(name))
}

/// What slides along the wall of chest and belly, on the labels' grid: lung (with the vessels in it) and the organs of these names;
/// `None` where there is neither.
pub fn slides(lung: Option<&Mask>, labels: &LabelMap, organs: &[String]) -> Option<Mask> {
    let lung = lung.map(|lung| erode(&dilate(lung, VESSELS_MM), VESSELS_MM));
    let organs: Vec<u16> =
        labels.names.iter().filter(|(_, name)| organs.contains(name)).map(|(label, _)| *label).collect();
    if organs.is_empty() {
        return lung;
    }
    let data = labels.volume.data();
    let slides = |v: usize| organs.contains(&data[v]) || lung.as_ref().is_some_and(|lung| lung.data()[v]);
    let region = Volume::from_fn(labels.volume.grid().clone(), slides);
    region.data().contains(&true).then_some(region)
}

/// Mean HU of each component.
fn means(ct: &Volume<f32>, parts: &Components<bool>) -> Vec<f64> {
    let mut sums = vec![0f64; parts.len()];
    for run in &parts.runs {
        sums[run.component] += ct.data()[run.start..run.end].iter().map(|hu| f64::from(*hu)).sum::<f64>();
    }
    sums.iter().zip(&parts.sizes).map(|(sum, size)| sum / *size as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::{BodyOptions, find};

    /// A chest of 20 HU cut by the image on the left and below, in air of -1000 HU, with a lung that reaches both borders
    /// and an airway of air alone; beside it a foam of -900 HU.
    fn chest(lung: f32) -> Volume<f32> {
        let grid = Grid::axis_aligned([50, 60, 40], [3.0; 3], [0.0; 3]).unwrap();
        Volume::from_fn(grid.clone(), |l| {
            let p = grid.centre(grid.voxel(l));
            let noise = (l * 7919 % 61) as f32 - 30.0;
            let inside = |grow: f64| {
                ((p.x - 30.0) / (75.0 + grow)).powi(2) + ((p.y - 90.0) / (60.0 + grow)).powi(2) < 1.0
                    && p.z < 105.0 + grow
            };
            match p {
                _ if inside(-12.0) && (p.y - 90.0).abs() > 6.0 => lung + noise,
                _ if inside(-12.0) => 40.0 + noise,
                _ if inside(0.0) => 20.0 + noise,
                _ if p.y > 156.0 => -900.0 + noise,
                _ => -1000.0 + noise,
            }
        })
    }

    #[test]
    fn lung_that_two_borders_cut_open_is_patient_and_air_of_the_same_shape_is_not() {
        let ct = chest(-860.0);
        let body = find(&ct, None, &BodyOptions::default()).unwrap();
        let found = lung(&ct, &body).expect("there is lung");
        let at = |mask: &Mask, p: [usize; 3]| *mask.at(p);
        // Inside, at the side border, at the lower border and where the two meet.
        for p in [[12, 22, 15], [0, 22, 15], [12, 22, 0], [0, 22, 0], [12, 40, 15]] {
            assert!(at(&found, p) && at(&body, p), "{p:?}");
        }
        for p in [[12, 30, 15], [40, 30, 15], [12, 56, 15], [12, 30, 39]] {
            assert!(!at(&found, p), "{p:?} is no lung");
        }
        assert!(!at(&body, [12, 56, 15]), "foam is no patient");
        // The same with air in it.
        let ct = chest(-1000.0);
        let body = find(&ct, None, &BodyOptions::default()).unwrap();
        assert!(lung(&ct, &body).is_none() && !at(&body, [0, 22, 0]));
    }
}
