//! A CT as the fit sees it: blurred tissue with the places where tissue is known.
//!
//! Air takes no part. A bone never lies in air, so air where a bone should be means padding: the circle of the
//! reconstruction, a cut field of view, a fill value. Blurring is normalised over tissue, so that neither padding
//! nor the image's edge bleeds into bone.

use crate::volume::{Volume, gaussian};
use nalgebra::Vector3;

/// Below this HU a voxel is air or padding.
const AIR_HU: f32 = -600.0;
/// Above this HU metal and its artefacts are cut.
const METAL_HU: f32 = 2000.0;

/// Blurred tissue with its validity.
#[derive(Debug, Clone)]
pub struct Tissue {
    /// Blurred HU; in air the blurred value of the tissue near it.
    pub value: Volume<f32>,
    /// 1 in tissue, 0 in air.
    pub valid: Volume<f32>,
}

impl Tissue {
    /// The tissue of a CT, blurred by `sigma` mm.
    pub fn blurred(ct: &Volume<f32>, sigma: f64) -> Self {
        let valid = ct.map(|&v| if v > AIR_HU { 1.0 } else { 0.0 });
        let mut value = Volume::new(
            ct.grid().clone(),
            ct.data().iter().zip(valid.data()).map(|(v, m)| m * v.min(METAL_HU)).collect(),
        )
        .expect("same grid, same length");
        value = gaussian(&value, sigma);
        let weight = gaussian(&valid, sigma);
        for (v, &w) in value.data_mut().iter_mut().zip(weight.data()) {
            *v = if w > 1e-3 { *v / w } else { AIR_HU };
        }
        Self { value, valid }
    }

    /// Visibility of a continuous index and its derivative per index step: 1 in tissue, 0 in air and outside, with a
    /// ramp over the outermost voxel of the image and over the surface of the tissue.
    pub fn visibility(&self, index: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let (edge, edge_slope) = ramp(self.valid.grid().size(), index);
        if edge <= 0.0 {
            return (0.0, Vector3::zeros());
        }
        let (tissue, slope) = trilinear_slope(&self.valid, index);
        // Half-filled cells hold partial volume: only the inner half of the ramp counts.
        let (w, dw) = if tissue > 0.5 { (2.0 * tissue - 1.0, slope * 2.0) } else { (0.0, Vector3::zeros()) };
        (edge * w, edge_slope * w + dw * edge)
    }
}

/// A ramp from 0 at the outermost voxel centres to 1 a voxel further in.
fn ramp(size: [usize; 3], index: &Vector3<f64>) -> (f64, Vector3<f64>) {
    let mut w = [1.0; 3];
    let mut d = [0.0; 3];
    for a in 0..3 {
        let last = (size[a] - 1) as f64;
        let (low, high) = (index[a], last - index[a]);
        if low < 1.0 || high < 1.0 {
            (w[a], d[a]) = if low < high { (low.clamp(0.0, 1.0), 1.0) } else { (high.clamp(0.0, 1.0), -1.0) };
        }
    }
    (w[0] * w[1] * w[2], Vector3::new(d[0] * w[1] * w[2], w[0] * d[1] * w[2], w[0] * w[1] * d[2]))
}

/// Trilinear value and slope at an index strictly inside the image.
fn trilinear_slope(v: &Volume<f32>, index: &Vector3<f64>) -> (f64, Vector3<f64>) {
    let size = v.grid().size();
    let low: [usize; 3] = std::array::from_fn(|a| (index[a] as usize).min(size[a].saturating_sub(2)));
    let t: [f64; 3] = std::array::from_fn(|a| index[a] - low[a] as f64);
    let strides = v.grid().strides();
    let base = v.grid().linear(low);
    let mut value = 0.0;
    let mut slope = Vector3::zeros();
    for c in 0..8 {
        let up = [c & 1, c >> 1 & 1, c >> 2];
        let at = base + (0..3).map(|a| if size[a] > 1 { up[a] * strides[a] } else { 0 }).sum::<usize>();
        let x = f64::from(v.data()[at]);
        let w: [f64; 3] = std::array::from_fn(|a| if up[a] == 1 { t[a] } else { 1.0 - t[a] });
        value += x * w[0] * w[1] * w[2];
        for a in 0..3 {
            let sign = if up[a] == 1 { 1.0 } else { -1.0 };
            slope[a] += x * sign * w[(a + 1) % 3] * w[(a + 2) % 3];
        }
    }
    (value, slope)
}
