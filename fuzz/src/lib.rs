//! Fuzz targets: each takes any bytes, gives them to a reader as a file, and writes back what was read.
//!
//! A target panics where a reader or a write-back does; anything else is an answer. `cargo fuzz run NAME` runs one with
//! libFuzzer, `tests/fuzz.rs` all of them with a plain byte mutator on stable Rust.

use aventail::config::{ConfigFile, StudyPlan};
use aventail::error::Error;
use aventail::geometry::Grid;
use aventail::io::points::{Space, read_points};
use aventail::io::{self, WriteOptions, inspect};
use aventail::phantom::{CbctOptions, Posture, degrade};
use aventail::report::Report;
use aventail::skeleton::{Bone, Joint, Skeleton};
use aventail::volume::Volume;
use nalgebra::{Matrix3, Point3};
use std::cell::RefCell;
use std::path::{Path, PathBuf};

/// A target's name, function, and small valid files to start from.
pub type Target = (&'static str, fn(&[u8]), fn() -> Vec<Vec<u8>>);

/// All targets.
pub const TARGETS: &[Target] = &[
    ("nifti", nifti, seeds::nifti),
    ("metaimage", metaimage, seeds::metaimage),
    ("nrrd", nrrd, seeds::nrrd),
    ("label_names", label_names, seeds::label_names),
    ("points_csv", points_csv, seeds::points_csv),
    ("points_markups", points_markups, seeds::points_markups),
    ("points_fcsv", points_fcsv, seeds::points_fcsv),
    ("points_elastix", points_elastix, seeds::points_elastix),
    ("mesh_obj", mesh_obj, seeds::mesh_obj),
    ("mesh_stl", mesh_stl, seeds::mesh_stl),
    ("contours", contours, seeds::contours),
    ("landmarks", landmarks, seeds::landmarks),
    ("density", density, seeds::density),
    ("transform_text", transform_text, seeds::transform_text),
    ("transform_json", transform_json, seeds::transform_json),
    ("settings", settings, seeds::settings),
    ("study", study, seeds::study),
    ("pose", pose, seeds::pose),
    ("posture", posture, seeds::pose),
    ("cbct", cbct, seeds::cbct),
    ("skeleton", skeleton, seeds::skeleton),
    ("report", report, seeds::report),
    ("dicom_ct", dicom::ct, dicom::ct_seeds),
    ("dicom_rtstruct", dicom::rtstruct, dicom::rtstruct_seeds),
    ("dicom_rtdose", dicom::rtdose, dicom::rtdose_seeds),
    ("dicom_reg", dicom::reg, dicom::reg_seeds),
    ("dicom_seg", dicom::seg, dicom::seg_seeds),
];

/// Images of more voxels are not written back, to keep runs short.
const MOST_VOXELS: usize = 4096;

thread_local! {
    /// A folder of this thread, in memory where the system has such a place.
    static FOLDER: RefCell<Option<PathBuf>> = const { RefCell::new(None) };
}

fn folder() -> PathBuf {
    FOLDER.with_borrow_mut(|folder| {
        folder
            .get_or_insert_with(|| {
                let memory = Path::new("/dev/shm");
                let base = if memory.is_dir() { memory.to_path_buf() } else { std::env::temp_dir() };
                let own = format!("aventail-fuzz-{}-{:?}", std::process::id(), std::thread::current().id());
                let path = base.join(own.replace(['(', ')'], ""));
                std::fs::create_dir_all(&path).expect("a folder for the fuzzer's files");
                path
            })
            .clone()
    })
}

/// Removes this thread's files.
pub fn clean_up() {
    FOLDER.with_borrow_mut(|folder| folder.take().map(std::fs::remove_dir_all));
}

/// The bytes as a file of this name.
fn file(name: &str, data: &[u8]) -> PathBuf {
    let path = folder().join(name);
    std::fs::write(&path, data).expect("the fuzzer's file can be written");
    path
}

/// Reads an image file in every way, and writes back what was read.
fn image(name: &str, data: &[u8]) {
    let path = file(name, data);
    let options = WriteOptions::default();
    let out = |ext: &str| folder().join(format!("out.{ext}"));
    if let Ok(read) = inspect::inspect(&path) {
        let _ = read.to_string();
    }
    let _ = io::read_grid(&path);
    if let Ok(read) = io::read_image(&path)
        && read.value.grid().len() <= MOST_VOXELS
    {
        for ext in ["nii.gz", "mha", "nrrd"] {
            let _ = io::write_image(out(ext), &read.value, io::Stored::Float32, &options);
            let _ = io::read_image(out(ext));
        }
        let _ = io::write_image(out("nii"), &read.value, io::Stored::Int16, &options);
    }
    let _ = io::read_labels(&path, None);
    if let Ok(read) = io::read_label_map(&path, None)
        && read.value.volume.grid().len() <= MOST_VOXELS
    {
        for ext in ["nii.gz", "mha", "nrrd"] {
            let _ = io::write_labels(out(ext), &read.value, &options);
        }
        let _ = io::read_labels(out("nii.gz"), None);
    }
    if let Ok(read) = io::read_field(&path)
        && read.value.grid().len() <= MOST_VOXELS
    {
        for format in [aventail::field::FieldFormat::Nifti, aventail::field::FieldFormat::NiftyregDeformation] {
            let _ = io::write_field(out("nii"), &read.value, format, &options);
            let _ = io::read_field(out("nii"));
        }
    }
}

/// NIfTI, plain or gzip.
pub fn nifti(data: &[u8]) {
    image("a.nii", data);
}

/// MetaImage.
pub fn metaimage(data: &[u8]) {
    image("a.mha", data);
}

/// NRRD.
pub fn nrrd(data: &[u8]) {
    image("a.nrrd", data);
}

/// Names of labels as JSON, on a label map of the labels 1 to 4.
pub fn label_names(data: &[u8]) {
    let map = file("labels.nrrd", &seeds::label_map());
    let _ = io::read_labels(&map, Some(&file("names.json", data)));
}

/// Reads positions, writes them back moved, and reads what was written.
fn points(name: &str, data: &[u8], space: Option<Space>) {
    let path = file(name, data);
    let Ok(read) = read_points(&path, "planning", space) else { return };
    let out = folder().join(format!("out.{name}"));
    let moved: Vec<Point3<f64>> = read.points.iter().map(|p| Point3::new(p.x + 1.0, p.y, p.z)).collect();
    match read.write(&out, &moved) {
        Ok(()) => {
            let back =
                read_points(&out, "planning", space).unwrap_or_else(|e| panic!("what was written is unreadable: {e}"));
            // Corners of a mesh that lie closer than its numbers tell become one.
            let kept = back.points.len() == moved.len() || name.ends_with(".stl");
            assert!(kept, "{} of {} points came back", back.points.len(), moved.len());
        }
        Err(Error::Write { .. }) => {}
        Err(other) => panic!("{other}"),
    }
}

/// Points as CSV.
pub fn points_csv(data: &[u8]) {
    points("a.csv", data, None);
}

/// Slicer's markups.
pub fn points_markups(data: &[u8]) {
    points("a.mrk.json", data, None);
}

/// Slicer's older fiducials.
pub fn points_fcsv(data: &[u8]) {
    points("a.fcsv", data, None);
}

/// elastix's points.
pub fn points_elastix(data: &[u8]) {
    points("a.txt", data, None);
}

/// Wavefront OBJ.
pub fn mesh_obj(data: &[u8]) {
    points("a.obj", data, Some(Space::Lps));
}

/// STL, text or binary.
pub fn mesh_stl(data: &[u8]) {
    points("a.stl", data, None);
}

/// Contours.
pub fn contours(data: &[u8]) {
    let Ok((contours, _)) = io::read_contours(file("a.json", data)) else { return };
    let out = folder().join("out.json");
    io::write_contours(&out, &contours, "planning").unwrap_or_else(|e| panic!("{e}"));
    let _ = io::read_contours(&out);
}

/// Landmarks, on bones or not.
pub fn landmarks(data: &[u8]) {
    let path = file("a.csv", data);
    let _ = (io::read_landmarks(&path), io::read_bone_landmarks(&path));
}

/// Mass density by CT number.
pub fn density(data: &[u8]) {
    let _ = io::read_density(file("a.csv", data));
}

/// ITK's text and bare matrices.
pub fn transform_text(data: &[u8]) {
    let path = file("a.txt", data);
    let _ = io::transform::read_rigid(&path, None, Some(Space::Ras));
    let _ = (io::transform::read_rigid(&path, Some("lps"), None), io::transform::is_bare(&path));
}

/// Matrices as JSON.
pub fn transform_json(data: &[u8]) {
    let path = file("a.json", data);
    let _ = io::transform::read_rigid(&path, Some("skull"), None);
    let _ = (io::transform::read_rigid(&path, None, Some(Space::Lps)), io::read_bone_transforms(&path));
}

/// Settings as TOML.
pub fn settings(data: &[u8]) {
    if let Ok(config) = ConfigFile::read(&file("a.toml", data)).and_then(|c| c.resolve(None)) {
        let _ = (config.toml(), config.problem());
    }
}

/// A plan of a study.
pub fn study(data: &[u8]) {
    if let Ok(plan) = StudyPlan::read(&file("a.toml", data)) {
        let _ = plan.stages();
    }
}

/// Two bones, the second on the first.
fn bones() -> Skeleton {
    let bone = |name: &str, label: u16, parent: Option<usize>| Bone {
        name: name.into(),
        label,
        parent,
        joint: Joint {
            name: format!("{name}-joint"),
            centre: Point3::new(1.0, 2.0, 3.0),
            axes: Matrix3::identity(),
            rotation_range_deg: [[-10.0, 10.0]; 3],
            translation_range_mm: [1.0; 3],
            source: "made up".into(),
        },
        centroid: Point3::origin(),
        volume_mm3: 5.0,
    };
    Skeleton { bones: vec![bone("vertebrae_C7", 2, None), bone("skull", 1, Some(0))] }
}

/// A pose of two bones.
pub fn pose(data: &[u8]) {
    let skeleton = bones();
    if let Ok(pose) = io::pose::read_pose(file("a.toml", data), &skeleton) {
        let out = folder().join("out.toml");
        io::pose::write_pose(&out, &skeleton, &pose).unwrap_or_else(|e| panic!("{e}"));
        io::pose::read_pose(&out, &skeleton).unwrap_or_else(|e| panic!("{e}"));
    }
}

/// Settings of a cone-beam CT, and an image made with what was read.
pub fn cbct(data: &[u8]) {
    if let Ok(options) = std::str::from_utf8(data).map_err(|e| e.to_string()).and_then(CbctOptions::parse) {
        let grid = Grid::axis_aligned([5, 4, 6], [30.0, 40.0, 20.0], [0.0; 3]).expect("a grid");
        let _ = degrade(&Volume::filled(grid, 20.0), &options, 1);
        let text = options.to_toml().unwrap_or_else(|e| panic!("{e}"));
        CbctOptions::parse(&text).unwrap_or_else(|e| panic!("{e}"));
    }
}

/// A posture of the phantom.
pub fn posture(data: &[u8]) {
    if let Ok(posture) = std::str::from_utf8(data).map_err(|e| e.to_string()).and_then(Posture::parse) {
        let _ = posture.pose(&bones());
    }
}

/// Changes to a skeleton.
pub fn skeleton(data: &[u8]) {
    if let Ok(changed) = io::skeleton::load_override(file("a.toml", data), bones()) {
        let out = folder().join("out.toml");
        io::skeleton::write_skeleton(&out, &changed).unwrap_or_else(|e| panic!("{e}"));
        io::skeleton::load_override(&out, bones()).unwrap_or_else(|e| panic!("{e}"));
    }
}

/// The report of an earlier run, as its settings and as itself.
pub fn report(data: &[u8]) {
    let path = file("report.json", data);
    let _ = Report::read(&path, "give another");
    if let Ok(config) = ConfigFile::read(&path) {
        let _ = config.resolve(None);
    }
}

pub mod dicom;
mod seeds;
