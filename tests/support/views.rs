//! Random views of a patient: postures within the joints' ranges, slabs and circles, of the phantom and of real cases.

use aventail::geometry::{Rigid, rigid_from_matrix};
use aventail::io::read_image;
use aventail::phantom::{CbctOptions, JointMotion, Phantom, PhantomOptions, Posture, degrade};
use aventail::skeleton::Skeleton;
use aventail::skeleton::anatomy::{Kind, Side};
use aventail::volume::Volume;
use aventail::volume::region::part;
use nalgebra::{Matrix4, Point3, Vector3};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Seeded numbers (splitmix64): the same ones anywhere.
#[derive(Clone)]
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        let mut random = Self(seed.wrapping_mul(0xD134_2543_DE82_EF95));
        random.next();
        random
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// A number of a range.
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// One of so many.
    pub fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }
}

/// What a view shows of a scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cut {
    /// Its lowest and its highest slice over the lowest one of the scan, mm.
    pub slab_mm: [f64; 2],
    /// Diameter of its circle, mm; 0 for none.
    pub circle_mm: f64,
    /// Whether its grey values are a cone-beam CT's.
    pub shaded: bool,
}

impl Cut {
    /// A few vertebrae in a circle, where another level explains much too: slabs of 3 to 7 cm, circles of 8 to 16 cm.
    pub fn short(random: &mut Random, height_mm: f64) -> Self {
        let slab = random.within(30.0, 70.0);
        let low = random.within(0.0, height_mm - slab);
        let circle_mm = random.within(80.0, 160.0);
        Self { slab_mm: [low, low + slab], circle_mm, shaded: random.below(2) == 1 }
    }

    /// Whole scans, slabs of 6 to 12 cm, circles of 10 to 25 cm, and circles in slabs, an eighth of them a few vertebrae high; half of
    /// them with grey values of a cone-beam CT.
    pub fn random(random: &mut Random, height_mm: f64) -> Self {
        let kind = random.below(8);
        let slab = if kind == 7 { random.within(25.0, 60.0) } else { random.within(60.0, 120.0) };
        let low = random.within(0.0, height_mm - slab);
        let circle = random.within(100.0, 250.0);
        let shaded = random.below(2) == 1;
        Self {
            slab_mm: if kind < 2 { [0.0, height_mm] } else { [low, low + slab] },
            circle_mm: if kind == 1 || kind > 4 { circle } else { 0.0 },
            shaded,
        }
    }
}

/// A fraction with its truth.
pub struct Scene {
    /// What it was made from.
    pub kind: String,
    /// Share of the joints' ranges that it uses; of real cases 0.
    pub strength: f64,
    pub cut: Cut,
    pub fraction: Volume<f32>,
    /// Voxels whose place in planning was not found: the posture folds there.
    pub unfound: usize,
    /// True motion of each bone, planning to fraction.
    pub truth: BTreeMap<String, Rigid>,
}

/// A motion that uses a share of a joint's range, of the common bend for the most part.
fn bent(range: &[[f64; 2]; 3], common: [f64; 3], own: [f64; 3], share: f64) -> [f64; 3] {
    std::array::from_fn(|a| {
        let part = share * (0.75 * common[a] + 0.25 * own[a]);
        part.abs() * if part < 0.0 { range[a][0] } else { range[a][1] }
    })
}

