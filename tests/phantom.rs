//! The phantom is what it says: rigid bones, an invertible unfolded map, images that follow from it.

use crate::support::{aventail, files_below, folder, small_phantom};
use aventail::geometry::rotation_angle_deg;
use aventail::io::pose::read_pose;
use aventail::io::read_image;
use aventail::phantom::{CbctOptions, INVERSE_TOLERANCE, JointMotion, Phantom, PhantomOptions, Posture};
use aventail::skeleton::JointPose;
use nalgebra::{Matrix3, Point3, Vector3};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::sync::OnceLock;

/// One coarse phantom without noise, gain or offset for all tests that only look.
fn plain() -> &'static Phantom {
    static ONE: OnceLock<Phantom> = OnceLock::new();
    ONE.get_or_init(|| Phantom::new(&plain_options()).expect("the options are sensible"))
}

fn plain_options() -> PhantomOptions {
    PhantomOptions {
        planning_noise_hu: 0.0,
        fraction_noise_hu: 0.0,
        fraction_gain: 1.0,
        fraction_offset_hu: 0.0,
        ..PhantomOptions::coarse()
    }
}

/// A still smaller one for tests that make several.
fn tiny_options() -> PhantomOptions {
    PhantomOptions { size: [65, 45, 42], spacing_mm: [8.0, 8.0, 10.0], ..plain_options() }
}

#[test]
fn at_least_forty_named_bones_are_in_the_image() {
    let p = plain();
    let counts = p.bones.counts();
    assert!(counts.len() >= 40 && counts.len() == p.bones.names.len());
    for (label, name) in &p.bones.names {
        assert!(counts[label] >= 8, "{name} has {} voxels", counts[label]);
    }
    let names: BTreeSet<&str> = p.bones.names.values().map(String::as_str).collect();
    let wanted = [
        "skull",
        "mandible",
        "hyoid",
        "vertebrae_C1",
        "vertebrae_T6",
        "rib_left_1",
        "rib_right_6",
        "sternum",
        "clavicula_left",
        "scapula_right",
        "humerus_left",
        "radius_left",
        "ulna_right",
    ];
    for name in wanted {
        assert!(names.contains(name), "{name}");
    }
    let of_skeleton: BTreeSet<&str> = p.skeleton.bones.iter().map(|b| b.name.as_str()).collect();
    assert_eq!(names, of_skeleton);
    for (n, b) in p.skeleton.bones.iter().enumerate() {
        assert!(b.parent.is_none_or(|q| q < n) && (b.parent.is_none() == (n == 0)), "{}", b.name);
    }
}

#[test]
fn bones_share_no_point_and_labels_follow_the_solids() {
    let p = plain();
    let (grid, anatomy) = (p.planning.grid(), p.motion.anatomy());
    let mut closest = f64::MAX;
    for (n, &label) in p.bones.volume.data().iter().enumerate().filter(|(_, l)| **l > 0) {
        let x = grid.centre(grid.voxel(n));
        assert_eq!(anatomy.sample(&x).label, label);
        for bone in 0..p.bones.names.len() {
            let d = anatomy.bone_distance(bone, &x);
            assert_eq!(d < 0.0, bone + 1 == usize::from(label), "bone {bone} at {x}: {d}");
            if bone + 1 != usize::from(label) {
                closest = closest.min(d);
            }
        }
    }
    assert!((0.5..3.0).contains(&closest), "joints are narrow but open: {closest}");
}

#[test]
fn bones_move_exactly_rigidly() {
    let p = plain();
    let grid = p.planning.grid();
    let mut seen = BTreeSet::new();
    for (n, &label) in p.bones.volume.data().iter().enumerate().filter(|(_, l)| **l > 0) {
        let bone = p.skeleton.bones.iter().position(|b| b.label == label).unwrap();
        let x = grid.centre(grid.voxel(n));
        assert!((p.push(&x) - p.transforms[bone] * x).norm() < 1e-9);
        seen.insert(label);
    }
    assert_eq!(seen.len(), p.skeleton.bones.len());
    for (given, made) in p.transforms.iter().zip(p.skeleton.transforms(&p.pose)) {
        assert!((given.to_homogeneous() - made.to_homogeneous()).abs().max() < 1e-9);
    }
    let skull = p.skeleton.bones.iter().position(|b| b.name == "skull").unwrap();
    assert!((8.0..14.0).contains(&rotation_angle_deg(&p.transforms[skull])));
}

