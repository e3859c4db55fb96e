//! Lets the elements of one lattice settle: by mechanics alone, then drawn by the images.

use super::super::lattice::Lattice;
use super::growth::Growth;
use super::pull::{ImagePull, Pull};
use super::relax::Relaxation;
use super::untangle::{around, beside, cells_of, tangled};
use crate::volume::Mask;
use rayon::prelude::*;

/// Relative volume of a cell's corner below which (or above its inverse) images free its elements.
/// Without it 215 cells of moderate folded; at 0.6 a chest errs by 1.841 mm for 1.820.
const LEAST_VOLUME: f64 = 0.3;
/// Times that elements are freed of images at each spacing.
/// Half or twice as many move no mean error by 0.003 mm.
const RELEASES: usize = 6;
/// Links around a tangled cell that settle anew when it is freed.
/// Halved nothing changes, at 10 a chest errs by 1.811 mm for 1.820.
const AROUND: usize = 5;

/// Relaxes by mechanics alone (several times where organs change their volume, until they do), then by the images.
pub fn settle(
    mut relaxation: Relaxation<'_>,
    lattice: &Lattice,
    loose: &Mask,
    rounds: usize,
    growth: &mut Growth,
    image: Option<&dyn ImagePull>,
) -> Vec<[f32; 3]> {
    let everywhere = relaxation.everywhere();
    for _ in 0..growth.passes() {
        relaxation.scale_links(growth.scale(lattice.node.len()));
        relaxation.run(rounds, &everywhere, None);
        growth.adapt(lattice, || relaxation.displacements());
    }
    match image {
        Some(image) => compared(relaxation, lattice, loose, image),
        None => relaxation.displacements(),
    }
}

/// Relaxes with the images' pull, which is taken from where cells would tangle, and has none on what is `loose`. After each
/// comparison only what has not settled goes on, and what lies beside it.
fn compared(mut relaxation: Relaxation<'_>, lattice: &Lattice, loose: &Mask, image: &dyn ImagePull) -> Vec<[f32; 3]> {
    let passes = image.passes(lattice);
    let renew = image.at(lattice);
    let mut released = loose.data().to_vec();
    let soft: Vec<u32> = lattice.soft().collect();
    let mut pull = Pull::none(soft.len(), passes.farthest);
    let mut now = relaxation.displacements();
    let mut goes_on = vec![true; lattice.node.len()];
    for pass in 1..=passes.most {
        let which: Vec<u32> = (0..soft.len() as u32).filter(|&s| goes_on[soft[s as usize] as usize]).collect();
        renew(&now, &which, &mut pull);
        pull.release(lattice, &released);
        relaxation.run(passes.rounds, &relaxation.among(&goes_on), Some(&pull));
        let before = std::mem::replace(&mut now, relaxation.displacements());
        let moving = moved(&soft, &before, &now, passes.settled_mm);
        let last = pass == passes.most || moving.len() as f64 <= passes.moving * soft.len() as f64;
        let mut next = beside(lattice, &moving);
        for _ in 0..if last { RELEASES } else { 1 } {
            let cells = tangled(lattice, &now, &cells_of(lattice, &goes_on), LEAST_VOLUME);
            if cells.is_empty() {
                break;
            }
            let near = around(lattice, &cells, AROUND);
            set(&mut goes_on, &near);
            set(&mut next, &near);
            set(&mut released, &around(lattice, &cells, 1));
            pull.release(lattice, &released);
            relaxation.run(passes.rounds, &relaxation.among(&near), Some(&pull));
            now = relaxation.displacements();
        }
        if last {
            break;
        }
        goes_on = next;
    }
    now
}

/// Sets what is set in `more` too.
fn set(nodes: &mut [bool], more: &[bool]) {
    nodes.iter_mut().zip(more).for_each(|(n, more)| *n |= more);
}

/// Those of `nodes` that have moved by more than `least`, mm.
fn moved(nodes: &[u32], before: &[[f32; 3]], after: &[[f32; 3]], least: f64) -> Vec<u32> {
    let far = |n: &u32| {
        let [a, b] = [before, after].map(|u| u[*n as usize]);
        f64::from((0..3).map(|c| (b[c] - a[c]).powi(2)).sum::<f32>()) > least * least
    };
    nodes.par_iter().copied().filter(far).collect()
}