/// A posture that uses up to a share `strength` of the joints' anatomical ranges: neck and head bend together, the jaw opens, the
/// shoulders rise, the arms swing, the couch lies elsewhere.
pub fn posture(random: &mut Random, strength: f64, skeleton: &Skeleton) -> Posture {
    let mut three = |most: f64| -> [f64; 3] { std::array::from_fn(|_| random.within(-most, most)) };
    let common = three(strength);
    let rise = three(1.0).map(|r| strength * (0.13 + 0.22 * r));
    let mut joints = BTreeMap::new();
    for bone in &skeleton.bones {
        let own = three(strength);
        let shift = three(strength);
        let range = &bone.joint.rotation_range_deg;
        let side = |s: Side| if s == Side::Left { -1.0 } else { 1.0 };
        let raised = |s: Side| if s == Side::Left { rise[0] } else { rise[1] };
        let Some(kind) = Kind::of(&bone.name) else { continue };
        let (rotation_deg, shift_mm) = match kind {
            Kind::Spine(_) if bone.parent.is_none() => (own.map(|v| 4.0 * v), shift.map(|v| 20.0 * v)),
            Kind::Spine(level) if level >= 19 => (bent(range, common, own, 0.95), [0.0; 3]),
            Kind::Spine(_) => (bent(range, common, own, 0.35), [0.0; 3]),
            Kind::Mandible => {
                let open = 22.0 * own[0].abs();
                ([open, own[1], own[2]], [0.0, -0.15 * open, -0.15 * open])
            }
            Kind::Hyoid => (own.map(|v| 5.0 * v), shift.map(|v| 4.0 * v)),
            Kind::Clavicle(s) => ([3.0 * own[0], side(s) * 12.0 * raised(s), 3.0 * own[2]], [0.0; 3]),
            Kind::Scapula(s) => ([2.0 * own[0], side(s) * 33.0 * raised(s), 3.0 * own[2]], [0.0; 3]),
            Kind::Humerus(s) => ([20.0 * own[0], side(s) * 120.0 * raised(s), 10.0 * own[2]], [0.0; 3]),
            Kind::Ulna(_) => ([-30.0 * own[0].abs(), 0.0, 0.0], [0.0; 3]),
            Kind::Radius(_) => ([0.0, 0.0, 20.0 * own[2]], [0.0; 3]),
            _ => (own.map(|v| 1.5 * v), shift.map(|v| 0.5 * v)),
        };
        joints.insert(bone.name.clone(), JointMotion { rotation_deg, shift_mm });
    }
    Posture { joints }
}

/// Height of the phantom's scan, mm, and the voxels of its fraction.
const HEIGHT_MM: f64 = 420.0;
const VOXEL_MM: f64 = 3.0;
/// More voxels than one of so many whose place is not found: the posture is made milder.
const FOLDED: usize = 500;

/// What is drawn of a scan so high, mm.
pub type Draw = fn(&mut Random, f64) -> Cut;

/// What is shown of a phantom.
pub enum Shown {
    /// This, in a posture so strong.
    Given(Cut, f64),
    /// What is drawn, as the posture is.
    Drawn(Draw),
}

/// A posture of the phantom, seen in part. `skeleton`: the phantom's.
pub fn of_phantom(seed: u64, skeleton: &Skeleton, shown: Shown) -> Scene {
    let mut random = Random::new(seed);
    let (cut, mut strength) = match shown {
        Shown::Given(cut, strength) => (cut, strength),
        Shown::Drawn(draw) => (draw(&mut random, HEIGHT_MM), random.within(0.2, 1.0)),
    };
    let scanner: [f64; 3] = std::array::from_fn(|_| random.within(-30.0, 30.0));
    loop {
        let posture = posture(&mut random.clone(), strength, skeleton);
        // Planning is made elsewhere, once: coarse voxels here.
        let options = PhantomOptions {
            size: [44, 31, 36],
            spacing_mm: [4.0 * VOXEL_MM; 3],
            edge_mm: 2.5,
            fraction_spacing_mm: [VOXEL_MM; 3],
            fraction_grid_shift: [0.03, -0.04, 0.02],
            fraction_cut_bottom_mm: cut.slab_mm[0],
            fraction_cut_top_mm: HEIGHT_MM - cut.slab_mm[1],
            scanner_shift_mm: scanner,
            posture,
            seed,
            ..PhantomOptions::default()
        };
        let phantom = Phantom::new(&options).expect("a part of the phantom is left");
        let grid = phantom.fraction.grid();
        if phantom.unfound > grid.len() / FOLDED && strength > 0.1 {
            strength *= 0.7;
            continue;
        }
        let truth: BTreeMap<String, Rigid> =
            phantom.skeleton.bones.iter().map(|b| b.name.clone()).zip(phantom.transforms).collect();
        let fraction = seen(&phantom.fraction, &cut, seed, skeleton, &truth, -1024.0);
        return Scene { kind: "phantom".into(), strength, cut, fraction, unfound: phantom.unfound, truth };
    }
}

