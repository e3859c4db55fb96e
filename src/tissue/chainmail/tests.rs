//! Every variant on scenes whose answer can be derived by hand: chains, single links, one rotation, an L, a U.
#![expect(clippy::float_cmp, reason = "values that are exact by construction")]

use super::relaxation::relax::Relaxation;
use super::relaxation::rest::RestingLinks;
use super::*;
use crate::geometry::{Grid, Rigid};
use crate::volume::{LabelMap, Mask, Volume};
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

mod random;
mod waves;

/// Play of a link in the scenes: pushed 0.2, pulled 0.5, sideways 0.25 of its length.
const SOFT: Constraint = Constraint { min: 0.8, max: 1.5, shear: 0.25 };
const RIGID: Constraint = Constraint { min: 1.0, max: 1.0, shear: 0.0 };

/// A lattice of 1 mm from rows of letters, lowest j first: `.` outside, `s` soft, `r` rigid tissue, `A`, `B` bones.
/// Inner voxel (i, j, k) is node (i + 1, j + 1, k + 1) and lies at (i, j, k).
fn scene(planes: &[&[&str]]) -> Lattice {
    let inner = [planes[0][0].len(), planes[0].len(), planes.len()];
    let grid = Grid::axis_aligned(inner.map(|n| n + 2), [1.0; 3], [-1.0; 3]).unwrap();
    let (node, constraint) = (0..grid.len())
        .map(|n| {
            let at = grid.voxel(n);
            if (0..3).any(|a| at[a] == 0 || at[a] > inner[a]) {
                return (Node::Outside, RIGID);
            }
            match planes[at[2] - 1][at[1] - 1].as_bytes()[at[0] - 1] {
                b'.' => (Node::Outside, RIGID),
                b's' => (Node::Soft, SOFT),
                b'r' => (Node::Soft, RIGID),
                bone => (Node::Bone(u16::from(bone - b'A')), RIGID),
            }
        })
        .unzip();
    Lattice::from_nodes(grid, node, constraint)
}

fn at(lattice: &Lattice, i: usize, j: usize) -> usize {
    lattice.grid.linear([i + 1, j + 1, 1])
}

/// The thesis's links at every order and carry.
/// Times by the formula of thesis 5.2.2: at a spacing of 1 mm the inverse of the shear.
fn variant() -> Variant {
    Variant {
        link_time: LinkTime::Literal,
        combination: Combination::Prioritisation,
        carry: Carry::Translation,
        ..Variant::thesis()
    }
}

fn spread_of(lattice: &Lattice, moves: &[[f64; 3]], variant: &Variant) -> Vec<Option<[f32; 3]>> {
    let transforms: Vec<Rigid> = moves.iter().map(|&t| Rigid::translation(t[0], t[1], t[2])).collect();
    let centroids = vec![Point3::origin(); transforms.len()];
    let u = spread(lattice, &Initiators { transforms: &transforms, centroids: &centroids }, variant);
    lattice.on_all_nodes(u, None)
}

fn near(a: f32, b: f64) -> bool {
    (f64::from(a) - b).abs() < 1e-5
}

const ORDERS: [Order; 3] = [Order::Timestamps, Order::ConstraintViolation, Order::FirstMoved];

#[test]
fn along_a_chain_every_link_takes_its_play() {
    // Links: bone-soft is the mean of rigid and soft (0.1 pushed, 0.25 pulled), soft-soft 0.2 and 0.5.
    let lattice = scene(&[&["Assssss"]]);
    for order in ORDERS {
        for (push, first, each) in [(1.0, 0.1, 0.2), (-1.0, 0.25, 0.5)] {
            let u = spread_of(&lattice, &[[push, 0.0, 0.0]], &Variant { order, ..variant() });
            for i in 0..7 {
                let left = if i == 0 { 1.0 } else { (1.0 - first - each * (i as f64 - 1.0)).max(0.0) };
                assert!(near(u[at(&lattice, i, 0)].unwrap()[0], push * left), "{order:?} {push} {i}");
            }
        }
        // Sideways: shear 0.125, then 0.25.
        let u = spread_of(&lattice, &[[0.0, 1.0, 0.0]], &Variant { order, ..variant() });
        assert!(near(u[at(&lattice, 1, 0)].unwrap()[1], 0.875) && near(u[at(&lattice, 2, 0)].unwrap()[1], 0.625));
    }
}