#[cfg(test)]
mod tests {
    use super::super::super::lattice::Node;
    use super::super::super::lattice::material::Constraint;
    use super::super::super::variants::Elasticity;
    use super::super::pull::{Comparison, Passes, Quadratic, STILL_MOVING};
    use super::super::rest::RestingLinks;
    use super::*;
    use crate::geometry::Grid;
    use std::sync::Mutex;

    const SIDE: usize = 24;
    const SETTLED_MM: f64 = 1e-3;
    /// Stiffer than an element's links together.
    const HOLD: f32 = 500.0;

    /// A cube of soft tissue on a bone.
    fn cube() -> Lattice {
        let grid = Grid::axis_aligned([SIDE; 3], [1.0; 3], [0.0; 3]).unwrap();
        let node = |n: usize| match grid.voxel(n) {
            at if at.iter().any(|&c| c == 0 || c == SIDE - 1) => Node::Outside,
            [_, _, 1] => Node::Bone(0),
            _ => Node::Soft,
        };
        let soft = Constraint { min: 0.8, max: 1.5, shear: 0.25 };
        let node: Vec<Node> = (0..grid.len()).map(node).collect();
        Lattice::from_nodes(grid.clone(), node, vec![soft; grid.len()])
    }

    /// Draws the elements of one corner by 0.5 mm and holds all others where they are; notes who asks.
    struct Corner {
        always: bool,
        asked: Mutex<Vec<Vec<u32>>>,
    }

    impl ImagePull for Corner {
        fn at<'a>(&'a self, lattice: &'a Lattice) -> Comparison<'a> {
            let soft: Vec<u32> = lattice.soft().collect();
            Box::new(move |_, which, pull| {
                for &s in which {
                    let drawn = lattice.grid.voxel(soft[s as usize] as usize).iter().all(|&c| c > SIDE - 9);
                    let towards = if drawn { 0.5 * HOLD } else { 0.0 };
                    let stiffness = [HOLD, 0.0, 0.0, HOLD, 0.0, HOLD];
                    pull.set(s as usize, Quadratic { stiffness, towards: [towards, 0.0, 0.0] });
                }
                self.asked.lock().unwrap().push(which.to_vec());
            })
        }

        fn passes(&self, _: &Lattice) -> Passes {
            let settled_mm = if self.always { 0.0 } else { SETTLED_MM };
            Passes { most: 40, rounds: 1, settled_mm, farthest: 10.0, moving: STILL_MOVING }
        }
    }

    #[test]
    fn what_has_settled_is_left_alone() {
        let lattice = cube();
        let rest = RestingLinks::new(&lattice, Elasticity::Corotated);
        let still = vec![[0.0; 3]; lattice.node.len()];
        let soft: Vec<u32> = lattice.soft().collect();
        let loose = Mask::filled(lattice.grid.clone(), false);
        let settled = |always| {
            let corner = Corner { always, asked: Mutex::default() };
            let relaxation = Relaxation::new(&lattice, &rest, &still, &[nalgebra::Matrix3::identity()], 0.3);
            let u = compared(relaxation, &lattice, &loose, &corner);
            (u, corner.asked.into_inner().unwrap())
        };
        let (all, asked) = settled(true);
        assert_eq!(asked.len(), 40);
        let (few, asked) = settled(false);
        // First everyone, then only around the corner, ever fewer.
        assert_eq!(asked[0].len(), soft.len());
        assert!(asked.len() > 2 && asked[1..].iter().all(|which| which.len() < soft.len() / 2));
        assert!(asked[1..].iter().flatten().all(|&s| lattice.grid.voxel(soft[s as usize] as usize)[0] > SIDE / 4));
        // And they end up where they would have otherwise.
        let moved = few.iter().map(|u| u[0]).fold(0.0, f32::max);
        let apart = few.iter().zip(&all).flat_map(|(a, b)| (0..3).map(|c| (a[c] - b[c]).abs())).fold(0.0, f32::max);
        assert!(moved > 0.1 && f64::from(apart) < 3.0 * SETTLED_MM, "{moved} {apart}");
    }
}
