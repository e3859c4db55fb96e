//! `skeleton.toml`: the joints of a skeleton, to be read and edited by people.
//!
//! A file need not say everything: [`load_override`] lays it over a built skeleton, key by key.

use super::keyed::{Keyed, near, parse};
use super::write_file;
use crate::error::{Error, Result};
use crate::skeleton::{Bone, Skeleton, anatomy, in_order};
use nalgebra::{Matrix3, Vector3};
use std::fmt::Write as _;
use std::path::Path;

/// Keys of a bone.
const KEYS: [&str; 9] =
    ["parent", "joint", "centre_mm", "axes", "flexion_deg", "lateral_deg", "axial_deg", "shift_mm", "source"];
/// Keys of the three rotation ranges, in the order of the joint's axes.
const RANGES: [&str; 3] = ["flexion_deg", "lateral_deg", "axial_deg"];
/// Parent of the root.
const NONE: &str = "none";
/// Departure from orthonormal axes that is taken for rounding in the file.
const ROUNDING: f64 = 1e-3;

/// Writes a skeleton with comments; reading it back over the same built skeleton changes nothing but rounding.
///
/// # Errors
/// [`Error::Write`] when the file cannot be written.
pub fn write_skeleton(path: impl AsRef<Path>, skeleton: &Skeleton) -> Result<()> {
    let text = text(skeleton);
    write_file(path, |out| out.write_all(text.as_bytes()))
}

/// The base skeleton with what a `skeleton.toml` says laid over it. Keys that the file does not name keep their value;
/// a bone that becomes the root is free, unless the file gives it ranges, and so stays one that was the root.
///
/// # Errors
/// [`Error::Read`] when the file is missing or no TOML; [`Error::Input`], naming file, key and value, for unknown bones
/// and keys, values of the wrong type, ranges that do not ascend, axes that are not orthonormal and right-handed,
/// cycles, and anything but one root.
pub fn load_override(path: impl AsRef<Path>, base: Skeleton) -> Result<Skeleton> {
    let path = path.as_ref();
    let table = parse(path)?;
    let file = Keyed::new(path, &table);
    file.only(&["bones"])?;
    let mut bones = base.bones;
    let names: Vec<String> = bones.iter().map(|b| b.name.clone()).collect();
    if let Some(listed) = file.inner("bones")? {
        for (name, keys) in listed.each()? {
            let Some(at) = names.iter().position(|n| n == name) else {
                let remedy = format!(
                    "bones of this label map that may be meant: {}",
                    near(name, names.iter().map(String::as_str))
                );
                return Err(keys.refuse("", "no such bone", remedy));
            };
            lay_over(&mut bones[at], &keys, &names)?;
        }
    }
    check_tree(path, &bones)?;
    Ok(in_order(bones))
}

/// Lays the keys of one bone over it.
fn lay_over(bone: &mut Bone, keys: &Keyed, names: &[String]) -> Result<()> {
    keys.only(&KEYS)?;
    if let Some(parent) = keys.text("parent")? {
        let old = bone.parent;
        bone.parent = names.iter().position(|n| n == parent);
        if bone.parent.is_none() && parent != NONE {
            let remedy = format!(
                "name a bone of this label map, for example {}; or \"{NONE}\" for the root",
                near(parent, names.iter().map(String::as_str))
            );
            return Err(keys.refuse("parent", "no such bone", remedy));
        }
        if old.is_some() && bone.parent.is_none() {
            let free = anatomy::unlimited();
            bone.joint.name = "root".into();
            bone.joint.centre = bone.centroid;
            bone.joint.rotation_range_deg = free.rotation_deg;
            bone.joint.translation_range_mm = free.translation_mm;
            bone.joint.source = free.source;
        }
    }
    let joint = &mut bone.joint;
    if let Some(name) = keys.text("joint")? {
        joint.name = name.to_owned();
    }
    if let Some(source) = keys.text("source")? {
        joint.source = source.to_owned();
    }
    if let Some(centre) = keys.numbers::<3>("centre_mm")? {
        joint.centre = centre.into();
    }
    if let Some(rows) = keys.rows("axes")? {
        joint.axes = axes(&rows).ok_or_else(|| {
            keys.refuse(
                "axes",
                "the three axes are not of length 1, perpendicular to each other and right-handed",
                "give flexion, lateral and axial axis so that flexion x lateral = axial",
            )
        })?;
    }
    for (axis, key) in RANGES.into_iter().enumerate() {
        if let Some(range) = keys.numbers::<2>(key)? {
            if range[0] > range[1] {
                return Err(keys.refuse(key, "the first number is greater than the second", "write [least, greatest]"));
            }
            joint.rotation_range_deg[axis] = range;
        }
    }
    if let Some(shift) = keys.numbers::<3>("shift_mm")? {
        if shift.iter().any(|s| *s < 0.0) {
            return Err(keys.refuse(
                "shift_mm",
                "a range is negative",
                "write how far it may go to either side, 0 or more",
            ));
        }
        joint.translation_range_mm = shift;
    }
    Ok(())
}

