//! Test objects whose deformation is a formula: any tool's field, or warp, can be held against the exact answer.

use crate::error::{Error, Result};
use crate::evaluate::landmark::Landmark;
use crate::field::{PullField, PushField};
use crate::geometry::Grid;
use crate::volume::{LabelMap, Volume};
use nalgebra::{Point3, Rotation3, Vector3};

/// Shift of [`Formula::Shift`], mm.
const SHIFT: [f64; 3] = [7.0, -4.5, 3.0];
/// Rotation vector of [`Formula::Rotation`], radians, about the origin.
const TURN: [f64; 3] = [0.08, -0.05, 0.2];
/// Factors of [`Formula::Scaling`] about the origin.
const SCALE: [f64; 3] = [1.1, 0.94, 1.05];
/// Greatest angle of [`Formula::Swirl`], radians, and the radius over which it fades, mm.
const SWIRL: (f64, f64) = (0.6, 40.0);
/// Depth and width of [`Formula::Fold`], mm.
const FOLD: (f64, f64) = (12.0, 6.0);
/// Half axes of the body, mm.
const BODY: [f64; 3] = [72.0, 60.0, 50.0];
/// Balls: name, centre and radius, mm.
const BALLS: [(&str, [f64; 3], f64); 3] = [
    ("ball_left", [34.0, 5.0, -4.0], 16.0),
    ("ball_right", [-30.0, -10.0, 8.0], 11.0),
    ("ball_small", [4.0, 26.0, 12.0], 5.0),
];
/// A label of a single voxel.
const SEED: (&str, [f64; 3]) = ("seed", [10.0, -24.0, -9.0]);

/// Deformations with exact answers, planning to fraction, about the origin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Formula {
    /// The same shift everywhere.
    Shift,
    /// A rigid rotation.
    Rotation,
    /// Three scale factors: the Jacobian is their product.
    Scaling,
    /// A turn about z by an angle that fades with the distance from it: volume is kept.
    Swirl,
    /// x - 12 tanh(x / 6): space is turned inside out where |x| < 6 acosh(sqrt 2) = 5.29 mm. It has no inverse.
    Fold,
}

impl Formula {
    /// Where a planning point goes.
    pub fn push(self, x: &Point3<f64>) -> Point3<f64> {
        match self {
            Self::Shift => x + Vector3::from(SHIFT),
            Self::Rotation => turn() * x,
            Self::Scaling => x.coords.component_mul(&Vector3::from(SCALE)).into(),
            Self::Swirl => swirl(x, 1.0),
            Self::Fold => Point3::new(x.x - FOLD.0 * (x.x / FOLD.1).tanh(), x.y, x.z),
        }
    }

    /// Where a fraction point was in planning; `None` for a fold.
    pub fn pull(self, y: &Point3<f64>) -> Option<Point3<f64>> {
        match self {
            Self::Shift => Some(y - Vector3::from(SHIFT)),
            Self::Rotation => Some(turn().inverse() * y),
            Self::Scaling => Some(y.coords.component_div(&Vector3::from(SCALE)).into()),
            Self::Swirl => Some(swirl(y, -1.0)),
            Self::Fold => None,
        }
    }
}

fn turn() -> Rotation3<f64> {
    Rotation3::from_scaled_axis(TURN.into())
}

/// A turn about z leaves the distance from z as it is, so its inverse is the turn back.
fn swirl(p: &Point3<f64>, sense: f64) -> Point3<f64> {
    let angle = sense * SWIRL.0 * (-(p.x.hypot(p.y) / SWIRL.1).powi(2)).exp();
    Rotation3::from_axis_angle(&Vector3::z_axis(), angle) * p
}

/// A test object: an image before and after, with everything that is true about it.
#[derive(Debug, Clone)]
pub struct TestObject {
    /// Its deformation.
    pub formula: Formula,
    /// Planning image, HU.
    pub planning: Volume<f32>,
    /// Labels of the planning image: three balls and a single voxel.
    pub labels: LabelMap,
    /// Points before and after.
    pub landmarks: Vec<Landmark>,
    /// The push field at the voxels of the planning grid.
    pub push: PushField,
    /// What has an exact inverse has these.
    pub deformed: Option<Deformed>,
}

/// The deformed image and the exact pull field, on a grid that is not the planning grid.
#[derive(Debug, Clone)]
pub struct Deformed {
    /// Fraction image, HU: the formula at the exact pre-image, without interpolation.
    pub image: Volume<f32>,
    /// Labels of the fraction image.
    pub labels: LabelMap,
    /// The pull field at the voxels of the fraction grid.
    pub pull: PullField,
}

