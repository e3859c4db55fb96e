//! The table of scenes.

use aventail::geometry::Grid;
use aventail::pipeline::Case;
use aventail::volume::{Volume, trilinear};
use nalgebra::{Point3, Rotation3, Vector3};

/// How a scene must end.
#[derive(Debug, Clone, Copy)]
pub enum Expected {
    /// Refused with this exit code.
    Exit(u8),
    /// Refused by one of these codes.
    Refused(&'static [&'static str]),
    /// Done, with this warning.
    Warned(&'static str),
    /// Done, without a word about the inputs.
    Silent,
}

/// One scene.
pub struct Scene {
    pub name: &'static str,
    pub change: fn(&mut Case),
    pub expected: Expected,
}

const fn scene(name: &'static str, change: fn(&mut Case), expected: Expected) -> Scene {
    Scene { name, change, expected }
}

/// Warnings that speak of the inputs.
pub const OF_INPUTS: [&str; 8] = [
    "hu-doubtful",
    "label-doubtful",
    "label-on-wrong-side",
    "levels-shifted",
    "vertebra-missing",
    "side-unsure",
    "fraction-scaled",
    "weak-start",
];

use Expected::{Exit, Refused, Silent, Warned};

const OFF: Expected = Refused(&["labels-off-bone"]);
const NO_HU: Expected = Refused(&["not-in-hu"]);
const TURNED: Expected = Refused(&["fraction-mirrored", "fraction-turned", "bones-not-found"]);
const SCALED: Expected = Refused(&["fraction-scaled", "bones-not-found"]);

/// What planning CT, labels and fraction CT say by themselves.
pub const INPUTS: [Scene; 36] = [
    scene("as they are", |_| {}, Silent),
    scene("labels 12 mm to the left", |c| shift(c, [12.0, 0.0, 0.0]), OFF),
    scene("labels 15 mm to the back", |c| shift(c, [0.0, 15.0, 0.0]), OFF),
    scene("labels 12 mm too low", |c| shift(c, [0.0, 0.0, -12.0]), OFF),
    scene("labels 30 mm too high", |c| shift(c, [0.0, 0.0, 30.0]), OFF),
    scene("labels 30 mm aside", |c| shift(c, [30.0, 0.0, 0.0]), OFF),
    scene("labels reversed left to right", |c| reverse_labels(c, 0), Refused(&["labels-mirrored"])),
    scene("labels reversed front to back", |c| reverse_labels(c, 1), Refused(&["labels-mirrored"])),
    scene("labels reversed head to foot", |c| reverse_labels(c, 2), Refused(&["labels-mirrored"])),
    scene(
        "left and right exchanged in the names",
        |c| {
            let other = |n: &String| match (n.contains("_left"), n.contains("_right")) {
                (true, _) => n.replace("_left", "_right"),
                (_, true) => n.replace("_right", "_left"),
                _ => n.clone(),
            };
            c.planning_mut().bones.names.values_mut().for_each(|n| *n = other(n));
        },
        Refused(&["labels-mirrored"]),
    ),
    scene(
        "planning CT and labels mirrored alike",
        |c| {
            reverse_labels(c, 0);
            c.planning_mut().ct = reversed(&c.planning.ct, 0);
        },
        Refused(&["labels-mirrored"]),
    ),
    scene(
        "a level without a label",
        |c| c.planning_mut().bones.names.retain(|_, n| n != "vertebrae_C4"),
        Warned("vertebra-missing"),
    ),
    scene("vertebrae named a level too low", |c| rename(c, 1), Warned("levels-shifted")),
    scene("vertebrae named a level too high", |c| rename(c, -1), Warned("levels-shifted")),
    scene("labels of another patient", |c| other_size(c, 0.85), OFF),
    scene("labels without a voxel", |c| c.planning_mut().bones.volume = c.planning.bones.volume.map(|_| 0), Exit(4)),
    scene("labels of one voxel each", one_voxel, Warned("small-bone")),
    scene("300 labels", |c| more_labels(c, 300), Warned("labels-ignored")),
    scene("planning and fraction swapped", swap, OFF),
    scene("planning CT constant", |c| c.planning_mut().ct = c.planning.ct.map(|_| 40.0), Exit(4)),
    scene("fraction CT constant", |c| c.fraction.ct = c.fraction.ct.map(|_| 0.0), Exit(4)),
    scene("fraction CT with NaN", |c| c.fraction.ct.data_mut()[1000] = f32::NAN, Exit(4)),
    scene("planning CT + 1024", |c| c.planning_mut().ct = c.planning.ct.map(|v| v + 1024.0), NO_HU),
    scene("fraction CT + 1024", |c| c.fraction.ct = c.fraction.ct.map(|v| v + 1024.0), NO_HU),
    scene(
        "both CTs + 1024",
        |c| {
            c.planning_mut().ct = c.planning.ct.map(|v| v + 1024.0);
            c.fraction.ct = c.fraction.ct.map(|v| v + 1024.0);
        },
        NO_HU,
    ),
    scene("fraction CT inverted", |c| c.fraction.ct = c.fraction.ct.map(|v| -v), NO_HU),
    scene("fraction CT clipped at 0", |c| c.fraction.ct = c.fraction.ct.map(|v| v.max(0.0)), NO_HU),
    scene(
        "a dose for the fraction CT",
        |c| c.fraction.ct = c.fraction.ct.map(|v| (v + 1100.0).clamp(0.0, 2000.0) / 30.0),
        NO_HU,
    ),
    scene("labels for the fraction CT", |c| c.fraction.ct = c.planning.bones.volume.map(|v| f32::from(*v)), NO_HU),
    scene("fraction CT with slope 0.6", |c| c.fraction.ct = c.fraction.ct.map(|v| 0.6 * v), Warned("hu-doubtful")),
    scene(
        "planning CT with slope 0.6",
        |c| c.planning_mut().ct = c.planning.ct.map(|v| 0.6 * v),
        Warned("hu-doubtful"),
    ),
    scene("padding of -1024", |c| pad(c, -1024.0), Silent),
    scene("padding of -2000", |c| pad(c, -2000.0), Silent),
    scene("padding of -3024", |c| pad(c, -3024.0), Silent),
    scene("padding of -32768", |c| pad(c, -32768.0), Silent),
    scene("padding of 0", |c| pad(c, 0.0), Silent),
];

