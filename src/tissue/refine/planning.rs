//! What the elements' points show in the planning CT. All fractions share it.

use crate::chainmail::Lattice;
use crate::geometry::Grid;
use crate::volume::{
    COARSE_MM, Counted, Mask, Volume, Window, block_means, block_within, blur_after, cubic, gaussian, gaussian_ratio,
    trilinear,
};
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

/// A CT in the window inside the patient; outside the window's lower edge. Fine voxels are averaged in blocks first.
pub(super) struct Windowed {
    image: Volume<f32>,
    /// The CT's own grid, and how many of its voxels make one of the image.
    own: Grid,
    block: [usize; 3],
    /// Which of the image's planes have values that are no number.
    holes: Vec<bool>,
}

/// Least share of a blur that must be known.
/// Half of it changes nothing; where nothing is known enough a cone-beam CT errs by 0.96 mm for 0.77.
const LEAST_KNOWN: f32 = 0.7;

impl Windowed {
    /// What is no number stays none.
    pub(super) fn new(ct: &Volume<f32>, body: &Mask, window: Window) -> Self {
        let own = ct.grid().clone();
        let block = block_within(&own, COARSE_MM);
        let shown = |v: f32, inside: bool| if inside || v.is_nan() { window.of(v) } else { window.low };
        let image = if block == [1; 3] {
            let data = ct.data().par_iter().zip(body.data()).map(|(v, inside)| shown(*v, *inside)).collect();
            Volume::new(own.clone(), data).expect("one value per voxel")
        } else {
            let known = |l: usize, v: f32| match shown(v, body.data()[l]) {
                hu if hu.is_nan() => [0.0, 0.0],
                hu => [hu, 1.0],
            };
            let [mut image, share] = block_means(ct, block, known);
            let mean = |(v, share): (&mut f32, &f32)| *v = if *share > LEAST_KNOWN { *v / share } else { f32::NAN };
            image.data_mut().par_iter_mut().zip(share.data()).for_each(mean);
            image
        };
        let plane = image.grid().strides()[2];
        let holes: Vec<bool> = image.data().par_chunks(plane).map(|plane| plane.iter().any(|v| v.is_nan())).collect();
        Self { image, own, block, holes }
    }

    /// The grid of the CT.
    pub(super) fn grid(&self) -> &Grid {
        &self.own
    }

    /// HU at a world position, where it is known.
    #[inline]
    pub(super) fn at(&self, world: &Point3<f64>) -> Option<f64> {
        trilinear(&self.image, &self.image.grid().index(world)).filter(|hu| !hu.is_nan())
    }

    /// Blurred by `sigma` mm over its known values; no number where too few of them are near.
    pub(super) fn blurred(&self, sigma: f64) -> Volume<f32> {
        let sigma = blur_after(&self.own, self.block, sigma);
        if !self.holes.contains(&true) {
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

    #[test]
    fn fine_voxels_show_what_they_hold_where_they_hold_it() {
        let grid = Grid::axis_aligned([60, 61, 20], [0.5, 0.7, 2.0], [3.0, -5.0, 8.0]).unwrap();
        let slope = |p: &Point3<f64>| 2.0 * p.x - 1.5 * p.y + p.z;
        let hole = |p: &Point3<f64>| p.x > 24.0;
        let body = Volume::filled(grid.clone(), true);
        let ct = Volume::from_fn(grid.clone(), |l| {
            let p = grid.centre(grid.voxel(l));
            if hole(&p) { f32::NAN } else { slope(&p) as f32 }
        });
        let shown = Windowed::new(&ct, &body, Window { low: -250.0, high: 300.0, thin: 0.0 });
        assert_eq!(shown.image.grid().size(), [20, 31, 20]);
        let blurred = shown.blurred(1.5);
        for p in [Point3::new(12.3, 10.1, 25.0), Point3::new(15.0, 20.0, 30.7)] {
            assert!((shown.at(&p).unwrap() - slope(&p)).abs() < 1e-3, "{p}");
            let (value, gradient) = sample(&blurred, &p).unwrap();
            assert!((value - slope(&p)).abs() < 1e-3 && (gradient - Vector3::new(2.0, -1.5, 1.0)).norm() < 1e-3, "{p}");
        }
        assert_eq!(shown.at(&Point3::new(27.0, 10.0, 25.0)), None);
    }
}