impl TestObject {
    /// The object on a planning grid of `spacing` mm (default 2 x 2 x 3).
    ///
    /// # Errors
    /// When the spacing makes no grid.
    pub fn new(formula: Formula, spacing: [f64; 3]) -> Result<Self> {
        let grid = centred(spacing, [90.0, 80.0, 66.0])?;
        let other = centred([1.1 * spacing[0], spacing[1], 0.9 * spacing[2]], [92.0, 82.0, 70.0])?;
        let identity = |p: &Point3<f64>| Some(*p);
        let planning = Volume::from_fn(grid.clone(), |n| hu(&grid.centre(grid.voxel(n))));
        let labels = labels(&grid, identity, &Point3::from(SEED.1));
        let u = Volume::from_fn(grid.clone(), |n| {
            let x = grid.centre(grid.voxel(n));
            (formula.push(&x) - x).map(|c| c as f32).into()
        });
        let push = PushField { displacement: u, computed: Volume::filled(grid, true) };
        let deformed = match formula.pull(&Point3::origin()) {
            None => None,
            Some(_) => Some(deformed(formula, &other)?),
        };
        let landmarks = (0..27)
            .map(|n: i32| {
                let at = [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1].map(f64::from);
                let planning = Point3::new(33.0 * at[0] + 2.5, 27.0 * at[1] - 1.5, 22.0 * at[2] + 0.7);
                Landmark { name: format!("p{:02}", n + 1), planning, fraction: formula.push(&planning) }
            })
            .collect();
        Ok(Self { formula, planning, labels, landmarks, push, deformed })
    }
}

/// A grid about the origin that reaches `half` mm each way.
fn centred(spacing: [f64; 3], half: [f64; 3]) -> Result<Grid> {
    let size = std::array::from_fn(|a| (2.0 * half[a] / spacing[a]).round() as usize + 1);
    let origin = std::array::from_fn(|a| -0.5 * (size[a] - 1) as f64 * spacing[a]);
    Grid::axis_aligned(size, spacing, origin)
}

fn deformed(formula: Formula, grid: &Grid) -> Result<Deformed> {
    let pull = |y: &Point3<f64>| formula.pull(y);
    let inner = || Error::Internal(format!("{formula:?} has no inverse"));
    let before: Vec<Point3<f64>> =
        (0..grid.len()).map(|n| pull(&grid.centre(grid.voxel(n)))).collect::<Option<_>>().ok_or_else(inner)?;
    let image = Volume::new(grid.clone(), before.iter().map(hu).collect())?;
    let v = before.iter().enumerate().map(|(n, x)| (x - grid.centre(grid.voxel(n))).map(|c| c as f32).into());
    let displacement = Volume::new(grid.clone(), v.collect())?;
    let labels = labels(grid, pull, &formula.push(&SEED.1.into()));
    Ok(Deformed { image, labels, pull: PullField { displacement, inside: Volume::filled(grid.clone(), true) } })
}

/// HU of the undeformed object: a textured body with a smooth edge, and the balls.
fn hu(p: &Point3<f64>) -> f32 {
    let soft = |d: f64| 0.5 - 0.5 * (d / 4.0).tanh();
    let scaled = p.coords.component_div(&Vector3::from(BODY)).norm();
    let body = soft((scaled - 1.0) * 55.0);
    let texture = 60.0 * (p.x / 9.0).sin() * (p.y / 11.0).cos() + 40.0 * (p.z / 8.0).sin() * (p.x / 13.0).cos();
    let balls: f64 = BALLS.iter().map(|(_, c, r)| 400.0 * soft((p - Point3::from(*c)).norm() - r)).sum();
    (-1000.0 + body * (1040.0 + texture + balls)) as f32
}