#[test]
fn violation_takes_the_stiff_detour_that_is_slow_in_time() {
    // The element right of the bone's corner is reached through soft tissue below or rigid tissue above.
    let lattice = scene(&[&["Asss", "rrrr"]]);
    let u = |order| {
        let u = spread_of(&lattice, &[[1.0, 0.0, 0.0]], &Variant { order, ..variant() });
        u[at(&lattice, 3, 0)].unwrap()[0]
    };
    // In time (literal: rigid is slow) straight along the soft chain: 1 - 0.1 - 0.2 - 0.2.
    assert!(near(u(Order::Timestamps), 0.5));
    // By violation over the rigid row, which keeps 1 mm, and down one link: shear (0 + 0.25) / 2.
    assert!(near(u(Order::ConstraintViolation), 1.0 - 0.125));
}

#[test]
fn first_moved_is_first_processed_and_elements_at_rest_stay() {
    let lattice = scene(&[&["sssssss", "sssssss", "sssAsss", "sssssss", "sssssss"]]);
    let o = Variant { order: Order::FirstMoved, ..variant() };
    let (t, c) = ([Rigid::translation(0.5, 0.0, 0.0)], [Point3::origin()]);
    let wave = first_wave(&lattice, &Initiators { transforms: &t, centroids: &c }, &o);
    let u = spread_of(&lattice, &[[0.5, 0.0, 0.0]], &o);
    let moved = |n: &u32| u[*n as usize].unwrap() != [0.0; 3];
    let first_at_rest = wave.order.iter().position(|n| !moved(n)).unwrap();
    assert!(wave.order[..first_at_rest].len() > 6 && wave.order[first_at_rest..].iter().all(|n| !moved(n)));
    // Breadth first: the number of links from the initiator never falls among the moved.
    let links = |n: &u32| {
        let [i, j, _] = lattice.grid.voxel(*n as usize);
        i.abs_diff(4) + j.abs_diff(3)
    };
    assert!(wave.order[..first_at_rest].windows(2).all(|w| links(&w[0]) <= links(&w[1])));
}

#[test]
fn prioritisation_gives_each_bone_its_region_and_superposition_its_weight() {
    let lattice = scene(&[&["AssssssB"]]);
    let moves = [[0.0; 3], [0.9, 0.0, 0.0]];
    let o = Variant { carry: Carry::Rigid, ..variant() };
    let u = spread_of(&lattice, &moves, &o);
    for i in 0..8 {
        assert!(near(u[at(&lattice, i, 0)].unwrap()[0], if i < 4 { 0.0 } else { 0.9 }), "{i}");
    }
    let t = moves.map(|t| Rigid::translation(t[0], t[1], t[2]));
    let c = [Point3::origin(); 2];
    let wave = first_wave(&lattice, &Initiators { transforms: &t, centroids: &c }, &o);
    let owners: Vec<_> = (0..8).map(|i| wave.owner[at(&lattice, i, 0)]).collect();
    assert_eq!(owners, [[Some(0); 4], [Some(1); 4]].concat());
    // Literal times: bone-soft 1 / 0.125 = 8, soft-soft 4. Element i lies at 8 + 4 (i - 1) from A, mirrored from B.
    for exponent in [1.0, 2.0, 4.0, 2.5] {
        let o = Variant { combination: Combination::Superposition, exponent, ..o.clone() };
        let u = spread_of(&lattice, &moves, &o);
        for i in 1..7 {
            let (a, b) = (4.0 * (f64::from(i) + 1.0), 4.0 * (8.0 - f64::from(i)));
            let w = b.powf(-exponent) / (a.powf(-exponent) + b.powf(-exponent));
            assert!(near(u[at(&lattice, i as usize, 0)].unwrap()[0], 0.9 * w), "n = {exponent}, element {i}");
        }
    }
}

#[test]
fn waves_do_not_enter_other_bones_nor_go_beyond_the_cutoff() {
    let lattice = scene(&[&["ABsssss"]]);
    let o = Variant { combination: Combination::Superposition, carry: Carry::Rigid, ..variant() };
    let u = spread_of(&lattice, &[[5.0, 0.0, 0.0], [0.0, 1.0, 0.0]], &o);
    // A's wave would have to pass B: all tissue follows B, and B keeps its own motion.
    assert!((1..7).all(|i| u[at(&lattice, i, 0)] == Some([0.0, 1.0, 0.0])));
    let u = spread_of(&lattice, &[[0.0; 3], [0.0, 1.0, 0.0]], &Variant { cutoff: 17.0, ..o });
    // Times 8, 12, 16, 20: the third soft element is the last.
    assert_eq!(u[at(&lattice, 4, 0)], Some([0.0, 1.0, 0.0]));
    assert_eq!(u[at(&lattice, 5, 0)], None);
}

