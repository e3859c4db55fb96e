//! What is known of one posture.

use crate::evaluate::contact::ContactReport;
use crate::evaluate::jacobian::JacobianStats;
use crate::pipeline::{Outcome, VolumeReached};
use crate::postures::{Six, neck, sixes};
use crate::report::OutputFile;
use crate::skeleton::{Pose, Skeleton};
use crate::warning::Warning;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// The file of a posture's folder that holds its record.
pub const RECORD: &str = "posture.json";

/// One posture of a library, as its `posture.json` holds it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PostureRecord {
    /// Its folder in the library.
    pub name: String,
    /// The plan's name of it, where somebody chose it.
    pub chosen: Option<String>,
    /// Which point of the sequence it is, where it was drawn.
    pub draw: Option<u32>,
    /// Joint coordinates that were held at the end of their range.
    pub held: usize,
    /// Whether nothing speaks against it.
    pub plausible: bool,
    /// What does.
    pub why: Vec<String>,
    /// What it depends on: version, settings, inputs and its own motion, as a checksum.
    pub key: String,
    /// Motion of each joint that moves, `couch` for the root: flexion, lateral bending, axial turn in degrees, shift along the
    /// same axes in mm.
    pub joints: BTreeMap<String, Six>,
    /// Sums over the joints that belong together.
    pub totals: Totals,
    /// Organs' volume over that in planning, as asked and as reached.
    pub volumes: Vec<VolumeReached>,
    /// How far each bone's centroid has moved, mm.
    pub motion_mm: BTreeMap<String, f64>,
    /// Jacobian of soft and bony tissue outside contact and sliding surfaces.
    pub jacobian: JacobianStats,
    /// Bones that overlap or come apart.
    pub contact: ContactReport,
    /// What the posture's making found.
    pub warnings: Vec<Warning>,
    /// Time it took, s.
    pub seconds: f64,
    /// Its files by what they are for, seen from the library's folder.
    pub files: BTreeMap<String, String>,
    /// The same with checksums.
    pub outputs: Vec<OutputFile>,
}

/// Sums of a posture.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Totals {
    /// The couch: rotation in degrees, shift in mm.
    pub couch: Six,
    /// The neck from its lowest joint to the skull: flexion, lateral bending, axial turn, degrees.
    pub neck_deg: [f64; 3],
    /// Opening of the mouth, degrees.
    pub jaw_deg: f64,
}

impl Totals {
    /// Of a pose.
    pub fn new(skeleton: &Skeleton, pose: &Pose) -> Self {
        let values = sixes(pose);
        let of_neck = neck(skeleton);
        let jaw = skeleton.bones.iter().position(|b| b.name == "mandible");
        Self {
            couch: values.first().copied().unwrap_or_default(),
            neck_deg: std::array::from_fn(|a| of_neck.iter().map(|&n| values[n][a]).sum()),
            jaw_deg: jaw.and_then(|n| values.get(n)).map_or(0.0, |v| v[0]),
        }
    }
}

impl PostureRecord {
    /// Of a posture that was made; what is known of its choice and files is to be added.
    pub fn new(name: &str, outcome: &Outcome, why: Vec<String>) -> Self {
        let moving = outcome.skeleton.bones.iter().zip(sixes(&outcome.pose));
        let joint = |(bone, six): (&crate::skeleton::Bone, Six)| {
            let name = if bone.parent.is_none() { "couch".to_owned() } else { bone.name.clone() };
            // Noise of the way from transforms to joints.
            let six = six.map(|v| if v.abs() < 1e-9 { 0.0 } else { v });
            six.iter().any(|v| *v != 0.0).then_some((name, six))
        };
        Self {
            name: name.into(),
            chosen: None,
            draw: None,
            held: 0,
            plausible: why.is_empty(),
            why,
            key: String::new(),
            joints: moving.filter_map(joint).collect(),
            totals: Totals::new(&outcome.skeleton, &outcome.pose),
            volumes: outcome.volume_changes.clone(),
            motion_mm: outcome.bone_fits.iter().map(|b| (b.name.clone(), b.motion_mm)).collect(),
            jacobian: outcome.jacobian_report.body,
            contact: outcome.contact.clone(),
            warnings: outcome.warnings.clone(),
            seconds: 0.0,
            files: BTreeMap::new(),
            outputs: Vec::new(),
        }
    }

    /// The record in a posture's folder, if it is there and depends on the same things, and its files are as it says.
    pub fn finished(library: &Path, name: &str, key: &str) -> Option<Self> {
        let text = std::fs::read(library.join(name).join(RECORD)).ok()?;
        let record: Self = serde_json::from_slice(&text).ok()?;
        let same = |o: &OutputFile| OutputFile::written(library, &o.name, "").is_ok_and(|now| now.sha256 == o.sha256);
        (record.key == key && record.name == name && record.outputs.iter().all(same)).then_some(record)
    }

    /// The greatest motion of any bone, and the bone.
    pub fn greatest(&self) -> Option<(&str, f64)> {
        self.motion_mm.iter().max_by(|a, b| a.1.total_cmp(b.1)).map(|(name, mm)| (name.as_str(), *mm))
    }

    /// Depth of the deepest overlap of bones, mm.
    pub fn deepest_mm(&self) -> f64 {
        self.contact.overlaps.first().map_or(0.0, |o| o.depth_mm)
    }
}
