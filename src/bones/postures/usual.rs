//! How much postures usually vary from one fraction to the next, with sources.
//!
//! Literature tells how far bones are displaced in masks, seldom by how many degrees joints move. The angles here are
//! chosen so that the displacements come out (`tests`), and are marked as chosen.

use super::plan::{Mode, PosturePlan};
use crate::skeleton::Skeleton;
use crate::skeleton::anatomy::{Kind, SKULL};

/// Level of the seventh cervical vertebra, the lowest of the neck.
const C7: u8 = 19;

/// Standard deviations of one part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sd {
    /// Flexion, lateral bending, axial turn, degrees.
    pub rotation_deg: [f64; 3],
    /// Along the same axes, mm.
    pub shift_mm: [f64; 3],
}

/// Where a default comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Source {
    /// What varies.
    pub part: &'static str,
    /// Whose measurement it follows, and what of it is chosen.
    pub source: &'static str,
}

/// Where the defaults come from, part by part.
pub fn sources() -> &'static [Source] {
    &SOURCES
}

const SOURCES: [Source; 7] = [
    Source {
        part: "couch",
        source: "shift: residual after offline correction, systematic 1.2 and random 1.5 mm (van Kranen S et al., Int J Radiat Oncol \
                 Biol Phys 73 (2009) 1566); yaw: systematic 0.43 and random 0.62 degrees (J Radiother Pract 17 (2018) 104); pitch and \
                 roll chosen alike",
    },
    Source {
        part: "neck",
        source: "angles chosen so that the skull is displaced against C4 to C6 as far as measured, 4.7 +- 2.5 mm, mostly by nodding \
                 (Polat B et al., Strahlenther Onkol 183 (2007) 506); shared by the levels' ranges of motion (White AA, Panjabi MM \
                 1990); each level's rest chosen",
    },
    Source { part: "back", source: "chosen: the couch and the headrest hold it" },
    Source {
        part: "mandible",
        source: "chosen; with the skull's motion it is displaced against C4 to C6 by 3 to 4 mm (Polat 2007 measured 4.4 +- 2.5 mm)",
    },
    Source {
        part: "hyoid",
        source: "that of the thyroid cartilage between fractions, systematic and random together 1.4, 0.9, 1.8 mm (Radiat Oncol 16 (2021), \
                 doi 10.1186/s13014-021-01833-2); rotation chosen",
    },
    Source {
        part: "shoulders",
        source: "angles of the clavicle chosen for displacements of 3.5 mm up or down and 4.2 mm forwards or back on the mean (Neubauer E et \
                 al., Radiat Oncol 7 (2012) 19); half of the variance common to both sides: chosen",
    },
    Source { part: "arms, sternum", source: "chosen" },
];

/// The couch; where this and the others come from: [`SOURCES`].
const COUCH: Sd = Sd { rotation_deg: [0.75; 3], shift_mm: [1.9; 3] };
/// The whole neck; its levels share it.
/// On a real neck the skull then varies against C4 to C6 by 4.8 +- 2.7 mm; measured are 4.7 +- 2.5 (Polat 2007).
const NECK: [f64; 3] = [4.2, 2.0, 2.5];
/// Each level of the neck beside its share, degrees.
const NECK_REST: f64 = 0.25;
/// The whole back.
const BACK: [f64; 3] = [0.8, 0.4, 0.4];
/// Names of the axes in modes.
const AXES: [&str; 3] = ["flexion", "lateral", "axial"];
/// Elevation and turn of both shoulders, and the same of each by itself, degrees.
const SHOULDER: [f64; 2] = [1.2, 1.4];