/// What the fit finds of the phantom's head and neck.
pub const NECK: [Scene; 5] = [
    scene("as it is", |_| {}, Silent),
    scene("slices 5 % too thick", |c| stretch(c, 2, 1.05), Warned("fraction-scaled")),
    scene("left to right", |c| c.fraction.ct = reversed(&c.fraction.ct, 0), TURNED),
    scene("front to back", |c| c.fraction.ct = reversed(&c.fraction.ct, 1), TURNED),
    scene("turned by 180 degrees", |c| turn(c, 180.0), TURNED),
];

/// What the fit finds of a real patient; what the phantom shows alike stands with it, and real_cases.rs has him as he is.
pub const FRACTION: [Scene; 3] = [
    scene("a metre away", |c| away(c, 1000.0), Silent),
    scene("slices 10 % too thin", |c| stretch(c, 2, 0.9), SCALED),
    scene("10 % too wide", |c| stretch(c, 0, 1.1), SCALED),
];

/// Voxels in reverse order along an axis, under the same header.
fn reversed<T: Copy + Default + Send + Sync>(image: &Volume<T>, axis: usize) -> Volume<T> {
    let grid = image.grid();
    Volume::from_fn(grid.clone(), |n| {
        let mut at = grid.voxel(n);
        at[axis] = grid.size()[axis] - 1 - at[axis];
        *image.at(at)
    })
}

fn reverse_labels(case: &mut Case, axis: usize) {
    case.planning_mut().bones.volume = reversed(&case.planning.bones.volume, axis);
}

/// Vertebrae under the name of the level so far below; who has no such name loses his.
fn rename(case: &mut Case, by: isize) {
    let levels: Vec<String> = [("C", 7), ("T", 12), ("L", 5)]
        .into_iter()
        .flat_map(|(part, count)| (1..=count).map(move |n| format!("vertebrae_{part}{n}")))
        .collect();
    let renamed = |name: &String| match levels.iter().position(|l| l == name) {
        Some(n) => n.checked_add_signed(by).and_then(|n| levels.get(n)).cloned(),
        None => Some(name.clone()),
    };
    case.planning_mut().bones.names =
        case.planning.bones.names.iter().filter_map(|(label, name)| Some((*label, renamed(name)?))).collect();
}

/// Labels as a patient of another size has them, about the middle of the scan.
fn other_size(case: &mut Case, factor: f64) {
    let labels = &case.planning.bones.volume;
    let grid = labels.grid();
    let middle = grid.middle();
    case.planning_mut().bones.volume = Volume::from_fn(grid.clone(), |n| {
        let from = middle + (grid.centre(grid.voxel(n)) - middle) / factor;
        grid.voxel_at(&from).map_or(0, |voxel| *labels.at(voxel))
    });
}

