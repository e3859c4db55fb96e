//! Several fractions of one patient share the planning side, a region of interest is a part of the whole, and a run that
//! needs too much memory does not begin.

use crate::support::{Register, done, files, files_below, folder, phantom, small_phantom};
use aventail::io;
use aventail::volume::{region::voxels_of_box, trilinear_vector};
use nalgebra::{Point3, Vector3};
use std::fs;
use std::path::{Path, PathBuf};

/// The second fraction of the phantom of large voxels.
fn second() -> PathBuf {
    small_phantom().planning.parent().expect("the file lies in a folder").join("fraction_2/fraction_ct.nii.gz")
}

/// That phantom, with few samples of the fit, the chain mail and a map of uncertainty.
fn small(out: &str) -> Register {
    let text =
        "preset = \"fast\"\n[fit]\noutward = [[4.0, 500]]\nlevels = [[2.0, 500]]\n[output]\nuncertainty = true\n";
    let settings = files::bytes(&folder().join("small.toml"), text.as_bytes());
    Register::of(small_phantom(), folder().join(out)).with("--config", settings).flag("-q")
}

fn stages(out: &Path) -> Vec<String> {
    let report: serde_json::Value =
        serde_json::from_slice(&fs::read(out.join("report.json")).expect("the report was written"))
            .expect("it is JSON");
    let stages = report["stages"].as_array().expect("stages are listed");
    stages.iter().map(|s| s["stage"].as_str().expect("a stage has a name").to_owned()).collect()
}

#[test]
fn fractions_share_planning_and_give_the_bits_of_single_runs() {
    let both = small("both").with("--fraction", second());
    both.command().assert().success();
    let alone = small("alone").fraction(second());
    alone.command().assert().success();
    // Both files have the same name, so the folders are numbered.
    let shared = both.out.join("2");
    let names = files_below(&alone.out);
    assert!(names.len() > 12 && files_below(&shared) == names, "{names:?}");
    for name in names.iter().filter(|n| !["report.json", "report.html"].contains(&n.as_str())) {
        assert_eq!(fs::read(alone.out.join(name)).unwrap(), fs::read(shared.join(name)).unwrap(), "{name}");
    }
    let first = fs::read(both.out.join("1/planning_to_fraction.nii.gz")).unwrap();
    assert_ne!(first, fs::read(shared.join("planning_to_fraction.nii.gz")).unwrap());
    // What depends on planning alone was done once.
    let (one, two) = (stages(&both.out.join("1")), stages(&shared));
    for stage in ["build skeleton, find the patient", "link elements"] {
        assert!(one.iter().any(|s| s == stage) && two.iter().all(|s| s != stage), "{stage}: {one:?} {two:?}");
    }
    assert!(two.iter().any(|s| s == "fit skeleton"), "{two:?}");
}

