//! Tests of building, checking and re-rooting skeletons on synthetic label maps.

use super::*;
use crate::findings;
use crate::geometry::Grid;
use crate::volume::{LabelMap, Volume};
use nalgebra::{Point3, Rotation3, Vector3};
use proptest::prelude::*;
use std::collections::BTreeMap;

/// Half thickness of body and disc, mm.
const HALF_BODY: f64 = 8.0;
const HALF_DISC: f64 = 3.0;

/// Blocks that look like vertebrae on a bent line, with the known middles of their discs.
struct BlockSpine {
    names: Vec<String>,
    /// World-to-block transforms, body in the middle.
    places: Vec<Rigid>,
    discs: Vec<Point3<f64>>,
}

impl BlockSpine {
    /// From below to above, each turned against the one below by `bend` (rotation vector, radians) about the disc.
    fn new(names: &[&str], first: Point3<f64>, bend: Vector3<f64>) -> Self {
        let mut place = Rigid::translation(first.x, first.y, first.z);
        let (mut places, mut discs) = (Vec::new(), Vec::new());
        for n in 0..names.len() {
            if n > 0 {
                let disc = place * Point3::new(0.0, 0.0, HALF_BODY + HALF_DISC);
                let turn = about(&disc, bend, Vector3::zeros());
                place = turn * place * Rigid::translation(0.0, 0.0, 2.0 * (HALF_BODY + HALF_DISC));
                discs.push(disc);
            }
            places.push(place);
        }
        let places = places.iter().map(Rigid::inverse).collect();
        Self { names: names.iter().map(|n| (*n).to_owned()).collect(), places, discs }
    }

    /// Whether a point of a block's frame belongs to it: body, pedicles, spinous process.
    fn inside(p: &Point3<f64>) -> bool {
        let body = p.x.abs() <= 11.0 && p.y.abs() <= 8.0 && p.z.abs() <= HALF_BODY;
        let pedicle = (7.0..11.0).contains(&p.x.abs()) && (0.0..26.0).contains(&p.y) && p.z.abs() <= 5.0;
        let process = p.x.abs() <= 11.0 && (22.0..30.0).contains(&p.y) && p.z.abs() <= 5.0;
        body || pedicle || process
    }

    fn labels(&self, grid: &Grid) -> LabelMap {
        let volume = Volume::from_fn(grid.clone(), |l| {
            let p = grid.centre(grid.voxel(l));
            self.places.iter().position(|t| Self::inside(&(t * p))).map_or(0, |n| n as u16 + 1)
        });
        let names = self.names.iter().enumerate().map(|(n, name)| (n as u16 + 1, name.clone())).collect();
        LabelMap { volume, names }
    }
}

const NECK: [&str; 5] = ["vertebrae_C7", "vertebrae_C6", "vertebrae_C5", "vertebrae_C4", "vertebrae_C3"];

fn neck_grid() -> Grid {
    Grid::axis_aligned([50, 110, 75], [1.2, 1.0, 2.0], [-30.0, -60.0, -20.0]).unwrap()
}

/// Largest distance of the built joints of upper vertebrae to the known discs.
fn worst(built: &Built, spine: &BlockSpine) -> f64 {
    let of = |name: &str| built.skeleton.bones.iter().find(|b| b.name == name).unwrap();
    let off = spine.names[1..].iter().zip(&spine.discs).map(|(n, d)| (of(n).joint.centre - d).norm());
    off.fold(0.0, f64::max)
}

#[test]
fn discs_of_a_straight_and_of_bent_spines_are_found() {
    for bend in [[0.0, 0.0, 0.0], [0.17, 0.0, 0.0], [-0.12, 0.05, 0.0], [0.0, -0.1, 0.02]] {
        let spine = BlockSpine::new(&NECK, Point3::origin(), bend.into());
        let built = build(&spine.labels(&neck_grid())).unwrap();
        assert!(worst(&built, &spine) < 2.0, "{bend:?}: {}", worst(&built, &spine));
        assert!(built.warnings.is_empty(), "{:?}", built.warnings);
        let joints: Vec<_> = built.skeleton.bones.iter().map(|b| b.joint.name.as_str()).collect();
        assert_eq!(joints, ["root", "C6-C7", "C5-C6", "C4-C5", "C3-C4"]);
        for (bone, place) in built.skeleton.bones.iter().zip(&spine.places).skip(1) {
            let up = bone.joint.axes.column(2).into_owned();
            let own_up: Vector3<f64> = place.inverse() * Vector3::z();
            assert!(up.angle(&own_up) < 0.15, "axial rotation is about the spine's axis");
            assert!((bone.joint.axes.determinant() - 1.0).abs() < 1e-9);
        }
    }
}

