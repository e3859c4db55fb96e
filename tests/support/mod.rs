//! Vocabulary of the tests: a coarse phantom as files, the program, and what is measured against truth.

pub mod browser;
pub mod files;
pub mod score;
pub mod shared;
pub mod skip;
pub mod viewer;
pub mod views;

use assert_cmd::Command;
use aventail::geometry::Grid;
use aventail::volume::Volume;
use std::collections::BTreeMap;
use std::panic::Location;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock};

/// A folder of the calling file's own that starts empty; it stays after the tests, to be looked at.
#[track_caller]
pub fn folder() -> &'static Path {
    let file = Path::new(Location::caller().file());
    named_folder(file.file_stem().and_then(|n| n.to_str()).expect("a file of tests has a name"))
}

fn named_folder(name: &str) -> &'static Path {
    static FOLDERS: Mutex<BTreeMap<String, &'static Path>> = Mutex::new(BTreeMap::new());
    let mut folders = FOLDERS.lock().expect("no thread stopped while a folder was made");
    if let Some(folder) = folders.get(name) {
        return folder;
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    if folder.exists() {
        std::fs::remove_dir_all(&folder).expect("the folder of an earlier run can be removed");
    }
    std::fs::create_dir_all(&folder).expect("cargo's folder for tests can be written to");
    folders.entry(name.to_owned()).or_insert(Box::leak(folder.into_boxed_path()))
}

/// The program, to be given arguments.
pub fn aventail() -> Command {
    Command::new(env!("CARGO_BIN_EXE_aventail"))
}

/// A coarse phantom as files, made once by `aventail phantom` for all tests, which only read them.
pub struct PhantomFiles {
    pub planning: PathBuf,
    pub bones: PathBuf,
    pub fraction: PathBuf,
    pub landmarks: PathBuf,
}

pub fn phantom() -> &'static PhantomFiles {
    static FILES: OnceLock<PhantomFiles> = OnceLock::new();
    FILES.get_or_init(|| PhantomFiles::new("phantom_5_5_6", "5x5x6"))
}

/// The same with large voxels, which takes a second.
pub fn small_phantom() -> &'static PhantomFiles {
    static FILES: OnceLock<PhantomFiles> = OnceLock::new();
    FILES.get_or_init(|| PhantomFiles::new("phantom_9", "9x9x9"))
}

impl PhantomFiles {
    fn new(name: &str, spacing: &str) -> Self {
        let out = named_folder(name).join("files");
        aventail().args(["phantom", "--spacing", spacing, "--out"]).arg(&out).assert().success();
        let file = |name: &str| out.join(name);
        Self {
            planning: file("planning_ct.nii.gz"),
            bones: file("bones.nii.gz"),
            fraction: file("fraction_ct.nii.gz"),
            landmarks: file("landmarks.csv"),
        }
    }
}

/// Settings of a run whose accuracy does not matter.
pub fn quick_settings() -> &'static Path {
    static FILE: OnceLock<PathBuf> = OnceLock::new();
    let text = "preset = \"fast\"\nsoft_tissue = \"nearest-bone\"\n[fit]\nlevels = [[2.0, 500]]\n";
    FILE.get_or_init(|| files::bytes(&named_folder("quick").join("settings.toml"), text.as_bytes()))
}

/// A motion near that of all bones of the phantoms' first fraction, for `--start`: the search for it would take most of a quick run.
pub fn near() -> String {
    static FILE: OnceLock<PathBuf> = OnceLock::new();
    let text = b"1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
    let file = FILE.get_or_init(|| files::bytes(&named_folder("near").join("start.txt"), text));
    format!("{}#lps", file.display())
}

/// Settings that find bones as the default does, and spend no time on what lies between them.
pub fn bones_alone() -> &'static Path {
    static FILE: OnceLock<PathBuf> = OnceLock::new();
    let text = "soft_tissue = \"nearest-bone\"\n[consistency]\nrounds = 0\n[output]\nuncertainty = false\n";
    FILE.get_or_init(|| files::bytes(&named_folder("bones_alone").join("settings.toml"), text.as_bytes()))
}

/// A `register` command line on the phantom, any part of which can be replaced.
#[derive(Clone)]
pub struct Register {
    pub planning: PathBuf,
    pub bones: PathBuf,
    pub fraction: PathBuf,
    pub out: PathBuf,
    pub more: Vec<String>,
}

impl Register {
    /// The phantom, into a folder of this name in the calling file's folder.
    #[track_caller]
    pub fn phantom(out: &str) -> Self {
        Self::of(phantom(), folder().join(out))
    }

    /// The phantom of large voxels with [`quick_settings`], near its motion, into a folder of this name in the
    /// calling file's folder.
    #[track_caller]
    pub fn quick(out: &str) -> Self {
        Self::searched(out).with("--start", near())
    }

    /// The same with a search for the motion, as several fractions need it.
    #[track_caller]
    pub fn searched(out: &str) -> Self {
        Self::of(small_phantom(), folder().join(out)).with("--config", quick_settings()).flag("--quiet")
    }

