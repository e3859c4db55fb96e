use super::*;
use crate::geometry::{Grid, about};
use crate::volume::Volume;

/// Tissue that varies over a few centimetres, HU.
fn tissue(p: &Point3<f64>) -> f64 {
    let wave = |x: f64, y: f64, width: f64| (x / width).sin() * (y / width + 0.4).cos();
    150.0 + 180.0 * wave(p.x, p.y, 6.0) + 150.0 * wave(p.y + 3.0, p.z, 7.0) + 120.0 * wave(p.z, p.x - 5.0, 5.0)
}

fn image(spacing: f64, value: impl Fn(&Point3<f64>) -> f64 + Sync) -> Volume<f32> {
    let n = (120.0 / spacing) as usize;
    let grid = Grid::axis_aligned([n; 3], [spacing; 3], [-60.0; 3]).unwrap();
    Volume::from_fn(grid.clone(), |l| value(&grid.centre(grid.voxel(l))) as f32)
}

/// A ball of samples about the middle.
fn samples() -> Samples {
    let steps = -4..=4;
    let all = steps.clone().flat_map(|i| steps.clone().flat_map(move |j| (-4..=4).map(move |k| [i, j, k])));
    let points = all.map(|v: [i32; 3]| Point3::from(Vector3::from(v.map(f64::from)) * 5.0));
    let points: Vec<Point3<f64>> = points.filter(|p| p.coords.norm() <= 20.0).collect();
    let values = points.iter().map(tissue).collect();
    Samples { points, values, memberships: Vec::new(), volume_mm3: 30_000.0 }
}

struct Scene {
    planning: Undescribed,
    fraction: Volume<f32>,
}

/// Planning's tissue moved by `motion` in a fraction where bright and dark are exchanged.
fn scene(motion: &Rigid) -> Scene {
    let planning = image(2.0, tissue);
    let back = motion.inverse();
    let fraction = image(4.0, |p| 300.0 - 0.6 * tissue(&(back * p)));
    Scene { planning: Undescribed::new(&planning, &Coarse::new(&planning)), fraction }
}

impl Scene {
    fn shapes(&self) -> Shapes<'_> {
        Shapes::new(Coarse::new(&self.fraction), &self.planning, &[samples()])
    }
}

fn cost(shape: &Shape<'_>, t: &Rigid) -> Evaluation {
    let mut found = Evaluation::nothing();
    shape.add(&mut found, t, &(t * Point3::origin()), None, true);
    found
}

#[test]
fn exchanged_grey_values_have_the_same_descriptors() {
    let [a, b] = [image(4.0, tissue), image(4.0, |p| 400.0 - 0.7 * tissue(p))];
    let seen = vec![true; a.data().len()];
    let [a, b] = [a, b].map(|value| Described::new(&Coarse { value, seen: seen.clone() }));
    assert!(a.is == b.is && a.is.iter().filter(|is| **is).count() > 20_000);
    let apart = a.each.iter().flatten().zip(b.each.iter().flatten()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(apart < 1e-3, "{apart}");
}

#[test]
fn the_right_place_costs_least_however_far_it_is_turned() {
    for degrees in [0.0f64, 20.0, 40.0] {
        let turn = Vector3::new(0.6, -0.5, 0.62).normalize() * degrees.to_radians();
        let motion = about(&Point3::origin(), turn, Vector3::new(3.0, -2.0, 1.0));
        let scene = scene(&motion);
        let shapes = scene.shapes();
        let shape = shapes.of(0, &motion.rotation);
        let right = cost(&shape, &motion).cost;
        for axis in 0..3 {
            for away in [-6.0, 6.0] {
                let moved = Rigid::from(nalgebra::Translation3::from(Vector3::ith(axis, away))) * motion;
                let wrong = cost(&shape, &moved).cost;
                assert!(right < 1.5 * wrong && right < -20.0, "{degrees} degrees, {axis}: {right} {wrong}");
            }
        }
        // As if the bone were not turned, its surroundings are others.
        if degrees > 30.0 {
            assert!(right < 1.5 * cost(&shapes.of(0, &UnitQuaternion::identity()), &motion).cost);
        }
    }
}

#[test]
fn gradient_matches_central_differences() {
    let scene = scene(&Rigid::translation(2.0, -1.0, 1.5));
    let shapes = scene.shapes();
    let shape = shapes.of(0, &UnitQuaternion::identity());
    let at = |turn: Vector3<f64>, shift: Vector3<f64>| about(&Point3::origin(), turn, shift);
    let start = [Vector3::new(0.03, -0.02, 0.01), Vector3::new(0.7, 0.4, -0.3)];
    let here = cost(&shape, &at(start[0], start[1]));
    let moved = |n: usize, step: f64| {
        let own = Vector3::ith(n % 3, step);
        let t = at(start[0], start[1]);
        let centre = t * Point3::origin();
        let none = Vector3::zeros();
        let small = if n < 3 { about(&centre, own, none) } else { about(&centre, none, own) };
        let mut found = Evaluation::nothing();
        shape.add(&mut found, &(small * t), &centre, None, false);
        found.cost
    };
    for n in 0..6 {
        let step = if n < 3 { 1e-4 } else { 1e-3 };
        let numeric = (moved(n, step) - moved(n, -step)) / (2.0 * step);
        let size = if n < 3 { 20.0 } else { 1.0 };
        let analytic = here.gradient[n];
        assert!((numeric - analytic).abs() < 0.02 * analytic.abs() + 0.02 * size, "{n}: {numeric} {analytic}");
    }
    assert!(here.curvature.symmetric_eigenvalues().min() > -1e-6);
}

#[test]
fn too_little_in_view_says_nothing() {
    let scene = scene(&Rigid::identity());
    let shapes = scene.shapes();
    let away = Rigid::translation(70.0, 0.0, 0.0);
    let found = cost(&shapes.of(0, &UnitQuaternion::identity()), &away);
    assert!(found.cost == 0.0 && found.gradient.norm() == 0.0);
}
