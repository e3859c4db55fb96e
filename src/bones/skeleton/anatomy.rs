//! What is known of human joints: which bone hangs on which, and how far they move.
//!
//! Bones are TotalSegmentator v2's, with mandible, hyoid, radius and ulna. All ranges are soft limits relative to
//! the planning posture, which is taken for neutral: where a source gives one range from end to end, half of it
//! goes to either side. Where planning may be far from neutral (arms up or down), the range is symmetric.

/// Body side.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Side {
    /// The patient's left, +x in LPS.
    Left,
    /// The patient's right, -x in LPS.
    Right,
}

impl Side {
    /// `left` or `right`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
        }
    }
}

/// Which bone a bone is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// A bone of the axis, by its level from below: [`SACRUM`], [`S1`], L5 to L1, T12 to T1, C7 to C1, [`SKULL`].
    Spine(u8),
    /// The jaw.
    Mandible,
    /// The hyoid, which muscles and ligaments suspend.
    Hyoid,
    /// The sternum.
    Sternum,
    /// A rib, 1 to 12.
    Rib(Side, u8),
    /// A clavicle.
    Clavicle(Side),
    /// A scapula.
    Scapula(Side),
    /// An upper arm.
    Humerus(Side),
    /// The forearm's inner bone.
    Ulna(Side),
    /// The forearm's outer bone.
    Radius(Side),
    /// A hip bone.
    Hip(Side),
    /// A thigh.
    Femur(Side),
}

/// Level of the sacrum.
pub const SACRUM: u8 = 0;
/// Level of the first sacral vertebra, which is one with the sacrum.
pub const S1: u8 = 1;
/// Level of the first thoracic vertebra.
pub const T1: u8 = 18;
/// Level of the third cervical vertebra.
pub const C3: u8 = 23;
/// Level of the axis.
pub const C2: u8 = 24;
/// Level of the atlas.
pub const C1: u8 = 25;
/// Level of the skull.
pub const SKULL: u8 = 26;

/// Whether a bone of this name is of the spine, the skull on it.
pub fn is_of_spine(name: &str) -> bool {
    matches!(Kind::of(name), Some(Kind::Spine(_)))
}

/// Labels of the bones (label and name) of the spine.
pub fn labels_of_spine(bones: &[(u16, String)]) -> Vec<u16> {
    bones.iter().filter(|(_, name)| is_of_spine(name)).map(|(label, _)| *label).collect()
}

impl Kind {
    /// The bone of a TotalSegmentator name; `None` for anything that is not a bone of the skeleton.
    pub fn of(name: &str) -> Option<Self> {
        let spine = |s: &str| (0..=SKULL).find(|&level| level_name(level) == s);
        if let Some(level) = spine(name.strip_prefix("vertebrae_").unwrap_or(name)) {
            return Some(Self::Spine(level)).filter(|_| name.starts_with("vertebrae_") == (S1..SKULL).contains(&level));
        }
        match name {
            "mandible" => return Some(Self::Mandible),
            "hyoid" => return Some(Self::Hyoid),
            "sternum" => return Some(Self::Sternum),
            _ => {}
        }
        let (bone, rest) = name.split_once('_')?;
        let (side, number) = rest.split_once('_').map_or((rest, None), |(s, n)| (s, Some(n)));
        let side = [Side::Left, Side::Right].into_iter().find(|s| s.name() == side)?;
        match (bone, number) {
            ("rib", Some(n)) => (1..=12).find(|m| m.to_string() == n).map(|m| Self::Rib(side, m)),
            ("clavicula", None) => Some(Self::Clavicle(side)),
            ("scapula", None) => Some(Self::Scapula(side)),
            ("humerus", None) => Some(Self::Humerus(side)),
            ("ulna", None) => Some(Self::Ulna(side)),
            ("radius", None) => Some(Self::Radius(side)),
            ("hip", None) => Some(Self::Hip(side)),
            ("femur", None) => Some(Self::Femur(side)),
            _ => None,
        }
    }