#[test]
fn a_region_is_a_part_of_the_whole() {
    let whole = done();
    let roi = Register::phantom("roi").with("--roi", "mandible").flag("-q");
    roi.command().assert().success();
    let field = |out: &Path| io::read_field(out.join("planning_to_fraction.nii.gz")).unwrap().value;
    let (all, part) = (field(&whole.out), field(&roi.out));
    assert!(part.data().len() * 5 < all.data().len() * 2, "{:?} of {:?}", part.grid().size(), all.grid().size());
    // In the box of the mandible itself the part agrees with the whole.
    let labels = io::read_labels(&phantom().bones, None).unwrap().value;
    let (label, _) = labels.names.iter().find(|(_, n)| *n == "mandible").expect("the phantom has a mandible");
    let grid = labels.volume.grid();
    let start = [Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN)];
    let own = (0..grid.len()).filter(|&n| labels.volume.data()[n] == *label);
    let [low, high] = own.fold(start, |[low, high], n| {
        let x = grid.centre(grid.voxel(n)).coords;
        [low.inf(&x), high.sup(&x)]
    });
    let range = voxels_of_box(grid, [Point3::from(low), Point3::from(high)], 0.0).expect("the box lies in the scan");
    let (mut sum, mut n, mut worst) = (0.0, 0, 0.0f64);
    for k in range[2].clone() {
        for j in range[1].clone() {
            for i in range[0].clone() {
                let x = grid.centre([i, j, k]);
                let a = trilinear_vector(&all, &all.grid().index(&x)).expect("inside");
                let b = trilinear_vector(&part, &part.grid().index(&x)).expect("the part covers the box");
                let apart = (a - b).norm();
                (sum, n, worst) = (sum + apart, n + 1, worst.max(apart));
            }
        }
    }
    let mean = sum / f64::from(n);
    println!("region against whole: mean {mean:.4} mm, worst {worst:.3} mm over {n} voxels");
    // At 5 x 5 x 6 mm: the elements of the coarse spacings begin elsewhere, and tissue ends at the margin.
    assert!(mean < 0.6, "{mean} mm");
    // Around the region and its margin the field fades to the couch shift: no reader sees it torn off where the scan goes on.
    let margin = voxels_of_box(grid, [Point3::from(low), Point3::from(high)], 50.0).expect("the box lies in the scan");
    let (size, spacing) = (part.grid().size(), part.grid().spacing());
    let text = fs::read_to_string(roi.out.join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    let couch = Vector3::from_fn(|a, _| report["common_shift"][a].as_f64().expect("the report has the mean motion"));
    let length = |n: usize| (Vector3::from(part.data()[n].map(f64::from)) - couch).norm();
    let (mut border, mut steepest) = (0.0f64, [0.0f64; 2]);
    for n in 0..part.data().len() {
        let at = part.grid().voxel(n);
        let scan = grid.voxel_at(&part.grid().centre(at)).expect("a part of the scan");
        for a in 0..3 {
            let ends = at[a] == 0 || at[a] + 1 == size[a];
            if ends && scan[a] > 0 && scan[a] + 1 < grid.size()[a] {
                border = border.max(length(n));
            }
            if at[a] + 1 < size[a] {
                let next = part.grid().linear(std::array::from_fn(|b| at[b] + usize::from(a == b)));
                let [u, v] = [n, next].map(|n| Vector3::from(part.data()[n].map(f64::from)));
                let around = usize::from((0..3).any(|a| scan[a] + 1 < margin[a].start || scan[a] >= margin[a].end));
                steepest[around] = steepest[around].max((v - u).norm() / spacing[a]);
            }
        }
    }
    let most = (0..part.data().len()).map(length).fold(0.0, f64::max);
    println!(
        "field of the region: at most {most:.2} mm, {border:.2} mm where it ends; steepest {steepest:.2?} per mm in it, around it"
    );
    // What moves by more than 26 mm needs more room to fade than there is. Bones that slide on each other at the margin's edge go on to do so.
    assert!(most > 20.0 && border < 0.2 * most && steepest[1] < 1.1 * steepest[0], "{most} {border} {steepest:?}");
    // What the report looks at is in the region.
    let page = fs::read_to_string(roi.out.join("report.html")).unwrap();
    let (_, rest) = page.split_once("apart from the couch shift: ").expect("the planes go through a bone");
    let bone = rest.split(" (").next().unwrap();
    let label = labels.names.iter().find(|(_, n)| *n == bone).map(|(l, _)| *l).expect("one of the labels");
    let own: Vec<usize> = (0..grid.len()).filter(|&n| labels.volume.data()[n] == label).collect();
    let middle = |a: usize| own.iter().map(|n| grid.voxel(*n)[a]).sum::<usize>() / own.len();
    assert!((0..3).all(|a| margin[a].contains(&middle(a))), "{bone}");
    // The region is a setting, by which the run is repeated (tests/invariance.rs).
    assert_eq!(report["settings"]["region"]["label"], "mandible", "{}", report["settings"]["region"]);
}

#[test]
fn what_cannot_be_is_refused_early() {
    let refused = |register: Register, word: &str| {
        let run = register.command().assert().code(2);
        let message = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        assert!(message.contains(word) && message.contains("remedy"), "{message}");
        assert_eq!(files_below(&register.out), [""; 0]);
    };
    refused(Register::phantom("m").with("--max-memory", "0.01"), "0.01");
    refused(Register::phantom("r").with("--roi", "mandable"), "mandible");
    refused(Register::phantom("b").with("--roi", "1,2,3,0,5,6"), "--roi");
    refused(Register::phantom("l").with("--fraction", second()).with("--landmarks", &phantom().landmarks), "landmarks");
}

#[test]
fn a_missing_fraction_is_found_before_the_first_is_registered() {
    let register = Register::phantom("missing").with("--fraction", "nowhere.nii.gz");
    let run = register.command().assert().code(3);
    let message = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
    assert!(message.contains("nowhere.nii.gz") && message.contains("remedy"), "{message}");
    assert_eq!(files_below(&register.out), [""; 0]);
}

#[test]
fn a_damaged_fraction_leaves_the_results_before_it_whole() {
    let damaged = folder().join("cut.nii.gz");
    let whole = fs::read(&small_phantom().fraction).unwrap();
    fs::write(&damaged, &whole[..whole.len() / 2]).unwrap();
    let register = Register::searched("damaged_run").with("--fraction", &damaged);
    let run = register.command().assert().code(3);
    let message = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
    assert!(message.contains("cut.nii.gz"), "{message}");
    let alone = Register::searched("before_damaged");
    alone.command().assert().success();
    let (all, whole) = (files_below(&register.out), files_below(&alone.out));
    assert_eq!(all.len(), whole.len(), "{all:?}");
    let field = |out: &Path| fs::read(out.join("planning_to_fraction.nii.gz")).unwrap();
    assert_eq!(field(&register.out.join("fraction_ct")), field(&alone.out));
}
