//! Writing a carried dose, and what is to be said about it.

use super::super::beside::named;
use super::super::record::{self, Output};
use super::super::terminal::command_line;
use super::args::MAPS;
use super::carried::PageContent;
use super::counted::CARRIED;
use super::out::{GiveBack, beside, gone, page_beside, parent};
use super::pages;
use super::sampled::Spread;
use crate::dose::judge_result;
use crate::error::Result;
use crate::io::dicom::CarriedDose;
use crate::io::{self, Stored, WriteOptions, write_json};
use crate::pipeline::DoseReport;
use crate::provenance::{InputFile, Provenance};
use crate::report::dose::SampledDose;
use crate::volume::Volume;
use crate::warning::Warning;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// What is written beside a mapped or accumulated dose.
#[derive(Serialize)]
struct Sidecar<'a> {
    version: &'a str,
    command: String,
    inputs: Vec<InputFile>,
    weights: Vec<f64>,
    parts: Vec<DoseReport>,
    /// How far it may be off, where samples tell.
    #[serde(skip_serializing_if = "Option::is_none")]
    samples: Option<SampledDose>,
    warnings: Vec<Warning>,
    /// The dose, with its checksum.
    outputs: Vec<Output>,
}

/// A dose that was carried, alone or as the sum of several.
pub(super) struct Carried<'a> {
    pub(super) dose: &'a Volume<f32>,
    pub(super) weights: Vec<f64>,
    pub(super) parts: Vec<DoseReport>,
    /// The files of the doses.
    pub(super) sources: &'a [&'a Path],
    /// How far it may be off, where samples tell.
    pub(super) spread: Option<Spread>,
}

/// Writes a dose and what is to be said about it.
pub(super) fn finish(
    back: &GiveBack<'_>,
    Carried { dose, weights, parts, sources, spread }: Carried<'_>,
    mut provenance: Provenance,
    page: Option<PageContent>,
    fields: &[&Path],
) -> Result<String> {
    let (out, json) = (back.out, back.json);
    provenance.warnings.extend(judge_result(&out.display().to_string(), dose)?);
    let options = WriteOptions { description: CARRIED.into(), ..WriteOptions::default() };
    // What tells of an earlier dose goes before that dose does.
    let maps = MAPS.map(|word| named(out, word));
    [beside(out), page_beside(out)].iter().chain(&maps).try_for_each(|path| gone(path))?;
    match &back.like {
        Some(like) => provenance.warnings.extend(like.dose(out, dose, CarriedDose::Dose, [sources, fields])?),
        None => io::write_image(out, dose, Stored::Float32, &options)?,
    }
    let of_samples = spread.as_ref().map(|spread| spread.told.text()).unwrap_or_default();
    let text = table(&parts) + &counted(&weights) + &of_samples + &listed(&provenance.warnings);
    let warnings = all_warnings(&provenance, &parts);
    let mut written = vec![out.to_owned()];
    if let Some(page) = page {
        written.push(page_beside(out));
        let drawn: Vec<Warning> = warnings.iter().cloned().chain(page.warnings).collect();
        pages::write(&page_beside(out), &page.title, &provenance, &drawn, page.pictures, page.tables)?;
    }
    if let Some(spread) = &spread {
        written.extend(spread.write(back, sources, fields)?);
    }
    let command = command_line();
    let inputs = provenance.seen_from(parent(out));
    let names: Vec<PathBuf> = written.iter().map(|path| path.file_name().unwrap_or_default().into()).collect();
    let outputs = record::outputs(parent(out), &names)?;
    let samples = spread.map(|spread| spread.told);
    let version = env!("CARGO_PKG_VERSION");
    let sidecar = Sidecar { version, command, inputs, weights, parts, samples, warnings, outputs };
    write_json(beside(out), &sidecar)?;
    if json {
        return io::json(&sidecar);
    }
    let page = written
        .get(1)
        .filter(|path| path.extension().is_some_and(|e| e == "html"))
        .map_or(String::new(), |page| format!("\nThe page: {}", page.display()));
    Ok(format!("{text}The dose: {}{page}", out.display()))
}

/// What was warned of: the inputs, then each dose that was carried.
fn all_warnings(provenance: &Provenance, parts: &[DoseReport]) -> Vec<Warning> {
    provenance.warnings.iter().chain(parts.iter().flat_map(|part| &part.warnings)).cloned().collect()
}

/// The figures of each part for the terminal.
fn table(parts: &[DoseReport]) -> String {
    let mut text = String::new();
    for (n, part) in parts.iter().enumerate() {
        let mut line = |t: String| writeln!(text, "  {t}").expect("writing to a String cannot fail");
        line(format!("dose {}: {}", n + 1, part.direction.name()));
        if let Some(b) = &part.balance {
            line(format!(
                "energy: {} J in, {} J mapped, {} J outside the target grid; relative error {:.1e}",
                joules(b.source_j),
                joules(b.mapped_j),
                joules(b.outside_j),
                b.relative_error
            ));
            line(format!(
                "mass: {:.1} g in, {:.1} g mapped; the other {:.1} g leave the target grid",
                b.source_g,
                b.mapped_g,
                b.source_g - b.mapped_g
            ));
        }
        if let Some(i) = &part.inversion {
            let r = &i.residual_mm;
            let (mean, worst) = (r.mean, r.max.max(i.unconverged_max_mm));
            let none = i.unconverged;
            let what = if part.by_given {
                "the dose went through the given field; its inverse, for checks alone, is"
            } else {
                "the dose went through the inverse of the given field, which is"
            };
            line(format!("{what} {mean:.1e} mm off on the mean, {worst:.1e} mm at worst, {none} voxels unconverged"));
        }
        let outside = &part.outside;
        if outside.volume_percent > 0.0 {
            line(format!(
                "{:.1} % of the volume and {:.2} % of the dose lie outside the field",
                outside.volume_percent, outside.amount_percent
            ));
        }
        text.push_str(&listed(&part.warnings));
    }
    text
}

/// An energy with three digits that count.
fn joules(j: f64) -> String {
    if j == 0.0 {
        return "0".into();
    }
    let digits = (2.0 - j.abs().log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{j:.digits$}")
}

/// How often each dose counts, where several are added up: shares that were forgotten or mistyped show.
fn counted(weights: &[f64]) -> String {
    if weights.len() < 2 {
        return String::new();
    }
    let each = weights.iter().map(f64::to_string).collect::<Vec<_>>().join(" + ");
    let all = (weights.iter().sum::<f64>() * 1e4).round() / 1e4;
    format!("  the doses count {each} = {all}; shares of one plan make 1\n")
}

/// Warnings for the terminal.
pub(super) fn listed(warnings: &[Warning]) -> String {
    warnings.iter().map(|w| format!("  warning ({}): {}\n", w.code, w.message)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn energies_are_plain_numbers() {
        assert_eq!([53.212_18, 0.004_567_8, 1234.5, 0.0].map(joules), ["53.2", "0.00457", "1234", "0"]);
    }
}