/// A chain along x whose first element is the bone; turned by `angle` about the z axis through `centre`.
fn turned_chain(angle: f64, centre: f64, carry: Carry) -> (Lattice, FirstWave, Vec<Option<[f32; 3]>>) {
    let lattice = scene(&[&["Asssssssss"]]);
    let c = Point3::new(centre, 0.0, 0.0);
    let t = [Rigid::from_parts(
        (c - UnitQuaternion::from_scaled_axis(Vector3::z() * angle) * c).into(),
        UnitQuaternion::from_scaled_axis(Vector3::z() * angle),
    )];
    let bones = Initiators { transforms: &t, centroids: &[c] };
    let o = Variant { carry, ..variant() };
    let (wave, u) = (first_wave(&lattice, &bones, &o), lattice.on_all_nodes(spread(&lattice, &bones, &o), None));
    (lattice, wave, u)
}

#[test]
fn one_link_of_the_constraint_based_rotation() {
    // Bone at x = 0, centre at x = -5: the neighbour, 6 mm from the centre, is held at the sheared corner of the turned
    // region: shear 0.125 and, along the link, 6 cos(a) - 5 or the region's end 0.9.
    for angle in [0.1, 0.3, 0.6] {
        let (lattice, wave, u) = turned_chain(angle, -5.0, Carry::ConstraintBased);
        let along = (6.0 * f64::cos(angle) - 5.0).max(0.9);
        let left = angle - f64::atan2(0.125, 5.0 + along);
        let n = at(&lattice, 1, 0);
        assert!(near(wave.angle[n], left), "{angle}: {} for {left}", wave.angle[n]);
        // Its place: the bone's end, 5 mm out at `angle`, and from there (along, -shear) in the turned frame.
        let (s, c) = angle.sin_cos();
        let place = [5.0 * c + along * c + 0.125 * s, 5.0 * s + along * s - 0.125 * c];
        let found = u[n].unwrap();
        assert!(near(found[0], place[0] - 6.0) && near(found[1], place[1]), "{found:?} for {place:?}");
    }
}

#[test]
fn links_along_the_axis_lose_the_angle_of_the_exception() {
    let lattice = scene(&[&["A"], &["s"], &["s"]]);
    let t = [Rigid::rotation(Vector3::z() * 0.8)];
    let c = [Point3::new(3.0, 0.0, 0.0)];
    let o = Variant { carry: Carry::ConstraintBased, ..variant() };
    let wave = first_wave(&lattice, &Initiators { transforms: &t, centroids: &c }, &o);
    let angle = |k: usize| wave.angle[lattice.grid.linear([1, 1, k + 1])];
    assert!(near(angle(0), 0.8) && near(angle(1), 0.8 - f64::atan2(0.125, 0.9)));
    assert!(near(angle(2), 0.8 - f64::atan2(0.125, 0.9) - f64::atan2(0.25, 0.8)));
}

#[test]
fn linear_decay_is_uniform_and_the_arc_never_folds() {
    // Reach 20 mm; play min(0.2, 0.25) of a soft link: 0.2 / 20 rad each, half of it on the first.
    let (lattice, wave, u) = turned_chain(0.3, -20.0, Carry::LinearDecay);
    for i in 1..10 {
        let n = at(&lattice, i, 0);
        let left = 0.3 - 0.01 * (i as f64 - 0.5);
        assert!(near(wave.angle[n], left), "{i}: {}", wave.angle[n]);
        let arm = 20.0 + i as f64;
        assert!((f64::from(u[n].unwrap()[1]) - arm * left.sin()).abs() < 1e-4);
    }
}

