//! A CT made to look like a cone-beam CT: wrong grey values, noise, streaks, and a short and round
//! field of view.
//!
//! This is no simulation of projections. Each effect is a formula of position whose size is known,
//! so that what a registration makes of it can be told apart from what the image shows.
//!
//! `options` says what is done, `view` what is seen at all, `artefacts` draws shading and streaks.

mod artefacts;
mod options;
#[cfg(test)]
mod tests;
mod view;

pub use options::CbctOptions;

use super::texture::{stored, voxel_noise};
use crate::error::Result;
use crate::volume::Volume;
use crate::volume::region::part;
use artefacts::{Shading, Streaks};
use rayon::prelude::*;
use view::{CircleView, kept};

/// The image, in HU, as a cone-beam machine shows it; slices lie across the storage axis that runs
/// most along the body. The same seed gives the same bits at any number of threads, and noise does
/// not depend on what is cut off.
///
/// # Errors
/// When an option is no number that an image can have, or nothing is left of the scan.
pub fn degrade(image: &Volume<f32>, options: &CbctOptions, seed: u64) -> Result<Volume<f32>> {
    options.check()?;
    let whole = image.grid();
    let kept = kept(options, whole)?;
    let image = part(image, &kept)?;
    let grid = image.grid();
    let (view, shading, streaks) =
        (CircleView::new(options, grid), Shading::new(options, seed), Streaks::new(options, seed));
    let value = |n: usize, hu: f64| {
        let Some(seen) = view.measured(grid, n) else { return options.padding_hu as f32 };
        let water = ((hu + 1000.0) / 1000.0).clamp(0.0, 1.0);
        let share = options.air_share + (1.0 - options.air_share).max(0.0) * water;
        let cupping = options.cupping_hu * (1.0 - (seen.radius / options.cupping_radius_mm).powi(2)).max(0.0);
        let rim = if view.radius < f64::MAX {
            options.rim_hu * ((seen.radius - view.radius) / options.rim_mm).exp()
        } else {
            0.0
        };
        let at = grid.voxel(n);
        let noise = voxel_noise(seed, whole.linear(std::array::from_fn(|a| at[a] + kept[a].start)));
        let added = share * (cupping + shading.at(&seen.from_axis, seen.height) + rim) + streaks.at(&seen);
        stored(-1000.0 + options.gain * (hu + 1000.0) + added + options.noise_hu * noise)
    };
    let data = image.data().par_iter().enumerate().map(|(n, hu)| value(n, f64::from(*hu))).collect();
    Volume::new(grid.clone(), data)
}
