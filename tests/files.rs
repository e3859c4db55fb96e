//! Files and process: no input is overwritten, a folder holds one run, what is written can be checked and found again, and
//! what arguments or headers tell is refused at once.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::{
    Register, aventail, copy, files_below, folder, near, quick_settings as quick, small_phantom as phantom,
};
use assert_cmd::assert::Assert;
use aventail::geometry::Grid;
use aventail::volume::{LabelMap, Volume};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

fn stderr(run: &Assert) -> String {
    String::from_utf8_lossy(&run.get_output().stderr).into_owned()
}

/// A run of the fastest kind on the phantom.
#[track_caller]
fn fast(out: &str) -> Register {
    Register::quick(out)
}

/// Registers the phantom of large voxels.
fn register(out: &str) -> Register {
    Register::of(phantom(), folder().join(out))
}

/// A finished run that tests may read and copy.
fn done() -> &'static Path {
    static RUN: OnceLock<PathBuf> = OnceLock::new();
    RUN.get_or_init(|| {
        let run = fast("done");
        run.command().assert().success();
        run.out
    })
}

/// Bytes of all files below a folder, by name.
fn contents(of: &Path) -> Vec<(String, Vec<u8>)> {
    files_below(of).into_iter().map(|name| (name.clone(), fs::read(of.join(name)).unwrap())).collect()
}

