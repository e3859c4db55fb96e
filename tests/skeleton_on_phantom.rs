//! The skeleton and the body that are found on the phantom, against what the phantom knows.

use crate::support::shared::fine;
use aventail::body::{self, BodyOptions};
use aventail::skeleton;

#[test]
fn joints_and_skin_are_where_the_phantom_has_them() {
    // The coarse phantom's hyoid falls to pieces.
    let phantom = fine();
    let built = skeleton::build(&phantom.bones).unwrap();
    assert!(built.warnings.is_empty() && built.ignored.is_empty(), "{:?} {:?}", built.warnings, built.ignored);
    assert_eq!(built.skeleton.bones.len(), phantom.skeleton.bones.len());
    for truth in &phantom.skeleton.bones {
        let own = built.skeleton.bones.iter().find(|b| b.name == truth.name).unwrap();
        let tolerance = match truth.name.as_str() {
            // The root's centre is a convention; so is the height of the atlas's axis along the dens.
            name if truth.parent.is_none() || name == "vertebrae_C1" => 15.0,
            name if name.starts_with("vertebrae") || name.starts_with("rib") || name.starts_with("humerus") => 3.0,
            // The elbows lie 130 mm outside the image.
            name if name.starts_with("ulna") || name.starts_with("radius") => 30.0,
            _ => 10.0,
        };
        let off = (own.joint.centre - truth.joint.centre).norm();
        assert!(off <= tolerance, "{}: {off:.1} mm", truth.name);
    }
    let body = body::find(&phantom.planning, Some(&phantom.bones), &BodyOptions::default()).unwrap();
    let common = body.data().iter().zip(phantom.body.data()).filter(|(a, b)| **a && **b).count();
    let dice = 2.0 * common as f64 / (body.count() + phantom.body.count()) as f64;
    assert!(dice >= 0.99, "Dice {dice:.4}");
}
