//! A joint turned until the skin around its bones lies where the fraction shows it: shoulders whose bones another modality
//! does not show, or that lie beyond the end of the scan.
//!
//! Tissue carries a turn of the joint to the skin, as far as the chain mail lets it; to first order a point of planning's skin
//! moves by so many mm per degree about each of the joint's axes. What it lies off the fraction's skin is squared (Huber) over
//! the independent patches of the skin, beside the joint's own play (docs/decisions/mr.md).

use super::problem::Local;
use super::solver::{Cost, solve};
use crate::error::Result;
use crate::volume::signed::{slope, within_edges};
use crate::volume::{Volume, trilinear};
use nalgebra::{DMatrix, DVector, Matrix3, Point3, Vector3};

/// A point of planning's skin.
#[derive(Debug, Clone)]
pub struct SkinPoint {
    /// Where the bones as they are take it, LPS mm.
    pub place: Point3<f64>,
    /// How much farther a turn of the joint takes it: one column per axis of the joint, mm per degree.
    pub by_turn: Matrix3<f64>,
}

/// How a joint is turned.
#[derive(Debug, Clone)]
pub struct TurnedBySkin {
    /// About each axis of the joint, degrees, beside its rotation before.
    pub by_deg: Vector3<f64>,
    /// Inverse of the cost's curvature: how well the turn is known, degrees squared.
    pub covariance: Matrix3<f64>,
    /// Mean distance of the points in view from the fraction's skin, mm, before and after.
    pub off_mm: [f64; 2],
    /// Points in view afterwards.
    pub seen: usize,
}

/// A point that a turn moves by less, mm per degree, is not of those that tell of it.
const MOVED_MM: f64 = 0.35;
/// Points that it moves by less than this, mm per degree, at least the stillest share of them, tell how the two skins lie to each
/// other where nothing turns.
const STILL_MM: f64 = 0.09;
const STILL_SHARE: f64 = 0.25;
/// Distances beyond this count less (Huber), mm.
const ROBUST_MM: f64 = 3.0;
/// How well a patch of skin tells where it is, one standard deviation, mm: clothes, fat and the edge of a coil's view.
const SD_MM: f64 = 2.0;
/// Skin that hangs together, mm^2.
const PATCH_MM2: f64 = 400.0;
/// Standard deviation of a free joint about planning's posture, degrees, as in the fit.
const JOINT_SD_DEG: f64 = 8.0;
/// Nearer to an edge of the fraction its skin is not believed, mm.
const EDGE_MM: f64 = 3.0;
const TOLERANCE_DEG: f64 = 0.01;
const MOST_ITERATIONS: u64 = 50;

impl SkinPoint {
    /// Whether a turn of the joint moves it.
    fn moves(&self) -> bool {
        self.by_turn.norm() >= MOVED_MM
    }

    /// Its distance from the fraction's skin after a further turn (degrees) and the distance's gradient; `None` out of view.
    fn off(&self, skin: &Volume<f32>, by_deg: &Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
        let place = self.place + self.by_turn * by_deg;
        if within_edges(skin.grid(), &place) < EDGE_MM {
            return None;
        }
        let index = skin.grid().index(&place);
        let (depth, slope) = (trilinear(skin, &index)?, slope(skin, &index)?);
        (depth.is_finite() && slope.iter().all(|s| s.is_finite())).then_some((depth, slope))
    }
}

/// The cost of a turn, in degrees.
struct Turn<'a> {
    points: Vec<&'a SkinPoint>,
    skin: &'a Volume<f32>,
    /// How far the fraction's skin lies outside of planning's where nothing turns, mm.
    apart_mm: f64,
    /// Independent patches among the points.
    patches: f64,
    /// Rotation of the joint before, degrees.
    now: Vector3<f64>,
}