#[test]
fn rigid_tissue_turns_as_a_whole() {
    let lattice = scene(&[&["Arr", "rrr"]]);
    let t = [Rigid::new(Vector3::new(0.4, -0.2, 0.0), Vector3::z() * 0.5)];
    let c = [Point3::new(-3.0, 1.0, 0.0)];
    let bones = Initiators { transforms: &t, centroids: &c };
    for carry in [Carry::ConstraintBased, Carry::LinearDecay, Carry::Rigid] {
        for order in [Order::Timestamps, Order::ConstraintViolation] {
            let u = spread(&lattice, &bones, &Variant { carry, order, ..variant() });
            let u = lattice.on_all_nodes(u, None);
            for (i, j) in [(1, 0), (2, 0), (0, 1), (2, 1)] {
                let n = at(&lattice, i, j);
                let x = lattice.rest(n);
                let truth = t[0] * x - x;
                let found = Vector3::from(u[n].unwrap().map(f64::from));
                assert!((found - truth).norm() < 1e-5, "{carry:?} {order:?}: {found:?} for {truth:?}");
            }
        }
    }
}

/// An L open to the upper right: its bars have 8 elements.
fn l_shape() -> Lattice {
    let tall = "Asssssssss";
    scene(&[&["AAAAAAAAss", tall, tall, tall, tall, tall, tall, tall, "ssssssssss"]])
}

#[test]
fn the_corner_of_an_l_averages_both_bars() {
    let lattice = l_shape();
    let push = [[1.0, 0.0, 0.0]];
    let plain = spread_of(&lattice, &push, &variant());
    let second = spread_of(&lattice, &push, &Variant { structures: Structures::SecondCriterion, ..variant() });
    let ux = |u: &[Option<[f32; 3]>], i, j| u[at(&lattice, i, j)].unwrap()[0];
    // First link from the upright bar: pushed 0.1; from the floor: sheared 0.125.
    let corner = 1.0 - (0.1 + 0.125) / 2.0;
    assert!(near(ux(&second, 1, 1), corner), "{}", ux(&second, 1, 1));
    // Plain: one or the other. Along the floor all the same; with flow, the second element is told by the floor (after 8
    // ticks of time) and by the corner (after 8 + 4): eq. 5.10.
    assert!(near(ux(&plain, 4, 1), 0.875) && near(ux(&plain, 1, 4), 0.9));
    let next = (0.875 / 8.0 + (corner - 0.2) / 12.0) / (1.0 / 8.0 + 1.0 / 12.0);
    assert!(near(ux(&second, 2, 1), next), "{} for {next}", ux(&second, 2, 1));
    // The third is told by the second, whose own time is 8 as well.
    let third = (0.875 / 8.0 + (next - 0.2) / 12.0) / (1.0 / 8.0 + 1.0 / 12.0);
    assert!(near(ux(&second, 3, 1), third), "{} for {third}", ux(&second, 3, 1));
}

#[test]
fn flat_faces_need_no_averaging() {
    let lattice = scene(&[&["ssssssss", "sssAAsss", "sssAAsss", "sssAAsss", "ssssssss"]]);
    let push = [[1.0, 0.0, 0.0]];
    let of = |structures| spread_of(&lattice, &push, &Variant { structures, ..variant() });
    let (plain, third) = (of(Structures::None), of(Structures::ThirdCriterion));
    // Beside the faces each element is told by the face alone; off the corners both informants agree but for play.
    for (i, j) in [(0, 2), (1, 1), (2, 3), (5, 2), (7, 3), (3, 0), (4, 4)] {
        assert_eq!(plain[at(&lattice, i, j)], third[at(&lattice, i, j)], "{i} {j}");
    }
}

/// A U open upwards, symmetric about its middle column.
fn u_shape() -> Lattice {
    let row = "AsssssssssssA";
    scene(&[&["AAAAAAAAAAAAA", row, row, row, row, row, row]])
}

#[test]
fn the_third_criterion_keeps_a_u_symmetric() {
    let lattice = u_shape();
    let (lift, mirror) = ([[0.0, 1.0, 0.0]], |i: usize| 12 - i);
    let asymmetry = |structures| {
        let u = spread_of(&lattice, &lift, &Variant { structures, ..variant() });
        let uy = |i, j| u[at(&lattice, i, j)].unwrap()[1];
        (1..7)
            .flat_map(|j| (1..12).map(move |i| (i, j)))
            .map(|(i, j)| (uy(i, j) - uy(mirror(i), j)).abs())
            .fold(0.0, f32::max)
    };
    assert!(asymmetry(Structures::ThirdCriterion) < 2e-2, "{}", asymmetry(Structures::ThirdCriterion));
    assert!(asymmetry(Structures::SecondCriterion) > 2.0 * asymmetry(Structures::ThirdCriterion));
}

