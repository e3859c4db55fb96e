//! Rank 5: soft tissue by image. The two CTs pull the chain mail's elements where they show contrast, their skins along
//! the normal; its elasticity does the rest.

mod level;
mod options;
mod skin;

pub use options::{RefineOptions, SkinOptions};

use crate::chainmail::{Comparison, ImagePull, Lattice, Passes, Pull};
use crate::volume::{Mask, Volume};
use level::{Level, mean_edge};
use skin::Skin;

/// The planning and the fraction CT, ready to pull at any resolution.
pub struct Images {
    /// Both CTs inside the patient; outside and beyond the window the window's edges. `None` where grey values do not pull.
    grey: Option<[Volume<f32>; 2]>,
    skin: Option<Skin>,
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
            grey: (options.weight > 0.0)
                .then(|| [windowed(planning, planning_body), windowed(fraction, fraction_body)]),
            skin: Skin::new(planning_body, fraction_body, &options.skin),
            options: options.clone(),
        }
    }
}

impl ImagePull for Images {
    fn at<'a>(&'a self, lattice: &'a Lattice) -> Comparison<'a> {
        let level =
            self.grey.as_ref().map(|[planning, fraction]| Level::new(planning, fraction, lattice, &self.options));
        let outline = self.skin.as_ref().map(|skin| skin.at(lattice));
        let nothing = || Pull::none(lattice.soft().count(), self.options.farthest(lattice));
        Box::new(move |u| {
            let mut pull = level.as_ref().map_or_else(nothing, |level| level.pull(u));
            if let Some(outline) = &outline {
                outline.add(u, &mut pull);
            }
            pull
        })
    }

    fn passes(&self, lattice: &Lattice) -> Passes {
        let settled_mm = self.options.settled * mean_edge(&lattice.grid.spacing());
        Passes { most: self.options.passes, rounds: self.options.rounds, settled_mm }
    }
}