#[test]
fn a_vertebra_cut_by_the_edge_still_has_its_disc() {
    // The image begins within C7.
    let spine = BlockSpine::new(&NECK, Point3::new(0.0, 0.0, -22.0), Vector3::zeros());
    let built = build(&spine.labels(&neck_grid())).unwrap();
    assert!(worst(&built, &spine) < 2.0, "{}", worst(&built, &spine));
    // The image begins within C6, and shows of C7 only a piece of the arch.
    let spine = BlockSpine::new(&NECK, Point3::new(0.0, 0.0, -38.0), Vector3::zeros());
    let mut labels = spine.labels(&neck_grid());
    let grid = labels.volume.grid().clone();
    for (l, v) in labels.volume.data_mut().iter_mut().enumerate() {
        let p = grid.centre(grid.voxel(l));
        if p.x.abs() < 8.0 && (32.0..40.0).contains(&p.y) && p.z < -14.0 {
            *v = 1;
        }
    }
    let built = build(&labels).unwrap();
    assert!(worst(&built, &spine) < 4.0, "{}", worst(&built, &spine));
}

#[test]
fn storage_order_does_not_matter() {
    let spine = BlockSpine::new(&NECK, Point3::origin(), Vector3::new(0.1, 0.05, 0.0));
    let first = neck_grid();
    let expected = build(&spine.labels(&first)).unwrap().skeleton;
    let direction = Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0);
    let turned = Grid::new([75, 50, 110], [2.0, 1.2, 1.0], first.centre([49, 109, 0]), direction).unwrap();
    let got = build(&spine.labels(&turned)).unwrap().skeleton;
    for (a, b) in expected.bones.iter().zip(&got.bones) {
        assert_eq!((&a.name, a.parent), (&b.name, b.parent));
        assert!((a.joint.centre - b.joint.centre).norm() < 0.2 && (a.centroid - b.centroid).norm() < 1e-6);
        assert!((a.joint.axes - b.joint.axes).abs().max() < 0.01);
    }
}

#[test]
fn swapped_vertebrae_and_bones_in_pieces_are_told() {
    let spine = BlockSpine::new(&NECK, Point3::origin(), Vector3::zeros());
    let mut labels = spine.labels(&neck_grid());
    labels.names.insert(2, "vertebrae_C5".into());
    labels.names.insert(3, "vertebrae_C6".into());
    let warnings = build(&labels).unwrap().warnings;
    let orders: Vec<_> = warnings.iter().filter(|w| w.is(findings::SPINE_ORDER)).collect();
    assert_eq!(orders.len(), 1);
    assert!(orders[0].message.starts_with("C5 lies below C6"), "{}", orders[0].message);

    let mut labels = spine.labels(&neck_grid());
    let grid = labels.volume.grid().clone();
    for (l, v) in labels.volume.data_mut().iter_mut().enumerate() {
        let p = grid.centre(grid.voxel(l));
        if p.y < -45.0 && p.z > 90.0 && p.z < 110.0 && p.x.abs() < 10.0 {
            *v = 1;
        }
    }
    let warnings = build(&labels).unwrap().warnings;
    assert_eq!(warnings.iter().map(|w| w.code.as_str()).collect::<Vec<_>>(), ["bone-in-pieces"]);
    assert!(warnings[0].message.contains("vertebrae_C7 is in 2 pieces"), "{}", warnings[0].message);
}