#[test]
fn corners_of_a_box_average_three_faces() {
    let floor: &[&str] = &["AAAA", "AAAA", "AAAA", "AAAA"];
    let wall: &[&str] = &["AAAA", "Asss", "Asss", "Asss"];
    let lattice = scene(&[floor, wall, wall, wall]);
    let o = Variant { structures: Structures::SecondCriterion, ..variant() };
    let u = spread_of(&lattice, &[[1.0, 0.0, 0.0]], &o);
    let corner = u[lattice.grid.linear([2, 2, 2])].unwrap()[0];
    assert!(near(corner, 1.0 - (0.1 + 0.125 + 0.125) / 3.0), "{corner}");
    let edge = u[lattice.grid.linear([3, 2, 2])].unwrap()[0];
    let expected = (2.0 * 0.875 / 8.0 + (f64::from(corner) - 0.2) / 12.0) / (2.0 / 8.0 + 1.0 / 12.0);
    assert!(near(edge, expected), "{edge} for {expected}");
}

/// A CT of 12 x 5 x 5 voxels: bones in the end slabs, an organ labelled 7 next to the first, water everywhere.
fn small_ct() -> (Volume<f32>, Mask, LabelMap, Vec<Option<u16>>) {
    let grid = Grid::axis_aligned([12, 5, 5], [1.0; 3], [-3.0, 4.0, 2.0]).unwrap();
    let labels = Volume::from_fn(grid.clone(), |v| match grid.voxel(v)[0] {
        0 => 4,
        1..=3 => 7,
        11 => 2,
        _ => 0,
    });
    let names = [(4, "skull"), (7, "tongue"), (2, "mandible")].map(|(l, n)| (l, n.to_owned())).into();
    let mut bone_of_label = vec![None; 1 << 16];
    (bone_of_label[4], bone_of_label[2]) = (Some(0), Some(1));
    (Volume::filled(grid.clone(), 0.0), Mask::filled(grid, true), LabelMap { volume: labels, names }, bone_of_label)
}

#[test]
fn regions_and_organs_on_a_ct() {
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
    let t = [Rigid::identity(), Rigid::translation(1.0, 0.0, 0.0)];
    let bones = Initiators { transforms: &t, centroids: &[Point3::origin(); 2] };
    // An organ of twice the shear is passed in half the time: 0.25 in water, so 0.5 and more room for the first bone.
    let own = Constraint { min: 0.5, max: 1.5, shear: 0.5 };
    let region = |o: &ChainmailOptions| {
        let p = propagate(&tissue, &bones, o, None, &crate::progress::Silent).unwrap();
        let r = regions(&tissue, &p.lattice, &bones, &o.variant).unwrap();
        let row: Vec<u16> = (0..12).map(|i| *r.at([i, 2, 2])).collect();
        let moved: Vec<bool> = (0..12).map(|i| p.push.displacement.at([i, 2, 2])[0] > 0.5).collect();
        // With prioritisation the regions are what moves.
        assert_eq!(row.iter().map(|&b| b == 2).collect::<Vec<_>>(), moved);
        row.iter().filter(|&&b| b == 1).count()
    };
    let variant = Variant { carry: Carry::Rigid, link_time: LinkTime::SlowInStiff, ..variant() };
    let o = ChainmailOptions { variant, ..ChainmailOptions::thesis() };
    let with_organ = ChainmailOptions { organs: [("tongue".to_owned(), own)].into(), ..o.clone() };
    assert_eq!((region(&o), region(&with_organ)), (6, 7));
    let wrong = ChainmailOptions { organs: [("liver".to_owned(), own)].into(), ..o };
    let Err(error) = propagate(&tissue, &bones, &wrong, None, &crate::progress::Silent) else {
        panic!("liver is no label")
    };
    assert!(error.to_string().contains("liver") && error.exit_code() == 2);
}

