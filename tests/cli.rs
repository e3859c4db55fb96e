//! The program as its users meet it: help, exit codes, messages, output streams, and a run that can be repeated.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::files::{self, nifti, put_f32, put_i16};
use crate::support::{
    Done, Register, aventail, bones_alone, done, files_below, folder, near, phantom, repeated, small_phantom,
};
use aventail::geometry::Grid;
use aventail::volume::{LabelMap, Volume};
use printed::{stderr, stdout};
use std::fs;
use std::path::{Path, PathBuf};

/// Reading what a run printed.
mod printed {
    use assert_cmd::assert::Assert;

    pub fn stdout(run: &Assert) -> String {
        String::from_utf8(run.get_output().stdout.clone()).expect("output is UTF-8")
    }

    pub fn stderr(run: &Assert) -> String {
        String::from_utf8(run.get_output().stderr.clone()).expect("output is UTF-8")
    }
}

/// What a successful run of `register` writes, landmarks given.
const RESULTS: [&str; 15] = [
    "body.nii.gz",
    "bone_posterior.json",
    "bone_transforms.json",
    "bones_on_fraction.nii.gz",
    "computed.nii.gz",
    "fraction_to_planning.nii.gz",
    "inside_planning.nii.gz",
    "jacobian.nii.gz",
    "landmarks.csv",
    "planning_on_fraction.nii.gz",
    "planning_to_fraction.nii.gz",
    "report.html",
    "report.json",
    "settings.toml",
    "uncertainty.nii.gz",
];

/// Runs a command line that must be refused: exit code, nothing on standard output, what the message names, a remedy,
/// and no result left behind.
fn refused(register: &Register, code: i32, names: &[&str]) {
    let run = register.command().assert().code(code);
    let message = stderr(&run);
    assert_eq!(stdout(&run), "", "{message}");
    for name in names {
        assert!(message.contains(name), "`{name}` is not in\n{message}");
    }
    assert!(message.contains("\n  remedy: "), "{message}");
    assert!(!message.contains("panicked"), "{message}");
    assert_eq!(files_below(&register.out), [""; 0], "left behind after\n{message}");
}

/// A path in this program's folder.
fn at(name: &str) -> PathBuf {
    folder().join(name)
}

#[test]
fn every_verb_has_a_manual_page_and_the_version_tells_the_build() {
    let out = at("man");
    aventail().arg("man").arg(&out).assert().success();
    let help = stdout(&aventail().arg("--help").assert().success());
    let verbs = help.lines().skip_while(|l| !l.starts_with("Commands:")).skip(1).take_while(|l| !l.is_empty());
    let verbs: Vec<&str> = verbs.filter(|l| l.starts_with("  ") && !l.starts_with("   ")).map(str::trim).collect();
    assert!(verbs.len() > 15, "{help}");
    for verb in verbs.iter().filter_map(|l| l.split(' ').next()).filter(|v| *v != "help") {
        let page = fs::read_to_string(out.join(format!("aventail-{verb}.1"))).unwrap();
        assert!(page.contains(".SH OPTIONS") || page.contains(".SH SUBCOMMANDS"), "{verb}");
    }
    let short = stdout(&aventail().arg("-V").assert().success());
    let long = stdout(&aventail().arg("--version").assert().success());
    assert_eq!(short.trim(), format!("aventail {}", env!("CARGO_PKG_VERSION")));
    assert!(
        long.starts_with(short.trim()) && long.contains(std::env::consts::ARCH) && long.contains("in use"),
        "{long}"
    );
}

