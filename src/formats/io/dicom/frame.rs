//! Frames of reference: positions of two objects can be compared only where it is the same (PS3.3
//! C.7.4.1).

use super::super::series_path::root_of;
use super::place::{Chosen, choose, is_place, is_segmentation, objects, segmentation};
use crate::error::{Error, Result};
use crate::findings;
use std::path::Path;

/// As what a path is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// A CT or MR series.
    Image,
    /// A structure set or a segmentation.
    Structures,
    /// A dose.
    Dose,
}

/// What may be DICOM, and then lies in a frame of reference.
#[derive(Debug, Clone, Copy)]
pub struct Framed<'a> {
    /// Where it is.
    pub path: &'a Path,
    /// What it is there.
    pub role: Role,
}

impl Role {
    /// What is at a path, in this role.
    pub fn at(self, path: &Path) -> Framed<'_> {
        Framed { path, role: self }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Image => "image",
            Self::Structures => "structure set",
            Self::Dose => "dose",
        }
    }
}

/// Whether two frames of reference are known and the same.
pub fn same_frame(a: &str, b: &str) -> bool {
    !a.is_empty() && a == b
}

/// The Frame of Reference UID of what a path means; `None` where it is no DICOM or does not say.
///
/// # Errors
/// As for reading it.
pub fn frame_of(Framed { path, role }: Framed<'_>) -> Result<Option<String>> {
    if !is_place(path) {
        return Ok(None);
    }
    let of = |modality: &str| {
        let mut frames = Vec::new();
        for object in objects(&root_of(path))?.objects {
            if object.series.modality == modality {
                frames.push(object.series.frame_of_reference);
            }
        }
        Ok::<_, Error>(frames.into_iter().next())
    };
    let frame = match role {
        Role::Structures if is_segmentation(path) => segmentation(path)?.map(|(o, _)| o.series.frame_of_reference),
        Role::Structures => of("RTSTRUCT")?,
        Role::Dose => of("RTDOSE")?,
        Role::Image => match choose(path)?.0 {
            Chosen::Scan(objects, _) | Chosen::Dose(objects, _) => {
                objects.into_iter().next().map(|o| o.series.frame_of_reference)
            }
            Chosen::Labels(object) => Some(object.series.frame_of_reference),
        },
    };
    Ok(frame.filter(|f| !f.is_empty()))
}

/// Refuses two things of DICOM that are used together and lie in different frames of reference.
/// What is no DICOM, or names no frame, passes: its reader says so.
///
/// # Errors
/// [`Error::Input`] with both frames.
pub fn check_frames(a: Framed<'_>, b: Framed<'_>) -> Result<()> {
    let (Some(one), Some(other)) = (frame_of(a)?, frame_of(b)?) else { return Ok(()) };
    if same_frame(&one, &other) {
        return Ok(());
    }
    let problem = format!(
        "this {} lies in another frame of reference ({one}) than the {} {} ({other}): their positions cannot be compared",
        a.role.name(),
        b.role.name(),
        b.path.display()
    );
    let remedy = format!(
        "give the {} that belongs to this {}, or map it first with a registration",
        a.role.name(),
        b.role.name()
    );
    Err(Error::refused(findings::DICOM_FRAME, a.path.display().to_string(), problem, remedy))
}
