//! Rank 5: soft tissue by image. The two CTs pull the chain mail's elements where they show contrast; its elasticity
//! does the rest.

mod level;
mod options;

pub use options::RefineOptions;

use crate::chainmail::{Comparison, ImagePull, Lattice};
use crate::volume::{Mask, Volume};
use level::Level;

/// The planning and the fraction CT, ready to pull at any resolution.
pub struct Images {
    /// Planning CT inside the patient; outside and beyond the window the window's edges.
    planning: Volume<f32>,
    /// Fraction CT, likewise.
    fraction: Volume<f32>,
    options: RefineOptions,
}

impl Images {
    /// From both CTs (HU) and the patient in each; the two grids may differ.
    pub fn new(
        (planning, planning_body): (&Volume<f32>, &Mask),
        (fraction, fraction_body): (&Volume<f32>, &Mask),
        options: &RefineOptions,
    ) -> Self {
        let [low, high] = options.window_hu;
        let windowed = |ct: &Volume<f32>, body: &Mask| {
            Volume::from_fn(ct.grid().clone(), |v| if body.data()[v] { ct.data()[v].clamp(low, high) } else { low })
        };
        Self {
            planning: windowed(planning, planning_body),
            fraction: windowed(fraction, fraction_body),
            options: options.clone(),
        }
    }
}

impl ImagePull for Images {
    fn at<'a>(&'a self, lattice: &'a Lattice) -> Comparison<'a> {
        let level = Level::new(&self.planning, &self.fraction, lattice, &self.options);
        Box::new(move |u| level.pull(u))
    }

    fn passes(&self) -> (usize, usize) {
        (self.options.passes, self.options.rounds)
    }
}
