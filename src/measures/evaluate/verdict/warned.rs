//! Warnings as verdicts: those that put the result itself in doubt.

use super::{Mark, Verdict};
use crate::findings::{Finding, Told};
use crate::warning::Warning;

/// A verdict for each kind of warning that counts: what would be refused if the settings did not let it through fails,
/// what puts the result in doubt is reviewed.
pub fn of_warnings(warnings: &[Warning]) -> Vec<Verdict> {
    let mut codes: Vec<&str> = Vec::new();
    for warning in warnings {
        if !codes.contains(&warning.code.as_str()) {
            codes.push(&warning.code);
        }
    }
    codes.into_iter().filter_map(|code| of_code(code, warnings)).collect()
}

/// What the name of a warning's verdict begins with.
const WARNING: &str = "warning: ";

/// Whether a verdict is that of a warning.
pub fn is_warning(verdict: &Verdict) -> bool {
    verdict.name.starts_with(WARNING)
}

fn of_code(code: &str, warnings: &[Warning]) -> Option<Verdict> {
    let finding = Finding::of(code)?;
    let let_through = finding.told == Told::Refused;
    if !let_through && !finding.doubted {
        return None;
    }
    let of_kind: Vec<&str> = warnings.iter().filter(|w| w.code == code).map(|w| w.message.as_str()).collect();
    // A refusal's own words end with its code and remedy.
    let first = of_kind.first()?.split(&format!(" [{code}]")).next()?;
    let more = if of_kind.len() > 1 { format!(" (and {} more)", of_kind.len() - 1) } else { String::new() };
    let (mark, limit) = if let_through { (Mark::Fail, "refused, unless let through") } else { (Mark::Review, "none") };
    Some(Verdict {
        name: format!("{WARNING}{code}"),
        value: of_kind.len() as f64,
        unit: if of_kind.len() == 1 { "warning" } else { "warnings" }.into(),
        limit: limit.into(),
        source: "docs/refusals.md".into(),
        verdict: mark,
        reason: format!("{first}{more}"),
        remedy: finding.remedy.into(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doubts_are_reviewed_refusals_let_through_fail_and_the_rest_is_silent() {
        let warning = |code: &str, message: &str| Warning { code: code.into(), message: message.into() };
        let all = of_warnings(&[
            warning("label-doubtful", "skull: its label may miss the bone"),
            warning("bones-meet", "12 cells"),
            warning("label-doubtful", "mandible: its label may miss the bone"),
            warning("labels-off-bone", "they lie 8 mm aside [labels-off-bone] remedy: give others"),
        ]);
        let told: Vec<_> = all.iter().map(|v| (v.name.as_str(), v.verdict)).collect();
        assert_eq!(told, [("warning: label-doubtful", Mark::Review), ("warning: labels-off-bone", Mark::Fail)]);
        assert!(all[0].reason.contains("skull") && all[0].reason.contains("1 more") && !all[0].remedy.is_empty());
        assert_eq!(all[1].reason, "they lie 8 mm aside");
        assert_eq!(super::super::measured(&all).count(), 0, "a warning is no rule that passes where it is not given");
    }
}