/// Axes as columns from the file's rows, made exactly orthonormal; `None` when they are not nearly so.
fn axes(rows: &[[f64; 3]; 3]) -> Option<Matrix3<f64>> {
    let m = Matrix3::from_columns(&rows.map(Vector3::from));
    let off = (m.transpose() * m - Matrix3::identity()).abs().max();
    if !(off <= ROUNDING && m.determinant() > 0.0) {
        return None;
    }
    let flexion = m.column(0).normalize();
    let axial = flexion.cross(&m.column(1).into_owned()).normalize();
    Some(Matrix3::from_columns(&[flexion, axial.cross(&flexion), axial]))
}

/// One root, and every bone reaches it.
fn check_tree(path: &Path, bones: &[Bone]) -> Result<()> {
    let refuse = |problem: String, remedy: &str| Err(Error::input(path.display().to_string(), problem, remedy));
    for bone in bones {
        let mut way = vec![bone.name.as_str()];
        let mut at = bone.parent;
        while let Some(parent) = at {
            let name = bones[parent].name.as_str();
            let round = way.contains(&name);
            way.push(name);
            if round {
                return refuse(
                    format!(
                        "bones.{}.parent: the bones hang on each other in a circle: {}",
                        bone.name,
                        way.join(" -> ")
                    ),
                    "give one of them another parent",
                );
            }
            at = bones[parent].parent;
        }
    }
    let roots: Vec<_> = bones.iter().filter(|b| b.parent.is_none()).map(|b| b.name.as_str()).collect();
    if roots.len() > 1 {
        return refuse(
            format!("{} bones have no parent: {}", roots.len(), roots.join(", ")),
            "a skeleton has one root: give the others a parent",
        );
    }
    Ok(())
}

/// The file's text.
fn text(skeleton: &Skeleton) -> String {
    let mut out = String::from(
        "# The skeleton: which bone hangs on which, where joints turn, and how far.\n\
         # Everything may be edited, and everything may be left out: what is missing is built from the label map.\n\
         #\n\
         # parent       bone that carries this one; \"none\" for the root\n\
         # centre_mm    centre of rotation in the planning CT, LPS mm\n\
         # axes         unit vectors, LPS: flexion (right-left), lateral bending (front-back), axial (foot-head)\n\
         # ..._deg      soft range about each axis, degrees: least, greatest; positive flexion bends forwards\n\
         # shift_mm     soft range of the shift along each axis, to either side, mm\n\
         # source       where the ranges come from\n",
    );
    for bone in &skeleton.bones {
        write_bone(&mut out, bone, bone.parent.map(|p| skeleton.bones[p].name.as_str()));
    }
    out
}

