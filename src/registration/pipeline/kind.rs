//! What kind of image a fraction is, in one line.

use crate::findings;
use crate::refine::GreyValues;
use crate::view::ViewReport;
use crate::warning::Warning;
use serde::{Deserialize, Serialize};
use std::fmt;

/// A fraction of whose grid more than this was not measured is cut, percent.
const UNMEASURED_PERCENT: f64 = 1.0;

/// Where dark and bright of an MR are shown, HU.
const SHOWN_HU: [f32; 2] = [-150.0, 170.0];
/// What is said of every MR.
const MR_TOLD: &str = "the fraction is an MR: on MR-like images made of CTs bones half in view err by 0.2 to 0.4 mm and soft tissue by 0.4 to 0.9; \
                       bones that an end of the scan cuts follow their joints or the skin around them, and err by up to 4; the scanner's geometric \
                       distortion is not corrected, and its grey values are no HU, so that no dose is computed on them. Look at \
                       the fusion images";

/// What kind of image the fraction is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FractionKind {
    /// What of it was measured.
    pub view: ViewReport,
    /// How its grey values agree with planning's; `None` where too little soft tissue is seen in both.
    pub grey: Option<GreyValues>,
    /// Whether images pulled with its grey values corrected.
    pub corrected: bool,
    /// Soft tissue that its image misled: bones alone carry it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub misled: Option<MisledTissue>,
    /// Of an MR: grey values that 2 and 98 % of the patient are darker than.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mr: Option<[f32; 2]>,
}

/// Soft tissue that images drew without agreeing better for it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MisledTissue {
    /// Share of soft tissue, percent.
    pub percent: f64,
    /// Its middle in planning, LPS mm.
    pub centre_mm: [f64; 3],
}

impl fmt::Display for FractionKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut told = Vec::new();
        if let Some(grey) = &self.grey {
            told.push(format!("contrast {:.2} times planning's, shading {:.0} HU", grey.gain.recip(), grey.shading));
        }
        told.extend(self.view.words());
        f.write_str(match self.mr {
            Some(_) => "MR",
            None if self.corrected => "CBCT-like",
            None => "CT",
        })?;
        if told.is_empty() { Ok(()) } else { write!(f, " ({})", told.join(", ")) }
    }
}

impl FractionKind {
    /// HU of the fraction on planning's scale, shading apart, where its grey values were corrected, and an MR in the window of soft
    /// tissue; else as they are.
    pub fn on_plannings_scale(&self, hu: f32) -> f32 {
        if let Some([dark, bright]) = self.mr {
            let [low, high] = SHOWN_HU;
            return low + (high - low) * (hu - dark) / (bright - dark).max(f32::MIN_POSITIVE);
        }
        match &self.grey {
            Some(grey) if self.corrected => (grey.gain * f64::from(hu) + grey.offset) as f32,
            _ => hu,
        }
    }

    /// Whether equal tissue has other grey values than in planning, so that colours of a fusion would not tell of motion alone.
    pub fn unlike(&self) -> bool {
        self.corrected || self.mr.is_some()
    }

    /// What the user should know of it.
    pub(super) fn warnings(&self) -> Vec<Warning> {
        let mut out = Vec::new();
        if self.mr.is_some() {
            out.push(Warning::new(findings::MR_FRACTION, MR_TOLD));
        }
        if self.corrected {
            let message = format!(
                "the fraction is {self}: its soft tissue was compared after shading was taken out by planning's grey values; \
                 on test cases bones err by about 0.6 mm where those of a CT err by 0.05, soft tissue by 2.5 to 3.5 times as much as in a \
                 CT; do not compute dose on its HU"
            );
            out.push(Warning::new(findings::SHADED_FRACTION, message));
        }
        if let Some(MisledTissue { percent, centre_mm }) = self.misled {
            // Adding 0 turns the minus of a zero away.
            let [x, y, z] = centre_mm.map(|c| c.round() + 0.0);
            let message = format!(
                "in {percent:.0} % of soft tissue, around ({x:.0}, {y:.0}, {z:.0}) mm of planning, moving it by the images did not \
                 make them agree better; bones alone move it there. Streaks of metal, noise or grey values of another machine do that"
            );
            out.push(Warning::new(findings::IMAGES_MISLEAD, message));
        }
        let unmeasured = 100.0 - self.view.measured_percent;
        if unmeasured > UNMEASURED_PERCENT {
            let message = format!(
                "{unmeasured:.0} % of the fraction's grid was not measured: there bones follow their joints and tissue follows \
                 bones; see the map of uncertainty"
            );
            out.push(Warning::new(findings::CUT_FRACTION, message));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::Circle;

    #[test]
    fn says_in_one_line_what_a_fraction_is() {
        let grey = GreyValues { gain: 1.25, offset: 20.0, shading: 118.0, left: 30.0 };
        let circle = Circle { centre_mm: [0.0; 3], along: 2, radius_mm: 125.0, rim_mm: 0.0 };
        let view =
            ViewReport { circle: Some(circle), padding: Some(-1000.0), measured_percent: 40.0, ..Default::default() };
        let kind = FractionKind { view, grey: Some(grey), corrected: true, misled: None, mr: None };
        assert_eq!(kind.to_string(), "CBCT-like (contrast 0.80 times planning's, shading 118 HU, circle of 250 mm)");
        let codes: Vec<_> = kind.warnings().iter().map(|w| w.code.to_string()).collect();
        assert_eq!(codes, ["shaded-fraction", "cut-fraction"]);
        assert!(kind.warnings()[0].message.contains("by 2.5 to 3.5 times as much"), "2.6 to 3.4 were measured");
        assert!((kind.on_plannings_scale(-100.0) + 105.0).abs() < 1e-4);
        let all = ViewReport { measured_percent: 100.0, ..Default::default() };
        let ct = FractionKind { view: all, grey: None, corrected: false, misled: None, mr: None };
        assert_eq!(ct.to_string(), "CT");
        assert!(ct.warnings().is_empty());
        let misled = Some(MisledTissue { percent: 7.2, centre_mm: [1.0, -40.0, 120.0] });
        let warnings = FractionKind { misled, ..ct.clone() }.warnings();
        assert!(
            warnings[0].is(findings::IMAGES_MISLEAD) && warnings[0].message.contains("(1, -40, 120)"),
            "{warnings:?}"
        );
        assert!((ct.on_plannings_scale(-100.0) + 100.0).abs() < 1e-9);
        let mr = FractionKind { mr: Some([40.0, 840.0]), ..ct };
        assert!(mr.to_string() == "MR" && mr.warnings()[0].is(findings::MR_FRACTION));
        assert!((mr.on_plannings_scale(440.0) - 10.0).abs() < 1e-4);
    }
}
