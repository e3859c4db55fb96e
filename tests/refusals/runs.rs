//! Registrations of a changed phantom, whose truth is known: what they may be off, and what their map of uncertainty must own
//! up to.

use super::scenes::{more_labels, one_voxel, under};
use aventail::geometry::Grid;
use aventail::pipeline::Case;
use aventail::volume::Volume;
use nalgebra::{Point3, Vector3};

/// How a run must end.
#[derive(Debug, Clone, Copy)]
pub enum End {
    /// Refused by one of these codes.
    Refused(&'static [&'static str]),
    /// Done.
    Done {
        /// Greatest mean error, mm.
        mean_mm: f64,
        /// Most points that may be off by more than the map says, percent.
        beyond_percent: f64,
        /// A warning that must be there; none where it is empty.
        warned: &'static str,
    },
}

/// One run.
pub struct Run {
    pub name: &'static str,
    pub change: fn(&mut Case),
    /// What the change adds to every true motion, mm.
    pub moved: [f64; 3],
    pub end: End,
}

const fn run(name: &'static str, change: fn(&mut Case), moved: [f64; 3], end: End) -> Run {
    Run { name, change, moved, end }
}

const fn done(mean_mm: f64, beyond_percent: f64, warned: &'static str) -> End {
    End::Done { mean_mm, beyond_percent, warned }
}

const HERE: [f64; 3] = [0.0; 3];
const ASIDE: [f64; 3] = [30.0, -20.0, 45.0];

/// At most 3 % of the points may be off by more than the map says.
pub const RUNS: [Run; 8] = [
    run("as it is", |_| {}, HERE, done(1.0, 3.0, "")),
    // It was taken for the levels above, 19 mm off and without a word.
    run("slab of 54 mm, origin elsewhere", |c| slab(c, -100.0, 54.0, ASIDE), ASIDE, done(1.5, 3.0, "")),
    run("slab of 36 mm, origin elsewhere", |c| slab(c, -60.0, 36.0, ASIDE), ASIDE, done(1.5, 3.0, "level-unsure")),
    run("slab of 20 mm, origin elsewhere", |c| slab(c, -60.0, 20.0, ASIDE), ASIDE, done(1.5, 3.0, "level-unsure")),
    run("noise of 100 HU", |c| noise(c, 100.0), HERE, done(1.2, 3.0, "")),
    run("metal in the jaw", metal, HERE, done(1.2, 3.0, "")),
    run("300 labels", |c| more_labels(c, 300), HERE, done(1.0, 3.0, "labels-ignored")),
    run("labels of one voxel each", one_voxel, HERE, End::Refused(&["bones-not-found"])),
];

/// What is left of the fraction between two heights (mm above the skull's joint), under a header that is `aside`.
fn slab(case: &mut Case, low: f64, height: f64, aside: [f64; 3]) {
    let grid = case.fraction.ct.grid();
    let first = grid.index(&Point3::new(0.0, 0.0, low)).z.round().max(0.0) as usize;
    let count = (height / grid.spacing()[2]).round() as usize;
    let [nx, ny, _] = grid.size();
    let origin = grid.centre([0, 0, first]) + Vector3::from(aside);
    let thin = Grid::new([nx, ny, count], grid.spacing(), origin, *grid.direction()).expect("a legal grid");
    let part = Volume::from_fn(thin.clone(), |n| {
        let [i, j, k] = thin.voxel(n);
        *case.fraction.ct.at([i, j, k + first])
    });
    case.fraction.ct = part;
    under(case, thin);
}

/// Noise without correlation of this standard deviation, HU.
fn noise(case: &mut Case, hu: f32) {
    // A sum of 12 equal numbers between 0 and 1 is as good as normal.
    let at = |n: usize| {
        let mut state = (n as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x5851_f42d_4c95_7f2d;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        (0..12).map(|_| next()).sum::<f32>() - 6.0
    };
    let image = &case.fraction.ct;
    case.fraction.ct = Volume::from_fn(image.grid().clone(), |n| image.data()[n] + hu * at(n));
}

/// Fillings on both sides of the jaw, with streaks in their slices.
fn metal(case: &mut Case) {
    let image = &case.fraction.ct;
    let grid = image.grid();
    let balls = [25.0, -25.0].map(|x| Point3::new(x, -70.0, -45.0));
    case.fraction.ct = Volume::from_fn(grid.clone(), |n| {
        let at = grid.centre(grid.voxel(n));
        let mut value = f64::from(image.data()[n]);
        for ball in &balls {
            let away = at - ball;
            if away.norm() < 9.0 {
                return 3071.0;
            }
            if away.z.abs() < 12.0 && value > -900.0 {
                value += 500.0 * (7.0 * away.y.atan2(away.x)).sin() * (-away.xy().norm() / 50.0).exp();
            }
        }
        value as f32
    });
}
