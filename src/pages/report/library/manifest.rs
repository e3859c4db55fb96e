//! `library.json`: a datalist as MONAI reads it (`load_decathlon_datalist`), with what the library was made from.

use super::PostureRecord;
use crate::provenance::InputFile;
use crate::report::OutputFile;
use crate::warning::Warning;
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// A posture that was drawn and not kept.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Rejected {
    /// Which point of the sequence it was.
    pub draw: u32,
    /// What spoke against it.
    pub why: Vec<String>,
}

/// What a library was made from, and how.
#[derive(Debug, Clone, Serialize)]
pub struct About {
    /// Version of aventail.
    pub version: String,
    /// The command line.
    pub command: String,
    /// Files that were read.
    pub inputs: Vec<InputFile>,
    /// The settings, defaults resolved.
    pub settings: Value,
    /// How the images were degraded; nothing where they were not.
    pub degraded: Option<Value>,
    /// The plan in full, a file of the library.
    pub plan: String,
    /// Postures drawn and kept.
    pub sampled: usize,
    /// Seed of the sequence.
    pub seed: u32,
    /// Numbers behind a drawn posture.
    pub dimensions: usize,
    /// Draws that were not kept.
    pub rejected: Vec<Rejected>,
    /// What was found of the planning side.
    pub warnings: Vec<Warning>,
}

/// The datalist.
#[derive(Debug, Serialize)]
pub struct Manifest {
    name: &'static str,
    description: &'static str,
    modality: BTreeMap<&'static str, &'static str>,
    labels: BTreeMap<String, String>,
    #[serde(rename = "numTraining")]
    number: usize,
    /// Postures that nothing speaks against.
    training: Vec<Value>,
    /// The others: whoever wants them has to ask for this list by name.
    implausible: Vec<Value>,
    #[serde(flatten)]
    about: About,
    /// All files with checksums.
    outputs: Vec<OutputFile>,
}

impl Manifest {
    /// Of all postures; `names` are those of the labels, `more` the files beside the postures'.
    pub fn new(records: &[PostureRecord], names: &BTreeMap<u16, String>, about: About, more: Vec<OutputFile>) -> Self {
        let labels = names.iter().map(|(l, n)| (l.to_string(), n.clone()));
        let of = |plausible: bool| records.iter().filter(|r| r.plausible == plausible).map(entry).collect();
        let training: Vec<Value> = of(true);
        Self {
            name: "aventail library",
            description: "Artificial CTs of one patient in sampled postures, research only; paths as seen from this file",
            modality: [("0", "CT")].into(),
            labels: labels.chain([("0".to_owned(), "background".to_owned())]).collect(),
            number: training.len(),
            training,
            implausible: of(false),
            about,
            outputs: records.iter().flat_map(|r| r.outputs.clone()).chain(more).collect(),
        }
    }
}

/// A posture as an item of the datalist: its files, then what it is.
fn entry(record: &PostureRecord) -> Value {
    let mut out: Map<String, Value> = record.files.iter().map(|(k, v)| (k.clone(), json!(v))).collect();
    out.insert("posture".into(), json!(record.name));
    out.insert("joints".into(), json!(record.joints));
    let factors: BTreeMap<&str, f64> = record.volumes.iter().map(|v| (v.organ.as_str(), v.factor)).collect();
    if !factors.is_empty() {
        out.insert("volumes".into(), json!(factors));
    }
    if let Some(name) = &record.chosen {
        out.insert("chosen".into(), json!(name));
    }
    if let Some(draw) = record.draw {
        out.insert("draw".into(), json!(draw));
    }
    out.insert("folded_cells".into(), json!(record.jacobian.folded));
    out.insert("deepest_overlap_mm".into(), json!(record.deepest_mm()));
    if !record.plausible {
        out.insert("why".into(), json!(record.why));
    }
    Value::Object(out)
}
