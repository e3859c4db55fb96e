//! Derivatives against central differences, known motions recovered, and the field of view that never pays.

use super::evaluation::Weights;
use super::prior::BeyondRange;
use super::problem::{Body, End, Link, PoseProblem};
use super::samples::Samples;
use super::similarity::{Held, Measure};
use super::solver::solve;
use super::stop::Stop;
use super::tissue::Tissue;
use crate::geometry::{Grid, Rigid, about};
use crate::skeleton::{Joint, JointPose};
use crate::volume::Volume;
use crate::volume::ranges::memberships;
use nalgebra::{DVector, Matrix3, Point3, Vector3};
use proptest::prelude::*;

mod schedule;
mod whole;

/// A smooth texture without symmetry, HU 0 to 800.
fn texture(p: &Point3<f64>) -> f64 {
    400.0
        + 150.0 * (p.x / 6.0).sin()
        + 120.0 * ((p.y + 0.3 * p.z) / 7.0).cos()
        + 100.0 * ((p.z - 0.2 * p.x) / 5.0).sin()
}

fn fraction(size: [usize; 3], gain: f64, offset: f64) -> Tissue {
    let grid = Grid::axis_aligned(size, [1.5, 1.5, 2.0], [-30.0, -30.0, -30.0]).unwrap();
    let ct = Volume::from_fn(grid.clone(), |l| (gain * texture(&grid.centre(grid.voxel(l))) + offset) as f32);
    Tissue::blurred(&ct, 0.0)
}

/// Samples of a ball whose true motion is `truth`: planning values are the texture at the moved place.
fn ball(centre: Point3<f64>, truth: &Rigid) -> Samples {
    let mut points = Vec::new();
    for k in -4..=4 {
        for j in -4..=4 {
            for i in -4..=4 {
                let o = Vector3::new(f64::from(i), f64::from(j), f64::from(k)) * 2.0;
                if o.norm() <= 8.0 {
                    points.push(centre + o);
                }
            }
        }
    }
    let values = points.iter().map(|p| texture(&(truth * p))).collect();
    Samples { points, values, volume_mm3: 2000.0, ..Samples::default() }
}

fn joint() -> Joint {
    Joint {
        name: "test".into(),
        centre: Point3::new(1.0, 6.0, 0.0),
        axes: *nalgebra::Rotation3::from_euler_angles(0.2, -0.1, 0.4).matrix(),
        rotation_range_deg: [[-3.0, 4.0], [-5.0, 5.0], [-6.0, 2.0]],
        translation_range_mm: [0.5, 1.0, 1.5],
        source: String::new(),
    }
}

fn body(samples: &Samples, base: Rigid) -> Body<'_> {
    let n = samples.points.len() as f64;
    let centre = Point3::from(samples.points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n);
    Body { samples, base, centre, radius: 6.0, held: None, shape: None }
}

