//! A CT made to look like a cone-beam CT: wrong grey values, noise, streaks, and a short and round
//! field of view.
//!
//! This is no simulation of projections. Each effect is a formula of position whose size is known,
//! so that what a registration makes of it can be told apart from what the image shows.

use super::shape::V3;
use super::texture::{stored, uniform, voxel_noise};
use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::volume::region::part;
use crate::volume::{Mask, Volume};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::ops::Range;

/// Thickness of the slabs that share their streaks, mm.
const SLAB_MM: f64 = 6.0;
/// Streaks of a slab.
const STREAKS: u64 = 8;
/// Width of a streak, mm: standard deviation of its profile.
const STREAK_MM: f64 = 1.5;

/// What a cone-beam machine does to an image. Every effect can be left out; see
/// [`CbctOptions::off`].
///
/// With `w` the voxel's share of water's attenuation, (HU + 1000) / 1000 kept between 0 and 1, the
/// new value is `-1000 + gain * (HU + 1000) + w * (cupping + shading + rim) + streaks + noise`, and
/// `padding_hu` where nothing was measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CbctOptions {
    /// Factor on HU above air; 1 changes nothing.
    pub gain: f64,
    /// HU added to water on the axis; less by the square of the distance to it, none from
    /// `cupping_radius_mm` on.
    pub cupping_hu: f64,
    /// Where cupping ends, mm from the axis.
    pub cupping_radius_mm: f64,
    /// Greatest HU that slow shading adds to water, or takes from it.
    pub shading_hu: f64,
    /// Wavelength of the shading, mm.
    pub shading_mm: f64,
    /// Share of cupping, shading and rim that air gets too; 0 leaves air alone, 1 adds them
    /// everywhere alike.
    pub air_share: f64,
    /// Standard deviation of the noise, HU; white.
    pub noise_hu: f64,
    /// Greatest HU of one streak; 0 draws none.
    pub streak_hu: f64,
    /// Radius of the reconstruction circle about the axis, mm; 0 has no circle.
    pub circle_radius_mm: f64,
    /// The axis, from the middle of the image: left and back, mm.
    pub circle_offset_mm: [f64; 2],
    /// HU that truncation adds to water at the circle.
    pub rim_hu: f64,
    /// Depth inside the circle over which the rim falls to 37 %, mm.
    pub rim_mm: f64,
    /// Value of what was not measured: outside of the circle and in blank slices.
    pub padding_hu: f64,
    /// Slices at the lower and at the upper end that hold only padding.
    pub blank_slices: [usize; 2],
    /// Length of the scan, mm, about the middle of the image; 0 keeps all slices.
    pub length_mm: f64,
}

impl Default for CbctOptions {
    /// All effects: a circle of 250 mm, 240 mm long, a fifth of the contrast lost.
    fn default() -> Self {
        Self {
            gain: 0.8,
            cupping_hu: -180.0,
            cupping_radius_mm: 150.0,
            shading_hu: 60.0,
            shading_mm: 180.0,
            air_share: 0.0,
            noise_hu: 60.0,
            streak_hu: 80.0,
            circle_radius_mm: 125.0,
            circle_offset_mm: [0.0; 2],
            rim_hu: 250.0,
            rim_mm: 4.0,
            padding_hu: -1024.0,
            blank_slices: [2, 2],
            length_mm: 240.0,
        }
    }
}

impl CbctOptions {
    /// No effect at all: what a test switches on its own effects in.
    pub fn off() -> Self {
        Self {
            gain: 1.0,
            cupping_hu: 0.0,
            shading_hu: 0.0,
            noise_hu: 0.0,
            streak_hu: 0.0,
            circle_radius_mm: 0.0,
            rim_hu: 0.0,
            blank_slices: [0; 2],
            length_mm: 0.0,
            ..Self::default()
        }
    }

    /// Reads TOML as the program writes it; what is not named keeps its default.
    ///
    /// # Errors
    /// What is wrong, and where.
    pub fn parse(text: &str) -> std::result::Result<Self, String> {
        toml::from_str(text.trim_start_matches('\u{feff}')).map_err(|e| e.to_string())
    }

