//! `pose.toml`: how far each joint of a skeleton is moved, by bone name.

use super::keyed::{Keyed, near, parse, parse_text};
use super::skeleton::bare;
use super::write_file;
use crate::error::Result;
use crate::skeleton::{Bone, JointPose, Pose, Skeleton};
use std::path::Path;

/// Reads a pose. Bones that the file does not name do not move against their parent.
///
/// `[bones.NAME]` has `flexion_deg`, `lateral_deg`, `axial_deg` (components of the rotation vector in the joint's axes,
/// degrees) and `shift_mm` (along the same axes). `[couch]` has `rotation_deg` and `shift_mm` of the root, which carries
/// all bones: about the root's centre and axes.
///
/// # Errors
/// [`Error::Read`](crate::error::Error::Read) when the file is missing or no TOML; [`Error::Input`](crate::error::Error::Input), naming
/// file, key and value, for unknown bones and keys, values of the wrong type, and a pose of the root under its name.
pub fn read_pose(path: impl AsRef<Path>, skeleton: &Skeleton) -> Result<Pose> {
    let table = parse(path.as_ref())?;
    pose_in(&Keyed::new(path.as_ref(), &table), skeleton, &[])
}

/// The pose of a pose file's text; `path` is its name in messages.
///
/// # Errors
/// As [`read_pose`].
pub fn parse_pose(text: &str, path: impl AsRef<Path>, skeleton: &Skeleton) -> Result<Pose> {
    let table = parse_text(text, path.as_ref())?;
    pose_in(&Keyed::new(path.as_ref(), &table), skeleton, &[])
}

/// The pose of a table that may hold `more` keys.
pub(super) fn pose_in(file: &Keyed, skeleton: &Skeleton, more: &[&str]) -> Result<Pose> {
    file.only(&[&["couch", "bones"], more].concat())?;
    let mut joints = vec![JointPose::default(); skeleton.bones.len()];
    if let (Some(couch), Some(root)) = (file.inner("couch")?, joints.first_mut()) {
        couch.only(&["rotation_deg", "shift_mm"])?;
        root.rotation = couch.numbers("rotation_deg")?.unwrap_or_default().map(f64::to_radians);
        root.translation = couch.numbers("shift_mm")?.unwrap_or_default();
    }
    let listed = file.inner("bones")?.map_or_else(|| Ok(Vec::new()), |bones| bones.each())?;
    for (name, keys) in listed {
        joints[child(name, &keys, skeleton)?] = joint(&keys)?;
    }
    Ok(Pose { joints })
}

/// The bone of this name, which is not the root.
pub(super) fn child(name: &str, keys: &Keyed, skeleton: &Skeleton) -> Result<usize> {
    let names = || skeleton.bones.iter().map(|b| b.name.as_str());
    match names().position(|n| n == name) {
        None => {
            let remedy = format!("bones of this skeleton that may be meant: {}", near(name, names()));
            Err(keys.refuse("", "no such bone", remedy))
        }
        Some(0) => Err(keys.refuse("", "this bone is the root", "move it with [couch]")),
        Some(at) => Ok(at),
    }
}

fn joint(keys: &Keyed) -> Result<JointPose> {
    keys.only(&["flexion_deg", "lateral_deg", "axial_deg", "shift_mm"])?;
    let angle = |key: &str| Ok(keys.number(key)?.unwrap_or_default().to_radians());
    Ok(JointPose {
        rotation: [angle("flexion_deg")?, angle("lateral_deg")?, angle("axial_deg")?],
        translation: keys.numbers("shift_mm")?.unwrap_or_default(),
    })
}

/// Writes a pose, leaving out joints that do not move.
///
/// # Errors
/// [`Error::Write`](crate::error::Error::Write) when the file cannot be written.
pub fn write_pose(path: impl AsRef<Path>, skeleton: &Skeleton, pose: &Pose) -> Result<()> {
    let text = text(skeleton, pose);
    write_file(path, |out| out.write_all(text.as_bytes()))
}

fn text(skeleton: &Skeleton, pose: &Pose) -> String {
    let mut out = String::from(
        "# A pose: the motion of each bone against its parent, planning to fraction.\n\
         # Angles are components of the rotation vector in the joint's axes, degrees; positive flexion bends forwards.\n\
         # Shifts are along the same axes (right-left, front-back, foot-head), mm.\n\
         # [couch] moves the root, and with it all bones.\n",
    );
    for (bone, joint) in skeleton.bones.iter().zip(&pose.joints) {
        if bone.parent.is_none() || *joint != JointPose::default() {
            out.push_str(&entry(bone, joint, ""));
        }
    }
    out
}

/// Numbers of a TOML list. Rust writes the shortest digits that read back as the same number.
pub(super) fn list(v: &[f64]) -> String {
    v.iter().map(|x| format!("{x:?}")).collect::<Vec<_>>().join(", ")
}

/// The name as a TOML key.
pub(super) fn key(name: &str) -> String {
    if bare(name) { name.to_owned() } else { toml::Value::from(name).to_string() }
}

