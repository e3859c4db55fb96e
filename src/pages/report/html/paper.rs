//! What is printed of lists that may be long. The screen has room for all; a printed report has four pages, so that of each
//! list as many lines are printed as its part of a page holds, and the number of the others is told.

use crate::warning::counted;
use maud::{Markup, html};

/// For each weight whether its line is printed: the `most` greatest are, earlier ones first where weights are equal.
pub(in crate::report) fn printed(weights: &[f64], most: usize) -> Vec<bool> {
    let mut order: Vec<usize> = (0..weights.len()).collect();
    order.sort_by(|a, b| weights[*b].total_cmp(&weights[*a]));
    let mut shown = vec![false; weights.len()];
    order.iter().take(most).for_each(|n| shown[*n] = true);
    shown
}

/// Says on paper how many of `all` lines are not printed and `where_` they are; nothing where none is missing. What they are
/// is said of one and of many.
pub(in crate::report) fn more(all: usize, most: usize, [one, many]: [&str; 2], where_: &str) -> Markup {
    let left = |all: usize| counted(all - most, &format!("more {one}"), &format!("more {many}"));
    html! { @if all > most { p.note.paper { "And " (left(all)) ": " (where_) "." } } }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_greatest_are_printed_and_the_others_counted() {
        assert_eq!(printed(&[1.0, f64::NAN, 3.0, 3.0, 2.0], 3), [false, true, true, true, false]);
        assert_eq!(printed(&[0.0, 0.0, 0.0], 2), [true, true, false]);
        assert_eq!(printed(&[1.0], 2), [true]);
        let told = more(45, 40, ["bone, which moves least", "bones, which move least"], "report.json").into_string();
        assert!(told.contains("And 5 more bones, which move least: report.json."), "{told}");
        let one = more(9, 8, ["warning", "warnings"], "report.json").into_string();
        assert!(one.contains("And 1 more warning: report.json."), "{one}");
        assert_eq!(more(40, 40, ["bone", "bones"], "report.json").into_string(), "");
    }
}
