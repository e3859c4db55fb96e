//! How far waves go, and who takes what they bring.

use super::super::waves::shortest::arrival;
use super::super::waves::{front, prolongation};
use super::*;
use std::sync::Arc;

/// In a body that is long, each bone's wave goes as far as it counts and no further: the work grows with the bones, not
/// with their square.
#[test]
fn waves_of_a_long_body_stay_near_their_bones() {
    let row: Vec<u8> = (b'A'..=b'Z').flat_map(|bone| [vec![bone], vec![b's'; 9]].concat()).collect();
    let (bones, soft) = (String::from_utf8_lossy(&row).into_owned(), "s".repeat(row.len()));
    let lattice = scene(&[&[&soft, &bones, &soft]]);
    let rules = front::FrontRules::of(&Variant { cutoff: 1e5, ..variant() });
    let medium = arrival::Medium::new(&lattice, rules);
    let latest = medium.latest(&medium.times(front::Source::AnyBone, None), 4.0);
    let reached = |bone: u8, latest| {
        let wave = medium.times(front::Source::Bone(u16::from(bone - b'A')), latest);
        wave.times.iter().flat_map(|t| t.0).filter(|&t| arrival::came(t, wave.limit)).count()
    };
    let all = lattice.soft().count();
    assert_eq!(reached(b'A', None), all);
    // The first time is 5 or 6 links at most: waves may count 4 times as far, of 260 links.
    for (bone, share) in [(b'A', 0.15), (b'M', 0.25), (b'Z', 0.15)] {
        let reached = reached(bone, Some(&latest)) as f64 / all as f64;
        assert!((0.05..share).contains(&reached), "{}: {reached}", char::from(bone));
    }
}

/// Elements of all spacings are told what the same waves bring.
#[test]
fn coarser_elements_take_what_waves_bring_to_finer_ones() {
    let (ct, body, labels, bone_of_label) = small_ct();
    let tissue = Tissue {
        ct: &ct,
        body: &body,
        labels: &labels,
        bone_of_label: &bone_of_label,
        lung: None,
        sliding: None,
        least_hu: -500.0,
    };
    let t = [Rigid::new(Vector3::new(1.0, 0.3, -0.4), Vector3::new(0.2, 0.1, 0.4)); 2];
    let bones = Initiators { transforms: &t, centroids: &[Point3::origin(); 2] };
    let lattice = |spacing| Lattice::new(&tissue, &Material::default(), &Organs::default(), spacing);
    let fine = Arc::new(lattice(0.0));
    let displacement = spread(&fine, &bones, &Variant::default());
    let waves = prolongation::Prolongation { lattice: fine.clone(), displacement, pruning: None };
    assert_eq!(&*waves.on(&fine, &bones), &waves.displacement);
    // Bones that move alike move everything alike.
    let coarse = lattice(1.5);
    let mut inside = 0;
    for (&n, u) in coarse.active.iter().zip(&*waves.on(&coarse, &bones)) {
        let at = coarse.rest(n as usize);
        let whole = fine.grid.index(&at);
        let around = (0..8usize).map(|c| [0, 1, 2].map(|a| (whole[a].floor() as usize) + (c >> a & 1)));
        if around.into_iter().all(|at| fine.node[fine.grid.linear(at)] != Node::Outside) {
            let (u, moved) = (Vector3::from(u.unwrap().map(f64::from)), t[0] * at - at);
            assert!((u - moved).norm() < 1e-4, "{u} for {moved}");
            inside += 1;
        }
    }
    assert!(inside > 20, "{inside}");
}