fn write_bone(out: &mut String, bone: &Bone, parent: Option<&str>) {
    let joint = &bone.joint;
    let number = |x: f64, digits: usize| {
        let text = format!("{x:.digits$}");
        let short = text.trim_end_matches('0');
        if short.ends_with('.') { format!("{short}0") } else { short.to_owned() }
    };
    let numbers = |v: &[f64], digits: usize| v.iter().map(|x| number(*x, digits)).collect::<Vec<_>>().join(", ");
    let quoted = |s: &str| toml::Value::from(s).to_string();
    let axes: Vec<_> =
        (0..3).map(|a| format!("[{}]", numbers(joint.axes.column(a).into_owned().as_slice(), 9))).collect();
    let lines = [
        String::new(),
        format!("[bones.{}]", if bare(&bone.name) { bone.name.clone() } else { quoted(&bone.name) }),
        format!("parent = {}", quoted(parent.unwrap_or(NONE))),
        format!("joint = {}", quoted(&joint.name)),
        format!("centre_mm = [{}]", numbers(joint.centre.coords.as_slice(), 6)),
        format!("axes = [{}]", axes.join(", ")),
    ];
    let ranges = RANGES.iter().zip(joint.rotation_range_deg).map(|(key, r)| format!("{key} = [{}]", numbers(&r, 4)));
    let last = [
        format!("shift_mm = [{}]", numbers(&joint.translation_range_mm, 4)),
        format!("source = {}", quoted(&joint.source)),
    ];
    for line in lines.into_iter().chain(ranges).chain(last) {
        writeln!(out, "{line}").expect("writing to a String cannot fail");
    }
}

