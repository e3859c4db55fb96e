//! What the elements' points show in the planning CT. All fractions share it.

use crate::chainmail::Lattice;
use crate::geometry::Grid;
use crate::volume::{Counted, Mask, Volume, Window, cubic, gaussian, gaussian_ratio, trilinear};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::sync::{Arc, Mutex, OnceLock};

/// Value and gradient (HU, HU/mm) at each point of each soft element; no number outside the image.
pub(super) type ElementShown = Arc<[[f32; 4]]>;

/// What the points of a planning CT's elements show, kept from one fraction to the next.
///
/// For one planning CT with its patient, one chain mail and one set of options.
#[derive(Debug, Default)]
pub struct PlanningSamples(Mutex<Vec<(Key, ElementShown)>>);

/// Spacing of the elements and blur, mm, bit by bit.
type Key = [u64; 4];

/// A value with its gradient at a point, if it lies in the image.
#[inline(always)]
pub(super) fn sample(image: &Volume<f32>, at: &Point3<f64>) -> Option<(f64, Vector3<f64>)> {
    let (value, slope) = cubic(image, &image.grid().index(at))?;
    Some((value, image.grid().inverse_step().transpose() * slope))
}

/// A CT in the window inside the patient; outside the window's lower edge.
pub(super) struct Windowed {
    image: Volume<f32>,
    /// Which of its planes have values that are no number; empty where none has.
    holes: Vec<bool>,
}

/// Least share of a blur that must be known.
/// Half of it changes nothing; where nothing is known enough a cone-beam CT errs by 0.96 mm for 0.77.
const LEAST_KNOWN: f32 = 0.7;

impl Windowed {
    /// What is no number stays none.
    pub(super) fn new(ct: &Volume<f32>, body: &Mask, window: Window) -> Self {
        let at = |(v, inside): (&f32, &bool)| if *inside || v.is_nan() { window.of(*v) } else { window.low };
        let data: Vec<f32> = ct.data().par_iter().zip(body.data()).map(at).collect();
        let plane = ct.grid().strides()[2].max(1);
        let mut holes: Vec<bool> = data.par_chunks(plane).map(|plane| plane.iter().any(|v| v.is_nan())).collect();
        if !holes.contains(&true) {
            holes.clear();
        }
        Self { image: Volume::new(ct.grid().clone(), data).expect("one value per voxel"), holes }
    }

    pub(super) fn grid(&self) -> &Grid {
        self.image.grid()
    }

    /// HU at a world position, where it is known.
    #[inline]
    pub(super) fn at(&self, world: &Point3<f64>) -> Option<f64> {
        trilinear(&self.image, &self.image.grid().index(world)).filter(|hu| !hu.is_nan())
    }

    /// Blurred by `sigma` mm over its known values; no number where too few of them are near.
    pub(super) fn blurred(&self, sigma: f64) -> Volume<f32> {
        if self.holes.is_empty() {
            return gaussian(&self.image, sigma);
        }
        let known = |v: f32| if v.is_nan() { 0.0 } else { 1.0 };
        let value = |v: f32| if v.is_nan() { 0.0 } else { v };
        let mean = |sum: f32, share: f32| if share > LEAST_KNOWN { sum / share } else { f32::NAN };
        gaussian_ratio(
            &Counted { image: &self.image, value },
            &Counted { image: &self.image, value: known },
            sigma,
            |k| !self.holes[k],
            mean,
        )
    }
}

/// The planning CT of a registration.
pub(super) struct Planning<'a> {
    pub(super) ct: &'a Volume<f32>,
    body: &'a Mask,
    window: Window,
    /// Windowed, once it is needed.
    windowed: OnceLock<Windowed>,
    kept: Option<&'a PlanningSamples>,
}

impl<'a> Planning<'a> {
    pub(super) fn new(ct: &'a Volume<f32>, body: &'a Mask, window: Window, kept: Option<&'a PlanningSamples>) -> Self {
        Self { ct, body, window, windowed: OnceLock::new(), kept }
    }

    /// In the window.
    pub(super) fn windowed(&self) -> &Windowed {
        self.windowed.get_or_init(|| Windowed::new(self.ct, self.body, self.window))
    }

    /// What the soft elements of a lattice show of it, blurred by `sigma` mm.
    pub(super) fn shown(&self, lattice: &Lattice, soft: &[u32], sigma: f64) -> ElementShown {
        let [x, y, z] = lattice.grid.spacing();
        let key: Key = [x, y, z, sigma].map(f64::to_bits);
        // A thread that panicked leaves the list as it was.
        let list = |kept: &'a PlanningSamples| kept.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some((_, found)) = self.kept.and_then(|kept| list(kept).iter().find(|(k, _)| *k == key).cloned()) {
            return found;
        }
        let blurred = self.windowed().blurred(sigma);
        let offsets = lattice.grid.eighths();
        let points = soft.par_iter().flat_map_iter(|&n| {
            let rest = lattice.rest(n as usize);
            let blurred = &blurred;
            offsets.iter().map(move |o| match sample(blurred, &(rest + o)) {
                Some((v, g)) => [v as f32, g.x as f32, g.y as f32, g.z as f32],
                None => [f32::NAN; 4],
            })
        });
        let shown: ElementShown = points.collect::<Vec<_>>().into();
        if let Some(kept) = self.kept {
            list(kept).push((key, shown.clone()));
        }
        shown
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blur_of_which_too_little_is_known_is_no_number() {
        let grid = Grid::axis_aligned([40, 9, 9], [1.0; 3], [0.0; 3]).unwrap();
        let ct = Volume::from_fn(grid.clone(), |l| if grid.voxel(l)[0] < 20 { 40.0 } else { f32::NAN });
        let body = Volume::filled(grid.clone(), true);
        let window = Window { low: -250.0, high: 300.0, thin: 0.0 };
        let blurred = Windowed::new(&ct, &body, window).blurred(2.0);
        let at = |x: usize| blurred.at([x, 4, 4]);
        // At 19 hardly more than half of the blur is known, at 17 nine tenths.
        assert!(at(19).is_nan() && at(25).is_nan(), "{} {}", at(19), at(25));
        assert!((at(17) - 40.0).abs() < 1e-3 && (at(5) - 40.0).abs() < 1e-3, "{} {}", at(17), at(5));
    }
}
