//! Folded cells, judged by how much of the tissue they are and where they lie.

use super::super::jacobian::JacobianReport;
use super::{Domain, Figure, Limits, Mark, Verdict, number};
use crate::warning::counted;

impl Limits {
    /// Folds of a field in this direction: those of tissue, or of where else they were counted, then those of bone contact
    /// and sliding interfaces, where there are cells of these. `cell_ml`: volume of an undeformed cell.
    pub fn folds(&self, direction: &str, jacobian: &JacobianReport, cell_ml: f64, domain: Domain) -> Vec<Verdict> {
        let mut all = vec![self.in_tissue(direction, jacobian, cell_ml, domain)];
        if jacobian.contact.cells + jacobian.interface.cells > 0 {
            all.push(self.in_contact(direction, jacobian, cell_ml, domain));
        }
        all.into_iter().map(|verdict| domain.judged(verdict)).collect()
    }

    fn in_tissue(&self, direction: &str, jacobian: &JacobianReport, cell_ml: f64, domain: Domain) -> Verdict {
        // A share of all tissue, so that it does not hang on what is taken for contact or interface.
        let (folded, cells) = (jacobian.body.folded, jacobian.all.cells.max(jacobian.body.cells));
        let (ml, percent) = (folded as f64 * cell_ml, 100.0 * folded as f64 / cells.max(1) as f64);
        let within = |n: usize| percent <= self.folded_percent[n] && ml <= self.folded_ml[n];
        let mark = if folded == 0 || within(0) {
            Mark::Pass
        } else if within(1) {
            Mark::Review
        } else {
            Mark::Fail
        };
        let place = jacobian.folded_at.map_or(String::new(), |p| {
            format!(", most at {:.0}, {:.0}, {:.0} (LPS mm, {})", p.x, p.y, p.z, start_of(direction))
        });
        let reason = if folded == 0 {
            "no cell is folded".to_owned()
        } else {
            format!(
                "{folded} of {cells} cells: {} ml, {} % of the {}{place}",
                number(ml),
                number(percent),
                domain.name()
            )
        };
        let [[p0, p1], [m0, m1]] = [self.folded_percent, self.folded_ml];
        let figure = Figure {
            name: match domain {
                Domain::Tissue => format!("folded tissue, {direction}"),
                _ => format!("folded cells of the {}, {direction}", domain.name()),
            },
            value: ml,
            unit: "ml",
            source: "docs/metrics.md; TG-132 allows none",
            remedy: "look at the place in the Jacobian map; do not map dose there",
        };
        figure.said(format!("pass up to {m0} ml and {p0} %, review up to {m1} ml and {p1} %"), mark, reason)
    }

    fn in_contact(&self, direction: &str, jacobian: &JacobianReport, cell_ml: f64, domain: Domain) -> Verdict {
        let (contact, interface) = (jacobian.contact.folded, jacobian.interface.folded);
        let percent = 100.0 * (contact + interface) as f64 / jacobian.all.cells.max(1) as f64;
        let mark = if percent <= self.folded_contact_percent { Mark::Pass } else { Mark::Review };
        let ml = (contact + interface) as f64 * cell_ml;
        let reason = match contact + interface {
            0 => "no cell is folded".to_owned(),
            _ => format!(
                "{} between touching bones, {interface} of sliding interfaces: {} ml, {} % of the {}; rigid \
                 bones that slide on each other fold what lies between them",
                counted(contact, "cell", "cells"),
                number(ml),
                number(percent),
                domain.name()
            ),
        };
        let figure = Figure {
            name: format!("folded in contact and interfaces, {direction}"),
            value: ml,
            unit: "ml",
            source: "docs/metrics.md: rigid bones that slide",
            remedy: "do not trust the field in these joints and interfaces",
        };
        figure.said(format!("pass up to {} %, else review", self.folded_contact_percent), mark, reason)
    }
}

/// The scan that a direction starts from.
fn start_of(direction: &str) -> &str {
    direction.split(' ').next().unwrap_or(direction)
}

#[cfg(test)]
mod tests {
    use super::super::super::jacobian::JacobianStats;
    use super::*;
    use nalgebra::Point3;

    fn report(cells: usize, folded: usize, contact: usize) -> JacobianReport {
        let stats = |cells: usize, folded: usize| JacobianStats {
            cells,
            folded,
            folded_percent: 100.0 * folded as f64 / cells.max(1) as f64,
            ..JacobianStats::default()
        };
        JacobianReport {
            all: stats(cells + 1000, folded + contact),
            body: stats(cells, folded),
            contact: stats(1000, contact),
            folded_at: (folded > 0).then(|| Point3::new(12.0, -30.0, 101.0)),
            ..JacobianReport::default()
        }
    }

    #[test]
    fn four_cells_of_two_million_do_not_fail_and_tell_where_they_are() {
        let limits = Limits::default();
        let judged =
            |folded| limits.folds("planning to fraction", &report(2_000_000, folded, 0), 0.003_75, Domain::Tissue);
        let few = &judged(4)[0];
        assert_eq!(few.verdict, Mark::Pass);
        assert!((few.value - 0.015).abs() < 1e-12 && few.unit == "ml");
        assert!(few.reason.contains("0.0150 ml") && few.reason.contains("12, -30, 101"), "{}", few.reason);
        assert_eq!(
            [0, 40, 400, 4000].map(|n| judged(n)[0].verdict),
            [Mark::Pass, Mark::Review, Mark::Review, Mark::Fail]
        );
        // A small scan: a large share fails, however few ml.
        assert_eq!(
            limits.folds("planning to fraction", &report(1000, 4, 0), 0.003_75, Domain::Tissue)[0].verdict,
            Mark::Fail
        );
    }

    #[test]
    fn of_the_whole_grid_nothing_is_said_of_tissue_and_nothing_fails() {
        let limits = Limits::default();
        let judged = |domain| limits.folds("planning to fraction", &report(2_000_000, 4000, 9000), 0.003_75, domain);
        assert_eq!(judged(Domain::Tissue)[0].verdict, Mark::Fail);
        for verdict in judged(Domain::Grid) {
            assert_eq!(verdict.verdict, Mark::Review);
            assert!(verdict.name.contains("whole grid, air included"), "{}", verdict.name);
            assert!(!format!("{} {}", verdict.name, verdict.reason).contains("tissue"), "{verdict:?}");
        }
        let in_mask = &judged(Domain::Mask)[0];
        assert!(in_mask.verdict == Mark::Fail && in_mask.reason.contains("of the given mask"), "{in_mask:?}");
        let curl = Domain::Grid.judged(limits.curl("planning to fraction", 20.0));
        assert!(curl.verdict == Mark::Review && curl.name.ends_with("whole grid, air included"), "{curl:?}");
    }

    #[test]
    fn folds_between_bones_are_looked_at_and_never_fail() {
        let limits = Limits::default();
        let judged =
            |contact| limits.folds("planning to fraction", &report(100_000, 0, contact), 0.004, Domain::Tissue);
        assert_eq!([0, 50, 900].map(|n| judged(n)[1].verdict), [Mark::Pass, Mark::Pass, Mark::Review]);
        assert!(judged(50)[1].reason.contains("50 cells between touching bones"));
    }
}
