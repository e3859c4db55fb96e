//! Where a dose is written, and what lies beside it.

use super::super::beside::{named, with_extension};
use crate::error::{Error, Result};
use crate::field::FieldFormat;
use crate::io;
use crate::io::dicom::like::{self, Like};
use crate::io::dicom::{Role, check_frames};
use std::path::{Path, PathBuf};

/// Where a dose goes.
pub(super) struct GiveBack<'a> {
    pub(super) out: &'a Path,
    /// The scan that an RT Dose refers to.
    pub(super) like: Option<Like>,
    pub(super) json: bool,
}

impl<'a> GiveBack<'a> {
    pub(super) fn new(series: Option<&Path>, out: &'a Path, grid: &Path, json: bool) -> Result<Self> {
        like::check(out, series, false)?;
        if let Some(series) = series {
            check_frames(Role::Image.at(grid), Role::Image.at(series))?;
        }
        Ok(Self { out, like: series.map(Like::read).transpose()?, json })
    }
}

/// The sidecar's path: the dose's with its extensions replaced.
pub(super) fn beside(out: &Path) -> PathBuf {
    with_extension(out, "json")
}

/// The page's path.
pub(super) fn page_beside(out: &Path) -> PathBuf {
    with_extension(out, "html")
}

/// Refuses a path that cannot be written before anything long begins.
pub(super) fn check_out(out: &Path, dicom: bool, inputs: &[&Path], more: &[&str]) -> Result<()> {
    if !dicom {
        FieldFormat::of(out)?;
    }
    let maps = more.iter().map(|word| named(out, word));
    let own: Vec<PathBuf> = [out.to_owned(), beside(out), page_beside(out)].into_iter().chain(maps).collect();
    io::check_files(inputs, &own)?;
    io::open_folder(parent(out))?;
    own.iter().try_for_each(|path| io::check_place(path))
}

/// Removes a file that tells of an earlier dose.
pub(super) fn gone(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
            Err(Error::write(path, e.to_string(), "remove it, or give another --out"))
        }
        _ => Ok(()),
    }
}

/// The folder of a file.
pub(super) fn parent(file: &Path) -> &Path {
    file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}
