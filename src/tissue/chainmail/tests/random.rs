//! Waves over scenes drawn at random: least times, packed cells, threads.

use super::super::waves::blend::{first_in_order, in_order};
use super::super::waves::front::{FrontRules, Source};
use super::super::waves::shortest::arrival::{Medium, came};
use super::super::waves::shortest::brick::value;
use super::super::waves::shortest::slabs::FirstArrivals;
use super::super::waves::superpose;
use super::*;
use proptest::prelude::*;

fn random_scene() -> impl Strategy<Value = Lattice> {
    proptest::collection::vec(
        prop_oneof![8 => Just(b's'), 2 => Just(b'r'), 1 => Just(b'.'), 1 => Just(b'A'), 1 => Just(b'B')],
        144,
    )
    .prop_map(|cells| {
        let rows: Vec<String> = cells.chunks(6).map(|r| String::from_utf8_lossy(r).into_owned()).collect();
        let planes: Vec<Vec<&str>> = rows.chunks(6).map(|p| p.iter().map(String::as_str).collect()).collect();
        scene(&planes.iter().map(Vec::as_slice).collect::<Vec<_>>())
    })
}

/// What [`Medium::latest`] stands for, link by link until nothing changes: (active soft node, latest ticks).
fn latest_by_hand(lattice: &Lattice, rules: FrontRules, medium: &Medium, ratio: f64) -> Vec<(usize, i32)> {
    let first = medium.times(Source::AnyBone, None);
    let soft: Vec<usize> = lattice.soft().map(|n| n as usize).collect();
    let mut latest = vec![i32::MIN; lattice.node.len()];
    for &n in &soft {
        let ticks = value(&first.times, medium.cell(lattice.grid.voxel(n)));
        let allowed = (ratio * f64::from(ticks)).min(f64::from(first.limit)) as i32;
        latest[n] = if came(ticks, first.limit) { allowed } else { 0 };
    }
    let hops = rules.links(lattice);
    loop {
        let before = latest.clone();
        for &n in &soft {
            for hop in &hops {
                let m = n.wrapping_add_signed(hop.offset);
                if lattice.node[m] == Node::Soft {
                    latest[n] = latest[n].max(latest[m] - rules.between(lattice, n, m, hop.mm) as i32);
                }
            }
        }
        if latest == before {
            return soft.into_iter().map(|n| (n, latest[n])).collect();
        }
    }
}