#[test]
fn help_names_every_option_of_every_verb() {
    let verbs: [(&str, &[&str]); 12] = [
        (
            "register",
            &[
                "--planning",
                "--bones",
                "--fraction",
                "--out",
                "--labels",
                "--skeleton",
                "--landmarks",
                "--config",
                "--preset",
                "--dvf-format",
                "--threads",
                "--json",
                "--quiet",
                "planning_to_fraction",
                "Examples:",
            ],
        ),
        ("demo", &["--out", "--threads", "--json"]),
        ("phantom", &["--out", "--spacing", "--field", "--breathing", "--cbct", "measured.nii.gz", "--threads"]),
        (
            "warp",
            &["--field", "--from", "--to", "--input", "--kind", "--grid", "--out-field", "--dvf-format", "Examples:"],
        ),
        ("skeleton", &["--bones", "--planning", "--labels", "--out", "--json"]),
        ("labels", &["merge"]),
        ("study", &["--concepts", "--out", "--threads", "Example:"]),
        ("inspect", &["<FILE>", "--json"]),
        ("bench", &["--size", "--repeat", "--only", "--json", "Example:"]),
        ("figure", &["<OUT>", "--kind", "--plane", "--at", "--out", "Examples:"]),
        ("view", &["<OUT>", "--structures", "--no-browser", "Examples:"]),
        ("curve", &["--planning", "--landmarks", "--plan", "--peers", "--out", "Examples:"]),
    ];
    for (verb, names) in verbs {
        let help = stdout(&aventail().args([verb, "--help"]).assert().success());
        for name in names {
            assert!(help.contains(name), "`{name}` is not in the help of {verb}:\n{help}");
        }
    }
    let help = stdout(&aventail().arg("--help").assert().success());
    for name in [
        "register",
        "pose",
        "study",
        "demo",
        "phantom",
        "warp",
        "evaluate",
        "dose",
        "skeleton",
        "labels",
        "inspect",
        "bench",
        "curve",
        "figure",
        "view",
        "completions",
        "Exit codes",
        "not a medical device",
    ] {
        assert!(help.contains(name), "`{name}` is not in\n{help}");
    }
    let version = stdout(&aventail().arg("-V").assert().success());
    assert_eq!(version.trim(), format!("aventail {}", env!("CARGO_PKG_VERSION")));
}

#[test]
fn completions_know_the_verbs() {
    for shell in ["bash", "zsh", "fish"] {
        let script = stdout(&aventail().args(["completions", shell]).assert().success());
        assert!(script.contains("register") && script.contains("dvf-format"), "{shell}: {script}");
    }
}

#[test]
fn wrong_command_lines_exit_with_2() {
    let lines: [(&[&str], &str); 6] = [
        (&["regster"], "regster"),
        (&["register", "--out", "x"], "--planning"),
        (&["register", "--planning", "a", "--bones", "b", "--fraction", "c"], "--out"),
        (&["phantom", "--out", "x", "--spacing", "2x2"], "1.5x1.5x3"),
        (&["register", "--config", "c.toml", "--out", "x", "--preset", "best"], "thesis"),
        (&["completions", "tcsh"], "fish"),
    ];
    for (line, name) in lines {
        let run = aventail().args(line).assert().code(2);
        assert!(stdout(&run).is_empty() && stderr(&run).contains(name), "{line:?}: {}", stderr(&run));
    }
}

#[test]
fn illegal_settings_are_refused_by_name() {
    let settings = [
        ("[chainmail]\nexponant = 2.0", "exponant"),
        ("[chainmail.variant]\nexponent = -1.0", "exponent"),
        ("[chainmail.variant]\nexponent = \"four\"", "four"),
        ("[chainmail.variant]\ncarry = \"magic\"", "magic"),
        ("[chainmail.variant]\norder = \"first-moved\"\nstructures = \"second-criterion\"", "structures"),
        ("[chainmail.organs]\nliver = { min = 0.5, max = 1.5, shear = 0.5 }", "liver"),
        ("[chainmail.organs]\nskull = { min = 0.5, max = 1.5, shear = 0.5 }", "rigid"),
        ("[fit]\nmeasure = \"beauty\"", "beauty"),
        ("[fit]\nlevels = []", "levels"),
        ("[fit]\nlevels = [[-1.0, 4000]]", "levels"),
        ("[fit]\noutward = [[2.0, 0]]", "outward"),
        ("[chainmail]\npoisson = nan", "poisson"),
        ("[refine]\nunseen_mm = 40.0", "refine.unseen_mm"),
        ("[body]\nseparation_mm = -8.0", "separation_mm"),
        ("[body]\nclosing_mm = inf", "closing_mm"),
        ("[invert]\ntolerance_mm = 0.0", "tolerance_mm"),
        ("[output]\ngzip_level = 12", "gzip_level"),
        ("preset = \"best\"", "best"),
    ];
    for (n, (text, name)) in settings.iter().enumerate() {
        let file = files::bytes(&at(&format!("illegal{n}.toml")), text.as_bytes());
        refused(&Register::phantom(&format!("illegal{n}")).with("--config", file), 2, &[name]);
    }
    let file = files::bytes(&at("inputs_missing.toml"), b"preset = \"thesis\"");
    let run =
        aventail().args(["register", "--config"]).arg(file).arg("--out").arg(at("inputs_missing")).assert().code(2);
    assert!(stderr(&run).contains("--planning"), "{}", stderr(&run));
}