/// All bones that have a place in the skeleton.
fn all_names() -> Vec<String> {
    let mut names: Vec<String> = vec!["sacrum".into(), "vertebrae_S1".into()];
    names.extend((1..=5).rev().map(|n| format!("vertebrae_L{n}")));
    names.extend((1..=12).rev().map(|n| format!("vertebrae_T{n}")));
    names.extend((1..=7).rev().map(|n| format!("vertebrae_C{n}")));
    names.extend(["skull", "mandible", "hyoid", "sternum"].map(String::from));
    for side in ["left", "right"] {
        names.extend((1..=12).map(|n| format!("rib_{side}_{n}")));
        let paired = ["clavicula", "scapula", "humerus", "radius", "ulna", "hip", "femur"];
        names.extend(paired.map(|b| format!("{b}_{side}")));
    }
    names
}

/// Each named bone as a block of its own in a row of blocks.
fn blocks(names: &[String]) -> LabelMap {
    let n = names.len();
    let grid = Grid::axis_aligned([9, 9, 8 * n], [1.0; 3], [0.0; 3]).unwrap();
    let volume = Volume::from_fn(grid.clone(), |l| {
        let [i, j, k] = grid.voxel(l);
        let inside = (2..7).contains(&i) && (2..7).contains(&j) && (1..7).contains(&(k % 8));
        if inside { (k / 8) as u16 + 1 } else { 0 }
    });
    let names = names.iter().enumerate().map(|(n, name)| (n as u16 + 1, name.clone())).collect();
    LabelMap { volume, names }
}

/// Child to parent, by name.
fn parents(skeleton: &Skeleton) -> BTreeMap<String, String> {
    let named = skeleton.bones.iter().filter_map(|b| Some((b.name.clone(), skeleton.bones[b.parent?].name.clone())));
    named.collect()
}

/// One root, first; every parent before its children.
fn assert_tree(skeleton: &Skeleton) {
    for (n, bone) in skeleton.bones.iter().enumerate() {
        assert_eq!(bone.parent.is_none(), n == 0, "{}", bone.name);
        assert!(bone.parent.is_none_or(|p| p < n), "{}", bone.name);
    }
}

#[test]
fn every_bone_has_its_place() {
    let mut names = all_names();
    let bones = names.len();
    names.extend(["costal_cartilages", "spinal_cord"].map(String::from));
    let mut labels = blocks(&names);
    labels.names.remove(&(bones as u16 + 2));
    let built = build(&labels).unwrap();
    assert_tree(&built.skeleton);
    assert_eq!(built.skeleton.bones.len(), bones);
    assert_eq!(built.skeleton.bones[0].name, "sacrum");
    assert_eq!(built.ignored, ["costal_cartilages".to_owned(), format!("label {} (no name)", bones + 2)]);
    let up = parents(&built.skeleton);
    let expected = [
        ("vertebrae_S1", "sacrum"),
        ("vertebrae_L5", "vertebrae_S1"),
        ("vertebrae_T12", "vertebrae_L1"),
        ("vertebrae_C7", "vertebrae_T1"),
        ("skull", "vertebrae_C1"),
        ("mandible", "skull"),
        ("hyoid", "vertebrae_C3"),
        ("rib_left_12", "vertebrae_T12"),
        ("rib_right_1", "vertebrae_T1"),
        ("sternum", "vertebrae_T1"),
        ("clavicula_left", "sternum"),
        ("scapula_right", "clavicula_right"),
        ("humerus_left", "scapula_left"),
        ("radius_left", "humerus_left"),
        ("ulna_right", "humerus_right"),
        ("hip_right", "sacrum"),
        ("femur_left", "hip_left"),
    ];
    for (child, parent) in expected {
        assert_eq!(up[child], parent);
    }
    let fused = built.skeleton.bones.iter().find(|b| b.name == "vertebrae_S1").unwrap();
    assert_eq!((fused.joint.rotation_range_deg, fused.joint.translation_range_mm), ([[0.0; 2]; 3], [0.0; 3]));
    let text = tree(&built.skeleton, &built.voxels);
    assert_eq!(text.lines().count(), bones + 1);
    assert!(text.contains("atlanto-occipital") && text.contains("150"), "{text}");
}