#[test]
fn joints_of_the_spine_lie_between_their_bones() {
    let p = plain();
    let mut seen = 0;
    for bone in p.skeleton.bones.iter().filter(|b| b.name.starts_with("vertebrae") || b.name == "skull") {
        let Some(parent) = bone.parent else { continue };
        for label in [bone.label, p.skeleton.bones[parent].label] {
            let d = p.motion.anatomy().bone_distance(usize::from(label) - 1, &bone.joint.centre);
            // The atlas turns about the dens, which is the axis's; the condyles stand beside the foramen.
            assert!(d < 9.9 || bone.name == "skull", "{}: {d} mm", bone.joint.name);
        }
        seen += 1;
    }
    assert_eq!(seen, 14);
}

#[test]
fn the_true_map_does_not_fold_and_the_demo_posture_keeps_bones_apart() {
    let p = plain();
    let grid = p.planning.grid();
    let (mut least, mut folded, mut soft) = (f64::MAX, 0, 0);
    for n in (0..grid.len()).filter(|&n| p.body.data()[n] && p.bones.volume.data()[n] == 0) {
        // Off the voxel centres, so that not only one lattice of points is looked at.
        let x = grid.centre(grid.voxel(n)) + Vector3::new(1.3, -0.9, 1.7);
        let h = 0.05;
        let column = |a: usize| {
            let mut e = Vector3::zeros();
            e[a] = h;
            (p.push(&(x + e)) - p.push(&(x - e))) / (2.0 * h)
        };
        let det = Matrix3::from_columns(&[column(0), column(1), column(2)]).determinant();
        least = least.min(det);
        folded += usize::from(det <= 0.0);
        soft += 1;
    }
    assert!(soft > 60_000);
    assert_eq!(folded, 0, "least determinant {least}");
    assert!(least > 0.05, "{least}");
}

#[test]
fn the_fraction_shows_the_planning_anatomy_through_the_inverse() {
    let p = plain();
    assert_eq!(p.unfound, 0);
    let grid = p.fraction.grid();
    let mut inside = 0;
    for n in (0..grid.len()).step_by(7) {
        let y = grid.centre(grid.voxel(n));
        let before = p.motion.pull(&y, None);
        if p.motion.anatomy().skin_distance(&before.point) > -5.0 {
            continue;
        }
        assert!(before.residual <= INVERSE_TOLERANCE && (p.push(&before.point) - y).norm() <= INVERSE_TOLERANCE);
        let expected = p.motion.anatomy().sample(&before.point).hu;
        let got = f64::from(p.fraction.data()[n]);
        assert!((got - expected).abs() < 1.0, "{y}: {got} for {expected}");
        inside += 1;
    }
    assert!(inside > 5_000, "{inside}");
}

/// Shells of bone thinner than a voxel were once hit or missed, by where its middle lay.
#[test]
fn a_voxel_at_bone_shows_the_mean_over_its_volume() {
    let spacing_mm = [2.5, 2.5, 3.0];
    let p = Phantom::new(&PhantomOptions { size: [84, 90, 24], spacing_mm, edge_mm: 2.2, ..plain_options() }).unwrap();
    let (grid, anatomy) = (p.fraction.grid(), p.motion.anatomy());
    let quarter = nalgebra::Vector3::from(spacing_mm) / 4.0;
    let mut off = Vec::new();
    for n in (0..grid.len()).step_by(5) {
        let y = grid.centre(grid.voxel(n));
        let before = p.motion.pull(&y, None);
        let distances = (0..p.bones.names.len()).map(|b| anatomy.bone_distance(b, &before.point).abs());
        if distances.fold(f64::MAX, f64::min) < 3.0 && anatomy.skin_distance(&before.point) < -5.0 {
            let corners = (0..8).map(|c| quarter.map_with_location(|a, _, q| if c >> a & 1 == 0 { -q } else { q }));
            let hu = corners.map(|o| anatomy.sample(&p.motion.pull(&(y + o), Some(&before)).point).hu);
            off.push((f64::from(p.fraction.data()[n]) - hu.sum::<f64>() / 8.0).abs());
        }
    }
    off.sort_by(f64::total_cmp);
    // Between teeth the neighbourhood is not rigid.
    assert!(off.len() > 1_000 && off[off.len() * 95 / 100] < 3.0, "{} of {}", off[off.len() * 95 / 100], off.len());
}

