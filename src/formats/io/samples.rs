//! A folder of samples of a registration: what each adds to the field, with what they were drawn from.

use super::checksum::{Output, outputs};
use super::field::{read_field, write_field};
use super::image::WriteOptions;
use super::json::{read_json, write_json};
use super::labels::{read_labels, write_labels};
use crate::error::{Error, Result};
use crate::field::FieldFormat;
use crate::findings;
use crate::geometry::rigid_from_matrix;
use crate::sampling::{Correlation, Drawn, PosePosterior, SampleSet, SamplingOptions, Strain};
use crate::volume::LabelMap;
use nalgebra::{Matrix4, RowVector4};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The file that tells of the samples beside it.
pub const SAMPLES: &str = "samples.json";
/// The bones that they move.
const BONES: &str = "bones.nii.gz";
/// What to do with a folder that cannot be used.
const REMEDY: &str = "give the folder that `aventail samples` or `aventail register --samples` has written";

/// A field that samples add to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SampledField {
    /// Its file, as seen from the folder.
    pub name: String,
    /// SHA-256 of its bytes, hexadecimal.
    pub sha256: String,
}

/// A bone that samples move.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SampledBone {
    /// Its name.
    pub name: String,
    /// Its label in `bones.nii.gz`.
    pub label: u16,
}

/// What a folder of samples says of itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SamplesFile {
    /// Version of aventail.
    pub version: String,
    /// The command line.
    pub command: String,
    /// How they were drawn.
    pub options: SamplingOptions,
    /// Over what lengths they are alike.
    pub correlation: Correlation,
    /// How much the registration deforms soft tissue, and the factor that follows.
    #[serde(default)]
    pub strain: Strain,
    /// The fields that they add to, in both directions.
    pub fields: Vec<SampledField>,
    /// The bones.
    pub bones: Vec<SampledBone>,
    /// For each sample and bone a 4x4 that takes the fitted bone in the fraction to where it may be, LPS mm.
    pub motions: Vec<Vec<[[f64; 4]; 4]>>,
    /// The files beside it.
    #[serde(skip_deserializing, default)]
    pub outputs: Vec<Output>,
}

impl SamplesFile {
    /// Refuses samples, in `folder`, that were drawn of another registration than the field of this file and checksum.
    ///
    /// # Errors
    /// [`Error::Input`] then.
    pub fn require_of(&self, folder: &Path, field: &Path, sha256: &str) -> Result<()> {
        if self.fields.iter().any(|own| own.sha256 == sha256) {
            return Ok(());
        }
        let names: Vec<&str> = self.fields.iter().map(|f| f.name.as_str()).collect();
        let problem = format!(
            "these samples were drawn of another registration than {} (by its checksum); they belong to {}",
            field.display(),
            names.join(" and ")
        );
        let remedy = "give the field of the run that they lie in, or draw samples of this run with `aventail samples`";
        Err(Error::refused(findings::SAMPLES_OF_ANOTHER_RUN, folder.display().to_string(), problem, remedy))
    }
}

/// Names of the files of so many samples.
pub fn names(number: usize) -> impl Iterator<Item = String> {
    std::iter::once(BONES.to_owned()).chain((1..=number).map(file))
}

fn file(sample: usize) -> String {
    format!("sample_{sample:03}.nii.gz")
}

/// Writes samples into a folder, `samples.json` last. `about` comes without motions, bones and outputs; `beside` are files that
/// lie there already and belong to them.
///
/// # Errors
/// [`Error::Write`] when a file cannot be written.
pub fn write(
    folder: &Path,
    labels: &LabelMap,
    posterior: &PosePosterior,
    drawn: &[Drawn],
    beside: &[&str],
    mut about: SamplesFile,
) -> Result<()> {
    let SamplingOptions { number, seed, scale } = about.options;
    let options = |what: String| WriteOptions { description: format!("aventail: {what}"), ..WriteOptions::default() };
    write_labels(folder.join(BONES), labels, &options("bones that samples move".into()))?;
    for (n, one) in drawn.iter().enumerate() {
        let what = format!("sample {} of {number}, seed {seed}, scale {scale}: adds to a field, LPS mm", n + 1);
        write_field(folder.join(file(n + 1)), &one.tissue, FieldFormat::Nifti, &options(what))?;
    }
    let rows = |m: Matrix4<f64>| [0, 1, 2, 3].map(|r| [0, 1, 2, 3].map(|c| m[(r, c)]));
    about.motions = drawn.iter().map(|d| d.bones.iter().map(|b| rows(b.to_homogeneous())).collect()).collect();
    about.bones = posterior.bones.iter().map(|b| SampledBone { name: b.name.clone(), label: b.label }).collect();
    let all = names(number).map(PathBuf::from).chain(beside.iter().map(PathBuf::from));
    about.outputs = outputs(folder, &all.collect::<Vec<_>>())?;
    write_json(folder.join(SAMPLES), &about)
}

/// Reads what a folder of samples says of itself.
///
/// # Errors
/// [`Error::Read`] when it holds none.
pub fn about(folder: &Path) -> Result<SamplesFile> {
    read_json(&folder.join(SAMPLES), REMEDY)
}

/// Reads a folder of samples.
///
/// # Errors
/// [`Error::Read`] when a file is missing or damaged; [`Error::Input`] when they do not belong together.
pub fn read(folder: &Path) -> Result<(SamplesFile, SampleSet)> {
    let (path, about) = (folder.join(SAMPLES), about(folder)?);
    let labels = read_labels(folder.join(BONES), None)?.value;
    let motion = |rows: &[[f64; 4]; 4]| {
        let matrix = Matrix4::from_rows(&rows.map(RowVector4::from));
        rigid_from_matrix(&matrix).ok_or_else(|| Error::read(&path, "a bone's motion is not rigid", REMEDY))
    };
    let one = |(n, motions): (usize, &Vec<[[f64; 4]; 4]>)| {
        let tissue = read_field(folder.join(file(n + 1)))?.value;
        Ok(Drawn { bones: motions.iter().map(motion).collect::<Result<_>>()?, tissue })
    };
    let drawn: Vec<Drawn> = about.motions.iter().enumerate().map(one).collect::<Result<_>>()?;
    let bones: Vec<u16> = about.bones.iter().map(|b| b.label).collect();
    let set = SampleSet::new(&labels.volume, &bones, &drawn)?;
    Ok((about, set))
}