#[test]
fn missing_bones_are_bridged_and_there_is_always_one_tree() {
    let of = |names: &[&str]| {
        let built = build(&blocks(&names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>())).unwrap();
        assert_tree(&built.skeleton);
        assert_eq!(built.skeleton.bones.len(), names.len());
        built
    };
    let neck = of(&["skull", "vertebrae_C2", "vertebrae_C4", "clavicula_left", "humerus_left", "mandible", "hyoid"]);
    let up = parents(&neck.skeleton);
    assert_eq!(neck.skeleton.bones[0].name, "vertebrae_C4");
    assert_eq!((up["vertebrae_C2"].as_str(), up["skull"].as_str()), ("vertebrae_C4", "vertebrae_C2"));
    assert_eq!((up["hyoid"].as_str(), up["humerus_left"].as_str()), ("vertebrae_C4", "clavicula_left"));
    assert_eq!(up["clavicula_left"], "vertebrae_C4");
    assert!(neck.warnings.iter().all(|w| !w.is(findings::BONE_WITHOUT_PARENT)), "{:?}", neck.warnings);
    let skull = neck.skeleton.bones.iter().find(|b| b.name == "skull").unwrap();
    assert!((skull.joint.rotation_range_deg[2][1] - 45.0).abs() < 1e-9, "C0-C1 and C1-C2 add up");

    // No axis at all: a thigh and a forearm.
    let limbs = of(&["femur_left", "ulna_left", "hip_left"]);
    let codes: Vec<_> = limbs.warnings.iter().map(|w| w.code.as_str()).collect();
    assert_eq!(codes, ["bone-without-parent"]);
    assert_eq!(parents(&limbs.skeleton)["femur_left"], "hip_left");
    assert_eq!(of(&["mandible"]).skeleton.bones.len(), 1);
}

#[test]
fn maps_without_bones_or_with_twins_are_refused() {
    let named = |names: &[&str]| blocks(&names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>());
    let none = build(&named(&["liver", "costal_cartilages"])).unwrap_err().to_string();
    assert!(none.contains("liver, costal_cartilages") && none.contains("vertebrae_C1"), "{none}");
    let twins = build(&named(&["skull", "hyoid", "skull"])).unwrap_err().to_string();
    assert!(twins.contains("labels 1 and 3 are both named skull"), "{twins}");
}

#[test]
fn the_head_of_a_thigh_is_the_centre_of_its_hip() {
    let centre = Point3::new(10.0, -5.0, 3.0);
    let grid = Grid::axis_aligned([70, 60, 60], [2.0, 2.0, 2.5], [-70.0, -60.0, -90.0]).unwrap();
    let volume = Volume::from_fn(grid.clone(), |l| {
        let p = grid.centre(grid.voxel(l));
        let v = p - centre;
        // A ball of 24 mm on an oblique neck with a shaft; a shell of socket above and medial of it.
        let axis = Vector3::new(1.0, 0.0, -0.8).normalize();
        let along = v.dot(&axis);
        let neck = (0.0..50.0).contains(&along) && (v - axis * along).norm() < 14.0;
        let shaft = (v.x - 40.0).hypot(v.y) < 15.0 && v.z < -25.0;
        let socket = (27.0..36.0).contains(&v.norm()) && v.dot(&Vector3::new(-1.0, 0.0, 1.0)) > 5.0;
        if v.norm() <= 24.0 || neck || shaft {
            1
        } else if socket {
            2
        } else {
            0
        }
    });
    let names = [(1, "femur_left".to_owned()), (2, "hip_left".to_owned())].into();
    let built = build(&LabelMap { volume, names }).unwrap();
    let femur = &built.skeleton.bones[1];
    assert_eq!(femur.joint.name, "hip_left");
    assert!((femur.joint.centre - centre).norm() < 2.0, "{}", femur.joint.centre);
}

