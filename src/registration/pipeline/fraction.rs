//! The fraction as the images' pull sees it.

use super::couch::Couch;
use super::guides::GuidePair;
use crate::body;
use crate::config::Config;
use crate::error::Result;
use crate::geometry::Grid;
use crate::view::ViewReport;
use crate::volume::{Mask, Outline, Volume};
use std::borrow::Cow;

/// The values on a part of a volume's grid.
fn part<T: Copy + Default + Send + Sync>(volume: &Volume<T>, grid: &Grid, beyond: T) -> Volume<T> {
    let whole = volume.grid();
    let value = |n: usize| whole.voxel_at(&grid.centre(grid.voxel(n))).map_or(beyond, |voxel| *volume.at(voxel));
    Volume::from_fn(grid.clone(), value)
}

/// A fraction CT with the patient in it.
pub(super) struct Fraction<'a> {
    /// HU, or an MR on the scale of [`crate::body::mr::tissue_scale`]; no number where nothing was measured.
    pub(super) ct: Cow<'a, Volume<f32>>,
    /// Inside of the skin.
    pub(super) body: Mask,
    /// What of it was measured.
    pub(super) view: ViewReport,
    /// Dark and bright grey values of the patient in an MR; `None` for a CT.
    pub(super) mr: Option<[f32; 2]>,
    /// Structures that guide, planning's outline first.
    pub(super) guides: Vec<GuidePair>,
}

impl<'a> Fraction<'a> {
    /// Finds the patient.
    ///
    /// # Errors
    /// As [`body::find`].
    pub(super) fn new(
        ct: Cow<'a, Volume<f32>>,
        view: ViewReport,
        mr: Option<[f32; 2]>,
        config: &Config,
    ) -> Result<Self> {
        let body = body::find(&ct, None, &config.body)?;
        Ok(Self { ct, body, view, mr, guides: Vec::new() })
    }

    /// In the frame that the couch has brought along.
    pub(super) fn shifted(self, couch: &Couch) -> Fraction<'static> {
        let ct = couch.volume(self.ct.into_owned());
        let pair = |(planning, fraction): &GuidePair| {
            (planning.clone(), Outline { inside: couch.volume(fraction.inside.clone()), ..fraction.clone() })
        };
        Fraction {
            ct: Cow::Owned(ct),
            body: couch.volume(self.body),
            view: self.view,
            mr: self.mr,
            guides: self.guides.iter().map(pair).collect(),
        }
    }

    /// The part of it on a part of its grid.
    pub(super) fn part(&self, grid: &Grid) -> Fraction<'static> {
        let ct = part(&self.ct, grid, f32::NAN);
        Fraction {
            ct: Cow::Owned(ct),
            body: part(&self.body, grid, false),
            view: self.view.clone(),
            mr: self.mr,
            guides: self.guides.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::small;
    use super::*;
    use crate::chainmail::Carry;
    use crate::geometry::Rigid;

    #[test]
    fn image_and_patient_go_with_the_couch() {
        let (ct, body, shift) = (small::ct(), small::body(), Rigid::translation(30.5, -4.25, 12.0));
        let there = Fraction {
            ct: Cow::Borrowed(&ct),
            body: body.clone(),
            view: ViewReport::default(),
            mr: None,
            guides: Vec::new(),
        };
        let couch = Couch::of(&small::fit([shift; 2], shift), ct.grid(), Carry::Rigid);
        let shifted = there.shifted(&couch);
        let back = couch.grid(ct.grid());
        assert!((back.origin() - ct.grid().origin() + shift.translation.vector).norm() < 1e-3);
        assert!(shifted.ct.grid().matches(&back, 1e-9) && shifted.body.grid().matches(&back, 1e-9));
        assert_eq!((shifted.ct.data(), shifted.body.data()), (ct.data(), body.data()));
    }
}