/// Whether a name needs no quotation marks as a TOML key.
pub(super) fn bare(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::skeleton::Joint;
    use nalgebra::{Point3, Rotation3};

    /// T1 carries C7, which carries the skull; T1 carries a rib.
    pub(in crate::io) fn example() -> Skeleton {
        let bone = |name: &str, label: u16, parent: Option<usize>| Bone {
            name: name.into(),
            label,
            parent,
            joint: Joint {
                name: if parent.is_some() { format!("{name}-joint") } else { "root".into() },
                centre: Point3::new(f64::from(label) / 3.0, -20.0, 1.0 / 7.0),
                axes: Rotation3::from_euler_angles(0.1 * f64::from(label), 0.2, -0.3).into_inner(),
                rotation_range_deg: [[-12.5, 10.0], [-5.0, 5.0], [0.0, 2.25]],
                translation_range_mm: [1.0, 2.5, 0.0],
                source: "a \"quoted\" source".into(),
            },
            centroid: Point3::new(1.0, 2.0, f64::from(label)),
            volume_mm3: 5.0,
        };
        let bones = vec![
            bone("vertebrae_T1", 4, None),
            bone("vertebrae_C7", 3, Some(0)),
            bone("skull", 1, Some(1)),
            bone("rib_left_1", 9, Some(0)),
        ];
        Skeleton { bones }
    }

    fn load(text: &str) -> Result<Skeleton> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("skeleton.toml");
        std::fs::write(&path, text).unwrap();
        load_override(&path, example())
    }

    #[test]
    fn written_skeletons_read_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("skeleton.toml");
        let skeleton = example();
        write_skeleton(&path, &skeleton).unwrap();
        // Over a base that differs in everything a file can say.
        let mut base = skeleton.clone();
        for bone in &mut base.bones {
            bone.parent = bone.parent.map(|_| 0);
            bone.joint = example().bones[1].joint.clone();
        }
        let back = load_override(&path, base).unwrap();
        assert_eq!(back.bones.len(), 4);
        for bone in &back.bones {
            let old = skeleton.bones.iter().find(|b| b.name == bone.name).unwrap();
            let parent = |s: &Skeleton, b: &Bone| b.parent.map(|p| s.bones[p].name.clone());
            assert_eq!(parent(&back, bone), parent(&skeleton, old));
            assert!((bone.joint.centre - old.joint.centre).norm() < 1e-3);
            assert!((bone.joint.axes - old.joint.axes).abs().max() < 2e-6);
            assert!((bone.joint.axes.transpose() * bone.joint.axes - Matrix3::identity()).abs().max() < 1e-12);
            assert_eq!(bone.joint.rotation_range_deg, old.joint.rotation_range_deg);
            let shifts = bone.joint.translation_range_mm.iter().zip(old.joint.translation_range_mm);
            assert!(shifts.into_iter().all(|(a, b)| (a - b).abs() < 1e-12));
            assert_eq!((&bone.joint.name, &bone.joint.source), (&old.joint.name, &old.joint.source));
        }
    }

    #[test]
    fn what_the_file_leaves_out_is_kept() {
        let got = load("bones.skull.centre_mm = [1, 2.5, -3]\n[bones.vertebrae_C7]\naxial_deg = [-4, 6]\n").unwrap();
        let mut expected = example();
        expected.bones[2].joint.centre = Point3::new(1.0, 2.5, -3.0);
        expected.bones[1].joint.rotation_range_deg[2] = [-4.0, 6.0];
        assert_eq!(got, expected);
        assert_eq!(load("# nothing\n").unwrap(), example());
    }

    #[test]
    fn the_tree_can_be_turned_round() {
        let got = load(
            "bones.skull.parent = \"none\"\nbones.vertebrae_C7.parent = \"skull\"\nbones.vertebrae_T1.parent = \"vertebrae_C7\"\n",
        );
        let got = got.unwrap();
        let names: Vec<_> = got.bones.iter().map(|b| b.name.as_str()).collect();
        assert_eq!(names, ["skull", "vertebrae_C7", "vertebrae_T1", "rib_left_1"]);
        assert_eq!(got.bones[0].joint.centre, got.bones[0].centroid);
        assert!(got.bones[0].joint.rotation_range_deg[0][1] > 90.0);
    }

    #[test]
    fn refusals_name_the_file_the_key_and_the_value() {
        let cases = [
            ("bones.skul.joint = \"x\"", &["bones.skul", "no such bone", "skull"][..]),
            ("bones.skull.parent = \"vertebra_T1\"", &["bones.skull.parent", "\"vertebra_T1\"", "vertebrae_T1"]),
            ("bones.vertebrae_C7.parent = \"skull\"", &["circle", "vertebrae_C7 -> skull -> vertebrae_C7"]),
            ("bones.skull.parent = \"skull\"", &["circle", "skull -> skull"]),
            ("bones.skull.parent = \"none\"", &["2 bones have no parent", "vertebrae_T1, skull"]),
            ("bones.skull.axes = [[1,0,0],[0,1,0],[0,0.1,1]]", &["bones.skull.axes", "0.1", "perpendicular"]),
            ("bones.skull.axes = [[1,0,0],[0,1,0],[0,0,-1]]", &["bones.skull.axes", "right-handed"]),
            ("bones.skull.axes = [[1,0,0],[0,1,0]]", &["bones.skull.axes", "3 lists of 3"]),
            ("bones.skull.centre_mm = [1, 2]", &["bones.skull.centre_mm = [1, 2]", "3 finite numbers"]),
            ("bones.skull.centre_mm = [1, 2, nan]", &["bones.skull.centre_mm", "nan"]),
            ("bones.skull.centre_mm = \"here\"", &["bones.skull.centre_mm = \"here\""]),
            ("bones.skull.axial_deg = [5, -5]", &["bones.skull.axial_deg = [5, -5]", "least, greatest"]),
            ("bones.skull.shift_mm = [1, -1, 0]", &["bones.skull.shift_mm", "negative"]),
            ("bones.skull.joint = 3", &["bones.skull.joint = 3", "quotation marks"]),
            ("bones.skull.range = 3", &["bones.skull.range = 3", "unknown key", "flexion_deg"]),
            ("bones.skull = 3", &["bones.skull = 3", "[bones.skull]"]),
            ("joints = 3", &["joints = 3", "use one of: bones"]),
            ("bones.skull.joint = ", &["line 1"]),
        ];
        for (text, parts) in cases {
            let error = load(text).unwrap_err().to_string();
            for part in parts.iter().chain(&["skeleton.toml"]) {
                assert!(error.contains(part), "{text}: {error}");
            }
        }
        let missing = load_override("no/such/skeleton.toml", example()).unwrap_err();
        assert_eq!(missing.exit_code(), 3);
    }
}