/// An image in a circle about one of the bones that it shows, with the grey values of a cone-beam CT where these are asked for.
fn seen(
    image: &Volume<f32>,
    cut: &Cut,
    seed: u64,
    skeleton: &Skeleton,
    truth: &BTreeMap<String, Rigid>,
    padding_hu: f64,
) -> Volume<f32> {
    let mut random = Random::new(!seed);
    let grid = image.grid();
    let there = |of: &dyn Fn(&str) -> bool| -> Vec<Point3<f64>> {
        let named = skeleton.bones.iter().filter(|b| of(&b.name));
        let all = named.filter_map(|b| Some(truth.get(&b.name)? * b.centroid));
        all.filter(|p| grid.contains(&grid.index(p))).collect()
    };
    let mut places = there(&|name: &str| name.starts_with("vertebrae") || name == "skull" || name == "mandible");
    if places.is_empty() {
        places = there(&|_| true);
    }
    let about = if places.is_empty() { grid.middle() } else { places[random.below(places.len())] };
    let jitter = Vector3::new(random.within(-25.0, 25.0), random.within(-25.0, 25.0), 0.0);
    let offset = about + jitter - grid.middle();
    let effects = if cut.shaded { CbctOptions::default() } else { CbctOptions::off() };
    let options = CbctOptions {
        circle_radius_mm: cut.circle_mm / 2.0,
        circle_offset_mm: [offset.x, offset.y],
        padding_hu,
        blank_slices: [0; 2],
        length_mm: 0.0,
        ..effects
    };
    degrade(image, &options, seed).expect("the options are legal")
}

/// Scans of real cases with the folder of their truth: each fraction's CT, and its cone-beam CT, there or in `cbct` beside the folder of
/// the cases.
pub fn real_scans(cases: &Path) -> Vec<(String, PathBuf, PathBuf)> {
    let entries = std::fs::read_dir(cases).expect("AVENTAIL_CASES is a folder");
    let mut folders: Vec<PathBuf> = entries.map(|e| e.expect("the folder can be listed").path()).collect();
    folders.sort();
    let mut out = Vec::new();
    for folder in folders.into_iter().filter(|f| f.join("truth_bones.json").is_file()) {
        let name = folder.file_name().expect("a folder has a name").to_string_lossy().into_owned();
        let cbct = [folder.join("cbct.nii.gz"), cases.join("../cbct").join(format!("{name}.nii.gz"))];
        let found = [("ct", Some(folder.join("fraction_ct.nii.gz"))), ("cbct", cbct.into_iter().find(|f| f.is_file()))];
        let found = found.into_iter().filter_map(|(kind, file)| Some((kind, file.filter(|f| f.is_file())?)));
        out.extend(found.map(|(kind, file)| (format!("{kind}:{name}"), file, folder.clone())));
    }
    out
}

/// A real fraction, seen in part. `skeleton`: that of planning.
pub fn of_real(seed: u64, skeleton: &Skeleton, (kind, file, folder): &(String, PathBuf, PathBuf), draw: Draw) -> Scene {
    let mut random = Random::new(seed);
    let whole = read_image(file).expect("the case has its image").value;
    let text = std::fs::read_to_string(folder.join("truth_bones.json")).expect("and its truth");
    let all: BTreeMap<String, [[f64; 4]; 4]> = serde_json::from_str(&text).expect("4 x 4 for each bone");
    let rigid = |m: &[[f64; 4]; 4]| rigid_from_matrix(&Matrix4::from_fn(|r, c| m[r][c])).expect("bones move rigidly");
    let truth: BTreeMap<String, Rigid> = all.iter().map(|(name, m)| (name.clone(), rigid(m))).collect();
    let ([ni, nj, nk], step) = (whole.grid().size(), whole.grid().spacing()[2]);
    let mut cut = draw(&mut random, (nk - 1) as f64 * step);
    let cone_beam = kind.starts_with("cbct");
    cut.shaded &= !cone_beam;
    let [low, high] = cut.slab_mm.map(|mm| (mm / step).round() as usize);
    let slab = part(&whole, &[0..ni, 0..nj, low..(high + 1).min(nk)]).expect("slices of the scan");
    // What a cone-beam CT did not measure keeps its one value.
    let padding = if cone_beam { -1000.0 } else { -1024.0 };
    let fraction = seen(&slab, &cut, seed, skeleton, &truth, padding);
    Scene { kind: kind.clone(), strength: 0.0, cut, fraction, unfound: 0, truth }
}