    /// The options as TOML.
    ///
    /// # Errors
    /// Never in practice: all of them are numbers.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self).map_err(|e| Error::Internal(format!("options of a cone-beam CT: {e}")))
    }

    /// Where a scan of this grid was measured: within the circle, blank slices left out. `grid` is
    /// that of the degraded image.
    pub fn measured(&self, grid: &Grid) -> Mask {
        let view = View::new(self, grid);
        Volume::from_fn(grid.clone(), |n| view.measured(grid, n).is_some())
    }

    /// Refuses what no image can have.
    fn check(&self) -> Result<()> {
        let positive = [self.gain, self.cupping_radius_mm, self.shading_mm, self.rim_mm];
        let none_or_more = [self.noise_hu, self.circle_radius_mm, self.length_mm, self.air_share];
        let [left, back] = self.circle_offset_mm;
        let any = [self.cupping_hu, self.shading_hu, self.streak_hu, self.rim_hu, self.padding_hu, left, back];
        let fine = positive.iter().all(|v| v.is_finite() && *v > 0.0)
            && none_or_more.iter().all(|v| v.is_finite() && *v >= 0.0)
            && any.iter().all(|v| v.is_finite());
        if fine {
            return Ok(());
        }
        let problem = format!(
            "gain, radius of cupping, wavelength of shading and depth of the rim {positive:?}, noise, radius of the circle, \
             length and share of air {none_or_more:?}, others {any:?}"
        );
        Err(Error::input(
            "options of the cone-beam CT",
            problem,
            "give finite numbers, positive ones for the first four and none below 0 for the next four",
        ))
    }
}

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
    let (view, shading, streaks) = (View::new(options, grid), Shading::new(options, seed), Streaks::new(options, seed));
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

/// The storage axis that runs most along the body.
fn long_axis(grid: &Grid) -> usize {
    let along = |a: &usize| grid.direction()[(2, *a)].abs();
    (0..3).max_by(|a, b| along(a).total_cmp(&along(b))).unwrap_or(2)
}

/// The voxels that a short scan keeps.
fn kept(options: &CbctOptions, grid: &Grid) -> Result<[Range<usize>; 3]> {
    let mut kept = grid.size().map(|n| 0..n);
    let axis = long_axis(grid);
    let (all, spacing) = (grid.size()[axis], grid.spacing()[axis]);
    if options.length_mm > 0.0 {
        let count = (options.length_mm / spacing + 1e-9).floor().min(all as f64 - 1.0) as usize + 1;
        let first = (all - count) / 2;
        kept[axis] = first..first + count;
    }
    let [low, high] = options.blank_slices;
    if low.saturating_add(high) >= kept[axis].len() {
        let problem = format!("{low} and {high} blank slices of {} leave nothing", kept[axis].len());
        return Err(Error::input("options of the cone-beam CT", problem, "leave fewer slices blank, or scan longer"));
    }
    Ok(kept)
}

/// Where a voxel lies in the scanner.
struct Seen {
    /// Across the axis, mm.
    from_axis: V3,
    /// Distance to the axis, mm.
    radius: f64,
    /// Along the axis, LPS mm.
    height: f64,
}

/// The field of view.
struct View {
    axis: usize,
    along: V3,
    middle: V3,
    radius: f64,
    filled: Range<usize>,
}

impl View {
    fn new(options: &CbctOptions, grid: &Grid) -> Self {
        let axis = long_axis(grid);
        let [left, back] = options.circle_offset_mm;
        // Blank ends are told by height, however slices are stored.
        let along: V3 = grid.direction().column(axis).into();
        let (first, last) = match options.blank_slices {
            [low, high] if along.z < 0.0 => (high, low),
            [low, high] => (low, high),
        };
        Self {
            axis,
            along,
            middle: grid.middle().coords + V3::new(left, back, 0.0),
            radius: if options.circle_radius_mm > 0.0 { options.circle_radius_mm } else { f64::MAX },
            filled: first..grid.size()[axis].saturating_sub(last),
        }
    }

    /// Where a voxel lies, or `None` for one that was not measured.
    fn measured(&self, grid: &Grid, n: usize) -> Option<Seen> {
        let at = grid.voxel(n);
        let x = grid.centre(at).coords;
        let across = x - self.middle;
        let from_axis = across - self.along * self.along.dot(&across);
        let radius = from_axis.norm();
        (radius <= self.radius && self.filled.contains(&at[self.axis])).then_some(Seen {
            from_axis,
            radius,
            height: x.z,
        })
    }
}

