//! Fields with a known bend.

use super::*;
use crate::field::{digital_folds, invert};
use crate::geometry::Grid;
use crate::volume::{Volume, trilinear_vector};
use nalgebra::{Matrix3, Point3, Vector3};

/// First plane of the bone.
const BONE: usize = 14;

/// Tissue under a bone is pressed against it to less than half its height; storage right- or left-handed.
fn pressed(handed: f64) -> (PushField, Grid) {
    let direction = Matrix3::from_diagonal(&Vector3::new(handed, 1.0, 1.0));
    let grid = Grid::new([41, 41, 24], [1.0, 1.0, 3.0], Point3::new(-20.0 * handed, -20.0, 0.0), direction).unwrap();
    let displacement = Volume::from_fn(grid.clone(), |n| {
        let x = grid.centre(grid.voxel(n));
        let under = (3.0 * BONE as f64 - x.z).max(0.0);
        let near = (-(x.x * x.x + x.y * x.y) / 100.0).exp();
        [0.0, 0.0, (0.55 * near * under.min(9.0)) as f32]
    });
    let fraction =
        Grid::new([37, 37, 20], [1.0, 1.0, 3.0], Point3::new(-18.2 * handed, -18.4, 4.5), direction).unwrap();
    (PushField { displacement, computed: Volume::filled(grid, true) }, fraction)
}

fn bone(grid: &Grid) -> impl Fn(usize) -> Option<u16> + Sync + use<> {
    let plane = grid.strides()[2];
    move |n: usize| (n / plane >= BONE).then_some(0)
}

#[test]
fn a_bend_beside_bone_gives_way_and_nothing_else_is_lost() {
    for handed in [1.0, -1.0] {
        let (mut push, fraction) = pressed(handed);
        let before = push.clone();
        let options = InvertOptions::default();
        let (mut pull, _) = invert(&push, &fraction, None, &options).unwrap();
        let grid = push.displacement.grid().clone();
        let rigid = bone(&grid);
        let report = made_to_agree(&mut push, &mut pull, &rigid, &options, &ConsistencyOptions::default());
        assert!(report.beyond_before > 50 && report.beyond == 0, "{report:?}");
        assert!(report.there_and_back_mm.max <= 0.5 && report.there_and_back_mm.n > 10_000, "{report:?}");
        assert!(report.moved_mm > 0.1 && report.moved_mm < 3.0, "{report:?}");
        let mut moved = 0.0f32;
        for n in 0..grid.len() {
            let (was, is) = (Vector3::from(before.displacement.data()[n]), Vector3::from(push.displacement.data()[n]));
            assert!(rigid(n).is_none() || was == is, "bone moved by {}", (was - is).norm());
            moved = moved.max((was - is).norm());
        }
        assert!((f64::from(moved) - report.moved_mm).abs() < 1e-6);
        // Only some planes are measured again: that tells what measuring all of them does.
        let off = ConsistencyOptions { rounds: 0, ..ConsistencyOptions::default() };
        let anew = made_to_agree(&mut push, &mut pull, &rigid, &options, &off);
        assert_eq!((anew.there_and_back_mm, anew.beyond), (report.there_and_back_mm, report.beyond));
        assert_eq!(digital_folds(&push).count(), 0);
        for (n, v) in pull.displacement.data().iter().enumerate() {
            let (y, v) = (fraction.centre(fraction.voxel(n)), Vector3::from(v.map(f64::from)));
            if let Some(u) = trilinear_vector(&push.displacement, &grid.index(&(y + v))) {
                assert!((v + u).norm() < 1.1e-3, "{}", (v + u).norm());
            }
        }
    }
}

/// [`agree`], with what lies beside bones that touch spared.
fn made_to_agree(
    push: &mut PushField,
    pull: &mut PullField,
    bone: &impl BoneOf,
    invert: &InvertOptions,
    options: &ConsistencyOptions,
) -> ConsistencyReport {
    let spared = beside_contact(push.displacement.grid(), bone).unwrap();
    agree(push, pull, &Beside { bone, spared: &spared }, invert, options)
}