    /// Names of all bones of the skeleton.
    pub fn names() -> Vec<String> {
        let spine = (0..=SKULL).map(|level| match level {
            SACRUM | SKULL => level_name(level),
            _ => format!("vertebrae_{}", level_name(level)),
        });
        let middle = ["mandible", "hyoid", "sternum"].map(str::to_owned);
        let sided = [Side::Left, Side::Right].into_iter().flat_map(|s| {
            let paired = ["clavicula", "scapula", "humerus", "ulna", "radius", "hip", "femur"];
            let ribs = (1..=12).map(move |n| format!("rib_{}_{n}", s.name()));
            paired.into_iter().map(move |bone| format!("{bone}_{}", s.name())).chain(ribs)
        });
        spine.chain(middle).chain(sided).collect()
    }

    /// The bone that carries this one in a complete body, counted outwards from the sacrum.
    ///
    /// The sternum hangs on T1: the first ribs are its shortest and stiffest link to the spine.
    pub fn carrier(self) -> Option<Self> {
        match self {
            Self::Spine(level) => level.checked_sub(1).map(Self::Spine),
            Self::Mandible => Some(Self::Spine(SKULL)),
            Self::Hyoid => Some(Self::Spine(C3)),
            Self::Sternum => Some(Self::Spine(T1)),
            Self::Rib(_, n) => Some(Self::Spine(T1 + 1 - n)),
            Self::Clavicle(_) => Some(Self::Sternum),
            Self::Scapula(s) => Some(Self::Clavicle(s)),
            Self::Humerus(s) => Some(Self::Scapula(s)),
            Self::Ulna(s) | Self::Radius(s) => Some(Self::Humerus(s)),
            Self::Hip(_) => Some(Self::Spine(SACRUM)),
            Self::Femur(s) => Some(Self::Hip(s)),
        }
    }

    /// Name of the joint between this bone and the one that carries it here.
    pub fn joint_name(self, parent: Self) -> String {
        let side = |joint: &str, s: Side| format!("{joint}_{}", s.name());
        match (self, parent) {
            (Self::Spine(SKULL), Self::Spine(C1)) => "atlanto-occipital".into(),
            (Self::Spine(C1), Self::Spine(C2)) => "atlanto-axial".into(),
            (Self::Spine(child), Self::Spine(parent)) => format!("{}-{}", level_name(child), level_name(parent)),
            (Self::Mandible, _) => "temporomandibular".into(),
            (Self::Hyoid, _) => "hyoid_suspension".into(),
            (Self::Sternum, _) => "sternum_suspension".into(),
            (Self::Rib(s, n), _) => format!("costovertebral_{}_{n}", s.name()),
            (Self::Clavicle(s), Self::Sternum) => side("sternoclavicular", s),
            (Self::Clavicle(s), _) => side("shoulder_girdle", s),
            (Self::Scapula(s), Self::Clavicle(_)) => side("acromioclavicular", s),
            (Self::Scapula(s), _) => side("scapulothoracic", s),
            (Self::Humerus(s), _) => side("glenohumeral", s),
            (Self::Ulna(s), _) => side("humeroulnar", s),
            (Self::Radius(s), _) => side("humeroradial", s),
            (Self::Hip(s), _) => side("sacroiliac", s),
            (Self::Femur(s), _) => side("hip", s),
            (Self::Spine(level), _) => format!("{}-joint", level_name(level)),
        }
    }
}

/// Short name of a level of the axis, for example `C7`.
pub fn level_name(level: u8) -> String {
    match level {
        SACRUM => "sacrum".into(),
        S1 => "S1".into(),
        2..=6 => format!("L{}", 7 - level),
        7..=18 => format!("T{}", 19 - level),
        19..=25 => format!("C{}", 26 - level),
        _ => "skull".into(),
    }
}

/// How far a joint moves.
#[derive(Debug, Clone, PartialEq)]
pub struct Ranges {
    /// Flexion (positive bends the upper or distal part forwards and down), lateral bending, axial rotation;
    /// degrees, least and greatest.
    pub rotation_deg: [[f64; 2]; 3],
    /// Shift along the same axes (right-left, front-back, up-down), plus or minus mm.
    pub translation_mm: [f64; 3],
    /// Where the numbers come from.
    pub source: String,
}

/// Ranges of the root, which the couch and the scanner move: no limit that matters.
pub fn unlimited() -> Ranges {
    Ranges { rotation_deg: [[-180.0, 180.0]; 3], translation_mm: [10_000.0; 3], source: "root: free".into() }
}

const WHITE_PANJABI: &str =
    "White AA, Panjabi MM. Clinical Biomechanics of the Spine, 2nd ed., Lippincott 1990, Tab. 2-5; shift: ch. 2 and 5";