/// Two slow waves in seeded oblique directions.
struct Shading {
    half_hu: f64,
    waves: [(V3, f64); 2],
}

impl Shading {
    fn new(options: &CbctOptions, seed: u64) -> Self {
        let wave = |n: u64| {
            let r = |m: u64| uniform(seed ^ 0x5AAD, 8 * n + m);
            // One mostly across, one mostly along: neither is constant over the scan.
            let tilt = [0.35, 0.9][n as usize % 2];
            let (sin, cos) = (TAU * r(0)).sin_cos();
            let direction = V3::new(cos, sin, tilt).normalize();
            (direction * (TAU / options.shading_mm), TAU * r(1))
        };
        Self { half_hu: 0.5 * options.shading_hu, waves: [wave(0), wave(1)] }
    }

    fn at(&self, from_axis: &V3, height: f64) -> f64 {
        let p = V3::new(from_axis.x, from_axis.y, height);
        self.waves.iter().map(|(k, phase)| self.half_hu * (k.dot(&p) + phase).sin()).sum()
    }
}

/// Bright and dark straight lines within slices.
struct Streaks {
    hu: f64,
    seed: u64,
    reach: f64,
}

impl Streaks {
    fn new(options: &CbctOptions, seed: u64) -> Self {
        let reach = if options.circle_radius_mm > 0.0 { options.circle_radius_mm } else { options.cupping_radius_mm };
        Self { hu: options.streak_hu, seed: seed ^ 0x57EA, reach: 0.6 * reach }
    }

    fn at(&self, seen: &Seen) -> f64 {
        if self.hu == 0.0 {
            return 0.0;
        }
        let slab = (seen.height / SLAB_MM).floor() as i64 as u64;
        let one = |n: u64| {
            let r = |m: u64| uniform(self.seed, slab.wrapping_mul(8 * STREAKS).wrapping_add(8 * n + m));
            let (sin, cos) = (TAU * 0.5 * r(0)).sin_cos();
            let d = cos * seen.from_axis.x + sin * seen.from_axis.y - self.reach * r(1);
            self.hu * r(2) * (-0.5 * (d / STREAK_MM).powi(2)).exp()
        };
        (0..STREAKS).map(one).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// HU of water with a ball of bone and air around, on an oblique or plain grid.
    fn scene() -> Volume<f32> {
        let grid = Grid::axis_aligned([60, 56, 50], [5.0, 5.0, 4.0], [-150.0, -130.0, 20.0]).unwrap();
        let middle = grid.middle();
        Volume::from_fn(grid.clone(), |n| {
            let p = grid.centre(grid.voxel(n)) - middle;
            match (p.x.hypot(p.y), p.norm()) {
                (_, d) if d < 20.0 => 1000.0,
                (r, _) if r < 120.0 => 0.0,
                _ => -1000.0,
            }
        })
    }

    fn mean_and_sd(values: &[f64]) -> (f64, f64) {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt())
    }