#[test]
fn landmarks_are_soft_tissue_and_follow_the_truth() {
    let p = plain();
    assert!(p.landmarks.len() >= 16);
    let truth = p.truth().unwrap();
    let moved: Vec<f64> = p.landmarks.iter().map(|l| (l.fraction - l.planning).norm()).collect();
    for l in &p.landmarks {
        assert!((p.push(&l.planning) - l.fraction).norm() < 1e-12);
        let sample = p.motion.anatomy().sample(&l.planning);
        assert!(sample.label == 0 && p.motion.anatomy().skin_distance(&l.planning) < 1.0, "{}", l.name);
        let index = p.planning.grid().index(&l.planning);
        let u = aventail::volume::trilinear_vector(&truth.displacement, &index).unwrap();
        assert!((l.planning + u - l.fraction).norm() < 1.5, "{}: the field on voxels", l.name);
    }
    assert!(moved.iter().all(|m| *m > 1.0) && moved.iter().any(|m| *m > 10.0), "{moved:?}");
}

#[test]
fn soft_tissue_moves_on_its_own_but_bones_do_not() {
    let still = Phantom::new(&PhantomOptions { soft_tissue_mm: 0.0, ..tiny_options() }).unwrap();
    let own = Phantom::new(&tiny_options()).unwrap();
    let grid = own.planning.grid();
    let mut most: f64 = 0.0;
    for n in (0..grid.len()).filter(|&n| own.body.data()[n]) {
        let x = grid.centre(grid.voxel(n));
        let apart = (own.push(&x) - still.push(&x)).norm();
        assert!(own.bones.volume.data()[n] == 0 || apart < 1e-9);
        most = most.max(apart);
    }
    assert!((0.8..5.0).contains(&most), "{most}");
}

#[test]
fn same_bits_at_one_and_two_threads() {
    let noisy = PhantomOptions { planning_noise_hu: 9.0, fraction_noise_hu: 12.0, ..tiny_options() };
    let make = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| Phantom::new(&noisy).unwrap())
    };
    let (a, b) = (make(1), make(2));
    assert_eq!(a.planning.data(), b.planning.data());
    assert_eq!(a.fraction.data(), b.fraction.data());
    assert_eq!(a.landmarks, b.landmarks);
    let other = Phantom::new(&PhantomOptions { seed: 1, ..noisy }).unwrap();
    assert_ne!(a.fraction.data(), other.fraction.data());
}

#[test]
fn the_couch_moves_by_its_own_shift_only() {
    let shift = 6.0;
    let options = PhantomOptions {
        size: [13, 400, 6],
        spacing_mm: [40.0, 1.0, 60.0],
        edge_mm: 1.0,
        fraction_grid_shift: [0.0; 3],
        couch_shift_mm: [0.0, shift, 0.0],
        ..plain_options()
    };
    let p = Phantom::new(&options).unwrap();
    // The couch's upper face beside the head, where nothing of the patient is above it.
    let face = |image: &aventail::volume::Volume<f32>| {
        let g = image.grid();
        let k = g.index(&Point3::new(0.0, 0.0, 40.0)).z.round() as usize;
        let j = (0..g.size()[1]).find(|&j| *image.at([12, j, k]) > -600.0).unwrap();
        g.centre([12, j, k]).y
    };
    assert!((face(&p.fraction) - face(&p.planning) - shift).abs() <= 1.0);
}

#[test]
fn the_body_mask_holds_bones_and_airway_but_no_couch() {
    let p = plain();
    let grid = p.planning.grid();
    let (mut couch, mut air) = (0, 0);
    for n in 0..grid.len() {
        let (hu, body) = (p.planning.data()[n], p.body.data()[n]);
        assert!(
            body || p.bones.volume.data()[n] == 0,
            "{} outside: {}",
            p.bones.names[&p.bones.volume.data()[n]],
            grid.centre(grid.voxel(n))
        );
        couch += usize::from(!body && hu > -400.0 && grid.centre(grid.voxel(n)).y > 121.0);
        air += usize::from(body && hu < -900.0);
    }
    assert!(couch > 100 && air > 50, "couch {couch}, airway {air}");
    let trachea = grid.index(&Point3::new(0.0, -22.0, -145.0)).map(|v| v.round() as usize);
    assert!(*p.body.at(trachea.into()) && *p.planning.at(trachea.into()) < -700.0);
}