/// Representative ranges of motion of the joint below each level, from S1 up to the skull, degrees: flexion and
/// extension together, lateral bending to one side, axial rotation to one side (White & Panjabi 1990, Tab. 2-5).
const SPINE: [[f64; 3]; 26] = [
    [0.0, 0.0, 0.0],   // S1 on the sacrum: fused
    [17.0, 3.0, 1.0],  // L5
    [16.0, 6.0, 2.0],  // L4
    [15.0, 8.0, 2.0],  // L3
    [14.0, 6.0, 2.0],  // L2
    [12.0, 6.0, 2.0],  // L1
    [12.0, 8.0, 2.0],  // T12
    [12.0, 9.0, 2.0],  // T11
    [9.0, 7.0, 2.0],   // T10
    [6.0, 6.0, 4.0],   // T9
    [6.0, 6.0, 6.0],   // T8
    [6.0, 6.0, 7.0],   // T7
    [5.0, 6.0, 7.0],   // T6
    [4.0, 6.0, 8.0],   // T5
    [4.0, 6.0, 8.0],   // T4
    [4.0, 5.0, 8.0],   // T3
    [4.0, 6.0, 8.0],   // T2
    [4.0, 5.0, 9.0],   // T1
    [9.0, 4.0, 2.0],   // C7
    [17.0, 7.0, 6.0],  // C6
    [20.0, 8.0, 7.0],  // C5
    [20.0, 11.0, 7.0], // C4
    [15.0, 11.0, 7.0], // C3
    [10.0, 10.0, 3.0], // C2
    [20.0, 5.0, 40.0], // C1
    [25.0, 5.0, 5.0],  // skull
];

/// Shift of a spinal joint, mm: sagittal translation up to 2.7 mm in the neck and 3 mm in the loins, 1 mm between
/// skull and atlas, up to 3 mm between atlas and dens.
fn spine_shift(level: u8) -> [f64; 3] {
    match level {
        SACRUM | S1 => [0.0; 3],
        2..=7 => [1.0, 3.0, 1.0],
        8..=18 => [1.0, 2.0, 1.0],
        C1 => [1.0, 3.0, 1.0],
        SKULL => [1.0; 3],
        _ => [1.0, 2.7, 1.0],
    }
}

/// Ranges of the joint between a bone and the bone that carries it in a complete body.
pub fn ranges(kind: Kind) -> Ranges {
    let both = |r: [f64; 3]| r.map(|v| [0.0 - v, v]);
    let (rotation_deg, translation_mm, source) = match kind {
        Kind::Spine(SACRUM) => return unlimited(),
        Kind::Spine(level) => {
            let [flexion, lateral, axial] = SPINE[usize::from(level.min(SKULL)) - 1];
            (both([flexion / 2.0, lateral, axial]), spine_shift(level), WHITE_PANJABI)
        }
        Kind::Mandible => (
            [[-3.0, 30.0], [-3.0, 3.0], [-6.0, 6.0]],
            [3.0, 10.0, 5.0],
            "Okeson JP. Management of Temporomandibular Disorders and Occlusion, 7th ed., Mosby 2013: opening 40-60 mm, \
             protrusion and laterotrusion about 10 mm",
        ),
        Kind::Hyoid => (
            both([20.0, 10.0, 10.0]),
            [5.0, 18.0, 25.0],
            "Molfenter SM, Steele CM. Dysphagia 26 (2011) 67: hyoid excursion in swallowing, 8-18 mm forwards and \
             6-25 mm upwards; rotation estimated",
        ),
        Kind::Sternum => (
            both([8.0, 5.0, 5.0]),
            [5.0, 15.0, 10.0],
            "Kapandji IA. The Physiology of the Joints, vol. 3, 2nd ed., Churchill Livingstone 1974: breathing; \
             rotation estimated",
        ),
        Kind::Rib(..) => (
            both([10.0, 10.0, 5.0]),
            [2.0; 3],
            "Wilson TA et al. J Physiol 530 (2001) 319: ribs turn by about 10 degrees over the vital capacity; shift \
             estimated",
        ),
        Kind::Clavicle(_) => (
            both([50.0, 40.0, 30.0]),
            [5.0; 3],
            "Inman VT, Saunders JB, Abbott LC. J Bone Joint Surg 26 (1944) 1; shift estimated",
        ),
        Kind::Scapula(_) => (
            both([25.0, 30.0, 25.0]),
            [10.0; 3],
            "Ludewig PM et al. J Bone Joint Surg Am 91 (2009) 378; shift estimated, larger as muscles hold the scapula",
        ),
        Kind::Humerus(_) => (
            both([120.0, 120.0, 90.0]),
            [4.0; 3],
            "Inman VT, Saunders JB, Abbott LC. J Bone Joint Surg 26 (1944) 1: 120 of 180 degrees of elevation; shift \
             estimated",
        ),
        Kind::Ulna(_) => (both([145.0, 5.0, 5.0]), [2.0; 3], AAOS),
        Kind::Radius(_) => (both([145.0, 5.0, 85.0]), [3.0; 3], AAOS),
        Kind::Hip(_) => {
            (both([2.5, 1.5, 1.5]), [0.7; 3], "Sturesson B, Selvik G, Uden A. Spine 14 (1989) 162: 2.5 degrees, 0.7 mm")
        }
        Kind::Femur(_) => ([[-120.0, 30.0], [-45.0, 45.0], [-45.0, 45.0]], [2.0; 3], AAOS),
    };
    Ranges { rotation_deg, translation_mm, source: source.into() }
}