impl Turn<'_> {
    fn seen(&self, by: &Vector3<f64>) -> Vec<(f64, Vector3<f64>)> {
        let off = |p: &&SkinPoint| p.off(self.skin, by).map(|(d, s)| (d - self.apart_mm, p.by_turn.transpose() * s));
        self.points.iter().filter_map(off).collect()
    }

    /// Mean distance from the skin of what is in view, mm, and how many points are.
    fn off_mm(&self, by: &Vector3<f64>) -> (f64, usize) {
        let seen = self.seen(by);
        (seen.iter().map(|(d, _)| d.abs()).sum::<f64>() / seen.len().max(1) as f64, seen.len())
    }
}

impl Cost for Turn<'_> {
    fn parameters(&self) -> usize {
        3
    }

    fn at(&self, x: &DVector<f64>) -> Local {
        let by = Vector3::new(x[0], x[1], x[2]);
        let angle = (self.now + by) / JOINT_SD_DEG;
        let mut cost = 0.5 * angle.norm_squared();
        let mut gradient = angle / JOINT_SD_DEG;
        let mut curvature = Matrix3::identity() / JOINT_SD_DEG.powi(2);
        let seen = self.seen(&by);
        // The mean counts: a turn that takes skin out of view gains nothing by it.
        let each = self.patches / SD_MM.powi(2) / seen.len().max(1) as f64;
        for (d, along) in seen {
            let far = d.abs().max(ROBUST_MM);
            cost += each * (if d.abs() < ROBUST_MM { 0.5 * d * d } else { ROBUST_MM * (far - 0.5 * ROBUST_MM) });
            let weight = each * ROBUST_MM / far;
            gradient += along * (weight * d);
            curvature += along * along.transpose() * weight;
        }
        Local {
            cost,
            gradient: DVector::from_column_slice(gradient.as_slice()),
            curvature: DMatrix::from_column_slice(3, 3, curvature.as_slice()),
        }
    }
}

/// The value below which a share of them lies; 0 of none.
fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    let at = (share * values.len() as f64) as usize;
    if at < values.len() { *values.select_nth_unstable_by(at, f64::total_cmp).1 } else { 0.0 }
}

