//! `[FROM:TO=]FILE[#NAME]`: fields and rigid transforms with the frames that they join.
//!
//! aventail's own fields tell their direction in the header; for every other file the command line must. Where both
//! speak they must not contradict each other, so that no field is used the wrong way round unnoticed.

use crate::error::{Error, Result};
use crate::field::{Link, Motion};
use crate::io::{FieldFrames, points::Space, split_choice, transform};
use crate::session::fields;
use crate::session::frames::FrameNames;
use crate::warning::Warning;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// One `--field`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LinkArg {
    /// The frames that the file joins, as the command line says.
    pub frames: Option<FieldFrames>,
    /// The file, with `#NAME` where a table of transforms holds several.
    pub file: String,
    /// The same as the system names it, which may be no text.
    exact: OsString,
}

impl LinkArg {
    /// Of an argument as the system gives it.
    ///
    /// # Errors
    /// As parsing a text.
    pub(super) fn of(argument: OsString) -> Result<Self, String> {
        let own: Self = argument.to_string_lossy().parse()?;
        let exact = behind(&argument, own.frames.is_some());
        Ok(Self { exact, ..own })
    }

    /// The file, and the name of its entry.
    fn place(&self) -> (PathBuf, Option<&str>) {
        let exact = Path::new(&self.exact);
        match split_choice(exact) {
            Some((path, entry)) if transform::is_transform(&path) => (path, Some(entry)),
            _ => (exact.into(), None),
        }
    }

    /// The file.
    pub(super) fn path(&self) -> PathBuf {
        self.place().0
    }
}

/// What stands behind the first `=` of an argument where frames stand before it, else all of it.
fn behind(argument: &OsStr, frames: bool) -> OsString {
    if !frames {
        return argument.to_owned();
    }
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStrExt;
        let bytes = argument.as_bytes();
        let from = bytes.iter().position(|b| *b == b'=').map_or(0, |n| n + 1);
        OsStr::from_bytes(&bytes[from..]).to_owned()
    }
    #[cfg(not(unix))]
    {
        let text = argument.to_string_lossy();
        text.split_once('=').map_or(&*text, |(_, file)| file).into()
    }
}

impl FromStr for LinkArg {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let (frames, file) = match text.split_once('=') {
            Some((head, file)) if !head.contains(['/', '\\']) && head.contains(':') => {
                let (from, to) = head.split_once(':').unwrap_or_default();
                (Some(FieldFrames { from: frame(from)?, to: frame(to)? }), file)
            }
            _ => (None, text),
        };
        if frames.as_ref().is_some_and(|f| f.from == f.to) {
            return Err("the two frames are the same".into());
        }
        if file.is_empty() {
            return Err("the file is missing: FROM:TO=FILE".into());
        }
        Ok(Self { frames, file: file.into(), exact: file.into() })
    }
}

/// A frame's name.
pub(super) fn frame(text: &str) -> Result<String, String> {
    let legal = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    if text.is_empty() || text.len() > 24 || !text.chars().all(legal) || text.contains("_to_") {
        return Err(format!("`{text}` is no name of a frame: up to 24 letters, digits, `_`, `-`, `.`, without `_to_`"));
    }
    Ok(text.into())
}

impl LinkArg {
    /// Reads the field or transform; also whether it tells its direction itself, and what is worth knowing of it. `space` is what
    /// the user says of matrices that do not tell their coordinates; `names` are those of frames of reference, by which the
    /// direction of a registration in DICOM is known.
    ///
    /// # Errors
    /// [`Error::Usage`] when its direction is unknown or said twice and differently; [`Error::Input`] when the frames of reference
    /// of a registration are not those of the scans; else as [`io::read_field`] and [`transform::read_rigid`].
    pub(super) fn read(&self, space: Option<Space>, names: &mut FrameNames) -> Result<(Link, bool, Vec<Warning>)> {
        let (path, entry) = self.place();
        let (motion, own, uids, warnings) = if transform::is_transform(&path) {
            let (rigid, uids) = transform::read_rigid_between(&path, entry, space)?;
            (Motion::Rigid(rigid), None, uids, Vec::new())
        } else {
            let (field, own, uids) = fields::open(&path)?;
            (Motion::Field(Box::new(field.value)), own, uids, field.warnings)
        };
        let by_uids = match &uids {
            Some(uids) => names.of(&self.file, uids, self.frames.as_ref())?,
            None => None,
        };
        let (FieldFrames { from, to }, told) = match (by_uids, uids) {
            (Some(known), _) => (known.frames, known.sure),
            (None, Some([a, b])) => return Err(self.unnamed(&a, &b)),
            (None, None) => {
                let told = own.is_some();
                (self.agreed(own)?, told)
            }
        };
        Ok((Link { name: self.file.clone(), from, to, motion }, told, warnings))
    }