    /// HU of voxels by their distance to the axis and height from the middle, mm.
    fn where_<'a>(image: &'a Volume<f32>, wanted: impl Fn(f64, f64) -> bool + 'a) -> Vec<f64> {
        let grid = image.grid();
        let middle = grid.middle();
        let of = |n: &usize| {
            let p = grid.centre(grid.voxel(*n)) - middle;
            wanted(p.x.hypot(p.y), p.z)
        };
        (0..grid.len()).filter(of).map(|n| f64::from(image.data()[n])).collect()
    }

    #[test]
    fn nothing_changes_without_effects() {
        assert_eq!(degrade(&scene(), &CbctOptions::off(), 3).unwrap(), scene());
    }

    #[test]
    fn gain_is_about_air_and_noise_is_as_large_as_asked() {
        let options = CbctOptions { gain: 0.8, noise_hu: 60.0, ..CbctOptions::off() };
        let image = degrade(&scene(), &options, 3).unwrap();
        let (mean, sd) = mean_and_sd(&where_(&image, |r, z| r < 115.0 && z.abs() > 25.0));
        assert!((mean + 200.0).abs() < 1.0 && (sd - 60.0).abs() < 1.0, "{mean} {sd}");
        let bone = mean_and_sd(&where_(&image, |r, z| r.hypot(z) < 18.0)).0;
        assert!((bone - 600.0).abs() < 15.0, "{bone}");
        // What lies below the least that a scanner stores is cut off.
        let air = where_(&image, |r, _| r > 125.0);
        assert!(air.iter().all(|v| *v >= -1024.0) && (mean_and_sd(&air).0 + 1000.0).abs() < 25.0);
    }

    #[test]
    fn cupping_is_deepest_on_the_axis_and_leaves_air() {
        let options = CbctOptions { cupping_hu: -180.0, cupping_radius_mm: 100.0, ..CbctOptions::off() };
        let image = degrade(&scene(), &options, 3).unwrap();
        let at = |from: f64, to: f64| mean_and_sd(&where_(&image, move |r, z| z > 25.0 && r >= from && r < to)).0;
        assert!((at(0.0, 5.0) + 180.0).abs() < 2.0, "{}", at(0.0, 5.0));
        assert!((at(68.0, 73.0) + 90.0).abs() < 4.0, "{}", at(68.0, 73.0));
        assert_eq!((at(101.0, 119.0), at(122.0, 130.0)), (0.0, -1000.0));
        let everywhere = CbctOptions { air_share: 1.0, cupping_hu: 50.0, cupping_radius_mm: 200.0, ..options };
        let image = degrade(&scene(), &everywhere, 3).unwrap();
        let air = mean_and_sd(&where_(&image, |r, _| (125.0..130.0).contains(&r))).0;
        assert!((air + 970.0).abs() < 2.0, "{air}");
    }

    #[test]
    fn shading_is_slow_and_no_greater_than_asked() {
        let options = CbctOptions { shading_hu: 60.0, shading_mm: 150.0, ..CbctOptions::off() };
        let image = degrade(&scene(), &options, 5).unwrap();
        let water = where_(&image, |r, z| r < 118.0 && z.abs() > 22.0);
        let (low, high) = water.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
        assert!((-60.0..-40.0).contains(&low) && (40.0..=60.0).contains(&high), "{low} {high}");
        let (grid, strides) = (image.grid(), image.grid().strides());
        let inside = |p: &V3| p.x.hypot(p.y) < 119.0 && p.z.abs() > 24.0;
        for n in 0..grid.len() - strides[2] {
            let next = n + strides[2];
            let [a, b] = [n, next].map(|n| grid.centre(grid.voxel(n)) - grid.middle());
            if inside(&a) && inside(&b) && a.z * b.z > 0.0 {
                // 4 mm of waves of 150 mm.
                assert!((image.data()[n] - image.data()[next]).abs() < 12.0, "{a} {b}");
            }
        }
    }

    #[test]
    fn outside_of_the_circle_and_in_blank_slices_lies_padding_alone() {
        let options = CbctOptions {
            circle_radius_mm: 90.0,
            circle_offset_mm: [20.0, -10.0],
            padding_hu: -2000.0,
            blank_slices: [2, 5],
            length_mm: 120.0,
            rim_hu: 300.0,
            rim_mm: 5.0,
            noise_hu: 30.0,
            ..CbctOptions::off()
        };
        let image = degrade(&scene(), &options, 3).unwrap();
        assert_eq!(image.grid().size(), [60, 56, 31]);
        assert!((image.grid().middle() - scene().grid().middle()).norm() < 4.0);
        let (grid, middle, seen) = (image.grid(), image.grid().middle(), options.measured(image.grid()));
        let (mut outside, mut rim, mut inner) = (0, Vec::new(), Vec::new());
        for n in 0..grid.len() {
            let (at, p) = (grid.voxel(n), grid.centre(grid.voxel(n)) - middle - V3::new(20.0, -10.0, 0.0));
            let (r, from_axis) = (p.x.hypot(p.y), (p + V3::new(20.0, -10.0, 0.0)).norm());
            let measured = r <= 90.0 && (2..26).contains(&at[2]);
            assert_eq!(image.data()[n] > -1100.0, measured, "{at:?}");
            assert_eq!(seen.data()[n], measured);
            outside += usize::from(!measured);
            if measured && from_axis > 25.0 && r > 85.0 {
                rim.push(f64::from(image.data()[n]));
            } else if measured && from_axis > 25.0 && r < 60.0 {
                inner.push(f64::from(image.data()[n]));
            }
        }
        let (rim, inner) = (mean_and_sd(&rim).0, mean_and_sd(&inner).0);
        // The mean of exp(-depth / 5 mm) over 5 mm is 0.63.
        assert!(outside > 10_000 && (rim - 190.0).abs() < 25.0 && inner.abs() < 2.0, "{outside} {rim} {inner}");
    }

    #[test]
    fn slices_lie_across_the_body_however_they_are_stored() {
        let options = CbctOptions {
            length_mm: 100.0,
            blank_slices: [1, 3],
            circle_radius_mm: 80.0,
            cupping_hu: -150.0,
            ..CbctOptions::off()
        };
        let plain = degrade(&scene(), &options, 3).unwrap();
        // Stored from head to foot, slices first.
        let old = scene();
        let [ni, nj, nk] = old.grid().size();
        let d = old.grid().direction();
        let direction = nalgebra::Matrix3::from_columns(&[-d.column(2), d.column(0).into(), d.column(1).into()]);
        let (s, corner) = (old.grid().spacing(), old.grid().centre([0, 0, nk - 1]));
        let grid = Grid::new([nk, ni, nj], [s[2], s[0], s[1]], corner, direction).unwrap();
        let turned = Volume::from_fn(grid.clone(), |n| {
            let [k, i, j] = grid.voxel(n);
            *old.at([i, j, nk - 1 - k])
        });
        let turned = degrade(&turned, &options, 3).unwrap();
        for n in 0..plain.grid().len() {
            let x = plain.grid().centre(plain.grid().voxel(n));
            let at = turned.grid().index(&x).map(|c| c.round() as usize);
            assert_eq!(plain.data()[n].to_bits(), turned.at(at.into()).to_bits(), "{x}");
        }
    }

    #[test]
    fn streaks_are_straight_and_within_slices() {
        let options = CbctOptions { streak_hu: 100.0, ..CbctOptions::off() };
        let image = degrade(&scene(), &options, 3).unwrap();
        let water = where_(&image, |r, z| r < 118.0 && z.abs() > 22.0);
        let touched = water.iter().filter(|v| v.abs() > 20.0).count() as f64 / water.len() as f64;
        assert!((0.01..0.4).contains(&touched), "{touched}");
        let (mean, most) = (mean_and_sd(&water).0, water.iter().fold(0.0f64, |m, v| m.max(v.abs())));
        assert!(mean.abs() < 5.0 && (50.0..400.0).contains(&most), "{mean} {most}");
    }

    #[test]
    fn one_seed_gives_one_image_at_any_number_of_threads() {
        let make = |threads, seed, options: &CbctOptions| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| degrade(&scene(), options, seed).unwrap())
        };
        let all = CbctOptions::default();
        let one = make(1, 9, &all);
        assert_eq!(one, make(3, 9, &all));
        assert_ne!(one, make(1, 10, &all));
        // What is cut off changes nothing of what stays.
        let longer = make(
            1,
            9,
            &CbctOptions {
                length_mm: 0.0,
                blank_slices: [0; 2],
                ..CbctOptions { noise_hu: 20.0, ..CbctOptions::off() }
            },
        );
        let short = make(1, 9, &CbctOptions { length_mm: 100.0, noise_hu: 20.0, ..CbctOptions::off() });
        let first = short.grid().size()[2];
        let offset = (longer.grid().size()[2] - first) / 2;
        assert_eq!(short.at([7, 8, 3]).to_bits(), longer.at([7, 8, 3 + offset]).to_bits());
    }

    #[test]
    fn settings_are_written_as_they_are_read_and_nonsense_is_refused() {
        let own = CbctOptions { circle_offset_mm: [3.0, -4.5], ..CbctOptions::default() };
        assert_eq!(CbctOptions::parse(&own.to_toml().unwrap()).unwrap(), own);
        assert_eq!(
            CbctOptions::parse("noise_hu = 20.0").unwrap(),
            CbctOptions { noise_hu: 20.0, ..CbctOptions::default() }
        );
        assert!(CbctOptions::parse("circle = 3").is_err());
        let refused = |options| degrade(&scene(), &options, 1).unwrap_err().to_string();
        assert!(refused(CbctOptions { gain: f64::NAN, ..CbctOptions::default() }).contains("gain"));
        assert!(refused(CbctOptions { noise_hu: -1.0, ..CbctOptions::default() }).contains("noise"));
        assert!(refused(CbctOptions { blank_slices: [30, 30], ..CbctOptions::default() }).contains("blank"));
    }
}
