//! What a `warp` tells of itself.

use super::args::WarpArgs;
use crate::field::{Chain, ChainReport, Link, Motion, outside_field};
use crate::findings;
use crate::geometry::Grid;
use crate::session::fields::{self, Known};
use crate::warning::{Warning, counted};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::Path;

/// What was done: the JSON that `--json` prints.
#[derive(Debug, Serialize)]
pub(super) struct WarpReport {
    pub(super) from: String,
    pub(super) to: String,
    /// Kind of the input.
    pub(super) kind: &'static str,
    /// What each step of the map did. Images are pulled, so their steps lead from `to` to `from`.
    pub(super) steps: Vec<String>,
    /// What happened to the voxels, points or vertices.
    pub(super) mapped: ChainReport,
    /// What else is worth knowing.
    pub(super) notes: Vec<String>,
    pub(super) warnings: Vec<Warning>,
    /// The file written.
    pub(super) out: String,
}

impl WarpReport {
    /// A word about fields of unknown direction that lie on the grid of the wrong frame.
    pub(super) fn doubt(&mut self, args: &WarpArgs, unsure: &[&Link], input: &Grid, target: &Grid) {
        let Some(path) = &args.grid else { return };
        let known = |frame, path: &Path, grid| Known { frame, name: path.display().to_string(), place: None, grid };
        let input_path = args.input.as_deref().unwrap_or(Path::new(""));
        let known = [known(args.from.as_str(), input_path, input), known(args.to.as_str(), path, target)];
        for link in unsure {
            if let Motion::Field(field) = &link.motion {
                self.warnings.extend(fields::doubt(&link.name, &link.from, &link.to, field.grid(), &known));
            }
        }
    }

    /// A word about what of the result, by what its voxels weigh, a field did not reach.
    pub(super) fn missed(
        &mut self,
        what: &str,
        worth: f64,
        chain: &Chain<'_>,
        mapped: &ChainReport,
        grid: &Grid,
        weight: impl Fn(usize) -> f64 + Sync,
    ) {
        if mapped.outside > 0 {
            let share = fields::missed(chain, grid, weight);
            self.warnings.extend(outside_field(what, "a field", share, worth));
        }
    }

    pub(super) fn finish(&mut self, chain: &Chain<'_>, mapped: ChainReport, out: &Path) {
        self.steps.clone_from(&chain.description);
        self.out = out.display().to_string();
        if mapped.unsolved > 0 && self.kind != "points" {
            let message = format!(
                "of {} {} no exact pre-image (folds or gaps of the field), residual up to {:.3} mm",
                counted(mapped.points, "place", "places"),
                counted(mapped.unsolved, "has", "have"),
                mapped.unsolved_max_mm
            );
            self.warnings.push(Warning::new(findings::NO_INVERSE, message));
        }
        self.mapped = mapped;
    }

    pub(super) fn text(&self) -> String {
        let mut out = format!("{} from {} to {}\n", self.kind, self.from, self.to);
        let mut line = |text: String| writeln!(out, "  {text}").expect("writing to a String cannot fail");
        self.steps.iter().for_each(|s| line(s.clone()));
        let m = &self.mapped;
        line(match &m.residual_mm {
            None => "no inversion was needed".into(),
            Some(r) => format!(
                "inversion residual mean {:.2e} mm, 95th percentile {:.2e} mm, greatest {:.2e} mm ({} of {} inverted)",
                r.mean,
                r.p95,
                r.max,
                r.n,
                r.n + m.unsolved
            ),
        });
        if m.outside > 0 {
            let share = 100.0 * m.outside as f64 / m.points.max(1) as f64;
            line(format!(
                "{} of {} ({share:.1} %) lie outside a field, which is the identity there",
                m.outside, m.points
            ));
        }
        self.notes.iter().for_each(|n| line(n.clone()));
        self.warnings.iter().for_each(|w| line(format!("warning ({}): {}", w.code, w.message)));
        line(format!("written: {}", self.out));
        out
    }
}