#[test]
fn unreadable_settings_exit_with_3() {
    let register = |out: &str| Register::phantom(out);
    refused(&register("s1").with("--config", at("nowhere.toml")), 3, &["nowhere.toml"]);
    let file = files::bytes(&at("broken.toml"), b"[chainmail\nexponent = 4");
    refused(&register("s2").with("--config", file), 3, &["broken.toml", "TOML"]);
    let file = files::bytes(&at("broken.json"), b"{\"settings\": ");
    refused(&register("s3").with("--config", file), 3, &["broken.json", "JSON"]);
    let file = files::bytes(&at("other.json"), b"{\"labels\": {\"1\": \"skull\"}}");
    refused(&register("s4").with("--config", file), 3, &["other.json", "settings"]);
}

#[test]
fn files_that_cannot_be_read_exit_with_3() {
    let whole = fs::read(&phantom().planning).unwrap();
    let unreadable: [(&str, PathBuf, &str); 7] = [
        ("u1", at("nowhere.nii.gz"), "no such file"),
        ("u2", folder().to_path_buf(), "folder"),
        ("u3", files::bytes(&at("cut.nii.gz"), &whole[..whole.len() / 2]), "cut.nii.gz"),
        ("u4", files::bytes(&at("empty.nii.gz"), b""), "empty"),
        ("u5", files::bytes(&at("text.nii"), &b"this is no image ".repeat(40)), "text.nii"),
        ("u6", nifti(&at("short.nii"), |b| b.truncate(b.len() - 10)), "short.nii"),
        ("u7", nifti(&at("complex.nii"), |b| put_i16(b, 70, 32)), "complex.nii"),
    ];
    for (out, file, name) in unreadable {
        refused(&Register::phantom(out).planning(&file), 3, &[name]);
        refused(&Register::phantom(out).fraction(&file), 3, &[name]);
        refused(&Register::phantom(out).bones(&file), 3, &[name]);
    }
    let bad = files::bytes(&at("labels.json"), b"[1, 2]");
    refused(&Register::phantom("u8").with("--labels", bad), 3, &["labels.json"]);
    refused(&Register::phantom("u9").with("--landmarks", at("nowhere.csv")), 3, &["nowhere.csv", "no such file"]);
}

