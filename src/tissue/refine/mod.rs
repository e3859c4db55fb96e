//! Rank 5: soft tissue by image. The two CTs pull the chain mail's elements where they show contrast, their skins along
//! the normal; its elasticity does the rest.

mod level;
mod options;
mod planning;
mod skin;

pub use options::{RefineOptions, SkinOptions};
pub use planning::PlanningSamples;

use crate::chainmail::{Comparison, ImagePull, Lattice, Passes};
use crate::volume::{Mask, Volume};
use level::{Level, mean_edge};
use planning::{Planning, windowed};
use skin::Skin;

/// The planning and the fraction CT, ready to pull at any resolution.
pub struct Images<'a> {
    planning: Planning<'a>,
    /// The fraction CT inside the patient; outside and beyond the window the window's edges. `None` where grey values do not
    /// pull.
    fraction: Option<Volume<f32>>,
    skin: Option<Skin>,
    options: RefineOptions,
}

impl<'a> Images<'a> {
    /// From both CTs (HU) and the patient in each; the two grids may differ. What the planning CT shows is taken from `kept`
    /// where it is known, and else kept there.
    pub fn new(
        (planning, planning_body): (&'a Volume<f32>, &'a Mask),
        (fraction, fraction_body): (&Volume<f32>, &Mask),
        options: &RefineOptions,
        kept: Option<&'a PlanningSamples>,
    ) -> Self {
        Self {
            planning: Planning::new(planning, planning_body, kept),
            fraction: (options.weight > 0.0).then(|| windowed(fraction, fraction_body, options.window_hu)),
            skin: Skin::new(planning_body, fraction_body, &options.skin),
            options: options.clone(),
        }
    }
}

impl ImagePull for Images<'_> {
    fn at<'a>(&'a self, lattice: &'a Lattice) -> Comparison<'a> {
        let of = |fraction| Level::new(&self.planning, fraction, lattice, &self.options);
        let level = self.fraction.as_ref().map(of);
        let outline = self.skin.as_ref().map(|skin| skin.at(lattice));
        Box::new(move |u, which, pull| {
            match &level {
                Some(level) => level.renew(u, which, pull),
                None => which.iter().for_each(|&s| pull.set(s as usize, Default::default())),
            }
            if let Some(outline) = &outline {
                outline.add(u, which, pull);
            }
        })
    }

    fn passes(&self, lattice: &Lattice) -> Passes {
        let settled_mm = self.options.settled * mean_edge(&lattice.grid.spacing());
        Passes {
            most: self.options.passes,
            rounds: self.options.rounds,
            settled_mm,
            farthest: self.options.farthest(lattice),
        }
    }
}