/// Standard deviations of a joint by itself.
fn own(kind: Kind) -> Sd {
    let sd = |rotation_deg, shift_mm| Sd { rotation_deg, shift_mm };
    match kind {
        Kind::Spine(level) if level >= C7 => sd([NECK_REST; 3], [0.0; 3]),
        Kind::Mandible => sd([2.0, 0.5, 0.5], [0.4, 0.8, 0.4]),
        Kind::Hyoid => sd([2.0, 1.0, 1.0], [1.4, 0.9, 1.8]),
        Kind::Sternum => sd([0.3, 0.2, 0.2], [0.2, 0.8, 0.5]),
        Kind::Clavicle(_) => sd([0.0, SHOULDER[0], SHOULDER[1]], [0.0; 3]),
        Kind::Scapula(_) => sd([0.5; 3], [0.5; 3]),
        Kind::Humerus(_) => sd([1.5; 3], [0.0; 3]),
        _ => sd([0.0; 3], [0.0; 3]),
    }
}

/// Positions of the bones of the neck: skull and cervical vertebrae that hang on another bone of the axis.
pub fn neck(skeleton: &Skeleton) -> Vec<usize> {
    along(skeleton, C7..=SKULL)
}

/// Positions of the bones of these levels that hang on another bone of the axis.
fn along(skeleton: &Skeleton, levels: std::ops::RangeInclusive<u8>) -> Vec<usize> {
    let level = |n: usize| match Kind::of(&skeleton.bones[n].name) {
        Some(Kind::Spine(level)) => Some(level),
        _ => None,
    };
    let hangs = |n: usize| skeleton.bones[n].parent.and_then(level).is_some();
    (0..skeleton.bones.len()).filter(|&n| level(n).is_some_and(|l| levels.contains(&l)) && hangs(n)).collect()
}

impl PosturePlan {
    /// The usual variation between fractions, of the bones that the skeleton has; see [`sources`].
    pub fn usual(skeleton: &Skeleton) -> Self {
        let mut plan = Self::still(skeleton);
        plan.bend(skeleton, "neck", NECK);
        plan.bend(skeleton, "back", BACK);
        plan.shoulders(skeleton);
        for (bone, spread) in skeleton.bones.iter().zip(&mut plan.joints) {
            let sd = match (bone.parent, Kind::of(&bone.name)) {
                (None, _) => COUCH,
                (Some(_), Some(kind)) => own(kind),
                (Some(_), None) => continue,
            };
            let ([a, b, c], [x, y, z]) = (sd.rotation_deg, sd.shift_mm);
            spread.sd = [a, b, c, x, y, z];
            if bone.name == "mandible" {
                // A closed mouth does not close further.
                spread.range[0] = [spread.range[0][0].max(-1.0), spread.range[0][1].min(8.0)];
            }
        }
        plan
    }

    /// Puts modes of the whole neck or back in place of those there are: `sd` degrees about each axis, shared by the levels
    /// in proportion to their ranges. Nothing where it has no joint.
    pub fn bend(&mut self, skeleton: &Skeleton, part: &str, sd: [f64; 3]) {
        let bones = if part == "neck" { neck(skeleton) } else { along(skeleton, 1..=C7 - 1) };
        for (a, axis) in AXES.into_iter().enumerate() {
            let name = format!("{part} {axis}");
            self.modes.retain(|m| m.name != name);
            let width = |n: &usize| {
                let [low, high] = skeleton.bones[*n].joint.rotation_range_deg[a];
                high - low
            };
            let whole: f64 = bones.iter().map(width).sum();
            if whole > 0.0 && sd[a] > 0.0 {
                let mut values = vec![[0.0; 6]; skeleton.bones.len()];
                bones.iter().for_each(|n| values[*n][a] = sd[a] * width(n) / whole);
                self.modes.push(Mode { name, values });
            }
        }
    }

    /// Both shoulders up or down, and forwards or back.
    fn shoulders(&mut self, skeleton: &Skeleton) {
        let at = |name: &str| skeleton.bones.iter().position(|b| b.name == name && b.parent.is_some());
        let [Some(left), Some(right)] = ["clavicula_left", "clavicula_right"].map(at) else { return };
        for (name, axis, sd) in [("shoulders up", 1, SHOULDER[0]), ("shoulders back", 2, SHOULDER[1])] {
            // Mirrored sides turn against each other.
            let mut values = vec![[0.0; 6]; skeleton.bones.len()];
            (values[left][axis], values[right][axis]) = (-sd, sd);
            self.modes.push(Mode { name: name.into(), values });
        }
    }
}