#[test]
fn images_that_cannot_be_registered_exit_with_4() {
    let four_d = |b: &mut Vec<u8>| {
        put_i16(b, 40, 4);
        put_i16(b, 48, 2);
        let voxels = b[352..].to_vec();
        b.extend(voxels);
    };
    let nan = |b: &mut Vec<u8>| put_f32(b, 352 + 4 * 17, f32::NAN);
    let infinite = |b: &mut Vec<u8>| put_f32(b, 352 + 4 * 3, f32::INFINITY);
    // The sform's first row gains a component along j; the qform is switched off, as it would contradict.
    let sheared = |b: &mut Vec<u8>| {
        put_i16(b, 252, 0);
        put_f32(b, 284, 1.0);
    };
    let unsuitable: [(&str, PathBuf, &str); 4] = [
        ("i1", nifti(&at("four_d.nii"), four_d), "[6, 5, 4, 2]"),
        ("i2", nifti(&at("nan.nii"), nan), "NaN"),
        ("i3", nifti(&at("infinite.nii"), infinite), "inf"),
        ("i4", nifti(&at("sheared.nii"), sheared), "shear"),
    ];
    for (out, file, name) in unsuitable {
        let own = file.file_name().unwrap().to_str().unwrap();
        refused(&Register::phantom(out).planning(&file), 4, &[own, name]);
        refused(&Register::phantom(out).fraction(&file), 4, &[own, name]);
    }
    let grid = aventail::io::read_image(&phantom().planning).unwrap().value.grid().clone();
    let air = files::image(&at("constant.nii.gz"), &Volume::filled(grid.clone(), -1000.0));
    refused(&Register::phantom("i5").planning(&air), 4, &["planning CT", "-1000"]);
    refused(&Register::phantom("i6").fraction(&air), 4, &["fraction CT", "-1000"]);
    let posture = files::bytes(&at("posture.toml"), b"wing = { rotation_deg = [1, 0, 0] }\n");
    let run =
        aventail().args(["phantom", "--spacing", "9x9x9", "--pose"]).arg(&posture).arg("--out").arg(at("i8")).assert();
    let message = stderr(&run.code(4));
    assert!(message.contains("posture.toml") && message.contains("wing"), "{message}");
    let thin = Grid::axis_aligned([40, 40, 2], [2.0; 3], [0.0; 3]).unwrap();
    let thin = files::image(&at("thin.nii.gz"), &Volume::from_fn(thin, |l| l as f32));
    refused(&Register::phantom("i7").fraction(thin), 4, &["fraction CT", "[40, 40, 2]"]);
}

#[test]
fn labels_that_do_not_fit_exit_with_4() {
    let bones = aventail::io::read_labels(&phantom().bones, None).unwrap().value;
    let grid = bones.volume.grid().clone();
    let write = |name: &str, map: &LabelMap| files::labels(&at(name), map);

    let moved = grid.origin() + nalgebra::Vector3::new(0.0, 25.0, 0.0);
    let moved = Grid::new(grid.size(), grid.spacing(), moved, *grid.direction()).unwrap();
    let moved =
        LabelMap { volume: Volume::new(moved, bones.volume.data().to_vec()).unwrap(), names: bones.names.clone() };
    refused(&Register::phantom("l1").bones(write("moved.nii.gz", &moved)), 4, &["grid", "spacing", "origin"]);

    let empty = LabelMap { volume: Volume::filled(grid.clone(), 0), names: bones.names.clone() };
    refused(&Register::phantom("l2").bones(write("unlabelled.nii.gz", &empty)), 4, &["unlabelled.nii.gz"]);

    let mut nameless = bones.clone();
    nameless.names.retain(|label, _| *label != 3);
    refused(&Register::phantom("l3").bones(write("nameless.nii.gz", &nameless)), 4, &["nameless.nii.gz", "3"]);

    let organs = bones.names.keys().map(|l| (*l, format!("organ_{l}"))).collect();
    let organs = LabelMap { volume: bones.volume.clone(), names: organs };
    refused(&Register::phantom("l4").bones(write("organs.nii.gz", &organs)), 4, &["organ_1", "no label is a bone"]);

    let mut twins = bones.clone();
    let name = twins.names[&1].clone();
    twins.names.insert(2, name.clone());
    refused(&Register::phantom("l5").bones(write("twins.nii.gz", &twins)), 4, &["twins.nii.gz", &name]);

    let image = bones.volume.map(|&l| f32::from(l) + 0.5);
    refused(&Register::phantom("l6").bones(files::image(&at("halves.nii.gz"), &image)), 4, &["halves.nii.gz", "0.5"]);

    let plain = files::image(&at("no_names.nii.gz"), &bones.volume.map(|&l| f32::from(l)));
    refused(&Register::phantom("l7").bones(plain), 4, &["no_names.nii.gz", "--labels"]);
}

