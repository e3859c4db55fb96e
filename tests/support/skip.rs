//! Tests that cannot run here say so, whoever runs them.

use std::io::Write;
use std::path::PathBuf;

/// Says that the running test, or a part of it, is left out, and why: past the harness, which keeps what passing tests print.
/// Where `AVENTAIL_SKIPPED` names a file, it is noted there too: `.ci/run` tells it again, and fails where all is there.
pub fn skipped(why: &str) {
    let thread = std::thread::current();
    let line = format!("skipped: {}: {why}\n", thread.name().unwrap_or("a test"));
    // One write, so that lines of two threads do not mix.
    let _ = std::io::stderr().write_all(line.as_bytes());
    if let Some(file) = std::env::var_os("AVENTAIL_SKIPPED").filter(|file| !file.is_empty()) {
        let noted = std::fs::OpenOptions::new().create(true).append(true).open(file);
        noted.and_then(|mut file| file.write_all(line.as_bytes())).expect("AVENTAIL_SKIPPED can be written to");
    }
}

/// The folder of real cases; `None`, told as [`skipped`], where `AVENTAIL_CASES` names none.
pub fn cases() -> Option<PathBuf> {
    let folder = std::env::var_os("AVENTAIL_CASES").filter(|folder| !folder.is_empty()).map(PathBuf::from);
    if folder.is_none() {
        skipped("AVENTAIL_CASES names no folder of real cases");
    }
    folder
}

/// A file of the real cases, or a folder of them; `None`, told as [`skipped`], where they lack it.
pub fn of_cases(path: PathBuf) -> Option<PathBuf> {
    if path.exists() {
        return Some(path);
    }
    skipped(&format!("the real cases have no {}", path.display()));
    None
}
