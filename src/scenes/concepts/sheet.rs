//! A 2-D scene: a lattice one element thick, deformed by the chain mail.

use super::{Heat, Mesh};
use crate::chainmail::{
    Carry, Combination, Constraint, FirstWave, Front, Initiators, Lattice, LinkTime, Material, MaterialName, Node,
    Variant, first_wave, spread,
};
use crate::geometry::{Grid, Rigid};
use nalgebra::{Point3, UnitQuaternion, Vector3};

/// A rigid element.
pub(super) const RIGID: Constraint = Constraint { min: 1.0, max: 1.0, shear: 0.0 };

/// Soft tissue of the figures: water in the elastic set, which the thesis uses in chapter 5.
pub(super) fn soft() -> (Node, Constraint) {
    (Node::Soft, Material::Named(MaterialName::Elastic).at(0.0))
}

/// Stiffer tissue for structures, which extends more easily than it is compressed: opposite sides of a structure then
/// differ, and conflicts between their waves show.
pub(super) fn stiff() -> (Node, Constraint) {
    (Node::Soft, Constraint { min: 0.75, max: 1.3, shear: 0.25 })
}

/// A bone's element.
pub(super) fn bone(b: u16) -> (Node, Constraint) {
    (Node::Bone(b), RIGID)
}

/// The thesis's links; every figure changes what it is about. A link of 1 mm takes the time of its stiffness, so that
/// stiff tissue is fast, as Fig. 14 shows it.
pub(super) fn variant() -> Variant {
    Variant {
        front: Front::Rhombus,
        link_time: LinkTime::FastInStiff,
        carry: Carry::Translation,
        combination: Combination::Prioritisation,
        prune_ratio: 0.0,
        ..Variant::thesis()
    }
}

/// Elements of 1 mm at (0, 0), (1, 0), ... and the bones that move them.
pub(super) struct Sheet {
    lattice: Lattice,
    size: [usize; 2],
    transforms: Vec<Rigid>,
    centroids: Vec<Point3<f64>>,
}

impl Sheet {
    /// A sheet with `element(i, j)` everywhere.
    pub(super) fn new(size: [usize; 2], element: impl Fn(usize, usize) -> (Node, Constraint)) -> Self {
        let grid = Grid::axis_aligned([size[0] + 2, size[1] + 2, 3], [1.0; 3], [-1.0, -1.0, -1.0])
            .expect("spacing 1 and a size above 0 are legal");
        let inside = |[i, j, k]: [usize; 3]| k == 1 && (1..=size[0]).contains(&i) && (1..=size[1]).contains(&j);
        let (node, constraint) = (0..grid.len())
            .map(|n| {
                let [i, j, k] = grid.voxel(n);
                if inside([i, j, k]) { element(i - 1, j - 1) } else { (Node::Outside, RIGID) }
            })
            .unzip();
        let lattice = Lattice::from_nodes(grid, node, constraint);
        Self { lattice, size, transforms: Vec::new(), centroids: Vec::new() }
    }

    /// The next bone moves by `shift` mm.
    pub(super) fn moved(mut self, shift: [f64; 2]) -> Self {
        self.transforms.push(Rigid::translation(shift[0], shift[1], 0.0));
        self.centroids.push(Point3::origin());
        self
    }

