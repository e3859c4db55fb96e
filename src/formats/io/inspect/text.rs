//! An inspection as text for the terminal.

use super::super::field::{FieldFrames, frames_of};
use super::{Content, Inspection, Label, Range, geometry_source};
use crate::warning::counted;
use std::fmt::{Display, Formatter, Result};

impl Display for Inspection {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        let (h, g, o) = (&self.header, &self.grid, &self.orientation);
        let size = g.size().map(|n| n.to_string()).join(" x ");
        let spacing = g.spacing().map(short).join(" x ");
        let handed = if o.right_handed { "right-handed" } else { "left-handed" };
        let oblique = if o.oblique_deg < 0.01 {
            "not oblique".into()
        } else {
            format!("oblique by {:.2} degrees", o.oblique_deg)
        };
        let packed = if h.compressed { ", compressed" } else { "" };
        let order = if h.big_endian { ", big-endian" } else { "" };
        let extent =
            std::array::from_fn::<_, 3, _>(|a| format!("{:.1}", g.size()[a] as f64 * g.spacing()[a])).join(" x ");
        writeln!(f, "{}", self.path.display())?;
        let mut row = |name: &str, value: String| writeln!(f, "  {name:<12} {value}");
        let own =
            h.description.starts_with("aventail") && h.description.contains("dose") && h.description.contains("Gy");
        let what = if own || h.format == "DICOM RT Dose" { "dose in Gy" } else { "image" };
        row("content", self.content.summary(what, &h.description))?;
        row("size", format!("{size} voxels of {spacing} mm = {extent} mm"))?;
        row(
            "origin",
            format!(
                "({}) mm LPS, centre of the first voxel",
                g.origin().coords.iter().map(|v| short(*v)).collect::<Vec<_>>().join(", ")
            ),
        )?;
        row("orientation", format!("{} ({}), {handed}, {oblique}", o.code, in_words(&o.code)))?;
        if o.oblique_deg >= 0.01 {
            for r in 0..3 {
                let name = if r == 0 { "direction" } else { "" };
                let d = g.direction();
                row(name, format!("{:>10.6} {:>10.6} {:>10.6}", d[(r, 0)], d[(r, 1)], d[(r, 2)]))?;
            }
        }
        row("geometry", format!("from {}", geometry_source(h)))?;
        let scaling = h.scaling.map(|[slope, inter]| format!(", value = raw * {slope} + {inter}")).unwrap_or_default();
        row("stored", format!("{}, {}{scaling}{order}{packed}", h.format, h.datatype))?;
        if let Some(code) = h.intent_code.filter(|c| *c != 0) {
            let name = if h.intent_name.is_empty() { String::new() } else { format!(" ({})", h.intent_name) };
            row("intent", format!("{code}{name}"))?;
        }
        if !h.description.is_empty() {
            row("description", h.description.clone())?;
        }
        for extension in &h.extensions {
            row("extension", format!("code {}, {} bytes", extension.code, extension.bytes))?;
        }
        row("sha256", self.sha256.clone())?;
        self.content.details(f)?;
        for warning in &self.warnings {
            writeln!(f, "  warning: {} [{}]", warning.message, warning.code)?;
        }
        Ok(())
    }
}

impl Content {
    /// `image` is what an image is called; the header's text may tell a field's direction, which its format does not.
    fn summary(&self, image: &str, description: &str) -> String {
        match self {
            Self::Image { values, .. } => format!("{image}, {values}"),
            Self::Labels { labels, .. } => format!("label map, {}", counted(labels.len(), "label", "labels")),
            Self::Field { .. } => match frames_of(description) {
                Some(FieldFrames { from, to }) => format!("displacement field, {from} to {to} by its description"),
                None => "displacement field; its format does not record the direction".into(),
            },
            Self::Other { reason, values } => format!("no image and no field: {reason}; {values}"),
        }
    }

    fn details(&self, f: &mut Formatter<'_>) -> Result {
        match self {
            Self::Image { view: Some(view), .. } if !view.words().is_empty() => {
                let (percent, words) = (view.measured_percent, view.words().join(", "));
                writeln!(f, "  {:<12} {percent:.0} % of the grid: {words}", "measured")
            }
            Self::Image { .. } | Self::Other { .. } => Ok(()),
            Self::Field { convention, components, length } => {
                writeln!(f, "  {:<12} {convention}", "vectors")?;
                for (name, range) in ["left", "posterior", "superior"].iter().zip(components) {
                    writeln!(f, "  {:<12} {range} mm", format!("  {name}"))?;
                }
                writeln!(f, "  {:<12} {length} mm", "  length")
            }
            Self::Labels { labels, absent } => {
                let width =
                    labels.iter().filter_map(|l| l.name.as_ref()).map(|n| n.chars().count()).max().unwrap_or(7).max(4);
                writeln!(f, "  {:>5}  {:<width$} {:>10} {:>11}", "label", "name", "voxels", "volume")?;
                for Label { label, name, voxels, volume_ml } in labels {
                    let name = name.as_deref().unwrap_or("no name");
                    writeln!(f, "  {label:>5}  {name:<width$} {voxels:>10} {volume_ml:>8.2} ml")?;
                }
                if *absent > 0 {
                    let names = counted(*absent, "more name in the header has", "more names in the header have");
                    writeln!(f, "  {names} no voxels")?;
                }
                Ok(())
            }
        }
    }
}

impl Display for Range {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        write!(f, "{} to {}, mean {}", short(self.least), short(self.greatest), short(self.mean))?;
        if self.not_finite > 0 {
            write!(f, "; {} values are NaN or infinite", self.not_finite)?;
        }
        Ok(())
    }
}

/// Up to four decimals, of less the first digits, no trailing zeros.
fn short(value: f64) -> String {
    if value != 0.0 && value.abs() < 1e-7 || value.abs() >= 1e9 {
        return format!("{value:.3e}");
    }
    if value != 0.0 && value.abs() < 1e-3 {
        let digits = (1.0 - value.abs().log10().floor()) as usize;
        return format!("{value:.digits$}").trim_end_matches('0').into();
    }
    let text = format!("{value:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}

/// The axes' directions spelt out.
fn in_words(code: &str) -> String {
    let word = |c| match c {
        'L' => "left",
        'R' => "right",
        'P' => "posterior",
        'A' => "anterior",
        'S' => "superior",
        _ => "inferior",
    };
    format!("axes run to {}", code.chars().map(word).collect::<Vec<_>>().join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_values_are_plain_numbers() {
        assert_eq!([6.248e-5, 0.0, 66.0, -0.000_4, 1.5e-9].map(short), ["0.000062", "0", "66", "-0.0004", "1.500e-9"]);
    }
}
