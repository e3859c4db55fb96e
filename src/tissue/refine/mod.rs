//! Rank 5: soft tissue by image. The two CTs pull the chain mail's elements where they show contrast, their skins along
//! the normal; its elasticity does the rest.

mod around;
mod evidence;
mod guide;
mod level;
mod local;
mod options;
mod planning;
mod shading;
mod skin;
mod translation;

pub use evidence::Misled;
pub use guide::{DOUBTED_MM, GuideOptions, Guides, UNBELIEVED_MM, depth_in};
pub use options::{RefineOptions, ShadingOptions, SkinOptions};
pub use planning::PlanningSamples;
pub use shading::{GreyValues, Shading};
pub use translation::translated;

use crate::chainmail::{Comparison, ImagePull, Lattice, Passes, STILL_MOVING};
use crate::volume::{Mask, Volume};
use level::{Alone, Level};
use planning::{Planning, Windowed};
use skin::Skin;

/// Gain and offset of a corrected fraction are found anew over neighbourhoods of this width (sigma), mm, or of an element where
/// that is wider: 12 was worse on all cone-beam cases.
const NEIGHBOURHOOD_MM: f64 = 6.0;

/// The planning and the fraction CT, ready to pull at any resolution.
pub struct Images<'a> {
    planning: Planning<'a>,
    /// The fraction CT inside the patient; outside and beyond the window the window's edges, and no number where nothing was
    /// measured. `None` where grey values do not pull.
    fraction: Option<Windowed>,
    skin: Option<Skin>,
    options: RefineOptions,
    neighbourhood_mm: Option<f64>,
    alone: Option<&'a Volume<[f32; 3]>>,
    /// Where grey values do not pull, since they mislead.
    misled: Option<&'a Mask>,
    /// Structures that both scans outline.
    guides: Option<&'a Guides>,
}

/// A CT (HU; no number where nothing was measured) with the patient in it.
#[derive(Debug, Clone, Copy)]
pub struct Scan<'a> {
    /// HU.
    pub ct: &'a Volume<f32>,
    /// Inside of the skin, on its grid.
    pub body: &'a Mask,
}

/// What is known of two scans that pull.
#[derive(Debug, Clone, Copy, Default)]
pub struct Kind {
    /// Planning shows lung.
    pub lung: bool,
    /// One scan's grey values were brought to the other's ([`Shading::corrected`], [`translated`]).
    pub corrected: bool,
    /// Planning is shown as an MR ([`translated`]).
    pub translated: bool,
}

impl<'a> Images<'a> {
    /// From both scans; their grids may differ. What the planning CT shows is taken from `kept` where it is known, and else
    /// kept there; a corrected fraction and another modality are compared otherwise, and keep nothing.
    pub fn new(
        planning: Scan<'a>,
        fraction: Scan<'_>,
        kind: Kind,
        options: &RefineOptions,
        kept: Option<&'a PlanningSamples>,
        alone: Option<&'a Volume<[f32; 3]>>,
    ) -> Self {
        let (kept, options, neighbourhood_mm) = match kind {
            Kind { translated: true, .. } => (None, options.translated(), Some(NEIGHBOURHOOD_MM)),
            Kind { corrected: true, .. } => (None, options.corrected(), Some(NEIGHBOURHOOD_MM)),
            _ => (kept, options.clone(), None),
        };
        let window = options.window(kind.lung);
        let pulls = options.weight > 0.0;
        Self {
            planning: Planning::new(planning.ct, planning.body, window, kept),
            fraction: pulls.then(|| Windowed::new(fraction.ct, fraction.body, window)),
            skin: Skin::new(planning.body, fraction.body, &options.skin),
            options,
            neighbourhood_mm,
            alone,
            misled: None,
            guides: None,
        }
    }

    /// The same pull, but where images mislead ([`Images::misled`]): tissue there is as tissue that the fraction does not show.
    #[must_use]
    pub fn without(self, misled: &'a Mask) -> Self {
        Self { misled: Some(misled), ..self }
    }

    /// The same pull, beside that of structures that both scans outline.
    #[must_use]
    pub fn guided(self, guides: Option<&'a Guides>) -> Self {
        Self { guides, ..self }
    }
}

impl ImagePull for Images<'_> {
    fn at<'a>(&'a self, lattice: &'a Lattice) -> Comparison<'a> {
        let of = |fraction| {
            let bones = Alone { field: self.alone, misled: self.misled };
            Level::new(&self.planning, fraction, lattice, &self.options, self.neighbourhood_mm, bones)
        };
        let level = self.fraction.as_ref().map(of);
        let outline = self.skin.as_ref().map(|skin| skin.at(lattice));
        let guided = self.guides.map(|guides| guides.at(lattice));
        Box::new(move |u, which, pull| {
            match &level {
                Some(level) => level.renew(u, which, pull),
                None => which.iter().for_each(|&s| pull.set(s as usize, Default::default())),
            }
            if let Some(outline) = &outline {
                outline.add(u, which, pull);
            }
            if let Some(guided) = &guided {
                guided.renew(u, which, pull);
            }
        })
    }

    fn passes(&self, lattice: &Lattice) -> Passes {
        let settled_mm = self.options.settled * lattice.grid.mean_edge();
        Passes {
            most: self.options.passes,
            rounds: self.options.rounds,
            settled_mm,
            farthest: self.options.farthest(lattice),
            // A structure is a small part of all elements: it must come to rest, too.
            moving: if self.guides.is_some() { 0.0 } else { STILL_MOVING },
        }
    }
}
