//! A registration of the phantom finds the motion that made its fraction CT.
//!
//! The phantom has 3 mm voxels here so that the test is quick; small bones are blurred, so the bounds
//! are those of a coarse image, and stand within 15 % of what was measured, so that what makes them worse is seen; docs/validation.md has the numbers at clinical resolution.

use crate::support::score::{Score, TruthPoint, name, score};
use crate::support::shared::fine_registered;
use aventail::chainmail::{ChainmailOptions, Initiators, Tissue, Variant, propagate};
use aventail::fit::DeterminedBy;
use aventail::phantom::Phantom;
use aventail::progress::Silent;
use std::collections::BTreeMap;

/// Mean over bones of their points' mean error, mm: 0.465 measured.
const BONES_MM: f64 = 0.53;
/// A bone's mean error, mm: 2.44 measured; the cut ends of forearm bones are round and say little of their turn.
const WORST_BONE_MM: f64 = 2.8;
/// Mean error of soft tissue, mm: 0.81 measured, 1.10 by bones alone.
const SOFT_MM: f64 = 0.93;
/// A bone's departure from a rigid motion, mm: single precision.
const RIGID_MM: f64 = 0.001;

/// Body voxels whose true place lies inside the fraction image, with their true motion.
fn truth(phantom: &Phantom) -> Vec<TruthPoint> {
    let grid = phantom.planning.grid();
    let seen = phantom.fraction.grid();
    let tissue = |l: &usize| phantom.body.data()[*l] && phantom.planning.data()[*l] > -500.0;
    (0..grid.len())
        .filter(tissue)
        .filter_map(|l| {
            let at = grid.centre(grid.voxel(l));
            let to = phantom.push(&at);
            let bone = phantom.bones.volume.data()[l];
            seen.contains(&seen.index(&to)).then(|| TruthPoint { at, motion: to - at, bone })
        })
        .collect()
}

#[test]
fn bones_and_tissue_are_where_they_truly_went() {
    let (phantom, outcome) = fine_registered();
    let truth = truth(phantom);
    let moved = truth.iter().map(|p| p.motion.norm()).sum::<f64>() / truth.len() as f64;
    assert!(moved > 5.0, "the phantom moves by {moved} mm, so standing still is no answer");
    let Score { soft, bones, worst } = score(&outcome.push, &truth, 20);
    let bone = name(&phantom.bones, worst.0);
    println!("motion {moved:.2} mm; bones {bones:.3} mm, worst {bone} {:.3} mm, soft tissue {soft:.3} mm", worst.1);
    assert!(bones <= BONES_MM, "bones {bones} mm");
    assert!(worst.1 <= WORST_BONE_MM, "{bone} {} mm", worst.1);
    assert!(soft <= SOFT_MM, "soft tissue {soft} mm");
}

#[test]
fn the_field_moves_bones_rigidly_as_their_transforms_say() {
    let (phantom, outcome) = fine_registered();
    for bone in &outcome.rigidity {
        assert!(bone.rms_mm <= RIGID_MM, "{} departs by {} mm", bone.name, bone.rms_mm);
    }
    let fits: BTreeMap<&str, _> = outcome.bone_fits.iter().map(|f| (f.name.as_str(), f.transform)).collect();
    let grid = phantom.planning.grid();
    let mut checked = 0;
    for (l, label) in phantom.bones.volume.data().iter().enumerate().filter(|(_, label)| **label > 0) {
        let x = grid.centre(grid.voxel(l));
        let u = outcome.push.displacement.data()[l].map(f64::from);
        let meant = fits[name(&phantom.bones, *label)] * x;
        assert!((x + nalgebra::Vector3::from(u) - meant).norm() < 1e-3, "{} at {x}", name(&phantom.bones, *label));
        checked += 1;
    }
    assert!(checked > 5_000, "{checked} bone voxels");
}

#[test]
fn nothing_folds_outside_bone_contact() {
    let report = &fine_registered().1.jacobian_report;
    println!("{} of {} cells fold, {} in contact", report.body.folded, report.body.cells, report.contact.folded);
    assert!(report.body.cells > 50_000);
    assert_eq!(report.body.folded, 0);
}

#[test]
fn landmarks_come_closer() {
    let landmarks = fine_registered().1.landmarks.as_ref().unwrap();
    println!("landmarks {:.2} mm before, {:.2} mm after", landmarks.before.mean, landmarks.after.mean);
    assert!(landmarks.each.len() >= 16);
    assert!(landmarks.ratio_of_means <= 0.06, "ratio of means {}", landmarks.ratio_of_means);
}