#[test]
fn landmarks_that_are_none_exit_with_4() {
    let head = "name,planning_x,planning_y,planning_z,fraction_x,fraction_y,fraction_z\n";
    let tables = [
        ("m1", "name,x,y\na,1,2\n".to_owned(), "planning_x"),
        ("m2", format!("{head}chin,1,2,3,4,five,6\n"), "five"),
        ("m3", head.to_owned(), "no landmark"),
    ];
    for (out, text, name) in tables {
        let file = files::bytes(&at(&format!("{out}.csv")), text.as_bytes());
        refused(&Register::phantom(out).with("--landmarks", file), 4, &[&format!("{out}.csv"), name]);
    }
}

#[test]
fn a_folder_that_cannot_be_written_to_exits_with_5() {
    // Below a regular file no folder can be made, not even by an administrator.
    let file = files::bytes(&at("a_file"), b"here");
    let register = Register { out: file.join("results"), ..Register::phantom("unused") };
    refused(&register, 5, &["a_file"]);
    for verb in ["phantom", "demo"] {
        let run = aventail().arg(verb).arg("--out").arg(file.join(verb)).assert().code(5);
        assert!(stderr(&run).contains("a_file") && stderr(&run).contains("remedy: "), "{}", stderr(&run));
    }
}

#[test]
fn images_without_common_anatomy_exit_with_6() {
    let grid = Grid::axis_aligned([60, 50, 40], [5.0; 3], [-150.0, -120.0, -100.0]).unwrap();
    // Soft blobs of tissue in air: nothing that bones of a head and neck would explain.
    let blobs = Volume::from_fn(grid.clone(), |l| {
        let p = grid.centre(grid.voxel(l));
        let wave = (p.x / 23.0).sin() * (p.y / 31.0).cos() * (p.z / 19.0).sin();
        if p.coords.norm() < 90.0 { (60.0 * wave) as f32 } else { -1000.0 }
    });
    let file = files::image(&at("blobs.nii.gz"), &blobs);
    refused(&Register::searched("f1").fraction(file), 6, &["registration failed", "bones", "same patient"]);
}

#[test]
fn results_go_to_the_folder_and_to_standard_output_diagnostics_to_standard_error() {
    let Done { out, stdout: printed, stderr: progress } = done();
    let files = files_below(out);
    let own: Vec<&str> = files.iter().map(String::as_str).filter(|f| !f.starts_with("report/")).collect();
    assert_eq!(own, RESULTS);
    assert!(files.iter().filter(|f| f.starts_with("report/") && f.ends_with(".png")).count() >= 5, "{files:?}");
    assert!(printed.contains("report.html") && printed.contains("mm"), "{printed}");
    assert!(printed.lines().count() < 60, "a short table:\n{printed}");
    assert!(progress.contains("fit skeleton") && progress.contains("propagate"), "{progress}");
    assert!(!printed.contains('\u{1b}') && !progress.contains('\u{1b}'), "no terminal, no colours");
    assert!(!printed.contains("fit skeleton ..."), "progress belongs to standard error");
}

#[test]
fn a_report_runs_again_and_prints_json() {
    // tests/invariance.rs compares their bytes.
    let Done { out: again, stdout: printed, stderr: progress } = repeated();
    assert_eq!(progress, "", "--quiet is quiet");
    let printed: serde_json::Value = serde_json::from_str(printed).unwrap();
    let (first, second) = (report(&done().out), report(again));
    assert_eq!(printed["bones"], second["bones"]);
    for part in [
        "version",
        "settings",
        "inputs",
        "bones",
        "pose",
        "jacobian",
        "contact",
        "uncertainty",
        "pruning",
        "links",
        "inverse",
        "consistency",
        "landmarks",
        "warnings",
    ] {
        assert!(!first[part].is_null(), "report.json has no {part}");
        assert_eq!(first[part], second[part], "{part}");
    }
}