fn gradient_error(problem: &PoseProblem<'_>, x: &DVector<f64>) -> (f64, f64) {
    let local = problem.local(x);
    let cost = |x: &DVector<f64>| problem.local(x).cost;
    let mut worst: f64 = 0.0;
    for i in 0..x.len() {
        // Single-precision interpolation limits the step from below, curvature from above.
        let h = 2e-3;
        let (mut up, mut down) = (x.clone(), x.clone());
        up[i] += h;
        down[i] -= h;
        let numeric = (cost(&up) - cost(&down)) / (2.0 * h);
        worst = worst.max((numeric - local.gradient[i]).abs());
    }
    (worst, local.gradient.amax())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn gradient_matches_central_differences(values in prop::collection::vec(-2.0f64..2.0, 12), cut in any::<bool>(), measure in prop::sample::select(vec![Measure::Correlation, Measure::SquaredDifference, Measure::CorrelationRatio]), hold in any::<bool>(), scale in prop::sample::select(vec![1.0, 1e-3])) {
        // A cut image puts part of the second ball on the edge, where visibility has a slope of its own.
        let image = fraction(if cut { [28, 40, 30] } else { [45, 45, 40] }, 1.1, -20.0);
        let truth = Rigid::identity();
        // Values that the image does not explain wholly: at a perfect match the logarithm is a cusp.
        let unlike = |mut s: Samples| {
            s.values.iter_mut().enumerate().for_each(|(n, v)| *v += 60.0 * (n as f64).sin());
            s.memberships = s.values.iter().map(|v| memberships(*v as f32)).collect();
            s
        };
        let (a, b) = (unlike(ball(Point3::new(0.0, 0.0, 0.0), &truth)), unlike(ball(Point3::new(5.0, 12.0, 3.0), &truth)));
        let grey = Weights::from_column_slice(&[-100.0, 30.0, 50.0, 300.0, 500.0, 900.0]);
        let held = hold.then_some(Held { view: 0.7, gain: 0.95, grey: Some(grey) });
        let j = joint();
        let start = about(&Point3::origin(), Vector3::new(0.05, -0.02, 0.03), Vector3::new(1.0, -0.5, 0.7));
        // On the grid itself visibility at the image's edge has a kink, and no derivative.
        let aside = Rigid::translation(0.05, -0.03, 0.04);
        let problem = PoseProblem {
            bodies: vec![Body { held, ..body(&a, start) }, Body { held, ..body(&b, aside) }],
            links: vec![
                Link { joint: &j, parent: End::Moving(0), child: End::Moving(1) },
                Link { joint: &j, parent: End::Held(start), child: End::Moving(1) },
                Link { joint: &j, parent: End::Moving(1), child: End::Held(start) },
            ],
            fraction: Some(&image),
            measure,
        };
        let x = DVector::from_vec(values) * scale;
        let (error, size) = gradient_error(&problem, &x);
        prop_assert!(error < 0.02 * size + 0.05, "error {error}, gradient {size}");
    }

    #[test]
    fn the_penalty_alone_has_the_right_gradient(values in prop::collection::vec(-3.0f64..3.0, 12)) {
        let image = fraction([20, 20, 20], 1.0, 0.0);
        let empty = Samples::default();
        let j = joint();
        let make = |base| Body { samples: &empty, base, centre: Point3::new(3.0, -2.0, 1.0), radius: 9.0, held: None, shape: None };
        let problem = PoseProblem {
            bodies: vec![make(Rigid::identity()), make(about(&Point3::origin(), Vector3::new(0.1, 0.2, -0.1), Vector3::zeros()))],
            links: vec![Link { joint: &j, parent: End::Moving(0), child: End::Moving(1) }],
            fraction: Some(&image),
            measure: Measure::Correlation,
        };
        let (error, size) = gradient_error(&problem, &DVector::from_vec(values));
        prop_assert!(error < 2e-3 * size + 1e-6, "error {error}, gradient {size}");
    }
}

#[test]
fn a_known_motion_is_recovered_under_gain_and_offset() {
    let truth = about(&Point3::new(0.0, 3.0, 0.0), Vector3::new(0.04, -0.06, 0.05), Vector3::new(1.2, -0.8, 0.9));
    let image = fraction([45, 45, 40], 0.8, 60.0);
    let samples = ball(Point3::origin(), &truth);
    let problem = || PoseProblem {
        bodies: vec![body(&samples, Rigid::identity())],
        links: Vec::new(),
        fraction: Some(&image),
        measure: Measure::Correlation,
    };
    let solution = solve(problem(), 1e-4, 100).unwrap();
    let found = problem().transforms(&solution.x)[0];
    let worst = samples.points.iter().map(|p| (found * p - truth * p).norm()).fold(0.0, f64::max);
    assert_eq!(solution.stop, Stop::Converged);
    assert!(solution.next.amax() < 1e-4);
    let early = solve(problem(), 1e-4, 1).unwrap();
    assert!(early.stop == Stop::IterationLimit(1) && early.next.amax() > 0.01, "{} {}", early.stop, early.next.amax());
    assert!(worst < 0.05, "worst point is off by {worst} mm");
    // Without free gain and offset the same image pulls it elsewhere.
    let squared = || PoseProblem { measure: Measure::SquaredDifference, ..problem() };
    let off = squared().transforms(&solve(squared(), 1e-4, 100).unwrap().x)[0];
    assert!(samples.points.iter().map(|p| (off * p - truth * p).norm()).fold(0.0, f64::max) > worst);
}

#[test]
fn leaving_the_field_of_view_never_pays() {
    let image = fraction([45, 45, 40], 1.0, 0.0);
    let samples = ball(Point3::origin(), &Rigid::identity());
    let cost = |shift: f64| {
        let t = Rigid::translation(shift, 0.0, 0.0);
        let p = PoseProblem {
            bodies: vec![body(&samples, t)],
            links: Vec::new(),
            fraction: Some(&image),
            measure: Measure::Correlation,
        };
        let e = &p.similarities(&[t], false)[0];
        (e.cost, e.visible)
    };
    let (inside, visible) = cost(0.0);
    assert!(visible > 0.999 && inside < 0.0);
    for shift in [33.0, 36.0, 41.0, 45.0, 60.0] {
        let (outside, visible) = cost(shift);
        assert!(visible < 0.9 && outside > inside, "shift {shift}: cost {outside}, inside {inside}");
    }
    assert_eq!(cost(200.0), (0.0, 0.0));
}