#[test]
fn hounsfield_units_are_those_of_a_person() {
    let anatomy = plain().motion.anatomy();
    let hu = |x: f64, y: f64, z: f64| anatomy.sample(&Point3::new(x, y, z)).hu;
    assert!((25.0..50.0).contains(&hu(20.0, 30.0, 95.0)), "brain");
    assert!((25.0..80.0).contains(&hu(18.0, 44.0, -70.0)), "muscle");
    assert!((-950.0..-500.0).contains(&hu(80.0, 20.0, -230.0)), "lung");
    assert!((150.0..500.0).contains(&hu(0.0, -9.7, -71.5)), "marrow of C4");
    assert!(hu(0.0, 0.0, -400.0) > -200.0 && hu(250.0, -150.0, 0.0) < -990.0, "inside, outside");
}

#[test]
fn a_shifted_scanner_moves_patient_couch_and_grid_together() {
    let shift = [480.0, -25.0, 310.0];
    let here = Phantom::new(&tiny_options()).unwrap();
    let there = Phantom::new(&PhantomOptions { scanner_shift_mm: shift, ..tiny_options() }).unwrap();
    let differing =
        here.fraction.data().iter().zip(there.fraction.data()).filter(|(a, b)| (*a - *b).abs() > 1.0).count();
    assert!(differing * 1000 < here.fraction.data().len(), "{differing} voxels differ");
    assert_eq!(there.unfound, 0);
    for (a, b) in here.landmarks.iter().zip(&there.landmarks) {
        assert!((b.fraction - a.fraction - Vector3::from(shift)).norm() < 1e-6);
    }
}

#[test]
fn arms_can_be_raised_by_165_degrees() {
    let skeleton = Phantom::new(&PhantomOptions { posture: Posture::at_rest(), ..tiny_options() }).unwrap().skeleton;
    let pose = read_pose("data/raise_arms.toml", &skeleton).unwrap();
    let moved = skeleton.bones.iter().zip(&pose.joints).filter(|(_, joint)| **joint != JointPose::default());
    let motion = |joint: &JointPose| JointMotion {
        rotation_deg: joint.rotation.map(f64::to_degrees),
        shift_mm: joint.translation,
    };
    let posture = Posture { joints: moved.map(|(bone, joint)| (bone.name.clone(), motion(joint))).collect() };
    assert_eq!(posture.joints.len(), 6);
    let p = Phantom::new(&PhantomOptions { posture, ..tiny_options() }).unwrap();
    for side in ["left", "right"] {
        let n = p.skeleton.bones.iter().position(|b| b.name == format!("humerus_{side}")).unwrap();
        assert!((rotation_angle_deg(&p.transforms[n]) - 165.0).abs() < 1.0);
        let elbow = p.skeleton.bones.iter().find(|b| b.name == format!("ulna_{side}")).unwrap().joint.centre;
        let shoulder = p.skeleton.bones[n].joint.centre;
        assert!(
            (p.transforms[n] * elbow).z > (p.transforms[n] * shoulder).z + 200.0,
            "the elbow is above the shoulder"
        );
    }
}