/// The same command line, to be let alone.
fn spawned(register: &Register) -> Child {
    let command = register.command();
    let mut own = Command::new(command.get_program());
    own.args(command.get_args()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

fn ended(child: &mut Child) -> bool {
    child.try_wait().unwrap().is_some()
}

/// Waits until `what` holds.
fn wait(mut what: impl FnMut() -> bool) {
    let start = Instant::now();
    while !what() {
        assert!(start.elapsed() < Duration::from_secs(120), "it did not come");
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn no_verb_overwrites_its_inputs() {
    let home = folder().join("same");
    fs::create_dir_all(&home).unwrap();
    for (from, name) in [
        (&phantom().bones, "body.nii.gz"),
        (&phantom().fraction, "planning_on_fraction.nii.gz"),
        (&phantom().landmarks, "landmarks.csv"),
        (&phantom().planning, "x.nii.gz"),
        (&phantom().planning.with_file_name("dose.nii.gz"), "d.nii.gz"),
        (&phantom().planning.with_file_name("true_planning_to_fraction.nii.gz"), "f.nii.gz"),
    ] {
        fs::copy(from, home.join(name)).unwrap();
    }
    fs::write(home.join("s.toml"), "").unwrap();
    fs::copy(home.join("d.nii.gz"), home.join("dose_difference.nii.gz")).unwrap();
    let before = contents(&home);
    let at = |name: &str| home.join(name).display().to_string();
    let out = home.display().to_string();
    let (p, b, f) = (&phantom().planning, &phantom().bones, &phantom().fraction);
    let [p, b, f] = [p, b, f].map(|path| path.display().to_string());
    let lines: [(&str, &str); 9] = [
        ("body.nii.gz", "register --planning {p} --bones {body} --fraction {f} --out {out}"),
        ("planning_on_fraction.nii.gz", "register --planning {p} --bones {b} --fraction {fx} --out {out}"),
        ("landmarks.csv", "register --planning {p} --bones {b} --fraction {f} --landmarks {lm} --out {out}"),
        ("landmarks.csv", "evaluate --planning-to-fraction {field} --landmarks {lm} --out {out}"),
        ("x.nii.gz", "warp --field {field} --from planning --to fraction --kind image --input {x} --out {x}"),
        ("f.nii.gz", "warp --field {field} --from planning --to fraction --out-field {field}"),
        ("d.nii.gz", "dose map --dose {d} --to fraction --planning-to-fraction {field} --grid {f} --out {d}"),
        ("dose_difference.nii.gz", "dose compare --dose {d} --reference {dd} --out {out}"),
        ("body.nii.gz", "skeleton --bones {body} --out {body}"),
    ];
    for (name, line) in lines {
        let own = [
            ("{p}", p.clone()),
            ("{b}", b.clone()),
            ("{f}", f.clone()),
            ("{out}", out.clone()),
            ("{body}", at("body.nii.gz")),
            ("{fx}", at("planning_on_fraction.nii.gz")),
            ("{lm}", at("landmarks.csv")),
            ("{x}", at("x.nii.gz")),
            ("{d}", at("d.nii.gz")),
            ("{dd}", at("dose_difference.nii.gz")),
            ("{field}", at("f.nii.gz")),
        ];
        let args = line.split(' ').map(|word| own.iter().find(|(key, _)| *key == word).map_or(word, |(_, path)| path));
        let run = aventail().args(args).assert().code(4);
        let message = stderr(&run);
        assert!(message.contains(&at(name)) && message.contains("[input-overwritten]"), "{line}\n{message}");
    }
    assert!(contents(&home) == before, "nothing has changed");
}

#[cfg(unix)]
#[test]
fn links_lead_to_the_file_itself() {
    use std::os::unix::fs::symlink;
    let home = folder().join("links");
    fs::create_dir_all(home.join("out")).unwrap();
    fs::copy(&phantom().bones, home.join("bones.nii.gz")).unwrap();
    fs::write(home.join("victim.txt"), "precious").unwrap();
    symlink("../bones.nii.gz", home.join("out/body.nii.gz")).unwrap();
    let run = register("links/out").bones(home.join("bones.nii.gz")).command().assert().code(4);
    assert!(stderr(&run).contains("body.nii.gz") && stderr(&run).contains("bones.nii.gz"), "{}", stderr(&run));
    // Hidden files that are links are no way out of the folder.
    for hidden in [".aventail-probe", ".aventail-run"] {
        symlink("../victim.txt", home.join("out").join(hidden)).unwrap();
    }
    aventail().args(["phantom", "--spacing", "12x12x12", "--out"]).arg(home.join("out")).assert().success();
    assert_eq!(fs::read(home.join("victim.txt")).unwrap(), b"precious");
}

#[test]
fn two_runs_at_once_and_killed_runs_never_share_a_folder() {
    let register = fast("shared").flag("--threads").flag("1");
    let out = &register.out;
    let mut first = spawned(&register);
    wait(|| out.join(".aventail-run").exists());
    let run = register.command().assert().code(5);
    let message = stderr(&run);
    assert!(message.contains(&first.id().to_string()) && message.contains("shared"), "{message}");
    assert!(first.wait().unwrap().success());
    aventail().arg("inspect").arg(out).assert().success();
    // Killed while it writes, over the result before.
    let other = fast("shared").with("--dvf-format", "mha");
    // It is soon done: once more where it was missed.
    let caught = || {
        let mut killed = spawned(&other);
        wait(|| !out.join("report.json").exists() && files_below(out).len() > 4 || ended(&mut killed));
        killed.kill().unwrap();
        !killed.wait().unwrap().success()
    };
    assert!((0..20).any(|_| caught()));
    assert!(!out.join("report.json").exists(), "no report before all is there");
    let run = aventail().arg("inspect").arg(out).assert().code(4);
    assert!(stderr(&run).contains("was stopped"), "{}", stderr(&run));
    register.command().assert().success();
    aventail().arg("inspect").arg(out).assert().success();
    assert_eq!(files_below(out), files_below(done()), "nothing of the other run is left");
}

#[test]
fn leftovers_of_other_settings_go_and_notes_stay() {
    let out = folder().join("leftovers");
    copy(done(), &out);
    fs::write(out.join("notes.txt"), "mine").unwrap();
    fast("leftovers").with("--dvf-format", "mha").command().assert().success();
    let names = files_below(&out);
    assert!(names.contains(&"notes.txt".to_owned()) && names.contains(&"planning_to_fraction.mha".to_owned()));
    assert!(!names.contains(&"planning_to_fraction.nii.gz".to_owned()), "{names:?}");
    aventail().arg("inspect").arg(&out).assert().success();
    // A refused run takes nothing away.
    let before = contents(&out);
    fast("leftovers").with("--roi", "mandable").command().assert().code(2);
    assert!(contents(&out) == before);
}

#[test]
fn inspect_names_what_is_missing_changed_or_of_another_run() {
    let out = folder().join("changed");
    copy(done(), &out);
    let text = String::from_utf8(aventail().arg("inspect").arg(&out).assert().success().get_output().stdout.clone());
    assert!(text.unwrap().contains("as its report says"));
    fs::remove_file(out.join("body.nii.gz")).unwrap();
    fs::copy(out.join("computed.nii.gz"), out.join("jacobian.nii.gz")).unwrap();
    fs::copy(out.join("computed.nii.gz"), out.join("skin_contact.nii.gz")).unwrap();
    let message = stderr(&aventail().arg("inspect").arg(&out).assert().code(4));
    for words in ["missing: body.nii.gz", "jacobian.nii.gz", "of another run", "skin_contact.nii.gz", "[run-changed]"] {
        assert!(message.contains(words), "{words}: {message}");
    }
    assert!(!message.contains("computed"), "{message}");
    let empty = folder().join("empty");
    fs::create_dir_all(&empty).unwrap();
    assert!(stderr(&aventail().arg("inspect").arg(&empty).assert().code(4)).contains("[no-run]"));
}

#[test]
fn reports_are_found_from_any_folder_and_after_a_move() {
    let home = folder().join("moved");
    copy(phantom().planning.parent().unwrap(), &home.join("before/data"));
    let data = |name: &str| Path::new("data").join(name);
    aventail()
        .current_dir(home.join("before"))
        .args(["register", "-q", "--out", "run", "--start", &near(), "--config"])
        .arg(quick())
        .arg("--planning")
        .arg(data("planning_ct.nii.gz"))
        .arg("--bones")
        .arg(data("bones.nii.gz"))
        .arg("--fraction")
        .arg(data("fraction_ct.nii.gz"))
        .assert()
        .success();
    let report: serde_json::Value =
        serde_json::from_slice(&fs::read(home.join("before/run/report.json")).unwrap()).unwrap();
    assert_eq!(report["inputs"][0]["path"], "../data/planning_ct.nii.gz");
    fs::rename(home.join("before"), home.join("after")).unwrap();
    let again = || {
        let mut command = aventail();
        command.current_dir(folder()).args(["register", "-q", "--config", "moved/after/run/report.json", "--out"]);
        command
    };
    again().arg("moved/again").assert().success();
    let field = "planning_to_fraction.nii";
    let field = if home.join("again").join(field).exists() { field } else { "planning_to_fraction.nii.gz" };
    assert_eq!(
        fs::read(home.join("again").join(field)).unwrap(),
        fs::read(home.join("after/run").join(field)).unwrap()
    );
    // A run is not repeated over itself: its report is an input.
    let message = stderr(&again().arg("moved/after/run").assert().code(4));
    assert!(message.contains("report.json"), "{message}");
    let plan = folder().join("plan.toml");
    let one = "[[table]]\ntitle = 'T'\nsource = ''\n[[table.stage]]\nid = 'near'\nname = 'n'\n\
               settings = { soft_tissue = 'nearest-bone', fit = { outward = [[4.0, 500]], levels = [[2.0, 500]] } }\n";
    fs::write(&plan, one).unwrap();
    let mut study = aventail();
    study.current_dir(folder()).args(["study", "-q", "--case", "moved/after/run", "--out", "moved/study", "--plan"]);
    study.arg(plan).assert().success();
}

#[test]
fn what_needs_no_voxels_is_refused_without_them() {
    // Files whose values are cut off: whatever is refused is refused by headers.
    let cut = |from: &Path, name: &str| {
        let bytes = fs::read(from).unwrap();
        crate::support::files::bytes(&folder().join(name), &bytes[..bytes.len() / 2])
    };
    let (planning, fraction) = (cut(&phantom().planning, "p.nii.gz"), cut(&phantom().fraction, "q.nii.gz"));
    let whole = register;
    let register = |out: &str| whole(out).planning(&planning).fraction(&fraction);
    let refused = |register: Register, code: i32, word: &str| {
        let message = stderr(&register.command().assert().code(code));
        assert!(message.contains(word), "{word}: {message}");
        assert_eq!(files_below(&register.out), [""; 0]);
    };
    refused(register("h1").with("--max-memory", "0.01"), 2, "--max-memory 0.01");
    refused(register("h2").with("--roi", "mandable"), 2, "mandible");
    refused(register("h3").flag("--roi").flag("5000,0,0,5100,10,10"), 2, "outside the planning CT");
    refused(register("h4").with("--fraction", "nowhere.nii.gz"), 3, "nowhere.nii.gz");
    refused(register("h5").with("--volume-change", "parotid=0.8"), 2, "parotid");
    let grid = Grid::axis_aligned([5, 5, 5], [9.0; 3], [0.0; 3]).unwrap();
    let labels = LabelMap { volume: Volume::filled(grid, 1), names: [(1, "skull".to_owned())].into() };
    let labels = crate::support::files::labels(&folder().join("small.nii.gz"), &labels);
    refused(whole("h6").fraction(&fraction).bones(labels), 4, "is not that of the planning CT");
    refused(register("h7").with("--threads", "100000"), 2, "1024");
    refused(register("h8"), 3, "p.nii.gz");
    let field = phantom().planning.with_file_name("true_planning_to_fraction.nii.gz");
    for (out, code) in [("warped.jpg", 2), ("nowhere/warped.nii.gz", 5)] {
        let mut warp = aventail();
        warp.args(["warp", "--from", "planning", "--to", "fraction", "--kind", "image", "--input"]).arg(&planning);
        let message = stderr(&warp.arg("--field").arg(&field).arg("--out").arg(folder().join(out)).assert().code(code));
        assert!(message.contains(out), "{message}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn what_cannot_be_printed_exits_with_5() {
    let image = phantom().bones.display().to_string();
    let lines: [&[&str]; 6] = [
        &["inspect", "--json", &image],
        &["inspect", &image],
        &["skeleton", "--json", "--bones", &image],
        &["--help"],
        &["--version"],
        &["completions", "bash"],
    ];
    for line in lines {
        let program = aventail().get_program().to_owned();
        let run = |out: Stdio| Command::new(&program).args(line).stdout(out).stderr(Stdio::piped()).output().unwrap();
        let full = run(fs::OpenOptions::new().write(true).open("/dev/full").unwrap().into());
        assert_eq!(full.status.code(), Some(5), "{line:?}");
        assert!(String::from_utf8_lossy(&full.stderr).contains("standard output"), "{line:?}");
        let unwritable = run(fs::File::open("/dev/null").unwrap().into());
        assert_eq!(unwritable.status.code(), Some(5), "{line:?}");
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let closed = run(writer.into());
        assert!(closed.status.success() && closed.stderr.is_empty(), "{line:?}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn arguments_that_are_no_text_work_to_the_end() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let home = folder().join(OsStr::from_bytes(b"odd\xff"));
    let at = |name: &[u8]| home.join(OsStr::from_bytes(name));
    fs::create_dir_all(&home).unwrap();
    fs::copy(&phantom().planning, at(b"ct\xfe.nii.gz")).unwrap();
    // A start is no text with the space that is named behind it.
    let register = Register::searched("unused").planning(at(b"ct\xfe.nii.gz"));
    Register { out: at(b"out"), ..register }.command().assert().success();
    aventail().arg("inspect").arg("--json").arg(at(b"out")).arg(at(b"ct\xfe.nii.gz")).assert().success();
    let again = at(b"again");
    aventail()
        .args(["register", "-q", "--config"])
        .arg(at(b"out/report.json"))
        .arg("--out")
        .arg(again)
        .assert()
        .success();
    let field = fs::read_dir(at(b"out")).unwrap().map(|e| e.unwrap().path());
    let field = field.into_iter().find(|p| p.to_string_lossy().contains("planning_to_fraction")).unwrap();
    let mut warp = aventail();
    warp.args(["warp", "--from", "planning", "--to", "fraction", "--field"]).arg(&field);
    warp.arg("--input").arg(&phantom().landmarks).arg("--out").arg(at(b"moved\xff.csv")).assert().success();
    let mut evaluate = aventail();
    evaluate.args(["evaluate", "-q", "--planning-to-fraction"]).arg(field).arg("--out").arg(at(b"judged"));
    evaluate.assert().success();
    aventail().arg("inspect").arg(at(b"judged")).assert().success();
}

/// Runs a verb of words whose files are named by their key.
fn run(line: &str, names: &[(&str, PathBuf)]) -> Assert {
    let word = |w| names.iter().find(|(key, _)| *key == w).map_or_else(|| PathBuf::from(w), |(_, path)| path.clone());
    aventail().args(line.split(' ').map(word)).assert()
}

#[test]
fn every_verb_leaves_checksums_that_inspect_verifies() {
    let home = folder().join("sums");
    fs::create_dir_all(&home).unwrap();
    let plan = "[[table]]\ntitle = 'T'\nsource = ''\n[[table.stage]]\nid = 'near'\nname = 'n'\nsettings = { \
                soft_tissue = 'nearest-bone', preset = 'fast', fit = { outward = [[4.0, 500]], levels = [[2.0, 500]] } }\n";
    fs::write(home.join("plan.toml"), plan).unwrap();
    fs::write(home.join("other.toml"), plan.replace("near'\n", "other'\n")).unwrap();
    let data = |name: &str| phantom().planning.with_file_name(name);
    let mut names: Vec<(&str, PathBuf)> = vec![
        ("{dose}", data("dose.nii.gz")),
        ("{field}", data("true_planning_to_fraction.nii.gz")),
        ("{contours}", data("contours.json")),
        ("{ct}", data("fraction_ct.nii.gz")),
        ("{bones}", data("bones.nii.gz")),
        ("{planning}", data("planning_ct.nii.gz")),
        ("{landmarks}", data("landmarks.csv")),
        ("{run}", done().to_owned()),
        ("{plan}", home.join("plan.toml")),
        ("{other}", home.join("other.toml")),
    ];
    let folders = [
        ("dvh", "dvh_figures.csv", "dose dvh --dose {dose} --structures {contours} --out {out}"),
        ("compare", "dose_difference.nii.gz", "dose compare --dose {dose} --reference {dose} --out {out}"),
        ("study", "stages/near.json", "study -q --case {run} --plan {plan} --out {out}"),
        ("concepts", "concepts.json", "study -q --concepts --out {out}"),
        (
            "curve",
            "curve.md",
            "curve -q --threads 1 --planning {planning} --bones {bones} --fraction {ct} --landmarks {landmarks} --plan {plan} --out {out}",
        ),
        ("phantom", "fraction_2/landmarks.csv", "phantom --spacing 20x20x20 --out {out}"),
    ];
    for (name, file, line) in folders {
        let out = home.join(name);
        names.push(("{out}", out.clone()));
        run(line, &names).success();
        let text =
            String::from_utf8(aventail().arg("inspect").arg(&out).assert().success().get_output().stdout.clone());
        let told = text.unwrap();
        assert!(told.contains("as its report says") && !told.contains(" 0 files"), "{line}: {told}");
        // Every file is listed, but for the record itself.
        let count = files_below(&out).len() - 1;
        assert!(told.contains(&format!(" {count} files")), "{line}: {told} {:?}", files_below(&out));
        if !file.ends_with("concepts.json") {
            fs::write(out.join(file), "other").unwrap();
            let message = stderr(&aventail().arg("inspect").arg(&out).assert().code(4));
            assert!(message.contains(file) && message.contains("[run-changed]"), "{line}: {message}");
        }
        names.pop();
    }
    // A study of other stages takes away what the one before has left; a folder of one verb is none of another's.
    names.push(("{out}", home.join("study")));
    run("study -q --case {run} --plan {other} --out {out}", &names).success();
    let left = files_below(&home.join("study"));
    assert!(left.iter().all(|f| !f.contains("near")) && left.iter().any(|f| f == "stages/other.json"), "{left:?}");
    aventail().arg("inspect").arg(home.join("study")).assert().success();
    names.push(("{single}", home.join("single.nii.gz")));
    names.push(("{json}", home.join("single.json")));
    names.push(("{taken}", data("dose.nii.gz")));
    let map = "dose map --dose {dose} --to fraction --planning-to-fraction {field} --grid {ct} --out";
    run(&format!("{map} {{single}}"), &names).success();
    run("inspect {json}", &names).success();
    fs::write(home.join("single.nii.gz"), "other").unwrap();
    assert!(stderr(&run("inspect {json}", &names).code(4)).contains("single.nii.gz"));
    names[0].1 = home.join("copy.nii.gz");
    fs::copy(data("dose.nii.gz"), home.join("copy.nii.gz")).unwrap();
    let message = stderr(&run(&format!("{map} {{taken}}"), &names).code(4));
    assert!(message.contains("[folder-of-another-run]") && message.contains("phantom.json"), "{message}");
}
