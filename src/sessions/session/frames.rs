//! Frames of reference of DICOM against the names that the command line has for frames: a registration between two frames of
//! reference must not be used the other way round, nor on scans that it does not belong to.

use crate::config::InputRole;
use crate::error::{Error, Result};
use crate::findings;
use crate::io::FieldFrames;
use crate::io::dicom::{Framed, Role, frame_of};
use std::path::{Path, PathBuf};

/// What a field is given for.
pub struct FieldRole<'a> {
    /// The file; its option has the role's name.
    pub given: InputRole,
    /// Frame whose points it takes.
    pub from: &'a str,
    /// Frame where they arrive.
    pub to: &'a str,
    /// What to do when it points the other way.
    pub remedy: &'a str,
}

/// UIDs of the frames of reference whose points a field takes, and where they arrive.
pub type Uids = [String; 2];

/// Frame of reference of a thing, if it is DICOM.
pub fn uid_of(place: Option<Framed<'_>>) -> Result<Option<String>> {
    place.map_or(Ok(None), frame_of)
}

/// A frame of reference that has a name.
#[derive(Debug, Clone)]
pub struct NamedFrame {
    /// Its name here.
    pub name: String,
    /// Its UID.
    pub uid: String,
    /// What lies in it.
    pub what: String,
}

/// Judges a registration of the role `role` by the frames of reference of what is known. Whether anything confirms it.
///
/// # Errors
/// [`Error::Input`] when it points the other way, or joins other frames of reference.
pub fn confirmed(
    file: &str,
    uids: &Uids,
    role: &FieldRole<'_>,
    known: impl IntoIterator<Item = NamedFrame>,
) -> Result<bool> {
    let [a, b] = uids;
    let mut sure = false;
    let known: Vec<NamedFrame> = known.into_iter().collect();
    let named = |name: &str| known.iter().find(|k| k.name == name && (k.uid == *a || k.uid == *b));
    if let (Some(one), Some(other)) = (named(role.from), named(role.to))
        && a != b
        && one.uid == other.uid
    {
        let problem = format!(
            "it takes points of the frame of reference {a} to {b}, and {} ({}) and {} ({}) both claim to lie in {}: which of them \
             is meant cannot be told",
            one.what, one.name, other.what, other.name, one.uid
        );
        let remedy =
            "give a scan of each frame of reference: for results of `register --dicom` the series in their folder ct";
        return Err(Error::refused(findings::DICOM_FRAME, file, problem, remedy));
    }
    for NamedFrame { name: frame, uid, what } in known {
        let expected = match frame.as_str() {
            f if f == role.from => a,
            f if f == role.to => b,
            _ => continue,
        };
        if uid == *expected {
            // Of two scans in one frame of reference either way fits.
            sure |= a != b;
            continue;
        }
        if uid == *a || uid == *b {
            let problem = format!(
                "it takes points of the frame of reference {a} to {b}, but --{} takes {} points to {}, and {what} ({frame}) lies in \
                 {uid}: it points the other way",
                role.given, role.from, role.to
            );
            return Err(Error::refused(findings::FIELD_DIRECTION, file, problem, role.remedy));
        }
        return Err(strange(file, uids, &what, &frame, &uid));
    }
    Ok(sure)
}

fn strange(file: &str, [a, b]: &Uids, what: &str, frame: &str, uid: &str) -> Error {
    let problem = format!("it joins the frames of reference {a} and {b}, but {what} ({frame}) lies in {uid}");
    Error::refused(findings::DICOM_FRAME, file, problem, "give the registration that belongs to these scans")
}

/// The names of a registration's frames.
#[derive(Debug, PartialEq, Eq)]
pub struct Confirmed {
    /// The names.
    pub frames: FieldFrames,
    /// Whether they are more than the user's word.
    pub sure: bool,
}

/// Names of frames of reference: what `--field FROM:TO=FILE`, `--from` and `--to` say of them.
#[derive(Default)]
pub struct FrameNames {
    known: Vec<NamedFrame>,
    /// The names of both ends of a lone field.
    ends: Option<FieldFrames>,
}