#[test]
fn a_changed_input_is_noticed_when_a_report_runs_again() {
    let first = Register::quick("to_change").with("--landmarks", &small_phantom().landmarks);
    first.command().assert().success();
    let mut report = report(&first.out);
    for input in report["inputs"].as_array_mut().unwrap() {
        if input["role"] == "landmarks" {
            input["sha256"] = "0".repeat(64).into();
        }
    }
    // Beside the report, as its paths begin there.
    let file = files::bytes(&first.out.join("changed.json"), report.to_string().as_bytes());
    let run =
        aventail().args(["register", "--json", "-q", "--config"]).arg(file).arg("--out").arg(at("changed")).assert();
    let printed: serde_json::Value = serde_json::from_str(&stdout(&run.success())).unwrap();
    let warnings = printed["warnings"].as_array().unwrap();
    assert!(warnings.iter().any(|w| w["code"] == "input-changed"), "{warnings:?}");
}

#[test]
fn fields_are_written_in_the_format_asked_for() {
    let first = Register::quick("nifti");
    first.command().assert().success();
    let reference = aventail::io::read_field(first.out.join("planning_to_fraction.nii.gz")).unwrap().value;
    // The settings of a run alone are enough to make its field again when the inputs are named.
    let again = Register::of(small_phantom(), at("mha")).with("--config", first.out.join("settings.toml"));
    let again = again.with("--start", near()).flag("-q");
    for (format, register) in [("mha", again), ("nrrd", Register::quick("nrrd"))] {
        let register = register.with("--field-format", format);
        register.command().assert().success();
        let file = register.out.join(format!("planning_to_fraction.{format}"));
        let field = aventail::io::read_field(file).unwrap().value;
        assert_eq!(field.data(), reference.data(), "{format}");
        assert!(field.grid().matches(reference.grid(), 1e-3));
    }
}

#[test]
fn the_thesis_preset_runs() {
    let register = Register::of(small_phantom(), at("thesis")).with("--preset", "thesis").with("--start", near());
    let register = register.flag("--json").flag("-q");
    let printed: serde_json::Value = serde_json::from_str(&stdout(&register.command().assert().success())).unwrap();
    assert_eq!(printed["settings"]["preset"], "thesis");
}

#[test]
fn every_stage_of_the_thesis_runs_and_regions_are_written() {
    for (n, stage) in [
        "order = \"first-moved\"\ncarry = \"translation\"\ncombination = \"prioritisation\"",
        "order = \"constraint-violation\"\ncarry = \"constraint-based\"\ncombination = \"prioritisation\"",
        "structures = \"third-criterion\"\nelasticity = \"gibson\"\n[chainmail]\nrelaxation = [[0, 5]]",
    ]
    .iter()
    .enumerate()
    {
        let text = format!(
            "preset = \"thesis\"\n[fit]\noutward = [[4.0, 500]]\nlevels = [[2.0, 500]]\n[consistency]\nrounds = 0\n[chainmail.variant]\n{stage}\n[output]\nregions = true\n"
        );
        let file = files::bytes(&at(&format!("stage{n}.toml")), text.as_bytes());
        let out = at(&format!("stage{n}"));
        let register = Register::of(small_phantom(), out).with("--config", file).with("--start", near()).flag("-q");
        register.command().assert().success();
        let regions = aventail::io::read_labels(register.out.join("regions.nii.gz"), None).unwrap().value;
        let counts = regions.counts();
        assert!(counts.len() > 20 && counts.keys().all(|l| regions.names.contains_key(l)), "{counts:?}");
        // Soft tissue belongs to a bone too: much more than the bones themselves.
        let bones = aventail::io::read_labels(&small_phantom().bones, None).unwrap().value.counts();
        assert!(counts.values().sum::<usize>() > 3 * bones.values().sum::<usize>());
        assert!(bones.keys().all(|l| counts[l] >= bones[l]));
    }
}