#[test]
fn cavities_move_along_and_the_field_fades_outside() {
    // A tube of tissue around 60 mm of air, with a bone at one end that moves by 4 mm; air on both sides of the patient.
    let grid = Grid::axis_aligned([41, 41, 26], [4.0; 3], [0.0; 3]).unwrap();
    let inside = |l: usize| grid.voxel(l)[..2].iter().all(|c| (10..=30).contains(c));
    let hollow = |l: usize| grid.voxel(l)[..2].iter().all(|c| (13..=27).contains(c)) && grid.voxel(l)[2] > 2;
    let ct = Volume::from_fn(grid.clone(), |l| if inside(l) && !hollow(l) { 0.0 } else { -1000.0 });
    let body = Volume::from_fn(grid.clone(), inside);
    let labels = Volume::from_fn(grid.clone(), |l| u16::from(inside(l) && grid.voxel(l)[2] < 2));
    let labels = LabelMap { volume: labels, names: [(1, "skull".to_owned())].into() };
    let mut bone_of_label = vec![None; 1 << 16];
    bone_of_label[1] = Some(0);
    let tissue = Tissue {
        ct: &ct,
        body: &body,
        labels: &labels,
        bone_of_label: &bone_of_label,
        lung: None,
        sliding: None,
        least_hu: -500.0,
    };
    let t = [Rigid::translation(4.0, 0.0, 0.0)];
    let bones = Initiators { transforms: &t, centroids: &[Point3::origin()] };
    let variant = Variant { carry: Carry::Rigid, ..variant() };
    let o = ChainmailOptions { spacing_mm: 4.0, variant, ..ChainmailOptions::thesis() };
    let push = propagate(&tissue, &bones, &o, None, &crate::progress::Silent).unwrap().push;
    let moves = |i: usize, k: usize| push.displacement.at([i, 20, k])[0];
    assert!(!push.computed.at([20, 20, 25]) && (moves(20, 25) - moves(11, 25)).abs() < 0.3, "{}", moves(20, 25));
    assert!(moves(20, 25) > 1.0);
    // 8 mm outside the skin it moves as the skin, within 28 mm it has faded, steadily.
    let outside: Vec<f32> = (30..41).map(|i| moves(i, 1)).collect();
    assert!((outside[0] - outside[2]).abs() < 1e-3 && outside[8] == 0.0, "{outside:?}");
    assert!(outside.windows(2).all(|w| w[0] >= w[1] && w[0] - w[1] < 0.75 * 4.0));
}

#[test]
fn relaxation_finds_the_chain_between_two_bones() {
    let lattice = scene(&[&["AsssB"]]);
    let moved: Vec<[f32; 3]> =
        spread_of(&lattice, &[[0.0; 3], [1.0, 0.0, 0.0]], &variant()).iter().map(|u| u.unwrap_or_default()).collect();
    let turns = [Matrix3::identity(); 2];
    let relaxed = |elasticity| {
        let rest = RestingLinks::new(&lattice, elasticity);
        let mut r = Relaxation::new(&lattice, &rest, &moved, &turns, 0.0);
        r.run(400, &r.everywhere(), None);
        let u = r.displacements();
        [1, 2, 3].map(|i| u[at(&lattice, i, 0)][0])
    };
    // Gibson: equal springs. Heterogeneous: the outer links have half the play, so they stretch half as much.
    assert!(relaxed(Elasticity::Gibson).iter().zip([0.25, 0.5, 0.75]).all(|(&u, t)| near(u, t)));
    let sixth = 1.0 / 6.0;
    assert!(relaxed(Elasticity::Heterogeneous).iter().zip([sixth, 0.5, 5.0 * sixth]).all(|(&u, t)| near(u, t)));
}

/// A bar between two bones that draw apart: in its middle it thins by Poisson's ratio times its stretch.
#[test]
fn a_stretched_bar_thins_by_poissons_ratio() {
    let row = "AsssssssssssssssssssssssB";
    let lattice = scene(&[[row; 5].as_slice(); 5]);
    let turns = [Matrix3::identity(); 2];
    let [sx, sy, sz] = lattice.grid.strides();
    let middle = lattice.grid.linear([13, 3, 3]);
    let ratio = |poisson| {
        let u: Vec<[f32; 3]> =
            (0..lattice.node.len()).map(|n| [0.02 * lattice.grid.voxel(n)[0] as f32, 0.0, 0.0]).collect();
        let rest = RestingLinks::new(&lattice, Elasticity::Corotated);
        let mut r = Relaxation::new(&lattice, &rest, &u, &turns, poisson);
        r.run(3000, &r.everywhere(), None);
        let u = r.displacements();
        let slope = |d: usize, a: usize| (u[middle + d][a] - u[middle - d][a]) / 2.0;
        -f64::from(slope(sy, 1) + slope(sz, 2)) / 2.0 / f64::from(slope(sx, 0))
    };
    let (links, tissue) = (ratio(0.0), ratio(0.38));
    assert!(links.abs() < 1e-3 && (tissue - 0.38).abs() < 0.03, "{links} {tissue}");
}