impl FrameNames {
    /// Of the things that lie in named frames. `ends` are the frames that a lone field must join.
    pub fn new(things: &[(&str, Framed<'_>)], ends: Option<FieldFrames>) -> Result<Self> {
        let mut known: Vec<NamedFrame> = Vec::new();
        for (name, thing) in things {
            if let Some(uid) = frame_of(*thing)? {
                let what = thing.path.display().to_string();
                if let Some(other) = known.iter().find(|k| k.name == *name && k.uid != uid) {
                    let problem = format!(
                        "it lies in the frame of reference {uid}, but {} in {}, and both are said to lie in {name}",
                        other.what, other.uid
                    );
                    let remedy = "give two things of one frame of reference, or map one to the other first";
                    return Err(Error::refused(findings::DICOM_FRAME, what, problem, remedy));
                }
                known.push(NamedFrame { name: (*name).into(), uid, what });
            }
        }
        Ok(Self { known, ends })
    }

    /// The names of a registration's frames, where they can be told.
    ///
    /// # Errors
    /// [`Error::Input`] when what is `said` contradicts what is known.
    pub fn of(&mut self, file: &str, uids: &Uids, said: Option<&FieldFrames>) -> Result<Option<Confirmed>> {
        let [a, b] = uids;
        if a == b {
            return Ok(said.map(|s| Confirmed { frames: s.clone(), sure: false }));
        }
        let name = |uid: &String| self.known.iter().find(|k| k.uid == *uid).map(|k| k.name.clone());
        let found = match (said, name(a), name(b)) {
            (Some(said), ..) => Some(said.clone()),
            (None, Some(from), Some(to)) => Some(FieldFrames { from, to }),
            (None, Some(from), None) => self.other(&from).map(|to| FieldFrames { from, to }),
            (None, None, Some(to)) => self.other(&to).map(|from| FieldFrames { from, to }),
            (None, None, None) => None,
        };
        let Some(frames) = found else { return Ok(None) };
        let FieldFrames { from, to } = &frames;
        let role = FieldRole { given: InputRole::Field, from, to, remedy: "correct FROM:TO, or leave it out" };
        let sure = confirmed(file, uids, &role, self.known.iter().cloned())?;
        // A frame of reference has one name.
        for (uid, name) in [(a, from), (b, to)] {
            if let Some(other) = self.known.iter().find(|k| k.uid == *uid && k.name != *name) {
                return Err(strange(file, uids, &other.what, &other.name, uid));
            }
            self.known.push(NamedFrame { name: name.clone(), uid: uid.clone(), what: file.into() });
        }
        Ok(Some(Confirmed { frames, sure }))
    }

    fn other(&self, name: &str) -> Option<String> {
        let FieldFrames { from, to } = self.ends.as_ref()?;
        if name == from { Some(to.clone()) } else { (name == to).then(|| from.clone()) }
    }
}

/// What a path is read as, for its frame of reference.
pub fn role_of(input: &Path, dose: bool) -> Role {
    match (crate::io::dicom::is_structure_set(input), dose) {
        (true, _) => Role::Structures,
        (_, true) => Role::Dose,
        _ => Role::Image,
    }
}

/// The file of an option, as DICOM of a role.
pub fn place(path: &Option<PathBuf>, role: Role) -> Option<Framed<'_>> {
    path.as_deref().map(|p| role.at(p))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uids() -> Uids {
        ["1.2.3".into(), "1.2.4".into()]
    }

    fn judged(known: &[(&str, &str)]) -> Result<bool> {
        let role = FieldRole { given: InputRole::Fields, from: "planning", to: "fraction", remedy: "turn it" };
        let known = known.iter().map(|(name, uid)| NamedFrame {
            name: (*name).into(),
            uid: (*uid).into(),
            what: format!("the {name}"),
        });
        confirmed("r.dcm", &uids(), &role, known)
    }

    #[test]
    fn a_registration_is_judged_by_frames_of_reference() {
        assert!(!judged(&[]).unwrap() && !judged(&[("third", "1.2.9")]).unwrap());
        assert!(judged(&[("planning", "1.2.3")]).unwrap() && judged(&[("fraction", "1.2.4")]).unwrap());
        for (known, code) in [
            (("planning", "1.2.4"), "field-direction"),
            (("fraction", "1.2.3"), "field-direction"),
            (("fraction", "1.2.9"), "dicom-frame"),
        ] {
            assert_eq!(judged(&[known]).unwrap_err().code(), code, "{known:?}");
        }
        // Two scans that claim one frame of reference fit neither way.
        for uid in ["1.2.3", "1.2.4"] {
            let error = judged(&[("planning", uid), ("fraction", uid)]).unwrap_err();
            assert!(error.code() == "dicom-frame" && error.to_string().contains("both claim"), "{error}");
        }
    }

    #[test]
    fn a_frame_of_reference_has_one_name() {
        let names = |known: &[(&str, &str)], ends: bool| FrameNames {
            known: known
                .iter()
                .map(|(uid, name)| NamedFrame { name: (*name).into(), uid: (*uid).into(), what: "a scan".into() })
                .collect(),
            ends: ends.then(|| FieldFrames::new("planning", "fraction")),
        };
        let said = |from: &str, to: &str| FieldFrames::new(from, to);
        let sure = |from: &str, to: &str, sure: bool| Some(Confirmed { frames: said(from, to), sure });
        let own = sure("planning", "fraction", true);
        assert_eq!(names(&[("1.2.3", "planning")], true).of("r", &uids(), None).unwrap(), own);
        assert_eq!(names(&[("1.2.4", "fraction")], true).of("r", &uids(), None).unwrap(), own);
        // The other end of one of several fields is not known, nor is either end without a scan.
        assert_eq!(names(&[("1.2.3", "planning")], false).of("r", &uids(), None).unwrap(), None);
        assert_eq!(names(&[], true).of("r", &uids(), None).unwrap(), None);
        let mut chain = names(&[], false);
        assert_eq!(chain.of("r", &uids(), Some(&said("a", "b"))).unwrap(), sure("a", "b", false));
        let onward = ["1.2.4".to_owned(), "1.2.5".to_owned()];
        for wrong in [said("c", "d"), said("b", "a")] {
            assert!(chain.of("s", &onward, Some(&wrong)).is_err(), "{wrong:?}");
        }
        assert_eq!(chain.of("s", &onward, Some(&said("b", "c"))).unwrap(), sure("b", "c", true));
        let wrong = names(&[("1.2.3", "planning")], true).of("r", &uids(), Some(&said("fraction", "planning")));
        assert_eq!(wrong.unwrap_err().code(), "field-direction");
        let same = ["1.2.3".to_owned(), "1.2.3".to_owned()];
        assert_eq!(names(&[("1.2.3", "planning")], true).of("r", &same, None).unwrap(), None);
    }
}