#[test]
fn study_makes_the_concept_figures() {
    let out = at("concepts");
    let text = stdout(&aventail().args(["study", "--concepts", "-q", "--out"]).arg(&out).assert().success());
    // All but the record of their checksums.
    let files: Vec<String> = files_below(&out).into_iter().filter(|f| f != "concepts.json").collect();
    assert!(files.len() == 10 && files.iter().all(|f| text.contains(f.as_str())), "{files:?}\n{text}");
    assert!(files.iter().all(|f| std::fs::metadata(out.join(f)).unwrap().len() > 2000));
    let run = aventail().args(["study", "--out"]).arg(at("nothing")).assert().code(2);
    assert!(stderr(&run).contains("--case"), "{}", stderr(&run));
}

#[test]
fn inspect_shows_files_and_whether_they_share_a_grid() {
    let f = phantom();
    let text = stdout(&aventail().arg("inspect").args([&f.planning, &f.bones, &f.fraction]).assert().success());
    assert!(text.contains("vertebrae_C1") && text.contains("5"), "{text}");
    let run = aventail().args(["inspect", "--json"]).args([&f.planning, &f.bones]).assert().success();
    let json: serde_json::Value = serde_json::from_str(&stdout(&run)).unwrap();
    assert_eq!(json["files"].as_array().unwrap().len(), 2);
    // A dose is 0 around the patient: that is no padding.
    let grid = Grid::axis_aligned([12; 3], [4.0; 3], [0.0; 3]).unwrap();
    let dose =
        Volume::from_fn(grid.clone(), |l| if grid.voxel(l).iter().all(|c| (4..8).contains(c)) { 31.5 } else { 0.0 });
    let dose = files::image(&at("inspected_dose.nii.gz"), &dose);
    let text = stdout(&aventail().arg("inspect").arg(dose).assert().success());
    assert!(!text.contains("padded") && !text.contains("blank"), "{text}");
    let run = aventail().arg("inspect").arg(at("nowhere.nii")).assert().code(3);
    assert!(stdout(&run).is_empty() && stderr(&run).contains("nowhere.nii"));
}

#[test]
fn skeleton_shows_the_tree_and_writes_it() {
    let bones = &phantom().bones;
    let file = at("skeleton.toml");
    let run = aventail().arg("skeleton").arg("--bones").arg(bones).arg("--out").arg(&file).assert().success();
    let text = stdout(&run);
    for name in ["vertebrae_C7", "atlanto-occipital", "humerus_left", "mandible"] {
        assert!(text.contains(name), "`{name}` is not in\n{text}");
    }
    let json = stdout(&aventail().args(["skeleton", "--json", "--bones"]).arg(bones).assert().success());
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert!(json.to_string().contains("vertebrae_C7"));
    // What it writes is what `register --skeleton` takes, and unchanged it changes nothing.
    let run = |name: &str| Register::phantom(name).with("--config", bones_alone()).with("--start", near()).flag("-q");
    let fields = [run("built_skeleton"), run("own_skeleton").with("--skeleton", &file)].map(|register| {
        register.command().assert().success();
        aventail::io::read_field(register.out.join("planning_to_fraction.nii.gz")).unwrap().value
    });
    let [built, own] = &fields;
    // The file rounds; at 5 mm voxels a weakly determined bone moves by a little more than that.
    let computed = aventail::io::read_image(done().out.join("computed.nii.gz")).unwrap().value;
    let tissue = own.data().iter().zip(built.data()).zip(computed.data()).filter(|(_, c)| **c > 0.0);
    let apart: Vec<f64> = tissue.flat_map(|((a, b), _)| (0..3).map(|c| f64::from((a[c] - b[c]).abs()))).collect();
    assert!(apart.len() > 100_000);
    let mean = apart.iter().sum::<f64>() / apart.len() as f64;
    println!("skeleton from a file: {mean:.5} mm");
    assert!(mean < 0.02, "{mean} mm");
    let broken = files::bytes(&at("broken_skeleton.toml"), b"[[bones]\n");
    refused(&Register::phantom("k1").with("--skeleton", broken), 3, &["broken_skeleton.toml"]);
}

fn report(out: &Path) -> serde_json::Value {
    serde_json::from_slice(&fs::read(out.join("report.json")).unwrap()).unwrap()
}