#[test]
fn the_program_writes_cone_beam_fractions_with_their_settings_and_truth() {
    let read = |out: &Path, name: &str| read_image(out.join(name)).unwrap().value;
    let make = |out: &str, words: &[&str]| {
        let out = folder().join(out);
        aventail().args(["phantom", "--spacing", "9x9x9"]).args(words).arg("--out").arg(&out).assert().success();
        out
    };
    let file = folder().join("own.toml");
    let own = CbctOptions { circle_radius_mm: 80.0, padding_hu: -1500.0, ..CbctOptions::default() };
    fs::write(&file, own.to_toml().unwrap()).unwrap();
    let cbct = make("cbct", &["--cbct", file.to_str().unwrap()]);
    let plain = small_phantom().planning.parent().unwrap();
    for fraction in ["", "fraction_2/"] {
        let at = |name: &str| format!("{fraction}{name}");
        assert_eq!(CbctOptions::parse(&fs::read_to_string(cbct.join(at("cbct.toml"))).unwrap()).unwrap(), own);
        for truth in ["true_planning_to_fraction.nii.gz", "true_bone_transforms.json", "landmarks.csv"] {
            assert_eq!(fs::read(cbct.join(at(truth))).unwrap(), fs::read(plain.join(at(truth))).unwrap(), "{truth}");
        }
        let (image, measured) = (read(&cbct, &at("fraction_ct.nii.gz")), read(&cbct, &at("measured.nii.gz")));
        let seen = measured.data().iter().filter(|m| **m > 0.5).count();
        assert!(seen > 2000 && 2 * seen < measured.data().len(), "{seen} of {}", measured.data().len());
        assert!(image.data().iter().zip(measured.data()).all(|(hu, m)| (*hu < -1400.0) == (*m < 0.5)));
    }
    assert_eq!(fs::read(cbct.join("planning_ct.nii.gz")).unwrap(), fs::read(plain.join("planning_ct.nii.gz")).unwrap());
    let chest = make("chest", &["--breathing", "-12", "--cbct"]);
    let names = files_below(&chest);
    for name in ["organs.nii.gz", "measured.nii.gz", "cbct.toml", "true_planning_to_fraction.nii.gz", "landmarks.csv"] {
        assert!(names.iter().any(|n| n == name), "{name}: {names:?}");
    }
    assert!(!names.iter().any(|n| n.starts_with("fraction_2")), "{names:?}");
    let wrong = folder().join("wrong.toml");
    fs::write(&wrong, "circle = 3\n").unwrap();
    for (words, code, word) in [
        (vec!["--cbct", wrong.to_str().unwrap()], 3, "wrong.toml"),
        (vec!["--breathing", "90"], 4, "amplitude"),
        (vec!["--breathing", "--pose", "x.toml"], 2, "--pose"),
        (vec!["--field", "swirl", "--cbct"], 2, "--cbct"),
    ] {
        let out = folder().join("refused");
        let run = aventail().arg("phantom").args(&words).arg("--out").arg(&out).assert().code(code);
        let message = String::from_utf8(run.get_output().stderr.clone()).unwrap();
        assert!(message.contains(word) && files_below(&out).is_empty(), "{words:?}: {message}");
    }
}

#[test]
fn senseless_options_are_refused() {
    let refused = |change: fn(&mut PhantomOptions)| {
        let mut options = tiny_options();
        change(&mut options);
        Phantom::new(&options).unwrap_err().to_string()
    };
    assert!(
        refused(|o| o.posture = Posture::parse("femur_left = { rotation_deg = [1, 2, 3] }").unwrap())
            .contains("femur_left")
    );
    assert!(refused(|o| o.posture = Posture::parse("skull = { shift_mm = [nan, 0, 0] }").unwrap()).contains("skull"));
    assert!(refused(|o| o.fraction_cut_top_mm = 1e4).contains("empty"));
    assert!(refused(|o| o.edge_mm = 0.0).contains("edge"));
    assert!(refused(|o| o.fraction_noise_hu = f64::NAN).contains("noise"));
    assert!(refused(|o| o.size = [0, 4, 4]).contains("size"));
    assert!(Posture::parse("skull = { rotation = [1, 2, 3] }").is_err());
}

#[test]
fn fat_goes_around_the_patient_and_leaves_what_is_in_him() {
    let lean = Phantom::new(&tiny_options()).unwrap();
    let stout = Phantom::new(&PhantomOptions { fat_mm: 18.0, ..tiny_options() }).unwrap();
    assert_eq!(lean.bones.volume.data(), stout.bones.volume.data());
    let [lean, stout] = [lean, stout].map(|p| (p.body, p.planning));
    let added: Vec<usize> = (0..lean.0.data().len()).filter(|&v| stout.0.data()[v] && !lean.0.data()[v]).collect();
    assert!((0..lean.0.data().len()).all(|v| stout.0.data()[v] || !lean.0.data()[v]));
    // Fat but for the skin, and what a voxel takes of the air beside it.
    let fat = added.iter().filter(|&&v| (-130.0..-70.0).contains(&stout.1.data()[v])).count();
    let count = |body: &aventail::volume::Mask| body.data().iter().filter(|b| **b).count() as f64;
    assert!((1.4..1.8).contains(&(count(&stout.0) / count(&lean.0))), "{} {}", count(&stout.0), count(&lean.0));
    assert!(2 * fat > added.len(), "{fat} of {}", added.len());
}
