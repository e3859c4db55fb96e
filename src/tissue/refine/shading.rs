//! How the grey values of a fraction agree with planning's, and a fraction freed of its shading.
//!
//! A cone-beam CT has its own scale, and scatter and beam hardening shade it: the same muscle has other HU in the middle
//! than at the skin. Where the bones' motion alone brings the two scans together, soft tissue is compared over
//! neighbourhoods wider than it is off, and what differs there is shading (Marchant et al. 2008 do so with deformable
//! registration; Zhu et al. 2013 call it a planning prior).

use super::options::ShadingOptions;
use crate::geometry::Grid;
use crate::volume::{Counted, Volume, gaussian_ratio, trilinear, trilinear_vector};
use nalgebra::Point3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Soft tissue in planning, HU.
const SOFT_HU: std::ops::RangeInclusive<f64> = -150.0..=150.0;
/// Least HU of tissue in a fraction of any scale.
/// At -350 a cone-beam CT errs by 0.778 mm for 0.772; at -1400 nothing changes.
const LEAST_HU: f64 = -700.0;
/// Width (sigma) of the neighbourhoods, mm: wider than soft tissue is off before images pull it.
/// 10 and 40 mm: 0.783 and 0.775 for 0.772 mm on a cone-beam CT.
const WIDE_MM: f64 = 20.0;
/// Spacing of the field of shading, mm.
/// Half or twice as far apart moves no mean error by 0.003 mm.
const SPACING_MM: f64 = 10.0;
/// Times that gain and shading are found in turn.
/// Half or twice as many move no mean error by 0.003 mm.
const ROUNDS: usize = 6;
/// Differences beyond this many times their own spread are something else than shading.
/// At 1.25 a cone-beam CT errs by 0.785 mm for 0.772, at 5 by 0.769.
const OUTLIER: f64 = 2.5;
/// Fewer nodes tell nothing.
/// Half or twice as many move no mean error by 0.003 mm.
const FEWEST: usize = 500;
/// Gains that are believed.
const GAINS: std::ops::RangeInclusive<f64> = 0.5..=2.0;

/// How the grey values of two scans agree in soft tissue.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GreyValues {
    /// What the fraction's HU are multiplied with to be planning's.
    pub gain: f64,
    /// What is added then, HU, on the mean.
    pub offset: f64,
    /// How far the offset differs from place to place, HU: one standard deviation over soft tissue.
    pub shading: f64,
    /// What is left after gain, offset and shading in places as small as a few mm, HU.
    pub left: f64,
}

/// How a fraction's grey values differ from planning's, place by place.
pub struct Shading {
    /// In short; `None` where too little soft tissue is seen in both.
    pub grey: Option<GreyValues>,
    /// What is to be added to the fraction's HU times the gain, on a coarse grid over the fraction.
    offset: Option<Volume<f32>>,
}

/// A node of soft tissue that both scans show: its place in the fraction, planning's and the fraction's HU.
struct Pair {
    place: Point3<f64>,
    planning: f64,
    fraction: f64,
}

impl Shading {
    /// Compares two CTs (HU; no number where nothing was measured) by a displacement from planning to fraction (mm, on any
    /// grid). `soft` tells of a planning voxel (its place in storage) whether it is soft tissue of the patient.
    pub fn of(
        planning: &Volume<f32>,
        soft: impl Fn(usize) -> bool + Sync,
        fraction: &Volume<f32>,
        moved: &Volume<[f32; 3]>,
    ) -> Self {
        let pairs = pairs(planning, soft, fraction, moved);
        if pairs.len() < FEWEST {
            return Self { grey: None, offset: None };
        }
        let grid = fraction.grid().coarsened(SPACING_MM);
        let (mut gain, mut weight) = (1.0, vec![1.0; pairs.len()]);
        let mut field = Volume::filled(grid.clone(), 0f32);
        let (mut mean, mut left) = (0.0, f64::MAX);
        for _ in 0..ROUNDS {
            let rest: Vec<f64> = pairs.iter().map(|p| p.planning - gain * p.fraction).collect();
            mean = mean_of(rest.iter().zip(&weight).map(|(r, w)| (*r, *w)));
            field = smooth(&grid, &pairs, rest.iter().map(|r| r - mean), &weight);
            let local: Vec<f64> = pairs.iter().map(|p| mean + at(&field, &p.place)).collect();
            let apart: Vec<f64> = rest.iter().zip(&local).map(|(r, l)| r - l).collect();
            left = spread(&apart);
            weight = apart.iter().map(|d| f64::from(d.abs() < OUTLIER * left)).collect();
            // Contrast of what is finer than shading.
            let [planning, fraction] = [|p: &Pair| p.planning, |p: &Pair| p.fraction].map(|value| {
                let middle = mean_of(pairs.iter().zip(&weight).map(|(p, w)| (value(p), *w)));
                let coarse = smooth(&grid, &pairs, pairs.iter().map(|p| value(p) - middle), &weight);
                pairs.iter().map(|p| value(p) - middle - at(&coarse, &p.place)).collect::<Vec<f64>>()
            });
            let fine = planning.iter().copied().zip(fraction).zip(&weight).filter(|(_, w)| **w > 0.0);
            gain = gain_of(fine.map(|(pair, _)| pair)).unwrap_or(gain);
        }
        let shading = mean_of(pairs.iter().map(|p| (at(&field, &p.place).powi(2), 1.0))).sqrt();
        let grey = GreyValues { gain, offset: mean, shading, left };
        Self { grey: Some(grey), offset: Some(field.map(|f| f + mean as f32)) }
    }

