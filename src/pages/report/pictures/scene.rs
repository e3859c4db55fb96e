//! Where to look: the planes that every picture of a run shares.

use super::super::canvas::{Canvas, Rgb};
use super::super::colour::INK;
use super::super::plane::{KINDS, Kind, Plane, Region, planes};
use super::focus::{Focus, focus, in_the_patient};
use crate::geometry::Grid;
use crate::pipeline::{Case, FractionKind, Outcome};
use nalgebra::{Point3, Vector3};

/// A run with the planes that matter.
pub(super) struct PictureScene<'a> {
    pub(super) case: &'a Case,
    pub(super) outcome: &'a Outcome,
    /// Planes in the planning CT.
    pub(super) planning: Vec<Plane>,
    /// CT numbers at their pixels.
    pub(super) planning_hu: Vec<Vec<f32>>,
    /// The corresponding planes in the fraction CT.
    pub(super) fraction: Vec<Plane>,
    /// CT numbers at their pixels.
    pub(super) fraction_hu: Vec<Vec<f32>>,
    /// Points of the patient in the fraction, before and after registration together.
    moved: Vec<Point3<f64>>,
    /// What the planes go through and why.
    pub(super) focus: String,
    /// Shift of the planning CT in the picture before registration; `None` when the scanner positions are used as they are.
    pub(super) shift_before: Option<Vector3<f64>>,
}

/// The planes that were chosen for both scans.
struct Chosen {
    planning: Vec<Plane>,
    fraction: Vec<Plane>,
    /// What they go through and why.
    focus: String,
}

/// Share of the fraction's box that the planning scan must cover for the picture before registration to be as scanned.
const LEAST_OVERLAP: f64 = 0.25;
/// Rim around the patient, mm.
const RIM_MM: f64 = 10.0;
/// Distance of the points that stand for the patient, mm.
const POINTS_MM: f64 = 4.0;
/// What lies this close to a plane decides what it shows, mm.
const SLAB_MM: f64 = 8.0;

/// How two scans are laid over each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Overlay {
    /// In two colours that add up to grey.
    Colours,
    /// In squares in turns.
    Checks,
}

impl<'a> PictureScene<'a> {
    pub(super) fn new(case: &'a Case, outcome: &'a Outcome) -> Self {
        let shift_before = shift_before(case, outcome);
        let (body, moved) = patient(outcome, shift_before.unwrap_or_default());
        // Of a region of interest, the scans hold more than the patient that was carried along.
        let seen = [Region::around(body.iter().copied()), Some(Region::of(case.fraction.ct.grid()))];
        let middles = [case.planning.ct.grid().middle(), case.fraction.ct.grid().middle()];
        let Focus { from, to: meant, mut told } = focus(outcome, seen, middles);
        let (from, to) = (in_the_patient(&body, &from, POINTS_MM), in_the_patient(&moved, &meant, POINTS_MM));
        for kind in KINDS.into_iter().filter(|kind| (to - meant)[kind.across()].abs() > POINTS_MM) {
            told.push_str(&format!("; the {} one moved to where more of the patient is", kind.name()));
        }
        let planning = planes(&regions(&body, &from, case.planning.ct.grid()), &from).into();
        let fraction = planes(&regions(&moved, &to, case.fraction.ct.grid()), &to).into();
        Self::of_planes(case, outcome, Chosen { planning, fraction, focus: told }, moved, shift_before)
    }

    /// One plane of planning and one of the fraction, through this coordinate (LPS mm) of both; what is drawn over them
    /// stays apart from their pixels.
    pub(super) fn single(case: &'a Case, outcome: &'a Outcome, kind: Kind, at: f64) -> Self {
        let shift_before = shift_before(case, outcome);
        let (body, moved) = patient(outcome, shift_before.unwrap_or_default());
        let plane = |points: &[Point3<f64>], grid: &Grid| {
            let mut through = grid.middle();
            through[kind.across()] = at;
            let region = regions(points, &through, grid)[kind as usize];
            vec![Plane::alone(kind, &region, &through).keeping_shapes()]
        };
        let (planning, fraction) = (plane(&body, case.planning.ct.grid()), plane(&moved, case.fraction.ct.grid()));
        let focus = format!("{} at {at:.1} mm", kind.name());
        Self::of_planes(case, outcome, Chosen { planning, fraction, focus }, moved, shift_before)
    }

