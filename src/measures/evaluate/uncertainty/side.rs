//! What the map needs of the planning side; all fractions share it.

use crate::error::Result;
use crate::geometry::{Grid, vectorised};
use crate::volume::distance::{nearest_label, squared_distance};
use crate::volume::{LabelMap, Mask, Volume, Window, gaussian, trilinear};
use rayon::prelude::*;

/// Spacing at which the map is computed, mm.
const SPACING_MM: f64 = 3.0;
/// Width (sigma) of the averages of difference and gradient, mm.
/// The features that the map was chosen from have it (docs/decisions/uncertainty.md).
pub(super) const AVERAGE_MM: f64 = 4.0;
/// The planning CT and its bones at the resolution of the map.
#[derive(Debug, Clone)]
pub struct PlanningSide {
    /// Nodes at which the map is computed.
    pub(super) grid: Grid,
    /// Label of the nearest bone, and the distance to it, mm.
    pub(super) owner: Volume<u16>,
    pub(super) far: Volume<f32>,
    /// Squared gradient of the windowed HU, averaged, (HU/mm)^2.
    pub(super) slope: Volume<f32>,
    /// Nodes in soft tissue, ascending, each with the windowed HU of its eight points.
    pub(super) soft: Vec<(u32, [f32; 8])>,
    /// HU between which the images are compared.
    pub(super) window: Window,
}

impl PlanningSide {
    /// From the planning CT (HU), the patient in it, and the labels, of which some are bones; all on one grid. `window`
    /// is that of the refinement by image.
    ///
    /// # Errors
    /// Only for internal inconsistency of grids.
    pub fn new(
        planning: &Volume<f32>,
        body: &Mask,
        bones: &LabelMap,
        window: Window,
        is_bone: impl Fn(u16) -> bool + Sync,
    ) -> Result<Self> {
        let grid = planning.grid().coarsened(SPACING_MM);
        let ((owner, far), (mean, soft)) =
            rayon::join(|| nearest(bones, &grid, &is_bone), || shown(planning, body, bones, &grid, window, &is_bone));
        let slope = gaussian(&squared_slope(&Volume::new(grid.clone(), mean)?), AVERAGE_MM);
        Ok(Self { grid, owner, far, slope, soft, window })
    }
}

/// Label of the nearest bone and the distance to it, mm, on a coarse grid.
fn nearest(bones: &LabelMap, grid: &Grid, is_bone: impl Fn(u16) -> bool) -> (Volume<u16>, Volume<f32>) {
    let fine = bones.volume.grid();
    let mut labels = Volume::filled(grid.clone(), 0u16);
    for (l, label) in bones.volume.data().iter().enumerate().filter(|(_, l)| **l != 0 && is_bone(**l)) {
        if let Some(at) = grid.voxel_at(&fine.centre(fine.voxel(l))) {
            let at = grid.linear(at);
            labels.data_mut()[at] = *label;
        }
    }
    let far = squared_distance(&labels.map(|l| *l != 0), true).map(|d| d.sqrt().min(1e3));
    (nearest_label(&labels), far)
}

/// Mean windowed HU at each node (the window's lower end outside the patient), and what soft tissue shows at eight points.
fn shown(
    planning: &Volume<f32>,
    body: &Mask,
    bones: &LabelMap,
    grid: &Grid,
    window: Window,
    is_bone: impl Fn(u16) -> bool + Sync,
) -> (Vec<f32>, Vec<(u32, [f32; 8])>) {
    let offsets = grid.eighths();
    let node = |n: usize| {
        let x = grid.centre(grid.voxel(n));
        let own = planning.grid().voxel_at(&x).map(|v| planning.grid().linear(v)).filter(|&own| body.data()[own])?;
        let instead = planning.data()[own];
        let values = vectorised(
            #[inline(always)]
            || {
                let mut values = [0f32; 8];
                for (value, o) in values.iter_mut().zip(&offsets) {
                    let hu = trilinear(planning, &planning.grid().index(&(x + o)));
                    *value = window.of(hu.map_or(instead, |hu| hu as f32));
                }
                values
            },
        );
        Some((values, !is_bone(bones.volume.data()[own])))
    };
    let plane = grid.size()[0] * grid.size()[1];
    let mut mean = vec![window.low; grid.len()];
    let soft: Vec<Vec<(u32, [f32; 8])>> = mean
        .par_chunks_mut(plane)
        .enumerate()
        .map(|(k, mean)| {
            let mut soft = Vec::new();
            for (at, mean) in mean.iter_mut().enumerate() {
                let Some((values, is_soft)) = node(k * plane + at) else { continue };
                *mean = values.iter().sum::<f32>() / 8.0;
                if is_soft {
                    soft.push(((k * plane + at) as u32, values));
                }
            }
            soft
        })
        .collect();
    (mean, soft.concat())
}

/// Squared length of the gradient, per mm^2; central differences, one-sided at the edge.
fn squared_slope(image: &Volume<f32>) -> Volume<f32> {
    let grid = image.grid();
    let (size, strides, spacing) = (grid.size(), grid.strides(), grid.spacing());
    let data = image.data();
    let square = |n: usize| {
        let at = grid.voxel(n);
        (0..3)
            .map(|a| {
                let low = if at[a] > 0 { n - strides[a] } else { n };
                let high = if at[a] + 1 < size[a] { n + strides[a] } else { n };
                let steps = ((high - low) / strides[a]).max(1) as f64;
                (f64::from(data[high] - data[low]) / (steps * spacing[a])).powi(2)
            })
            .sum::<f64>() as f32
    };
    let values = (0..grid.len()).into_par_iter().map(square).collect();
    Volume::new(grid.clone(), values).expect("one value per voxel")
}