/// The latest times of one scene are those of their definition.
fn latest_is_right(lattice: &Lattice, rules: FrontRules, ratio: f64) -> Result<(), TestCaseError> {
    let medium = Medium::new(lattice, rules);
    let latest = medium.latest(&medium.times(Source::AnyBone, None), ratio);
    for (n, by_hand) in latest_by_hand(lattice, rules, &medium, ratio) {
        let found = value(&latest, medium.cell(lattice.grid.voxel(n)));
        prop_assert_eq!(found, by_hand, "node {} at ratio {}", n, ratio);
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Timestamps are least path sums: any element's time is at most a neighbour's plus the link, and exactly that of
    /// its fastest parent, whatever order the queue took; and every variant gives the same bits on one or two threads.
    #[test]
    fn times_are_least_and_threads_do_not_matter(lattice in random_scene()) {
        let t = [Rigid::new(Vector3::new(1.0, 0.3, -0.4), Vector3::new(0.2, 0.1, 0.4)), Rigid::translation(0.0, -1.0, 0.5)];
        let c = [Point3::new(1.0, 2.0, 1.0), Point3::origin()];
        let bones = Initiators { transforms: &t, centroids: &c };
        for link_time in [LinkTime::Literal, LinkTime::FastInStiff] {
            let wave = first_wave(&lattice, &bones, &Variant { link_time, ..variant() });
            let time = |a: usize, b: usize| {
                let shear = f64::from(lattice.link(a, b).shear.max(0.02));
                let ticks = if link_time == LinkTime::Literal { 32.0 / shear } else { 32.0 * shear };
                ticks.round().max(1.0) / 32.0
            };
            for &n in &lattice.active {
                let n = n as usize;
                if lattice.node[n] != Node::Soft { continue }
                let [sx, sy, sz] = lattice.grid.strides();
                let least = [n - sx, n + sx, n - sy, n + sy, n - sz, n + sz]
                    .into_iter()
                    .filter(|&m| lattice.node[m] != Node::Outside && wave.time[m].is_finite())
                    .map(|m| wave.time[m] + time(n, m))
                    .fold(f64::INFINITY, f64::min);
                prop_assert!(wave.time[n] == least || least > 800.0, "{} for {least}", wave.time[n]);
            }
        }
        for carry in [Carry::Rigid, Carry::Translation, Carry::ConstraintBased, Carry::LinearDecay] {
            for combination in [Combination::Superposition, Combination::Prioritisation] {
                for (order, structures) in [(Order::Timestamps, Structures::None), (Order::Timestamps, Structures::ThirdCriterion), (Order::ConstraintViolation, Structures::None), (Order::FirstMoved, Structures::None)] {
                    let o = Variant { carry, combination, order, structures, ..variant() };
                    let on = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| spread(&lattice, &bones, &o));
                    let (one, two) = (on(1), on(2));
                    prop_assert!(one == two);
                    prop_assert!(one.iter().flatten().flatten().all(|v| v.is_finite()));
                }
            }
        }
    }

    /// The one contract of both ways to find a wave: with the same settings packed cells have the times of one element at a
    /// time, bit by bit, whatever the links and their law; the owner is the first of the bones that come first.
    #[test]
    fn both_ways_find_the_same_times(lattice in random_scene()) {
        let t = [Rigid::translation(1.0, 0.0, 0.0), Rigid::translation(0.0, -1.0, 0.5)];
        let c = [Point3::origin(); 2];
        let bones = Initiators { transforms: &t, centroids: &c };
        for front in [Front::Round, Front::Rhombus] {
            for link_time in [LinkTime::SlowInStiff, LinkTime::FastInStiff, LinkTime::Literal] {
                for cutoff in [800.0, 9.0] {
                    let rigid = Variant { front, link_time, cutoff, carry: Carry::Rigid, ..variant() };
                    let (packed, general) = (superpose::first_wave(&lattice, &rigid), first_in_order(&lattice, &bones, &rigid));
                    prop_assert_eq!(&packed.time, &general.time);
                    prop_assert_eq!(packed.order.len(), general.order.len());
                    // Each bone alone: the other one is as impassable as air.
                    let alone = [0u16, 1].map(|b| {
                        let apart = |n: &Node| if *n == Node::Bone(1 - b) { Node::Outside } else { *n };
                        let node = lattice.node.iter().map(apart).collect();
                        superpose::first_wave(&Lattice::from_nodes(lattice.grid.clone(), node, lattice.constraint.clone()), &rigid).time
                    });
                    for &n in &lattice.active {
                        let n = n as usize;
                        let first = match (lattice.node[n], packed.time[n].is_finite()) {
                            (Node::Bone(b), _) => Some(b),
                            (_, true) => Some(u16::from(alone[1][n] < alone[0][n])),
                            (_, false) => None,
                        };
                        prop_assert_eq!(packed.owner[n], first);
                        // Of bones that come at the same time the general way takes either.
                        prop_assert!(general.owner[n] == first || alone[0][n] == alone[1][n]);
                    }
                }
            }
        }
    }

    /// And the same displacements, but for the rounding of motions that one takes row by row, also where waves are pruned.
    #[test]
    fn both_ways_find_the_same_displacements(lattice in random_scene(), turn in prop::array::uniform3(-2.0f64..2.0)) {
        let t = [Rigid::new(Vector3::new(1.0, 0.3, -0.4), Vector3::from(turn)), Rigid::translation(0.0, -1.0, 0.5)];
        let bones = Initiators { transforms: &t, centroids: &[Point3::origin(); 2] };
        for front in [Front::Round, Front::Rhombus] {
            for link_time in [LinkTime::SlowInStiff, LinkTime::FastInStiff, LinkTime::Literal] {
                for (combination, exponent, prune_ratio) in [
                    (Combination::Superposition, 4.0, 0.0),
                    (Combination::Superposition, 2.5, 3.0),
                    (Combination::Prioritisation, 4.0, 0.0),
                ] {
                    let rigid = Variant { front, link_time, combination, exponent, prune_ratio, carry: Carry::Rigid, ..variant() };
                    let (packed, general) = (superpose::spread(&lattice, &bones, &rigid).0, in_order(&lattice, &bones, &rigid));
                    let (first, second) = (superpose::first_wave(&lattice, &rigid), first_in_order(&lattice, &bones, &rigid));
                    for (&n, (u, v)) in lattice.active.iter().zip(packed.iter().zip(&general)) {
                        let (Some(u), Some(v)) = (u, v) else { prop_assert!(u == v); continue };
                        let tied = first.owner[n as usize] != second.owner[n as usize];
                        let apart = (0..3).map(|a| (u[a] - v[a]).abs()).fold(0.0, f32::max);
                        prop_assert!(apart < 1e-5 || tied && combination == Combination::Prioritisation, "{} at {}", apart, n);
                    }
                }
            }
        }
    }

    /// Slabs find what one search over the whole finds, times and owners, also where fronts cross from slab to slab and back.
    #[test]
    fn slabs_find_what_the_whole_finds(lattice in random_scene()) {
        for front in [Front::Round, Front::Rhombus] {
            for link_time in [LinkTime::SlowInStiff, LinkTime::FastInStiff] {
                for cutoff in [800.0, 4.0] {
                    let medium = Medium::new(&lattice, FrontRules { time: link_time, front, cutoff });
                    let whole = FirstArrivals::of(&medium, 1);
                    for slabs in 2..=5 {
                        // What comes after the cut-off is not computed to the end, and counts as not come.
                        let parts = FirstArrivals::of(&medium, slabs);
                        for n in 0..8 * medium.bricks.len() {
                            prop_assert_eq!(parts.at(n), whole.at(n), "cell {} of {} slabs", n, slabs);
                        }
                    }
                }
            }
        }
    }

    /// Pruning waves changes no time that counts, and the displacements by no more than the bound that is printed.
    #[test]
    fn what_is_pruned_is_bounded(lattice in random_scene(), ratio in 1.2f64..8.0, turn in prop::array::uniform3(-2.0f64..2.0)) {
        let t = [Rigid::new(Vector3::new(1.0, 0.3, -0.4), Vector3::from(turn)), Rigid::translation(0.0, -1.0, 0.5)];
        let bones = Initiators { transforms: &t, centroids: &[Point3::origin(); 2] };
        for front in [Front::Round, Front::Rhombus] {
            let exact = Variant { front, combination: Combination::Superposition, carry: Carry::Rigid, ..variant() };
            let early = Variant { prune_ratio: ratio, ..exact.clone() };
            let medium = Medium::new(&lattice, FrontRules::of(&exact));
            let first = medium.times(Source::AnyBone, None);
            let latest = medium.latest(&first, ratio);
            let mut gone = 0;
            for bone in 0..2 {
                let (whole, part) = (medium.times(Source::Bone(bone), None), medium.times(Source::Bone(bone), Some(&latest)));
                gone += usize::from(part.pruned);
                let rows = first.times.iter().zip(&whole.times).zip(&part.times);
                for (first, (whole, part)) in rows.flat_map(|((f, w), p)| (0..8).map(|l| (f.0[l], (w.0[l], p.0[l])))) {
                    prop_assert!(part >= whole && (part == whole || f64::from(whole) > ratio * f64::from(first)), "{first} {whole} {part}");
                }
            }
            let (u, _) = superpose::spread(&lattice, &bones, &exact);
            let (v, pruned) = superpose::spread(&lattice, &bones, &early);
            prop_assert_eq!(pruned, gone);
            let bound = Pruning::new(pruned, &lattice, &t, &early);
            for (u, v) in u.iter().zip(&v) {
                let (Some(u), Some(v)) = (u, v) else { prop_assert!(u == v); continue };
                let apart = (0..3).map(|a| f64::from(u[a] - v[a]).powi(2)).sum::<f64>().sqrt();
                prop_assert!(apart <= bound.most_mm + 1e-5, "{} for {:?}", apart, bound);
            }
        }
    }

    /// When a wave may come at the latest is what its definition says, whatever the links and their law.
    #[test]
    fn latest_times_are_the_greatest_of_their_definition(lattice in random_scene(), ratio in 1.2f64..8.0) {
        for front in [Front::Round, Front::Rhombus] {
            for time in [LinkTime::SlowInStiff, LinkTime::FastInStiff] {
                for cutoff in [800.0, 9.0] {
                    latest_is_right(&lattice, FrontRules { time, front, cutoff }, ratio)?;
                }
            }
        }
    }
}