/// A bone that the image's edge cuts must neither move for more of it to come into view nor make up for a wrong place by a
/// gain of its own.
#[test]
fn what_is_held_buys_no_match() {
    let image = fraction([45, 45, 40], 1.1, -20.0);
    let mut samples = ball(Point3::new(35.0, 3.0, 2.0), &Rigid::identity());
    samples.values.iter_mut().enumerate().for_each(|(n, v)| *v += 25.0 * (n as f64 * n as f64 * 0.37).sin());
    let cost = |shift: f64, held: Option<Held>| {
        let t = Rigid::translation(shift, 0.0, 0.0);
        let p = PoseProblem {
            bodies: vec![Body { held, ..body(&samples, t) }],
            links: Vec::new(),
            fraction: Some(&image),
            measure: Measure::Correlation,
        };
        let e = p.similarities(&[t], false)[0].clone();
        (e.cost, e.visible, e.contrast[0] / e.contrast[1])
    };
    let (_, visible, gain) = cost(0.0, None);
    assert!((0.3..0.9).contains(&visible) && (gain - 1.0 / 1.1).abs() < 0.05, "{visible} {gain}");
    let held = Some(Held { view: visible, gain, grey: None });
    let best = |held| {
        let at = |n: i32| f64::from(n) * 0.1;
        (-20..=20).map(at).min_by(|a, b| cost(*a, held).0.total_cmp(&cost(*b, held).0)).unwrap()
    };
    assert!(best(held).abs() < 0.15 && best(None) < best(held), "held {}, free {}", best(held), best(None));
    let wrong = Some(Held { view: visible, gain: 1.5 * gain, grey: None });
    assert!(cost(0.0, wrong).0 > cost(0.0, held).0);
}

#[test]
fn a_bone_without_image_follows_its_joint() {
    let image = fraction([45, 45, 40], 1.0, 0.0);
    let truth = about(&Point3::origin(), Vector3::new(0.0, 0.0, 0.08), Vector3::new(1.0, 0.0, 0.5));
    let seen = ball(Point3::origin(), &truth);
    let hidden = ball(Point3::new(500.0, 0.0, 0.0), &truth);
    let j = Joint { axes: Matrix3::identity(), ..joint() };
    let problem = || PoseProblem {
        bodies: vec![body(&seen, Rigid::identity()), body(&hidden, Rigid::identity())],
        links: vec![Link { joint: &j, parent: End::Moving(0), child: End::Moving(1) }],
        fraction: Some(&image),
        measure: Measure::Correlation,
    };
    let t = problem().transforms(&solve(problem(), 1e-4, 100).unwrap().x);
    assert!((t[0].inverse() * t[1] * j.centre - j.centre).norm() < 1e-2);
    assert!((t[0].inverse() * t[1]).rotation.angle() < 1e-3);
    assert!(t[0].rotation.angle() > 0.07);
}

#[test]
fn degrees_and_millimetres_beyond_a_range_are_told_apart() {
    let of = |degrees: [f64; 3], shift: [f64; 3]| {
        let pose = JointPose { rotation: degrees.map(f64::to_radians), translation: shift };
        BeyondRange::of(&joint().excess(&pose))
    };
    assert!(!of([3.9, -4.9, 1.0], [-0.5, 1.0, 0.0]).any());
    assert_eq!(of([4.0, -7.5, 0.0], [0.0; 3]).to_string(), "2.5 degrees");
    assert_eq!(of([0.0; 3], [0.0, -3.1, 0.0]).to_string(), "2.1 mm");
    assert_eq!(of([-4.0, 0.0, 3.5], [4.5, 0.0, 0.0]).to_string(), "1.5 degrees and 4.0 mm");
}

#[test]
fn a_joint_just_beyond_its_range_does_not_read_as_if_it_were_inside() {
    let told = |rotation_deg, shift_mm| BeyondRange { rotation_deg, shift_mm }.to_string();
    assert_eq!(told(0.04, 0.0), "less than 0.1 degrees");
    assert_eq!(told(4.02, 0.049), "4.0 degrees and less than 0.1 mm");
    assert_eq!(told(0.05, 0.0), "0.1 degrees");
}