#[test]
fn what_agrees_or_is_not_asked_for_stays_to_the_bit() {
    let (mut push, fraction) = pressed(1.0);
    let options = InvertOptions::default();
    let (mut pull, _) = invert(&push, &fraction, None, &options).unwrap();
    let (u, v) = (push.displacement.clone(), pull.displacement.clone());
    let grid = u.grid().clone();
    let rigid = bone(&grid);
    let off = ConsistencyOptions { rounds: 0, ..ConsistencyOptions::default() };
    let report = made_to_agree(&mut push, &mut pull, &rigid, &options, &off);
    assert!(report.beyond == report.beyond_before && report.beyond > 0 && report.there_and_back_mm.max > 0.5);
    let generous = ConsistencyOptions { limit_mm: 5.0, ..ConsistencyOptions::default() };
    assert_eq!(made_to_agree(&mut push, &mut pull, &rigid, &options, &generous).beyond, 0);
    // Where bones touch, misses are not counted: here everywhere.
    let plane = u.grid().strides()[2];
    let touching = |n: usize| Some((n / plane % 2) as u16);
    let report = made_to_agree(&mut push, &mut pull, &touching, &options, &ConsistencyOptions::default());
    assert_eq!((report.there_and_back_mm.n, report.beyond_before), (0, 0));
    assert!(push.displacement == u && pull.displacement == v);
}

#[test]
fn misses_change_as_the_system_says() {
    let (mut push, fraction) = pressed(1.0);
    let exact = InvertOptions { tolerance_mm: 1e-5, ..InvertOptions::default() };
    let (mut pull, _) = invert(&push, &fraction, None, &exact).unwrap();
    let grid = push.displacement.grid().clone();
    let rigid = bone(&grid);
    let mut patch = Patch::new(&grid, &fraction);
    patch.extend(
        &[grid.linear([20, 20, BONE - 1])],
        &Beside { bone: &rigid, spared: &Volume::filled(grid.clone(), false) },
        &push,
        &pull,
        &exact,
    );
    let rows = inverse_errors(&push, &pull, &patch.watched, 0.05..3.0);
    let system = System::new(&push, &pull, &rows, &patch, 0.5, 0.3);
    // A small move without pattern.
    let part = |n: usize| (n as f64 * 12.9898).sin();
    let steps: Vec<Vector3<f64>> = (0..=patch.movable.len())
        .map(|n| if n == 0 { Vector3::zeros() } else { 0.01 * Vector3::new(part(n), part(2 * n + 7), part(3 * n + 1)) })
        .collect();
    let predicted = system.changes(&steps);
    assert!(patch.advance(&steps, &mut push, &mut pull, &exact).is_empty());
    let voxels: Vec<usize> = rows.iter().map(|m| m.voxel).collect();
    let after = inverse_errors(&push, &pull, &voxels, 0.0..9.0);
    assert!(rows.len() > 50 && after.len() == rows.len());
    let (mut wrong, mut all) = (0.0, 0.0);
    for ((before, after), predicted) in rows.iter().zip(&after).zip(&predicted) {
        let change = after.by - before.by;
        (wrong, all) = (wrong + (change - predicted).norm(), all + change.norm());
    }
    assert!(all / rows.len() as f64 > 1e-3 && wrong < 0.05 * all, "{wrong} of {all}");
}

#[test]
fn what_was_kept_stays_kept_where_nothing_may_move_any_more() {
    let (mut push, fraction) = pressed(1.0);
    let options = InvertOptions::default();
    let (mut pull, _) = invert(&push, &fraction, None, &options).unwrap();
    let grid = push.displacement.grid().clone();
    let mut patch = Patch::new(&grid, &fraction);
    let seed = grid.linear([20, 20, BONE - 3]);
    patch.extend(
        &[seed],
        &Beside { bone: &bone(&grid), spared: &Volume::filled(grid.clone(), false) },
        &push,
        &pull,
        &options,
    );
    let steps = vec![Vector3::new(0.01, 0.02, -0.01); patch.movable.len() + 1];
    assert!(patch.advance(&steps, &mut push, &mut pull, &options).is_empty());
    let after = push.displacement.clone();
    patch.keep(&push, &pull);
    patch.bar(&[seed]);
    assert!(patch.movable.len() + 2 < steps.len());
    patch.keep(&push, &pull);
    patch.restore(&mut push, &mut pull);
    assert!(push.displacement == after);
}
