//! The figures by which runs of a cohort are compared.

use super::super::numbers::Report;
use crate::fit::{BoneFit, DeterminedBy};

/// Which way a figure is worse.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Worse {
    High,
    Low,
    /// Neither is better; what is unlike the others is worth a look.
    Unlike,
}

/// One figure of a run.
pub(super) struct FigureOfRuns {
    /// Its column in tables and key in JSON, with its unit.
    pub(super) key: &'static str,
    /// Heading of its column on the page.
    pub(super) title: &'static str,
    pub(super) unit: &'static str,
    pub(super) digits: usize,
    pub(super) worse: Worse,
    /// A smaller difference from the cohort's median matters to nobody.
    pub(super) least: f64,
    /// Whether the page draws its course over a patient's fractions.
    pub(super) course: bool,
    of: fn(&Report) -> Option<f64>,
}

impl FigureOfRuns {
    /// The figure of a run; nothing where the run has none or it is no number, infinite where it is more than can be told.
    pub(super) fn of(&self, report: &Report) -> Option<f64> {
        (self.of)(report).filter(|v| !v.is_nan())
    }
}

/// A figure without a course, which is worse where it is higher.
const PLAIN: FigureOfRuns = FigureOfRuns {
    key: "",
    title: "",
    unit: "mm",
    digits: 2,
    worse: Worse::High,
    least: 0.0,
    course: false,
    of: |_| None,
};

/// All figures, in the order of the columns.
pub(super) const KINDS: [FigureOfRuns; 18] = [
    FigureOfRuns {
        key: "couch_shift_mm",
        title: "couch shift",
        digits: 1,
        worse: Worse::Unlike,
        least: 5.0,
        course: true,
        of: |r| Some(r.couch.shift().norm()),
        ..PLAIN
    },
    FigureOfRuns {
        key: "bones_by_image",
        title: "bones found",
        unit: "",
        digits: 0,
        worse: Worse::Low,
        least: 1.0,
        of: |r| Some(r.bones_by_image() as f64),
        ..PLAIN
    },
    FigureOfRuns {
        key: "images_bones",
        title: "images agree at bones",
        unit: "",
        worse: Worse::Low,
        least: 0.1,
        of: |r| Some(r.agreement?.bones?.after),
        ..PLAIN
    },
    FigureOfRuns {
        key: "images_soft_tissue",
        title: "images agree in soft tissue",
        unit: "",
        worse: Worse::Low,
        least: 0.1,
        of: |r| Some(r.agreement?.soft_tissue?.after),
        ..PLAIN
    },
    FigureOfRuns {
        key: "least_similarity",
        title: "least similarity of a bone found in the image",
        unit: "",
        worse: Worse::Low,
        least: 0.05,
        of: |r| least(r.bones.iter().filter(found).filter_map(|b| b.similarity_after)),
        ..PLAIN
    },
    FigureOfRuns {
        key: "largest_bone_motion_mm",
        title: "largest motion of a bone found or given",
        digits: 1,
        worse: Worse::Unlike,
        least: 5.0,
        course: true,
        of: |r| {
            most(
                r.bones
                    .iter()
                    .filter(|b| matches!(b.determined_by, DeterminedBy::Image | DeterminedBy::Given))
                    .map(|b| b.motion_mm),
            )
        },
        ..PLAIN
    },
    FigureOfRuns {
        key: "bone_position_sd_mm",
        title: "greatest SD of the position of a bone found in the image",
        least: 0.2,
        of: |r| most(r.bones.iter().filter(found).map(|b| b.position_sd_mm).filter(|sd| sd.is_finite())),
        ..PLAIN
    },
    FigureOfRuns {
        key: "joint_beyond_range_deg",
        title: "joint beyond its range",
        unit: "degrees",
        digits: 1,
        least: 2.0,
        of: |r| most(r.bones.iter().map(|b| b.beyond_range.rotation_deg)),
        ..PLAIN
    },
    FigureOfRuns {
        key: "landmarks_mean_mm",
        title: "landmarks, mean",
        least: 0.2,
        course: true,
        of: |r| r.landmarks.as_ref().filter(|l| l.after.n > 0).map(|l| l.after.mean),
        ..PLAIN
    },
    FigureOfRuns {
        key: "landmarks_worst_mm",
        title: "landmarks, worst",
        least: 0.5,
        of: |r| r.landmarks.as_ref().filter(|l| l.after.n > 0).map(|l| l.after.max),
        ..PLAIN
    },
    FigureOfRuns {
        key: "there_and_back_mean_mm",
        title: "there and back, mean",
        digits: 3,
        least: 0.05,
        of: |r| Some(r.consistency.there_and_back_mm.mean),
        ..PLAIN
    },
    FigureOfRuns {
        key: "there_and_back_worst_mm",
        title: "there and back, worst",
        least: 0.5,
        of: |r| Some(r.consistency.there_and_back_mm.max),
        ..PLAIN
    },
    FigureOfRuns {
        key: "folded_percent",
        title: "folded tissue",
        unit: "%",
        digits: 4,
        least: 0.01,
        course: true,
        of: |r| Some(r.jacobian.body.folded_percent),
        ..PLAIN
    },
    FigureOfRuns {
        key: "departure_from_rigid_mm",
        title: "bones' departure from rigid, worst rms",
        digits: 3,
        least: 0.01,
        of: |r| r.least_rigid().map(|b| b.rms_mm),
        ..PLAIN
    },
    FigureOfRuns {
        key: "uncertainty_median_mm",
        title: "uncertainty, median",
        least: 0.2,
        course: true,
        of: |r| r.uncertainty.map(|u| u.soft_tissue_mm.median.unwrap_or(f64::INFINITY)),
        ..PLAIN
    },
    FigureOfRuns {
        key: "uncertainty_p95_mm",
        title: "uncertainty, 95th percentile",
        least: 0.5,
        of: |r| r.uncertainty.map(|u| u.soft_tissue_mm.p95.unwrap_or(f64::INFINITY)),
        ..PLAIN
    },
    FigureOfRuns {
        key: "uncertainty_unknown_percent",
        title: "tissue of which nothing is known",
        unit: "%",
        digits: 1,
        least: 2.0,
        of: |r| r.uncertainty.map(|u| u.unknown_percent),
        ..PLAIN
    },
    FigureOfRuns {
        key: "seconds",
        title: "time",
        unit: "s",
        digits: 1,
        least: 5.0,
        of: |r| Some(r.seconds()),
        ..PLAIN
    },
];

/// Whether a bone was found in the image: what follows its joint has neither similarity nor deviation of its own.
fn found(bone: &&BoneFit) -> bool {
    bone.determined_by == DeterminedBy::Image
}

fn most(values: impl Iterator<Item = f64>) -> Option<f64> {
    values.max_by(f64::total_cmp)
}

fn least(values: impl Iterator<Item = f64>) -> Option<f64> {
    values.min_by(f64::total_cmp)
}
