//! Where images mislead: they draw soft tissue away from where the bones alone would carry it, and agree no better for it.
//!
//! Place by place this tells nothing: where the local correlation of the images is worse than before, tissue still lies nearer to
//! the truth than by bones alone as a rule, since what its neighbours were shown moves it. Over some centimetres it does: there
//! the drawn tissue must gain more agreement than it loses, or what draws it is no anatomy (streaks of metal, noise, grey values
//! of another machine). docs/decisions/images.md has the measurements.

use super::Images;
use super::around::{POINTS, spread, summed};
use super::planning::Windowed;
use crate::chainmail::Lattice;
use crate::volume::{Mask, Volume, trilinear_vector};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Width (sigma) of the neighbourhoods in which images are correlated, mm, or the elements' spacing where that is greater.
/// At 9 mm streaks around a filling are no longer told from anatomy (0.60 mm for 0.35); at 2.25 nothing changes.
const NEAR_MM: f64 = 4.5;
/// Width (sigma) over which gains and losses are weighed against each other, mm.
/// 10 and 40 mm: 0.40 and 0.36 for 0.35 mm under streaks, 0.42 and 0.41 for 0.43 under noise.
const WIDE_MM: f64 = 20.0;
/// Grey values are counted in these, HU, so that single precision does.
const UNIT_HU: f64 = 100.0;
/// Contrast (standard deviation) below which a correlation means nothing, HU.
/// Half or twice as much moves no mean error by 0.003 mm.
const RIDGE_HU: f64 = 3.0;
/// Points of an element that both scans must show on the mean of a neighbourhood.
/// Half or twice as many move no mean error by 0.003 mm.
const LEAST_SEEN: f32 = 0.2;
/// A correlation that changes by less has neither gained nor lost.
/// At 0.005 and 0.02: 0.353 and 0.342 for 0.350 mm under streaks.
const LEAST_CHANGE: f32 = 0.01;
/// Tissue that is drawn by less does no harm, mm: else a pair that the bones alone explain would be judged by its noise.
const LEAST_MM: f32 = 0.3;
/// Tissue that is drawn by more counts as if it were this much more than that, mm.
/// At 1 and 4: 0.367 and 0.343 for 0.350 mm under streaks.
const FARTHEST_MM: f32 = 2.0;
/// Tissue is taken to be drawn by at least this on the mean, mm: where images agree with the bones alone nothing is to be doubted.
const LEAST_MEAN_MM: f64 = 0.1;
/// The balance of gains and losses (1: all gain, -1: all lose) below which tissue counts as drawn without gain, and the share of
/// all that tissue is drawn, percent, that must be so before images are doubted at all: at most 0.9 on ordinary pairs that were
/// measured, 5.6 and 9.4 in a breathing phantom (with and without labels of organs), whose soft tissue errs by 1.81 and 2.04 mm
/// (doubted: 1.92 and 2.35), 17 and more where images misled.
const WITHOUT_GAIN: f32 = 0.2;
const DOUBTED_PERCENT: f64 = 12.0;
/// Once they are doubted they must do better than this: ordinary pairs have 0.8 to 1 nearly everywhere.
/// At 0.2 and 0.8: 0.428 and 0.270 for 0.350 mm under streaks, 0.416 and 0.474 for 0.426 under noise.
const CLEAR: f32 = 0.4;

/// Where images mislead.
#[derive(Debug, Clone)]
pub struct Misled {
    /// On the elements' grid.
    pub at: Mask,
    /// Share of the soft elements, percent.
    pub percent: f64,
    /// The middle of those elements, LPS mm, in planning.
    pub centre: Point3<f64>,
}

/// What both scans show around an element: how many points, and the sums of grey values and their products (planning, fraction
/// where tissue was drawn, fraction where the bones alone carry it).
type EvidenceSums = [f32; 9];

impl Images<'_> {
    /// Where the images have drawn the elements of a lattice, at the displacements `u` (mm), without agreeing better than by bones
    /// alone; `None` where that is hardly anywhere, and where grey values do not pull.
    pub fn misled(&self, lattice: &Lattice, u: &[[f32; 3]]) -> Option<Misled> {
        let (fraction, alone) = (self.fraction.as_ref()?, self.alone?);
        let soft: Vec<u32> = lattice.soft().collect();
        let planning = self.planning.windowed();
        let seen: Vec<(f32, EvidenceSums)> =
            soft.par_iter().map(|&n| compared(lattice, planning, fraction, u, alone, n as usize)).collect();
        let near = NEAR_MM.max(lattice.grid.mean_edge());
        let around = |q: usize| spread(lattice, &soft, near, |s| seen[s].1[q]);
        let sums: Vec<Volume<f32>> = (0..9).into_par_iter().map(around).collect();
        let votes: Vec<(f32, f32)> = soft
            .par_iter()
            .zip(&seen)
            .map(|(&n, (drawn, _))| {
                let around: EvidenceSums = std::array::from_fn(|q| sums[q].data()[n as usize]);
                gain(&around).map_or((0.0, 0.0), |gain| (gain * drawn, *drawn))
            })
            .collect();
        let widely = |of: fn(&(f32, f32)) -> f32| spread(lattice, &soft, WIDE_MM, |s| of(&votes[s]));
        let (gained, drawn) = rayon::join(|| widely(|v| v.0), || widely(|v| v.1));
        let below = |n: usize, least: f32| gained.data()[n] < least * drawn.data()[n];
        let without = |least: f32| soft.iter().zip(&votes).filter(move |(n, _)| below(**n as usize, least));
        let all: f64 = votes.iter().map(|v| f64::from(v.1)).sum();
        let lost: f64 = without(WITHOUT_GAIN).map(|(_, v)| f64::from(v.1)).sum();
        if 100.0 * lost <= DOUBTED_PERCENT * all.max(LEAST_MEAN_MM * soft.len() as f64) {
            return None;
        }
        let (mut count, mut sum) = (0, Vector3::zeros());
        without(CLEAR).for_each(|(&n, _)| (count, sum) = (count + 1, sum + lattice.rest(n as usize).coords));
        let at = Volume::from_fn(lattice.grid.clone(), |n| below(n, CLEAR));
        let percent = 100.0 * f64::from(count) / soft.len().max(1) as f64;
        Some(Misled { at, percent, centre: (sum / f64::from(count.max(1))).into() })
    }
}