    /// The fraction with planning's grey values, where the options ask for it.
    pub fn corrected(&self, fraction: &Volume<f32>, options: &ShadingOptions) -> Option<Volume<f32>> {
        let (grey, offset) = (self.grey.as_ref()?, self.offset.as_ref()?);
        if grey.shading < options.least_hu && (grey.gain - 1.0).abs() < options.least_gain {
            return None;
        }
        let grid = fraction.grid();
        let value = |l: usize| {
            let hu = f64::from(fraction.data()[l]);
            (grey.gain * hu + at(offset, &grid.centre(grid.voxel(l)))) as f32
        };
        Some(Volume::from_fn(grid.clone(), value))
    }
}

/// Contrast of the first value of each pair over that of the second. Either is noisy, so that a regression would find too
/// little. `None` where one hardly varies.
fn gain_of(pairs: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let mut s = [0f64; 5];
    for (p, f) in pairs {
        s = [s[0] + 1.0, s[1] + p, s[2] + f, s[3] + p * p, s[4] + f * f];
    }
    let variance = |n: usize| s[n + 2] / s[0] - (s[n] / s[0]).powi(2);
    let (p, f) = (variance(1), variance(2));
    (s[0] > 1.0 && p > 1.0 && f > 1.0).then(|| (p / f).sqrt().clamp(*GAINS.start(), *GAINS.end()))
}

/// Nodes of homogeneous soft tissue that both scans show.
fn pairs(
    planning: &Volume<f32>,
    soft: impl Fn(usize) -> bool + Sync,
    fraction: &Volume<f32>,
    moved: &Volume<[f32; 3]>,
) -> Vec<Pair> {
    let nodes = moved.grid();
    let offsets = nodes.eighths();
    let pair = |n: usize| {
        let x = nodes.centre(nodes.voxel(n));
        let own = planning.grid().linear(planning.grid().voxel_at(&x)?);
        if !soft(own) {
            return None;
        }
        let place = x + trilinear_vector(moved, &nodes.index(&x))?;
        let (mut p, mut f) = (0.0, 0.0);
        for o in &offsets {
            let here = trilinear(planning, &planning.grid().index(&(x + o)))?;
            let there = trilinear(fraction, &fraction.grid().index(&(place + o)))?;
            if !SOFT_HU.contains(&here) || there.is_nan() || there < LEAST_HU {
                return None;
            }
            (p, f) = (p + here / 8.0, f + there / 8.0);
        }
        Some(Pair { place, planning: p, fraction: f })
    };
    (0..nodes.len()).into_par_iter().filter_map(pair).collect()
}

/// The values at the pairs' places, averaged over neighbourhoods; where there are none near, 0.
fn smooth(grid: &Grid, pairs: &[Pair], values: impl Iterator<Item = f64>, weight: &[f64]) -> Volume<f32> {
    let (mut sum, mut count) = (vec![0f32; grid.len()], vec![0f32; grid.len()]);
    for ((pair, value), w) in pairs.iter().zip(values).zip(weight) {
        if let Some(voxel) = grid.voxel_at(&pair.place) {
            let l = grid.linear(voxel);
            sum[l] += (w * value) as f32;
            count[l] += *w as f32;
        }
    }
    // A little of nothing everywhere: far from all pairs the mean holds.
    let (sum, count) = [sum, count].map(|v| Volume::new(grid.clone(), v).expect("one value per voxel")).into();
    gaussian_ratio(
        &Counted::whole(&sum),
        &Counted::whole(&count),
        WIDE_MM,
        |_| false,
        |sum, count| sum / (count + 1e-4),
    )
}