/// Of each bone the voxel in the middle of its list.
pub fn one_voxel(case: &mut Case) {
    let all: Vec<u16> = case.planning.bones.names.keys().copied().collect();
    let labels = &mut case.planning_mut().bones.volume;
    for label in all {
        let own: Vec<usize> = labels.data().iter().enumerate().filter(|(_, l)| **l == label).map(|(n, _)| n).collect();
        let keep = own.get(own.len() / 2).copied();
        own.into_iter().filter(|n| Some(*n) != keep).for_each(|n| labels.data_mut()[n] = 0);
    }
}

/// Labels that are no bones in a row of voxels, up to this number of labels.
pub fn more_labels(case: &mut Case, count: u16) {
    let first = case.planning.bones.names.keys().max().map_or(1, |l| l + 1);
    let free: Vec<usize> =
        case.planning.bones.volume.data().iter().enumerate().filter(|(_, l)| **l == 0).map(|(n, _)| n).collect();
    for (label, chunk) in (first..=count).zip(free.chunks(40).skip(1000)) {
        case.planning_mut().bones.names.insert(label, format!("structure_{label}"));
        chunk.iter().for_each(|&n| case.planning_mut().bones.volume.data_mut()[n] = label);
    }
}

/// Either CT in the other's place, on the planning grid.
fn swap(case: &mut Case) {
    let grid = case.planning.ct.grid().clone();
    let fraction = &case.fraction.ct;
    let on = Volume::from_fn(grid.clone(), |n| {
        let index = fraction.grid().index(&grid.centre(grid.voxel(n)));
        trilinear(fraction, &index).map_or(-1000.0, |v| v as f32)
    });
    case.fraction.ct = std::mem::replace(&mut case.planning_mut().ct, on);
}

/// Labels moved by whole voxels that come nearest to this, LPS mm.
fn shift(case: &mut Case, mm: [f64; 3]) {
    let labels = &case.planning.bones.volume;
    let grid = labels.grid();
    let step = grid.index(&Point3::from(grid.origin().coords + Vector3::from(mm))).map(|v| v.round() as i64);
    case.planning_mut().bones.volume = Volume::from_fn(grid.clone(), |n| {
        let from: [i64; 3] = std::array::from_fn(|a| grid.voxel(n)[a] as i64 - step[a]);
        let inside = (0..3).all(|a| from[a] >= 0 && from[a] < grid.size()[a] as i64);
        if inside { *labels.at(from.map(|v| v as usize)) } else { 0 }
    });
}

/// Both CTs with this value in place of air.
fn pad(case: &mut Case, value: f32) {
    let padded = |v: &f32| if *v < -900.0 { value } else { *v };
    // A third of the air stays: no scanner's circle ends at the skin.
    let part = |image: &Volume<f32>| {
        let all = image.map(padded);
        let size = image.grid().size();
        Volume::from_fn(image.grid().clone(), |n| {
            let [i, ..] = image.grid().voxel(n);
            if 6 * i > 5 * size[0] || 6 * i < size[0] { all.data()[n] } else { image.data()[n] }
        })
    };
    case.planning_mut().ct = part(&case.planning.ct);
    case.fraction.ct = part(&case.fraction.ct);
}

/// The fraction under another header.
pub fn under(case: &mut Case, grid: Grid) {
    case.fraction.ct = Volume::new(grid, case.fraction.ct.data().to_vec()).expect("as many voxels");
}

fn stretch(case: &mut Case, axis: usize, factor: f64) {
    let grid = case.fraction.ct.grid();
    let mut spacing = grid.spacing();
    spacing[axis] *= factor;
    let grid = Grid::new(grid.size(), spacing, grid.origin(), *grid.direction()).expect("a legal grid");
    under(case, grid);
}

fn away(case: &mut Case, mm: f64) {
    let grid = case.fraction.ct.grid();
    let origin = grid.origin() + Vector3::new(mm, -0.3 * mm, 0.2 * mm);
    let grid = Grid::new(grid.size(), grid.spacing(), origin, *grid.direction()).expect("a legal grid");
    under(case, grid);
}

/// Turned about the long axis through its middle.
fn turn(case: &mut Case, degrees: f64) {
    let grid = case.fraction.ct.grid();
    let q = Rotation3::from_axis_angle(&Vector3::z_axis(), degrees.to_radians());
    let middle = grid.middle();
    let origin = middle + q * (grid.origin() - middle);
    let grid = Grid::new(grid.size(), grid.spacing(), origin, q.into_inner() * grid.direction()).expect("a legal grid");
    under(case, grid);
}
