//! Aerated tissue inside the patient: lungs, with their airways.

use crate::volume::components::{Components, Connectivity, Run};
use crate::volume::morphology::{dilate, erode};
use crate::volume::{Mask, Volume};

/// Less dense than this is air or lung, HU; as the least HU of tissue elsewhere.
const THIN_HU: f32 = -500.0;
/// Lung on the mean, HU, emphysema included: what is thinner is air alone.
const LUNG_HU: std::ops::Range<f64> = -970.0..-500.0;
/// Smaller cavities are airways, sinuses and bowel gas, mm^3.
const LEAST_MM3: f64 = 100_000.0;
/// What a ball of this radius does not fit into is the partial volume of a surface, or an airway, mm.
const CORE_MM: f64 = 4.0;
/// Share of a lung's surface that may border on air: airways. Foam borders on more.
const MOST_AIR: f64 = 0.35;

/// The patient with lungs that the image's border cuts open: denser than air on the mean, and for the most part within the
/// patient and that border.
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
    let mut borders = vec![Border::default(); parts.len()];
    for run in &parts.runs {
        borders[run.component].add(run, &thick, &aerated);
    }
    let means = means(ct, &parts);
    let is_lung = |n: usize| enough(parts.sizes[n]) && LUNG_HU.contains(&means[n]) && borders[n].air_share() < MOST_AIR;
    let lung = parts.select(&thick, is_lung);
    Volume::from_fn(grid.clone(), |l| body.data()[l] || lung.data()[l])
}

/// Faces between a component and what is around it.
#[derive(Debug, Clone, Copy, Default)]
struct Border {
    patient: usize,
    air: usize,
}

impl Border {
    fn add(&mut self, run: &Run, thick: &Mask, aerated: &Mask) {
        let grid = thick.grid();
        let (size, strides) = (grid.size(), grid.strides());
        for l in run.start..run.end {
            let at = grid.voxel(l);
            for a in 0..3 {
                let low = (at[a] > 0).then(|| l - strides[a]);
                let high = (at[a] + 1 < size[a]).then(|| l + strides[a]);
                for next in [low, high].into_iter().flatten().filter(|n| !thick.data()[*n]) {
                    match aerated.data()[next] {
                        true => self.air += 1,
                        false => self.patient += 1,
                    }
                }
            }
        }
    }

    fn air_share(&self) -> f64 {
        self.air as f64 / (self.air + self.patient).max(1) as f64
    }
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

/// Mean HU of each component.
fn means(ct: &Volume<f32>, parts: &Components<bool>) -> Vec<f64> {
    let mut sums = vec![0f64; parts.len()];
    for run in &parts.runs {
        sums[run.component] += ct.data()[run.start..run.end].iter().map(|hu| f64::from(*hu)).sum::<f64>();
    }
    sums.iter().zip(&parts.sizes).map(|(sum, size)| sum / *size as f64).collect()
}