#[test]
fn a_rib_turns_at_its_head_though_it_touches_the_arch_too() {
    let names = ["vertebrae_T2", "vertebrae_T1"];
    let mut labels = BlockSpine::new(&names, Point3::origin(), Vector3::zeros()).labels(&neck_grid());
    let grid = labels.volume.grid().clone();
    let (head, angle) = (Point3::new(13.0, 4.0, 22.0), Point3::new(15.0, 26.0, 22.0));
    for (l, v) in labels.volume.data_mut().iter_mut().enumerate() {
        let p = grid.centre(grid.voxel(l));
        let t = ((p - head).dot(&(angle - head)) / (angle - head).norm_squared()).clamp(0.0, 1.0);
        if *v == 0 && (p - (head + (angle - head) * t)).norm() < 4.0 {
            *v = 3;
        }
    }
    labels.names.insert(3, "rib_left_1".into());
    let built = build(&labels).unwrap();
    let rib = built.skeleton.bones.iter().find(|b| b.name == "rib_left_1").unwrap();
    assert!((rib.joint.centre - head).norm() < 5.0, "{}", rib.joint.centre);
}

#[test]
fn an_elbow_outside_the_image_lies_where_the_arms_axes_meet() {
    let grid = Grid::axis_aligned([60, 60, 60], [3.0; 3], [0.0; 3]).unwrap();
    let elbow = Point3::new(90.0, 80.0, -90.0);
    let arm = Vector3::new(-0.3, 0.1, 1.0).normalize();
    let forearm = Vector3::new(0.3, -0.2, 1.0).normalize();
    let volume = Volume::from_fn(grid.clone(), |l| {
        let v = grid.centre(grid.voxel(l)) - elbow;
        let near = |axis: &Vector3<f64>| v.cross(axis).norm() < 9.0;
        if near(&arm) { 1 } else { u16::from(near(&forearm)) * 2 }
    });
    let names = [(1, "humerus_left".to_owned()), (2, "ulna_left".to_owned())].into();
    let built = build(&LabelMap { volume, names }).unwrap();
    let ulna = &built.skeleton.bones[1];
    assert_eq!(ulna.joint.name, "humeroulnar_left");
    assert!((ulna.joint.centre - elbow).norm() < 12.0, "{}", ulna.joint.centre);
    let axial = ulna.joint.axes.column(2).into_owned();
    assert!(axial.dot(&forearm).abs() > 0.99, "the forearm turns about its own length");
}

/// Any skeleton of `n` bones with any pose.
fn any_skeleton(n: usize) -> impl Strategy<Value = (Skeleton, Pose)> {
    let bone = (any::<prop::sample::Index>(), prop::array::uniform9(-1.0f64..1.0), prop::array::uniform6(-0.8f64..0.8));
    prop::collection::vec(bone, n).prop_map(|list| {
        let mut joints = Vec::new();
        let bones = list.iter().enumerate().map(|(at, (parent, v, pose))| {
            let vector = |k: usize| Vector3::new(v[k], v[k + 1], v[k + 2]);
            let shift = Vector3::new(pose[3], pose[4], pose[5]) * 5.0;
            joints.push(JointPose { rotation: [pose[0], pose[1], pose[2]], translation: shift.into() });
            Bone {
                name: format!("bone{at}"),
                label: at as u16 + 1,
                parent: (at > 0).then(|| parent.index(at.max(1))),
                joint: Joint {
                    name: format!("joint{at}"),
                    centre: (vector(0) * 200.0).into(),
                    axes: Rotation3::from_scaled_axis(vector(3)).into_inner(),
                    rotation_range_deg: [[-10.0, 30.0], [-5.0, 5.0], [0.0, 20.0]],
                    translation_range_mm: [1.0; 3],
                    source: String::new(),
                },
                centroid: (vector(6) * 200.0).into(),
                volume_mm3: 1.0,
            }
        });
        let skeleton = Skeleton { bones: bones.collect() };
        (skeleton, Pose { joints })
    })
}

proptest! {
    #[test]
    fn a_pose_is_found_again_from_the_transforms_that_it_makes((skeleton, pose) in any_skeleton(8)) {
        assert_tree(&skeleton);
        let transforms = skeleton.transforms(&pose);
        let again = skeleton.transforms(&skeleton.pose_of(&transforms));
        for (a, b) in transforms.iter().zip(&again) {
            prop_assert!((a.to_homogeneous() - b.to_homogeneous()).abs().max() < 1e-9);
        }
    }
}