    /// A registration whose frames of reference have no names.
    fn unnamed(&self, a: &str, b: &str) -> Error {
        Error::usage(
            format!(
                "{}: it takes points of the frame of reference {a} to {b}, and it is not known which frames these are",
                self.file
            ),
            "give it as FROM:TO=FILE with your names of these two frames",
        )
    }

    /// Whether it is a matrix that `--space` speaks of.
    pub(super) fn needs_space(&self) -> bool {
        let (path, entry) = self.place();
        entry.is_none() && transform::is_transform(&path) && transform::is_bare(&path).unwrap_or(false)
    }

    /// The frames by command line and header.
    fn agreed(&self, own: Option<FieldFrames>) -> Result<FieldFrames> {
        match (&self.frames, own) {
            (Some(FieldFrames { from, to }), Some(own)) if fields::contradicts(from, to, &own) => Err(Error::usage(
                format!(
                    "{}: its header says that it takes {} points to {}, the command line says {from}:{to}",
                    self.file, own.from, own.to
                ),
                "leave FROM:TO= out, or name the frames in the header's order",
            )),
            (Some(said), _) => Ok(said.clone()),
            (None, Some(own)) => Ok(own),
            (None, None) => Err(Error::usage(
                format!("{}: it does not say from which frame to which it takes points", self.file),
                "give it as FROM:TO=FILE. A field lies on the grid of FROM and takes its points x to x + u(x) in TO: ITK's, \
                 elastix's, plastimatch's and NiftyReg's fields of fixed image A and moving image B are A:B",
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_stand_before_the_file() {
        let parse = |text: &str| text.parse::<LinkArg>();
        let with = parse("planning:week_3=a=b.nii.gz").unwrap();
        assert_eq!(with.frames, Some(FieldFrames::new("planning", "week_3")));
        assert_eq!(with.file, "a=b.nii.gz");
        assert_eq!(parse("out/p:q=x.mha").unwrap().frames, None);
        assert_eq!(parse("C:\\fields\\f.mha").unwrap().frames, None);
        for bad in ["a:a=f.mha", "a:=f.mha", ":b=f.mha", "a:b=", "a_to_b:c=f.mha", "a:b:c=f.mha"] {
            assert!(parse(bad).is_err(), "{bad}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn files_need_not_be_text() {
        use std::os::unix::ffi::OsStrExt;
        let of = |bytes: &[u8]| LinkArg::of(OsStr::from_bytes(bytes).to_owned()).unwrap();
        let odd = of(b"planning:day=f\xff=.mha");
        assert_eq!(odd.frames, Some(FieldFrames::new("planning", "day")));
        assert_eq!(odd.path().as_os_str().as_bytes(), b"f\xff=.mha");
        assert_eq!(of(b"a=f\xff.mha").path().as_os_str().as_bytes(), b"a=f\xff.mha");
        assert_eq!(of(b"t.json#skull").place(), ("t.json".into(), Some("skull")));
        let folder = Path::new(OsStr::from_bytes(b"f\xff"));
        assert_eq!(of(b"f\xff/t.json#skull").place(), (folder.join("t.json"), Some("skull")));
    }

    #[test]
    fn header_and_command_line_must_agree() {
        let arg = |text: &str| text.parse::<LinkArg>().unwrap();
        let own = || Some(FieldFrames::new("planning", "fraction"));
        assert_eq!(arg("f.mha").agreed(own()).unwrap(), own().unwrap());
        assert_eq!(arg("planning:day2=f.mha").agreed(own()).unwrap().to, "day2");
        for (text, own, word) in [
            ("fraction:planning=f.mha", own(), "takes planning points to fraction"),
            ("day2:planning=f.mha", own(), "day2:planning"),
            ("f.mha", None, "does not say"),
        ] {
            let error = arg(text).agreed(own).unwrap_err();
            assert!(error.to_string().contains(word) && error.exit_code() == 2, "{error}");
        }
    }
}