/// A joint's table; `within` begins its heading.
pub(super) fn entry(bone: &Bone, joint: &JointPose, within: &str) -> String {
    let [flexion, lateral, axial] = joint.rotation.map(f64::to_degrees);
    let shift = list(&joint.translation);
    if bone.parent.is_none() {
        let rotation = list(&[flexion, lateral, axial]);
        return format!("\n[{within}couch]\nrotation_deg = [{rotation}]\nshift_mm = [{shift}]\n");
    }
    format!(
        "\n[{within}bones.{}]\nflexion_deg = {flexion:?}\nlateral_deg = {lateral:?}\naxial_deg = {axial:?}\nshift_mm = [{shift}]\n",
        key(&bone.name)
    )
}

#[cfg(test)]
mod tests {
    use super::super::skeleton::tests::example;
    use super::*;

    fn load(text: &str) -> Result<Pose> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("pose.toml");
        std::fs::write(&path, text).unwrap();
        read_pose(&path, &example())
    }

    #[test]
    fn written_poses_read_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("pose.toml");
        let mut pose = Pose { joints: vec![JointPose::default(); 4] };
        pose.joints[0] = JointPose { rotation: [0.1, -0.2, 1.0 / 3.0], translation: [500.0, -1e-7, 0.1] };
        pose.joints[2] = JointPose { rotation: [0.0, 0.7, 0.0], translation: [0.0, 0.0, -3.25] };
        write_pose(&path, &example(), &pose).unwrap();
        let back = read_pose(&path, &example()).unwrap();
        for (a, b) in pose.joints.iter().zip(&back.joints) {
            let values = |j: &JointPose| j.rotation.into_iter().chain(j.translation).collect::<Vec<_>>();
            for (x, y) in values(a).iter().zip(values(b)) {
                assert!((x - y).abs() <= 1e-14 * x.abs(), "{x} {y}");
            }
        }
        assert_eq!(std::fs::read_to_string(&path).unwrap().matches("[bones.").count(), 1);
    }

    #[test]
    fn degrees_go_to_the_named_bone_and_the_couch_to_the_root() {
        let pose =
            load("couch.shift_mm = [1, 2, 3]\n[bones.skull]\nflexion_deg = 90\nshift_mm = [0, 0, 1.5]\n").unwrap();
        let mut expected = vec![JointPose::default(); 4];
        expected[0].translation = [1.0, 2.0, 3.0];
        expected[2] = JointPose { rotation: [std::f64::consts::FRAC_PI_2, 0.0, 0.0], translation: [0.0, 0.0, 1.5] };
        assert_eq!(pose.joints, expected);
    }

    #[test]
    fn a_text_is_read_as_its_file_is() {
        let text = "couch.rotation_deg = [0, 0, 180]\n[bones.skull]\naxial_deg = -45\nshift_mm = [1, -2.5, 0]\n";
        let pose = parse_pose(text, "pose", &example()).unwrap();
        assert_eq!(pose, load(text).unwrap());
        let mut expected = vec![JointPose::default(); 4];
        expected[0].rotation = [0.0, 0.0, std::f64::consts::PI];
        expected[2] = JointPose { rotation: [0.0, 0.0, -std::f64::consts::FRAC_PI_4], translation: [1.0, -2.5, 0.0] };
        assert_eq!(pose.joints, expected);
        assert_eq!(parse_pose("", "pose", &example()).unwrap().joints, vec![JointPose::default(); 4]);
    }

    #[test]
    fn a_texts_name_stands_in_what_is_refused() {
        for (text, word, code) in [("[bones.skull", "posture of Monday", 3), ("[bones.skul]", "skul", 4)] {
            let error = parse_pose(text, "posture of Monday", &example()).unwrap_err();
            let told = error.to_string();
            assert!(error.exit_code() == code && told.contains("posture of Monday") && told.contains(word), "{told}");
        }
    }

    #[test]
    fn refusals_name_the_file_the_key_and_the_value() {
        let cases = [
            ("[bones.skul]", &["bones.skul", "no such bone", "skull"][..]),
            ("[bones.vertebrae_T1]", &["bones.vertebrae_T1", "root", "[couch]"]),
            ("bones.skull.flexion_deg = \"5\"", &["bones.skull.flexion_deg = \"5\"", "number"]),
            ("bones.skull.flexion_deg = inf", &["bones.skull.flexion_deg = inf", "finite"]),
            ("bones.skull.rotation_deg = [1, 2, 3]", &["bones.skull.rotation_deg", "unknown key"]),
            ("couch.rotation_deg = 5", &["couch.rotation_deg = 5", "3 finite numbers"]),
            ("couch.flexion_deg = 5", &["couch.flexion_deg", "unknown key"]),
        ];
        for (text, parts) in cases {
            let error = load(text).unwrap_err().to_string();
            for part in parts.iter().chain(&["pose.toml"]) {
                assert!(error.contains(part), "{text}: {error}");
            }
        }
    }
}