    /// The next bone turns by `degrees` about `centre`.
    pub(super) fn turned(mut self, degrees: f64, centre: [f64; 2]) -> Self {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * degrees.to_radians());
        let c = Point3::new(centre[0], centre[1], 0.0);
        self.transforms.push(Rigid::from_parts((c - turn * c).into(), turn));
        self.centroids.push(c);
        self
    }

    fn bones(&self) -> Initiators<'_> {
        Initiators { transforms: &self.transforms, centroids: &self.centroids }
    }

    /// Storage position of element (i, j).
    pub(super) fn node(&self, i: usize, j: usize) -> usize {
        self.lattice.grid.linear([i + 1, j + 1, 1])
    }

    fn elements(&self) -> impl Iterator<Item = [usize; 2]> {
        let [nx, ny] = self.size;
        (0..ny).flat_map(move |j| (0..nx).map(move |i| [i, j]))
    }

    /// The wave from all bones in detail.
    pub(super) fn wave(&self, variant: &Variant) -> FirstWave {
        first_wave(&self.lattice, &self.bones(), variant)
    }

    /// Displacement of each element, mm; zero where no wave comes. x fastest.
    pub(super) fn displacement(&self, variant: &Variant) -> Vec<[f64; 2]> {
        let u = self.lattice.on_all_nodes(spread(&self.lattice, &self.bones(), variant), None);
        let of = |[i, j]: [usize; 2]| u[self.node(i, j)].map_or([0.0; 2], |u| [f64::from(u[0]), f64::from(u[1])]);
        self.elements().map(of).collect()
    }

    /// The deformed elements.
    pub(super) fn mesh(&self, variant: &Variant) -> Mesh {
        let u = self.displacement(variant);
        let place: Vec<[f64; 2]> =
            self.elements().zip(&u).map(|([i, j], u)| [i as f64 + u[0], j as f64 + u[1]]).collect();
        let rigid = |n: usize| self.lattice.node[n] != Node::Outside && self.lattice.constraint[n] == RIGID;
        let mut points = Vec::new();
        for b in 0..self.transforms.len() as u16 {
            let own: Vec<usize> = (0..place.len())
                .filter(|&e| self.lattice.node[self.node(e % self.size[0], e / self.size[0])] == Node::Bone(b))
                .collect();
            if let [e] = own[..] {
                points.push([[(e % self.size[0]) as f64, (e / self.size[0]) as f64], place[e]]);
            }
        }
        Mesh {
            size: self.size,
            rigid: self.elements().map(|[i, j]| rigid(self.node(i, j))).collect(),
            outline: self.outline(rigid),
            points,
            window: [[-1.0; 2], self.size.map(|n| n as f64)],
            place,
        }
    }

    /// The deformed elements inside a window: lower left and upper right corner.
    pub(super) fn close_up(&self, variant: &Variant, window: [[f64; 2]; 2]) -> Mesh {
        Mesh { window, ..self.mesh(variant) }
    }

    /// Processing index of each element that moves, from 0 (first) to 1 (last).
    pub(super) fn heat(&self, variant: &Variant) -> Heat {
        let wave = self.wave(variant);
        let u = self.lattice.on_all_nodes(spread(&self.lattice, &self.bones(), variant), None);
        let moves = |n: &&u32| u[**n as usize].is_some_and(|u| u[0].hypot(u[1]) > 1e-6);
        let order: Vec<u32> = wave.order.iter().filter(moves).copied().collect();
        let mut index = vec![None; self.lattice.node.len()];
        for (at, &n) in order.iter().enumerate() {
            index[n as usize] = Some(at as f64 / order.len() as f64);
        }
        Heat {
            size: self.size,
            value: self.elements().map(|[i, j]| index[self.node(i, j)]).collect(),
            outline: self.outline(|n| self.lattice.constraint[n] == RIGID && self.lattice.node[n] == Node::Soft),
        }
    }

    /// Edges between elements that are `inside` and those that are not.
    fn outline(&self, inside: impl Fn(usize) -> bool) -> Vec<[[f64; 2]; 2]> {
        let mut out = Vec::new();
        for [i, j] in self.elements() {
            let n = self.node(i, j);
            if !inside(n) {
                continue;
            }
            let (x, y) = (i as f64, j as f64);
            let row = self.size[0] + 2;
            for (other, a, b) in [
                (n - 1, [-0.5, -0.5], [-0.5, 0.5]),
                (n + 1, [0.5, -0.5], [0.5, 0.5]),
                (n - row, [-0.5, -0.5], [0.5, -0.5]),
                (n + row, [-0.5, 0.5], [0.5, 0.5]),
            ] {
                if !inside(other) || self.lattice.node[other] == Node::Outside {
                    out.push([[x + a[0], y + a[1]], [x + b[0], y + b[1]]]);
                }
            }
        }
        out
    }
}