#[test]
fn the_inverse_undoes_the_field() {
    let outcome = fine_registered().1;
    let grid = outcome.pull.displacement.grid();
    let mut apart: Vec<f64> = (0..grid.len())
        .filter(|&l| outcome.pull.inside.data()[l])
        .filter_map(|l| {
            let y = grid.centre(grid.voxel(l));
            let x = y + nalgebra::Vector3::from(outcome.pull.displacement.data()[l].map(f64::from));
            let back = aventail::field::push_point(&outcome.push, &x)?;
            Some((back - y).norm())
        })
        .collect();
    apart.sort_by(f64::total_cmp);
    assert!(apart.len() > 100_000, "{}", apart.len());
    let p999 = apart[apart.len() * 999 / 1000];
    println!("push after pull: 99.9th percentile {p999:.4} mm");
    assert!(p999 <= 0.0013, "{p999} mm");
}

#[test]
fn the_way_there_and_back_ends_where_it_began() {
    let report = &fine_registered().1.consistency;
    let back = &report.there_and_back_mm;
    println!(
        "planning to fraction and back: {:.4} mm mean, {:.3} mm worst of {}, beyond 0.5 mm {} (before {})",
        back.mean, back.max, back.n, report.beyond, report.beyond_before
    );
    assert!(back.n > 100_000 && back.mean <= 0.039, "{back:?}");
    // Islands of tissue in the lung once came back from up to 12 mm away.
    assert!(back.max <= 0.5 && report.beyond == 0, "{report:?}");
}

/// What the default saves costs less than a tenth of a millimetre: elements of 4.5 mm for waves instead of every voxel, and waves
/// that are pruned. Bones alone, without images, which would hide the difference.
#[test]
fn the_default_is_as_good_as_waves_through_every_voxel() {
    let (phantom, _) = fine_registered();
    let centroids: Vec<_> = phantom.skeleton.bones.iter().map(|b| b.centroid).collect();
    let mut bone_of_label = vec![None; 1 << 16];
    for (b, bone) in phantom.skeleton.bones.iter().enumerate() {
        bone_of_label[usize::from(bone.label)] = Some(b as u16);
    }
    let options = ChainmailOptions::default();
    let tissue = Tissue {
        ct: &phantom.planning,
        body: &phantom.body,
        labels: &phantom.bones,
        bone_of_label: &bone_of_label,
        lung: None,
        sliding: None,
        least_hu: options.least_hu,
    };
    let bones = Initiators { transforms: &phantom.transforms, centroids: &centroids };
    let of =
        |options: &ChainmailOptions| propagate(&tissue, &bones, options, None, &Silent).expect("no organs are named");
    let default = of(&options);
    let variant = Variant { waves_mm: 0.0, prune_ratio: 0.0, ..Variant::default() };
    let exact = of(&ChainmailOptions { variant, ..options });
    let apart: Vec<f64> = (0..phantom.planning.grid().len())
        .filter(|&l| default.push.computed.data()[l] && phantom.bones.volume.data()[l] == 0)
        .map(|l| {
            let [a, b] =
                [&default, &exact].map(|p| nalgebra::Vector3::from(p.push.displacement.data()[l].map(f64::from)));
            (a - b).norm()
        })
        .collect();
    let mean = apart.iter().sum::<f64>() / apart.len() as f64;
    let waves = [&default, &exact].map(|p| p.pruning.expect("a bound is known"));
    println!("{mean:.4} mm apart on the mean of {}; {}; {}", apart.len(), waves[0], waves[1]);
    assert!(apart.len() > 100_000 && mean > 1e-4 && mean <= 0.006, "{mean} mm");
    assert!(waves[0].waves > 0 && waves[0].most_mm <= 0.1, "{waves:?}");
    assert_eq!((waves[1].waves, waves[1].most_mm), (0, 0.0));
}

#[test]
fn the_fit_says_which_bones_the_image_shows() {
    let outcome = fine_registered().1;
    let by_image = outcome.bone_fits.iter().filter(|f| f.determined_by == DeterminedBy::Image).count();
    assert!(by_image >= 30, "{by_image} bones");
    for fit in outcome.bone_fits.iter().filter(|f| f.determined_by == DeterminedBy::Image) {
        let (before, after) = (fit.similarity_before.unwrap(), fit.similarity_after.unwrap());
        assert!((0.0..=1.0).contains(&after) && (0.0..=1.0).contains(&before), "{}: {before} {after}", fit.name);
        assert!(fit.position_sd_mm.is_finite() && fit.position_sd_mm > 0.0, "{}", fit.name);
    }
    let better = outcome.bone_fits.iter().filter(|f| f.similarity_after > f.similarity_before).count();
    assert!(better * 10 >= outcome.bone_fits.len() * 7, "{better} bones fit better than before");
}
