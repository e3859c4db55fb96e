//! Vocabulary of the tests: a coarse phantom as files, the program, and what is measured against truth.

pub mod files;
pub mod score;

use assert_cmd::Command;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// A folder of this test program's own that starts empty; it stays after the tests, to be looked at.
pub fn folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(env!("CARGO_CRATE_NAME"));
        if folder.exists() {
            std::fs::remove_dir_all(&folder).expect("the folder of an earlier run can be removed");
        }
        std::fs::create_dir_all(&folder).expect("cargo's folder for tests can be written to");
        folder
    })
}

/// The program, to be given arguments.
pub fn aventail() -> Command {
    Command::new(env!("CARGO_BIN_EXE_aventail"))
}

/// A coarse phantom as files, made once by `aventail phantom`.
pub struct PhantomFiles {
    pub planning: PathBuf,
    pub bones: PathBuf,
    pub fraction: PathBuf,
    pub landmarks: PathBuf,
}

pub fn phantom() -> &'static PhantomFiles {
    static FILES: OnceLock<PhantomFiles> = OnceLock::new();
    FILES.get_or_init(|| {
        let out = folder().join("phantom");
        aventail().args(["phantom", "--spacing", "5x5x6", "--out"]).arg(&out).assert().success();
        let file = |name: &str| out.join(name);
        PhantomFiles {
            planning: file("planning_ct.nii.gz"),
            bones: file("bones.nii.gz"),
            fraction: file("fraction_ct.nii.gz"),
            landmarks: file("landmarks.csv"),
        }
    })
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
    /// The phantom, into a folder of this name.
    pub fn phantom(out: &str) -> Self {
        let f = phantom();
        Self {
            planning: f.planning.clone(),
            bones: f.bones.clone(),
            fraction: f.fraction.clone(),
            out: folder().join(out),
            more: Vec::new(),
        }
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
