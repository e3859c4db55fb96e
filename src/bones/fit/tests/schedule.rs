//! What decides on the way of the fit, at its limits.

use crate::fit::hanging::hanging;
use crate::fit::schedule::{LEAST_EXPLAINED, doubtful, held, neighbours, unexplained};
use crate::fit::similarity::Evaluation;
use crate::fit::{FitOptions, LEAST_EXPLAINED_OF_MR};

fn seen(visible: f64, explained: f64, contrast: [f64; 2]) -> Evaluation {
    Evaluation { visible, explained, contrast, ..Evaluation::nothing() }
}

#[test]
fn neighbours_are_parent_and_children() {
    // 2 hangs on 0, 3 and 1 on 2, 4 on 3.
    let parents = [None, Some(2), Some(0), Some(2), Some(3)];
    let skeleton = hanging(&parents);
    let of = |b: usize| neighbours(&skeleton, b).collect::<Vec<_>>();
    assert_eq!([0, 1, 2, 3, 4].map(of), [vec![2], vec![2], vec![0, 1, 3], vec![2, 4], vec![3]]);
}

#[test]
fn a_bone_is_doubtful_when_it_explains_little_or_is_cut() {
    let of = |visible, explained| doubtful(&seen(visible, explained, [0.0; 2]));
    assert!(of(1.0, 0.59) && !of(1.0, 0.61) && !of(0.91, 0.61));
    assert!(of(0.89, 0.84) && !of(0.89, 0.86) && of(0.89, 0.3));
}

#[test]
fn what_the_image_does_not_explain_is_told_by_the_others_too() {
    let of = |bones: &[(f64, f64)]| {
        let all: Vec<Evaluation> = bones.iter().map(|&(v, e)| seen(v, e, [0.0; 2])).collect();
        unexplained(&all, LEAST_EXPLAINED)
    };
    // Too little in view, too little explained, and a cut bone that is unlike the others by itself.
    let good = [(1.0, 0.96); 6];
    let odd = [(0.04, 0.99), (1.0, 0.49), (0.5, 0.75), (0.95, 0.75), (0.5, 0.86)];
    assert_eq!(of(&[&good[..], &odd].concat())[6..], [true, true, true, false, false]);
    // Among bones that explain no more, by noise, it is usual; those out of view do not count for what is usual.
    assert_eq!(of(&[(1.0, 0.8), (0.5, 0.83), (1.0, 0.8)]), [false; 3]);
    assert_eq!(of(&[(1.0, 0.96), (1.0, 0.95), (0.5, 0.75), (0.0, 0.0), (0.0, 0.0)]), [false, false, true, true, true]);
}

#[test]
fn one_gain_is_held_for_all_bones() {
    let all = held(&[seen(0.9, 0.8, [6.0, 4.0]), seen(0.2, 0.1, [-1.0, 1.0])]);
    let found: Vec<[f64; 2]> = all.iter().flatten().map(|h| [h.view, h.gain]).collect();
    assert_eq!(found, [[0.9, 1.0], [0.2, 1.0]]);
    assert!(held(&[seen(0.9, 0.0, [0.0; 2])]).iter().all(Option::is_none));
}

#[test]
fn a_whole_bone_of_a_planning_mr_may_explain_less_and_a_cut_one_may_not() {
    // Whole, whole, cut.
    let all = [seen(1.0, 0.55, [0.0; 2]), seen(0.95, 0.35, [0.0; 2]), seen(0.6, 0.35, [0.0; 2])];
    assert_eq!(unexplained(&all, FitOptions::default().least_explained), [false, true, true]);
    assert_eq!(unexplained(&all, LEAST_EXPLAINED_OF_MR), [false, false, true]);
}