/// The turn of a joint, whose rotation is `now_deg` about its axes, that brings planning's skin to the fraction's best. `skin` is
/// the signed distance to the latter, mm, negative inside, and no number where nothing was measured; each point stands for
/// `area_mm2` of skin. `None` where no turn moves any skin in view.
///
/// # Errors
/// As the solver.
pub fn turn_by_skin(
    points: &[SkinPoint],
    skin: &Volume<f32>,
    area_mm2: f64,
    now_deg: Vector3<f64>,
) -> Result<Option<TurnedBySkin>> {
    let none = Vector3::zeros();
    let still = quantile(points.iter().map(|p| p.by_turn.norm()).collect(), STILL_SHARE).max(STILL_MM);
    let still = points.iter().filter(|p| p.by_turn.norm() <= still);
    let apart_mm = quantile(still.filter_map(|p| p.off(skin, &none)).map(|(d, _)| d).collect(), 0.5);
    let moving: Vec<&SkinPoint> = points.iter().filter(|p| p.moves()).collect();
    let patches = moving.len() as f64 * area_mm2 / PATCH_MM2;
    let cost = || Turn { points: moving.clone(), skin, apart_mm, patches, now: now_deg };
    let before = cost().off_mm(&none);
    if before.1 == 0 {
        return Ok(None);
    }
    let solution = solve(cost(), TOLERANCE_DEG, MOST_ITERATIONS)?;
    let by_deg = Vector3::new(solution.x[0], solution.x[1], solution.x[2]);
    let (after, seen) = cost().off_mm(&by_deg);
    let covariance = Matrix3::from_column_slice(solution.curvature.as_slice()).try_inverse();
    let off_mm = [before.0, after];
    Ok(covariance.map(|covariance| TurnedBySkin { by_deg, covariance, off_mm, seen }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use crate::volume::signed::measured_depth;

    /// A cone that widens downwards, cut by the scan's end: turned about its tip it comes elsewhere.
    fn cone(turn_deg: f64) -> impl Fn(&Point3<f64>) -> bool {
        let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::y_axis(), turn_deg.to_radians());
        move |p: &Point3<f64>| {
            let q = turn.inverse() * p;
            q.y.hypot(q.z) < 10.0 + 0.5 * q.x
        }
    }

    /// The skin of the cone at rest, as points, and the turned one's distance.
    fn scene(turn_deg: f64) -> (Vec<SkinPoint>, Volume<f32>) {
        let grid = Grid::axis_aligned([80, 70, 70], [2.0; 3], [0.0, -69.0, -69.0]).unwrap();
        let (rest, there) = (cone(0.0), cone(turn_deg));
        // The last slices are blank.
        let measured = |n: usize| grid.voxel(n)[0] < 70;
        let inside = Volume::from_fn(grid.clone(), |n| there(&grid.centre(grid.voxel(n))) && measured(n));
        let skin = measured_depth(&inside, measured, 40.0);
        let mut points = Vec::new();
        for n in 0..grid.len() {
            let p = grid.centre(grid.voxel(n));
            let out = [-2.0, 2.0].iter().any(|d| !rest(&(p + Vector3::new(0.0, *d, 0.0))));
            if n % 3 == 0 && rest(&p) && out {
                let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(|a| a.cross(&p.coords) * 1f64.to_radians());
                points.push(SkinPoint { place: p, by_turn: Matrix3::from_columns(&axes) });
            }
        }
        (points, skin)
    }

    #[test]
    fn a_joint_turns_as_far_as_the_skin_has() {
        for degrees in [-6.0, 0.0, 4.0] {
            let (points, skin) = scene(degrees);
            let found = turn_by_skin(&points, &skin, 12.0, Vector3::zeros()).unwrap().unwrap();
            let off = found.by_deg - Vector3::new(0.0, degrees, 0.0);
            assert!(off.y.abs() < 0.5 && off.z.abs() < 0.5, "{degrees}: {}", found.by_deg);
            // About its own axis nothing tells but the joint.
            assert!(off.x.abs() < 0.5 && found.covariance[(0, 0)] > 4.0 * found.covariance[(1, 1)]);
            assert!(found.seen > 500 && found.off_mm[1] < 1.5, "{:?}", found.off_mm);
            assert!(degrees == 0.0 || found.off_mm[0] > 2.0 * found.off_mm[1], "{:?}", found.off_mm);
        }
    }

    #[test]
    fn cost_and_slope_agree() {
        let (points, skin) = scene(5.0);
        let turn =
            Turn { points: points.iter().collect(), skin: &skin, apart_mm: 0.0, patches: 50.0, now: Vector3::y() };
        let x = DVector::from_vec(vec![0.3, 1.0, -0.7]);
        let here = turn.at(&x);
        for a in 0..3 {
            let step = DVector::from_fn(3, |n, _| if n == a { 0.05 } else { 0.0 });
            let slope = (turn.at(&(&x + &step)).cost - turn.at(&(&x - &step)).cost) / 0.1;
            assert!((slope - here.gradient[a]).abs() < 0.1 * here.gradient.norm(), "{a}: {slope} {}", here.gradient);
        }
    }

    #[test]
    fn skin_out_of_view_or_that_nothing_moves_turns_no_joint() {
        let (points, skin) = scene(5.0);
        let far: Vec<SkinPoint> =
            points.iter().map(|p| SkinPoint { place: p.place + Vector3::x() * 500.0, ..p.clone() }).collect();
        let still: Vec<SkinPoint> =
            points.iter().map(|p| SkinPoint { by_turn: Matrix3::zeros(), ..p.clone() }).collect();
        for points in [far, still, Vec::new()] {
            assert!(turn_by_skin(&points, &skin, 12.0, Vector3::zeros()).unwrap().is_none());
        }
    }
}