    /// These files, into a folder.
    pub fn of(f: &PhantomFiles, out: PathBuf) -> Self {
        let [planning, bones, fraction] = [&f.planning, &f.bones, &f.fraction].map(Clone::clone);
        Self { planning, bones, fraction, out, more: Vec::new() }
    }

    pub fn planning(self, planning: impl Into<PathBuf>) -> Self {
        Self { planning: planning.into(), ..self }
    }

    pub fn bones(self, bones: impl Into<PathBuf>) -> Self {
        Self { bones: bones.into(), ..self }
    }

    pub fn fraction(self, fraction: impl Into<PathBuf>) -> Self {
        Self { fraction: fraction.into(), ..self }
    }

    /// An option and its value.
    pub fn with(mut self, option: &str, value: impl AsRef<Path>) -> Self {
        self.more.extend([option.to_owned(), value.as_ref().display().to_string()]);
        self
    }

    pub fn flag(mut self, flag: &str) -> Self {
        self.more.push(flag.to_owned());
        self
    }

    pub fn command(&self) -> Command {
        let mut command = aventail();
        command.arg("register").arg("--planning").arg(&self.planning).arg("--bones").arg(&self.bones);
        command.arg("--fraction").arg(&self.fraction).arg("--out").arg(&self.out).args(&self.more);
        command
    }
}

/// A finished run of `register` on the phantom, and what it printed.
pub struct Done {
    pub out: PathBuf,
    pub stdout: String,
    pub stderr: String,
}

/// One run with landmarks and settings as they come, for all tests that look at it.
pub fn done() -> &'static Done {
    static RUN: OnceLock<Done> = OnceLock::new();
    RUN.get_or_init(|| {
        let out = named_folder("done").join("run");
        let register = Register::of(phantom(), out).with("--landmarks", &phantom().landmarks);
        let output = register.command().assert().success().get_output().clone();
        let text = |bytes| String::from_utf8(bytes).expect("output is UTF-8");
        Done { out: register.out, stdout: text(output.stdout), stderr: text(output.stderr) }
    })
}

/// Every second voxel of each slice's rows and columns.
pub fn thinned<T: Copy + Default + Send + Sync>(image: &Volume<T>) -> Volume<T> {
    let old = image.grid();
    let ([ni, nj, nk], s) = (old.size(), old.spacing());
    let grid =
        Grid::new([ni.div_ceil(2), nj.div_ceil(2), nk], [2.0 * s[0], 2.0 * s[1], s[2]], old.origin(), *old.direction())
            .expect("a coarser grid is legal");
    Volume::from_fn(grid.clone(), |l| {
        let [i, j, k] = grid.voxel(l);
        *image.at([2 * i, 2 * j, k])
    })
}

/// [`done`] once more, by its report and on another number of threads.
pub fn repeated() -> &'static Done {
    static RUN: OnceLock<Done> = OnceLock::new();
    RUN.get_or_init(|| {
        let out = named_folder("done").join("repeated");
        let one = std::thread::available_parallelism().is_ok_and(|n| n.get() > 1);
        let mut command = aventail();
        command.args(["register", "--json", "--quiet", "--threads", if one { "1" } else { "2" }, "--config"]);
        command.arg(done().out.join("report.json")).arg("--out").arg(&out);
        let output = command.assert().success().get_output().clone();
        let text = |bytes| String::from_utf8(bytes).expect("output is UTF-8");
        Done { out, stdout: text(output.stdout), stderr: text(output.stderr) }
    })
}

/// Copies all files below a folder.
pub fn copy(from: &Path, to: &Path) {
    for name in files_below(from) {
        let target = to.join(&name);
        let parent = target.parent().expect("it lies in the folder");
        std::fs::create_dir_all(parent).expect("the folder can be made");
        std::fs::copy(from.join(name), target).expect("the file can be copied");
    }
}

/// The phantom of large voxels with its DICOM set, which tests only read.
pub fn dicom_phantom() -> &'static Path {
    static OUT: OnceLock<PathBuf> = OnceLock::new();
    OUT.get_or_init(|| {
        let out = named_folder("phantom_dicom").join("files");
        aventail().args(["phantom", "--dicom", "--spacing", "9x9x9", "--out"]).arg(&out).assert().success();
        out
    })
}

/// Names of all files below a folder, `/` between parts, sorted.
pub fn files_below(folder: &Path) -> Vec<String> {
    let mut names = Vec::new();
    let Ok(entries) = std::fs::read_dir(folder) else { return names };
    for entry in entries {
        let path = entry.expect("the folder can be listed").path();
        let name = path.file_name().expect("an entry has a name").to_string_lossy().into_owned();
        if path.is_dir() {
            names.extend(files_below(&path).into_iter().map(|n| format!("{name}/{n}")));
        } else {
            names.push(name);
        }
    }
    names.sort();
    names
}
