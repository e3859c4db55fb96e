//! Frames of reference of DICOM against the names that the command line has for frames: a registration between two frames of
//! reference must not be used the other way round, nor on scans that it does not belong to.

use crate::config::InputRole;
use crate::error::{Error, Result};
use crate::findings;
use crate::io::dicom::{Role, frame_of};
use std::path::{Path, PathBuf};

/// What a field is given for.
pub(super) struct FieldRole<'a> {
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
pub(super) type Uids = [String; 2];

/// Frame of reference of a thing, if it is DICOM.
pub(super) fn uid_of(place: Option<(&Path, Role)>) -> Result<Option<String>> {
    place.map_or(Ok(None), |(path, role)| frame_of(path, role))
}

/// Judges a registration of the role `role` by the frames of reference of what is known: name of the frame, thing, UID. Whether
/// anything confirms it.
///
/// # Errors
/// [`Error::Input`] when it points the other way, or joins other frames of reference.
pub(super) fn confirmed(
    file: &str,
    uids: &Uids,
    role: &FieldRole<'_>,
    known: impl Iterator<Item = (String, String, String)>,
) -> Result<bool> {
    let [a, b] = uids;
    let mut sure = false;
    for (frame, what, uid) in known {
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

/// Names of frames of reference: what `--field FROM:TO=FILE`, `--from` and `--to` say of them.
#[derive(Default)]
pub(super) struct Names {
    /// UID, name, and who says so.
    known: Vec<(String, String, String)>,
    /// The names of both ends of a lone field.
    ends: Option<(String, String)>,
}

impl Names {
    /// Of the things that lie in named frames. `ends` are the frames that a lone field must join.
    pub(super) fn new(things: &[(&str, &Path, Role)], ends: Option<(&str, &str)>) -> Result<Self> {
        let mut known: Vec<(String, String, String)> = Vec::new();
        for (name, path, role) in things {
            if let Some(uid) = frame_of(path, *role)? {
                let what = path.display().to_string();
                if let Some((had, _, before)) = known.iter().find(|k| k.1 == *name && k.0 != uid) {
                    let problem = format!(
                        "it lies in the frame of reference {uid}, but {before} in {had}, and both are said to lie in {name}"
                    );
                    let remedy = "give two things of one frame of reference, or map one to the other first";
                    return Err(Error::refused(findings::DICOM_FRAME, what, problem, remedy));
                }
                known.push((uid, (*name).into(), what));
            }
        }
        Ok(Self { known, ends: ends.map(|(a, b)| (a.into(), b.into())) })
    }

    /// The names of a registration's frames, where they can be told, and whether they are more than the user's word.
    ///
    /// # Errors
    /// [`Error::Input`] when what is `said` contradicts what is known.
    pub(super) fn of(
        &mut self,
        file: &str,
        uids: &Uids,
        said: Option<&(String, String)>,
    ) -> Result<Option<((String, String), bool)>> {
        let [a, b] = uids;
        if a == b {
            return Ok(said.map(|s| (s.clone(), false)));
        }
        let name = |uid: &String| self.known.iter().find(|k| k.0 == *uid).map(|k| k.1.clone());
        let (from, to) = match (said, name(a), name(b)) {
            (Some(said), ..) => said.clone(),
            (None, Some(from), Some(to)) => (from, to),
            (None, Some(from), None) => match self.other(&from) {
                Some(to) => (from, to),
                None => return Ok(None),
            },
            (None, None, Some(to)) => match self.other(&to) {
                Some(from) => (from, to),
                None => return Ok(None),
            },
            (None, None, None) => return Ok(None),
        };
        let role =
            FieldRole { given: InputRole::Field, from: &from, to: &to, remedy: "correct FROM:TO, or leave it out" };
        let known = self.known.iter().map(|(uid, name, what)| (name.clone(), what.clone(), uid.clone()));
        let sure = confirmed(file, uids, &role, known)?;
        // A frame of reference has one name.
        for (uid, name) in [(a, &from), (b, &to)] {
            if let Some((_, other, what)) = self.known.iter().find(|k| k.0 == *uid && k.1 != *name) {
                return Err(strange(file, uids, what, other, uid));
            }
            self.known.push((uid.clone(), name.clone(), file.into()));
        }
        Ok(Some(((from, to), sure)))
    }

    fn other(&self, name: &str) -> Option<String> {
        let (a, b) = self.ends.as_ref()?;
        if name == a { Some(b.clone()) } else { (name == b).then(|| a.clone()) }
    }
}

/// What a path is read as, for its frame of reference.
pub(super) fn role_of(input: &Path, dose: bool) -> Role {
    match (crate::io::dicom::is_structure_set(input), dose) {
        (true, _) => Role::Structures,
        (_, true) => Role::Dose,
        _ => Role::Image,
    }
}

/// The file of an option, as DICOM of a role.
pub(super) fn place(path: &Option<PathBuf>, role: Role) -> Option<(&Path, Role)> {
    path.as_deref().map(|p| (p, role))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uids() -> Uids {
        ["1.2.3".into(), "1.2.4".into()]
    }

    fn judged(known: &[(&str, &str)]) -> Result<bool> {
        let role = FieldRole { given: InputRole::Fields, from: "planning", to: "fraction", remedy: "turn it" };
        let known = known.iter().map(|(frame, uid)| ((*frame).into(), format!("the {frame}"), (*uid).into()));
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
    }

    #[test]
    fn a_frame_of_reference_has_one_name() {
        let names = |known: &[(&str, &str)], ends: bool| Names {
            known: known.iter().map(|(uid, name)| ((*uid).into(), (*name).into(), "a scan".into())).collect(),
            ends: ends.then(|| ("planning".into(), "fraction".into())),
        };
        let said = |from: &str, to: &str| (from.to_owned(), to.to_owned());
        let own = Some((said("planning", "fraction"), true));
        assert_eq!(names(&[("1.2.3", "planning")], true).of("r", &uids(), None).unwrap(), own);
        assert_eq!(names(&[("1.2.4", "fraction")], true).of("r", &uids(), None).unwrap(), own);
        // The other end of one of several fields is not known, nor is either end without a scan.
        assert_eq!(names(&[("1.2.3", "planning")], false).of("r", &uids(), None).unwrap(), None);
        assert_eq!(names(&[], true).of("r", &uids(), None).unwrap(), None);
        let mut chain = names(&[], false);
        assert_eq!(chain.of("r", &uids(), Some(&said("a", "b"))).unwrap(), Some((said("a", "b"), false)));
        let onward = ["1.2.4".to_owned(), "1.2.5".to_owned()];
        for wrong in [said("c", "d"), said("b", "a")] {
            assert!(chain.of("s", &onward, Some(&wrong)).is_err(), "{wrong:?}");
        }
        assert_eq!(chain.of("s", &onward, Some(&said("b", "c"))).unwrap(), Some((said("b", "c"), true)));
        let wrong = names(&[("1.2.3", "planning")], true).of("r", &uids(), Some(&said("fraction", "planning")));
        assert_eq!(wrong.unwrap_err().code(), "field-direction");
        let same = ["1.2.3".to_owned(), "1.2.3".to_owned()];
        assert_eq!(names(&[("1.2.3", "planning")], true).of("r", &same, None).unwrap(), None);
    }
}