/// The value of the nearest place of a coarse volume's hull, trilinear.
fn at(volume: &Volume<f32>, world: &Point3<f64>) -> f64 {
    trilinear(volume, &volume.grid().index_within(world)).unwrap_or(0.0)
}

fn mean_of(values: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (sum, weight) = values.fold((0.0, 0.0), |(s, n), (v, w)| (s + v * w, n + w));
    sum / weight.max(1.0)
}

/// Median of the absolute values, as a standard deviation.
fn spread(values: &[f64]) -> f64 {
    let mut values: Vec<f64> = values.iter().map(|v| v.abs()).collect();
    let middle = values.len() / 2;
    1.4826 * *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Grid {
        Grid::axis_aligned([60, 60, 40], [3.0; 3], [0.0; 3]).unwrap()
    }

    /// Fat with muscles of 12 mm.
    fn planning() -> Volume<f32> {
        Volume::from_fn(grid(), |l| {
            let [i, j, k] = grid().voxel(l);
            if (i / 4 + j / 4 + k / 4) % 2 == 0 { 50.0 } else { -90.0 }
        })
    }

    /// Offset that the fraction has at a place, HU.
    fn shade(p: &Point3<f64>, greatest: f64) -> f64 {
        greatest * (p.x / 60.0).cos() * (p.y / 80.0).cos()
    }

    fn compared(gain: f64, greatest: f64) -> (Shading, Volume<f32>) {
        let planning = planning();
        // Noise that no neighbour shares.
        let noise = |l: usize| ((l * 7919 % 101) as f64 - 50.0) * 0.6;
        let value = |l: usize| {
            let p = grid().centre(grid().voxel(l));
            ((f64::from(planning.data()[l]) + 1000.0) * gain - 1000.0 + shade(&p, greatest) + noise(l)) as f32
        };
        let fraction = Volume::from_fn(grid(), value);
        let still = Volume::filled(grid().coarsened(9.0), [0f32; 3]);
        (Shading::of(&planning, |_| true, &fraction, &still), fraction)
    }

    #[test]
    fn gain_and_shading_are_found_and_taken_out() {
        let (shading, fraction) = compared(0.8, 90.0);
        let grey = shading.grey.unwrap();
        assert!((1.1..1.4).contains(&grey.gain), "{grey:?}");
        assert!((25.0..70.0).contains(&grey.shading), "{grey:?}");
        let options = ShadingOptions::default();
        let corrected = shading.corrected(&fraction, &options).expect("it is shaded");
        let inner = |l: &usize| grid().voxel(*l).iter().zip(grid().size()).all(|(&c, n)| c > 6 && c + 7 < n);
        let off = |image: &Volume<f32>| {
            let planning = planning();
            let all: Vec<f64> = (0..grid().len())
                .filter(inner)
                .map(|l| f64::from(image.data()[l] - planning.data()[l]).abs())
                .collect();
            all.iter().sum::<f64>() / all.len() as f64
        };
        assert!(off(&corrected) < 35.0 && off(&fraction) > 150.0, "{} {}", off(&corrected), off(&fraction));
    }

    #[test]
    fn a_ct_of_another_scanner_is_left_as_it_is() {
        let (shading, fraction) = compared(0.97, 4.0);
        let grey = shading.grey.unwrap();
        assert!(grey.shading < 6.0 && (grey.gain - 1.0).abs() < 0.1, "{grey:?}");
        assert!(shading.corrected(&fraction, &ShadingOptions::default()).is_none());
    }

    #[test]
    fn another_scale_alone_is_corrected() {
        let (shading, fraction) = compared(0.7, 0.0);
        let grey = shading.grey.unwrap();
        assert!(grey.shading < ShadingOptions::default().least_hu && grey.gain > 1.2, "{grey:?}");
        assert!(shading.corrected(&fraction, &ShadingOptions::default()).is_some());
    }

    #[test]
    fn what_appears_in_one_place_is_no_shading() {
        let (_, mut fraction) = compared(1.0, 0.0);
        // A layer of 9 mm is 250 HU brighter.
        let bright = |l: usize| (27..30).contains(&grid().voxel(l)[0]);
        fraction.data_mut().iter_mut().enumerate().filter(|(l, _)| bright(*l)).for_each(|(_, v)| *v += 250.0);
        let still = Volume::filled(grid().coarsened(9.0), [0f32; 3]);
        let grey = Shading::of(&planning(), |_| true, &fraction, &still).grey.unwrap();
        println!("{grey:?}");
        assert!(grey.shading < 6.0 && grey.offset.abs() < 6.0, "{grey:?}");
    }
}