    fn of_planes(
        case: &'a Case,
        outcome: &'a Outcome,
        chosen: Chosen,
        moved: Vec<Point3<f64>>,
        shift_before: Option<Vector3<f64>>,
    ) -> Self {
        let Chosen { planning, fraction, focus } = chosen;
        let hu = |ct, planes: &[Plane]| planes.iter().map(|plane| plane.hu(ct)).collect::<Vec<_>>();
        let fraction_hu = hu(&case.fraction.ct, &fraction);
        let mut scene = Self {
            planning_hu: hu(&case.planning.ct, &planning),
            fraction_hu: Vec::new(),
            case,
            outcome,
            planning,
            fraction,
            moved,
            focus,
            shift_before,
        };
        let shown = |mut hu: Vec<f32>| {
            scene.on_plannings_scale(&mut hu);
            hu
        };
        scene.fraction_hu = fraction_hu.into_iter().map(shown).collect();
        scene
    }

    /// Brings the fraction's values to where one window shows both scans: a cone-beam CT on planning's scale, an MR by its own
    /// dark and bright.
    pub(super) fn on_plannings_scale(&self, values: &mut [f32]) {
        if let Some(kind) = &self.outcome.kind {
            values.iter_mut().for_each(|hu| *hu = kind.on_plannings_scale(*hu));
        }
    }

    /// How both scans are laid over each other.
    pub(super) fn overlay(&self) -> Overlay {
        let unlike = self.outcome.kind.as_ref().is_some_and(FractionKind::unlike);
        if unlike { Overlay::Checks } else { Overlay::Colours }
    }

    /// The planning CT's planes with `colour` of each position and its CT number, as rows of a sheet.
    pub(super) fn planning_rows(&self, colour: impl Fn(Point3<f64>, f32) -> Rgb + Sync, backdrop: Rgb) -> Vec<Canvas> {
        let planes = self.planning.iter().zip(&self.planning_hu);
        planes.map(|(plane, hu)| plane.row(&plane.paint(|p, n| colour(p, hu[n])), backdrop, INK, backdrop)).collect()
    }

    /// The planes of the fraction through another point.
    pub(super) fn fraction_through(&self, p: &Point3<f64>) -> [Plane; 3] {
        planes(&regions(&self.moved, p, self.case.fraction.ct.grid()), p)
    }
}

/// What axial, coronal and sagittal plane through `p` show: the patient near the plane, as far as `grid` reaches.
fn regions(points: &[Point3<f64>], p: &Point3<f64>, grid: &Grid) -> [Region; 3] {
    let scan = Region::of(grid);
    KINDS.map(|kind| {
        let a = kind.across();
        let near =
            Region::around(points.iter().filter(|q| (q[a] - p[a]).abs() <= SLAB_MM && scan.contains(q)).copied());
        near.map_or(scan, |r| r.grown(RIM_MM).within(scan))
    })
}

/// Points of the body in the planning CT, and in the fraction before and after registration together.
fn patient(outcome: &Outcome, shift: Vector3<f64>) -> (Vec<Point3<f64>>, Vec<Point3<f64>>) {
    let grid = outcome.body.grid();
    let every = grid.spacing().map(|s| ((POINTS_MM / s).round() as usize).max(1));
    let along = |a: usize| (0..grid.size()[a]).step_by(every[a]);
    let (mut body, mut moved) = (Vec::new(), Vec::new());
    for k in along(2) {
        for j in along(1) {
            for i in along(0).filter(|&i| *outcome.body.at([i, j, k])) {
                let x = grid.centre([i, j, k]);
                body.push(x);
                let u = outcome.push.displacement.at([i, j, k]).map(f64::from);
                moved.extend([x + shift, x + Vector3::from(u)]);
            }
        }
    }
    (body, moved)
}

/// Shift of the planning CT in what is shown of before the registration; `None` where the scans meet as they are.
pub(in crate::report) fn shift_before(case: &Case, outcome: &Outcome) -> Option<Vector3<f64>> {
    (overlap(case.planning.ct.grid(), case.fraction.ct.grid()) < LEAST_OVERLAP).then_some(outcome.couch.shift())
}

/// Share of `fraction`'s box that lies inside `planning`'s.
fn overlap(planning: &Grid, fraction: &Grid) -> f64 {
    let coarse = fraction.coarsened(10.0);
    let inside =
        (0..coarse.len()).filter(|&l| planning.contains(&planning.index(&coarse.centre(coarse.voxel(l))))).count();
    inside as f64 / coarse.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlap_counts_the_shared_part() {
        let planning = Grid::axis_aligned([101, 101, 101], [1.0; 3], [0.0; 3]).unwrap();
        let at = |x: f64| Grid::axis_aligned([101, 101, 101], [1.0; 3], [x, 0.0, 0.0]).unwrap();
        assert!((overlap(&planning, &at(0.0)) - 1.0).abs() < 1e-12);
        assert!((overlap(&planning, &at(75.0)) - 3.0 / 11.0).abs() < 1e-12);
        assert!(overlap(&planning, &at(500.0)) == 0.0);
    }
}