/// The balls at the exact pre-images of a grid's voxels, and one voxel for the seed.
fn labels(grid: &Grid, before: impl Fn(&Point3<f64>) -> Option<Point3<f64>> + Sync, seed: &Point3<f64>) -> LabelMap {
    let label = |n: usize| {
        let x = before(&grid.centre(grid.voxel(n)))?;
        let inside = |(_, c, r): &(&str, [f64; 3], f64)| (x - Point3::from(*c)).norm() <= *r;
        BALLS.iter().position(inside).map(|b| b as u16 + 1)
    };
    let mut volume = Volume::from_fn(grid.clone(), |n| label(n).unwrap_or(0));
    let at = grid.index(seed).map(|c| c.round().max(0.0) as usize);
    let n = grid.linear(at.into());
    let seeds = BALLS.len() as u16 + 1;
    if let Some(voxel) = volume.data_mut().get_mut(n) {
        *voxel = seeds;
    }
    let names = BALLS.iter().map(|b| b.0).chain([SEED.0]).map(str::to_owned);
    LabelMap { volume, names: (1..=seeds).zip(names).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::{FOLDED, InvertOptions, invert, jacobian, warp_image, warp_labels};

    const ALL: [Formula; 5] = [Formula::Shift, Formula::Rotation, Formula::Scaling, Formula::Swirl, Formula::Fold];

    #[test]
    fn pull_undoes_push() {
        for formula in ALL {
            for p in [[3.0, -7.0, 11.0], [-44.0, 20.0, 5.0], [0.5, 0.0, -30.0]].map(Point3::from) {
                if let Some(back) = formula.pull(&formula.push(&p)) {
                    assert!((back - p).norm() < 1e-12, "{formula:?}");
                } else {
                    assert_eq!(formula, Formula::Fold);
                }
            }
        }
    }

    #[test]
    fn the_exact_fields_warp_the_object_onto_its_deformed_image() {
        for formula in &ALL[..4] {
            let object = TestObject::new(*formula, [3.0, 3.0, 3.0]).unwrap();
            let deformed = object.deformed.as_ref().unwrap();
            let warped = warp_image(&deformed.pull, &object.planning, -1000.0).unwrap();
            let apart = warped.data().iter().zip(deformed.image.data()).map(|(a, b)| f64::from(a - b).powi(2));
            let rms = (apart.sum::<f64>() / warped.data().len() as f64).sqrt();
            assert!(rms < 12.0, "{formula:?}: {rms} HU");
            let labels = warp_labels(&deformed.pull, &object.labels).unwrap();
            let (own, exact) = (labels.counts(), deformed.labels.counts());
            assert_eq!((own[&4], exact[&4]), (1, 1), "{formula:?}");
            for label in 1..=2 {
                let ratio = own[&label] as f64 / exact[&label] as f64;
                assert!((ratio - 1.0).abs() < 0.1, "{formula:?}: {ratio}");
            }
        }
    }

    #[test]
    fn the_numerical_inverse_is_the_exact_one() {
        for formula in &ALL[..4] {
            let object = TestObject::new(*formula, [4.0, 4.0, 4.0]).unwrap();
            let exact = &object.deformed.as_ref().unwrap().pull;
            let (pull, report) =
                invert(&object.push, exact.displacement.grid(), None, &InvertOptions::default()).unwrap();
            assert_eq!(report.unconverged_tissue, 0);
            // Between voxels the push field is linear, the formula is not: only the swirl shows the difference.
            let bound = if *formula == Formula::Swirl { 0.15 } else { 2e-3 };
            for (n, _) in pull.inside.data().iter().enumerate().filter(|(_, inside)| **inside) {
                let (a, b) = (pull.displacement.data()[n], exact.displacement.data()[n]);
                let apart = (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>().sqrt();
                assert!(apart < bound, "{formula:?}: {apart} mm");
            }
        }
    }

    #[test]
    fn the_jacobian_of_the_formulas_is_known() {
        let of = |formula| {
            let object = TestObject::new(formula, [2.0, 4.0, 4.0]).unwrap();
            let map = jacobian(&object.push).to_volume();
            let grid = map.grid().clone();
            (0..grid.len()).map(|n| (grid.centre(grid.voxel(n)), map.data()[n])).collect::<Vec<_>>()
        };
        let inner = |p: &Point3<f64>| p.coords.amax() < 60.0;
        let product: f64 = SCALE.iter().product();
        assert!(
            of(Formula::Scaling).iter().filter(|(p, _)| inner(p)).all(|(_, j)| (f64::from(*j) - product).abs() < 1e-4)
        );
        let folded: Vec<f64> =
            of(Formula::Fold).iter().filter(|(p, j)| inner(p) && *j <= FOLDED).map(|(p, _)| p.x + 1.0).collect();
        let widest = folded.iter().fold(0.0f64, |m, x| m.max(x.abs()));
        assert!(widest < 6.0 && widest > 4.0, "{widest}");
    }
}