const AAOS: &str = "American Academy of Orthopaedic Surgeons. Joint Motion: Method of Measuring and Recording, 1965; \
                    shift estimated";

/// Ranges of one joint that stands for several in a row: the sums.
pub fn bridged(path: &[Kind]) -> Ranges {
    let all: Vec<Ranges> = path.iter().map(|&k| ranges(k)).collect();
    let mut sources: Vec<&str> = Vec::new();
    for r in &all {
        if !sources.contains(&r.source.as_str()) {
            sources.push(&r.source);
        }
    }
    let sum = |of: &dyn Fn(&Ranges) -> f64| all.iter().map(of).sum::<f64>();
    Ranges {
        rotation_deg: std::array::from_fn(|a| {
            std::array::from_fn(|end| sum(&|r| r.rotation_deg[a][end]).clamp(-180.0, 180.0))
        }),
        translation_mm: std::array::from_fn(|a| sum(&|r| r.translation_mm[a])),
        source: sources.join("; "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_levels_agree() {
        assert_eq!(Kind::of("vertebrae_T1"), Some(Kind::Spine(T1)));
        assert_eq!(Kind::of("vertebrae_C3"), Some(Kind::Spine(C3)));
        assert_eq!(Kind::of("vertebrae_S1"), Some(Kind::Spine(S1)));
        assert_eq!(Kind::of("sacrum"), Some(Kind::Spine(SACRUM)));
        assert_eq!(Kind::of("skull"), Some(Kind::Spine(SKULL)));
        assert_eq!(Kind::of("rib_right_12"), Some(Kind::Rib(Side::Right, 12)));
        let no = ["costal_cartilages", "brain", "vertebrae_skull", "C1", "rib_left_13", "rib_left", "hip_left_2", "T1"];
        for name in no {
            assert_eq!(Kind::of(name), None, "{name}");
        }
        let names = Kind::names();
        let kinds: std::collections::BTreeSet<Kind> = names.iter().filter_map(|n| Kind::of(n)).collect();
        assert_eq!((names.len(), kinds.len()), (68, 68));
    }

    #[test]
    fn carriers_lead_to_the_sacrum() {
        assert_eq!(Kind::Rib(Side::Left, 12).carrier(), Some(Kind::Spine(7)));
        assert_eq!(level_name(7), "T12");
        let mut kind = Kind::Radius(Side::Right);
        let mut steps = 0;
        while let Some(next) = kind.carrier() {
            kind = next;
            steps += 1;
        }
        assert_eq!((kind, steps), (Kind::Spine(SACRUM), 5 + 18));
    }

    #[test]
    fn a_bridge_moves_as_far_as_what_it_stands_for() {
        // C2 on C4: the joints C2-C3 and C3-C4.
        let r = bridged(&[Kind::Spine(C2), Kind::Spine(C3)]);
        assert!((r.rotation_deg[0][1] - 12.5).abs() < 1e-12 && (r.rotation_deg[1][0] + 21.0).abs() < 1e-12);
        assert!((r.translation_mm[1] - 5.4).abs() < 1e-12);
    }
}