/// By how much an element is drawn from where the bones alone carry it, mm, beyond [`LEAST_MM`] and up to [`FARTHEST_MM`], and what
/// both scans show in it.
fn compared(
    lattice: &Lattice,
    planning: &Windowed,
    fraction: &Windowed,
    u: &[[f32; 3]],
    alone: &Volume<[f32; 3]>,
    n: usize,
) -> (f32, EvidenceSums) {
    let rest = lattice.rest(n);
    let Some(by_bones) = trilinear_vector(alone, &alone.grid().index(&rest)) else { return (0.0, [0.0; 9]) };
    let drawn = Vector3::from(u[n].map(f64::from));
    let offsets = lattice.grid.eighths();
    let shown = |point: &usize| {
        let at = |image: &Windowed, place: Point3<f64>| image.at(&(place + offsets[*point])).map(|hu| hu / UNIT_HU);
        Some(products([at(planning, rest)?, at(fraction, rest + drawn)?, at(fraction, rest + by_bones)?]))
    };
    let far = (drawn - by_bones).norm() as f32 - LEAST_MM;
    (far.clamp(0.0, FARTHEST_MM), summed(POINTS.iter().filter_map(shown)))
}

/// What a point adds to [`EvidenceSums`].
fn products([p, f, b]: [f64; 3]) -> [f64; 9] {
    [1.0, p, f, b, p * p, f * f, b * b, p * f, p * b]
}

/// 1 where the correlation with planning gains by what tissue was drawn, -1 where it loses, 0 where it hardly changes; `None` where
/// too little is seen.
fn gain(&[n, p, f, b, pp, ff, bb, pf, pb]: &EvidenceSums) -> Option<f32> {
    if n < LEAST_SEEN {
        return None;
    }
    let ridge = (RIDGE_HU / UNIT_HU).powi(2) as f32;
    let spread = |sum: f32, squares: f32| (squares / n - (sum / n).powi(2)).max(0.0) + ridge;
    let correlation = |sum: f32, squares: f32, products: f32| {
        (products / n - p * sum / (n * n)) / (spread(p, pp) * spread(sum, squares)).sqrt()
    };
    let change = correlation(f, ff, pf) - correlation(b, bb, pb);
    Some(if change.abs() > LEAST_CHANGE { change.signum() } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chainmail::{Material, Node};
    use crate::geometry::Grid;
    use crate::volume::Window;

    /// EvidenceSums over points of planning, fraction as drawn, fraction by bones alone, HU.
    fn sums(points: &[[f64; 3]]) -> EvidenceSums {
        summed(points.iter().map(|hu| products(hu.map(|hu| hu / UNIT_HU))))
    }

    #[test]
    fn what_agrees_better_gains_whatever_its_scale() {
        let planning = [40.0, -80.0, 60.0, -100.0, 20.0];
        let like = |p: f64| 0.7 * p + 200.0;
        let unlike = [10.0, -20.0, -90.0, 50.0, 0.0];
        let points = |drawn: &dyn Fn(usize) -> f64, by_bones: &dyn Fn(usize) -> f64| {
            sums(&std::array::from_fn::<_, 5, _>(|n| [planning[n], drawn(n), by_bones(n)]))
        };
        let (good, bad) = (|n: usize| like(planning[n]), |n: usize| unlike[n]);
        assert_eq!(gain(&points(&good, &bad)), Some(1.0));
        assert_eq!(gain(&points(&bad, &good)), Some(-1.0));
        assert_eq!(gain(&points(&good, &good)), Some(0.0));
        assert_eq!(gain(&[0.0; 9]), None);
        // Where nothing has contrast nothing is gained.
        let flat = sums(&[[30.0, 90.0, -50.0]; 5]);
        assert_eq!(gain(&flat), Some(0.0));
    }

    #[test]
    fn the_first_tenths_of_a_millimetre_are_not_counted_as_drawn() {
        let grid = Grid::axis_aligned([8; 3], [4.0; 3], [0.0; 3]).unwrap();
        let lattice = Lattice::from_nodes(
            grid.clone(),
            vec![Node::Soft; grid.len()],
            vec![Material::default().at(20.0); grid.len()],
        );
        let body = Volume::filled(grid.clone(), true);
        let ct = Volume::from_fn(grid.clone(), |l| grid.voxel(l)[0] as f32);
        let shown = Windowed::new(&ct, &body, Window { low: -250.0, high: 300.0, thin: 0.0 });
        let alone = Volume::filled(grid.clone(), [1.0f32, 0.0, 0.0]);
        let middle = grid.linear([4; 3]);
        let drawn = |x: f32| {
            let mut u = vec![[1.0f32, 0.0, 0.0]; grid.len()];
            u[middle][0] += x;
            compared(&lattice, &shown, &shown, &u, &alone, middle).0
        };
        for (x, counted) in [(0.0, 0.0), (0.2, 0.0), (-0.8, 0.5), (1.3, 1.0), (9.0, FARTHEST_MM)] {
            assert!((drawn(x) - counted).abs() < 1e-5, "{x}: {}", drawn(x));
        }
    }
}
