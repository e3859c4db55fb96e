//! What pulls elements besides their links: a quadratic energy per element, as images give it.

use super::super::lattice::Lattice;

/// Energy `1/2 u.A u - b.u` of one element's displacement `u`; zero where nothing pulls.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Quadratic {
    /// `A`, in the order of [`Pull::ENTRIES`]; positive semidefinite.
    pub stiffness: [f32; 6],
    /// `b`.
    pub towards: [f32; 3],
}

/// Energy `1/2 u.A u - b.u` of each soft element's displacement `u`, in storage order.
#[derive(Debug, Clone)]
pub struct Pull {
    /// `A`, its entries in the order of [`Pull::ENTRIES`]; positive semidefinite, zero where nothing pulls.
    pub stiffness: Vec<[f32; 6]>,
    /// `b`.
    pub towards: Vec<[f32; 3]>,
    /// What outlines ask of each soft element, as its links do: nothing limits it. Empty where nothing is outlined.
    pub firm: Vec<Quadratic>,
    /// The farthest that an element is drawn away from where its links alone would hold it, mm.
    pub farthest: f32,
}

impl Quadratic {
    /// Whether it pulls at all.
    fn pulls(&self) -> bool {
        let [xx, _, _, yy, _, zz] = self.stiffness;
        xx + yy + zz > 0.0
    }
}

impl Pull {
    /// Rows and columns of the entries of a symmetric 3x3: xx, xy, xz, yy, yz, zz.
    pub const ENTRIES: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

    /// No pull on any of `soft` elements.
    pub fn none(soft: usize, farthest: f32) -> Self {
        Self { stiffness: vec![[0.0; 6]; soft], towards: vec![[0.0; 3]; soft], firm: Vec::new(), farthest }
    }

    /// Sets what pulls soft element `s`.
    pub fn set(&mut self, s: usize, energy: Quadratic) {
        self.stiffness[s] = energy.stiffness;
        self.towards[s] = energy.towards;
    }

    /// Takes the pull from the nodes that are set.
    pub(in crate::chainmail) fn release(&mut self, lattice: &Lattice, nodes: &[bool]) {
        for (s, n) in lattice.soft().enumerate() {
            if nodes[n as usize] {
                self.stiffness[s] = [0.0; 6];
                self.towards[s] = [0.0; 3];
                if let Some(firm) = self.firm.get_mut(s) {
                    *firm = Quadratic::default();
                }
            }
        }
    }

    /// Where soft element `s` comes to rest whose links have the total stiffness `weights` and would hold it at
    /// `sum / weights`.
    pub fn settle(&self, s: usize, weights: f32, sum: [f32; 3]) -> [f32; 3] {
        if let Some(firm) = self.firm.get(s).filter(|firm| firm.pulls()) {
            let (sum, free) = firm.with(weights, &[0.0; 6], sum);
            return self.drawn(s, weights, &firm.stiffness, sum, free);
        }
        let [xx, _, _, yy, _, zz] = self.stiffness[s];
        if xx + yy + zz <= 0.0 {
            return sum.map(|s| s / weights);
        }
        let t = self.towards[s];
        let b = [sum[0] + t[0], sum[1] + t[1], sum[2] + t[2]];
        let settled = settle(weights, &self.stiffness[s], b);
        self.held(settled, sum.map(|s| s / weights))
    }

    /// As [`Pull::settle`], where links also have a stiffness of directions, and would hold the element at `free`.
    pub(in crate::chainmail) fn settle_from(
        &self,
        s: usize,
        weights: f32,
        stiffness: &[f32; 6],
        sum: [f32; 3],
        free: [f32; 3],
    ) -> [f32; 3] {
        if let Some(firm) = self.firm.get(s).filter(|firm| firm.pulls()) {
            let (sum, free) = firm.with(weights, stiffness, sum);
            let firm = std::array::from_fn(|e| firm.stiffness[e] + stiffness[e]);
            return self.drawn(s, weights, &firm, sum, free);
        }
        self.drawn(s, weights, stiffness, sum, free)
    }

    /// Where images draw an element that would else rest at `free`.
    #[inline(always)]
    fn drawn(&self, s: usize, weights: f32, stiffness: &[f32; 6], sum: [f32; 3], free: [f32; 3]) -> [f32; 3] {
        let both = std::array::from_fn(|e| self.stiffness[s][e] + stiffness[e]);
        let t = self.towards[s];
        self.held(settle(weights, &both, std::array::from_fn(|a| sum[a] + t[a])), free)
    }

    /// No farther from where links would hold it than is allowed.
    #[inline(always)]
    fn held(&self, settled: [f32; 3], free: [f32; 3]) -> [f32; 3] {
        let d: [f32; 3] = std::array::from_fn(|a| settled[a] - free[a]);
        let far = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        let keep = if far > self.farthest { self.farthest / far } else { 1.0 };
        std::array::from_fn(|a| free[a] + keep * d[a])
    }
}

impl Quadratic {
    /// The pull of links of a stiffness together with this one, and where both would hold an element.
    #[inline(always)]
    fn with(&self, weights: f32, stiffness: &[f32; 6], sum: [f32; 3]) -> ([f32; 3], [f32; 3]) {
        let sum = std::array::from_fn(|a| sum[a] + self.towards[a]);
        (sum, settle(weights, &std::array::from_fn(|e| self.stiffness[e] + stiffness[e]), sum))
    }
}

/// The solution of `(weights I + A) u = b`: the inverse of a symmetric 3x3 by its adjugate.
#[inline(always)]
pub(in crate::chainmail) fn settle(weights: f32, &[xx, xy, xz, yy, yz, zz]: &[f32; 6], b: [f32; 3]) -> [f32; 3] {
    let (a, d, f) = (xx + weights, yy + weights, zz + weights);
    let (c0, c1, c2) = (d * f - yz * yz, xz * yz - xy * f, xy * yz - xz * d);
    let determinant = a * c0 + xy * c1 + xz * c2;
    let (c3, c4, c5) = (a * f - xz * xz, xy * xz - a * yz, a * d - xy * xy);
    [
        (c0 * b[0] + c1 * b[1] + c2 * b[2]) / determinant,
        (c1 * b[0] + c3 * b[1] + c4 * b[2]) / determinant,
        (c2 * b[0] + c4 * b[1] + c5 * b[2]) / determinant,
    ]
}

/// Renews the pull on some soft elements (their positions among a lattice's soft elements, ascending) at displacements of
/// the lattice's nodes (storage order, mm).
pub type Comparison<'a> = Box<dyn Fn(&[[f32; 3]], &[u32], &mut Pull) + 'a>;

/// Images that pull elements towards places that look alike.
pub trait ImagePull: Sync {
    /// Prepares for a lattice.
    fn at<'a>(&'a self, lattice: &'a Lattice) -> Comparison<'a>;

    /// How often the images are compared on a lattice.
    fn passes(&self, lattice: &Lattice) -> Passes;
}

/// Comparisons of the images on one lattice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Passes {
    /// Comparisons at most.
    pub most: usize,
    /// Rounds of relaxation after each.
    pub rounds: usize,
    /// An element has settled when it moves by no more than this after a comparison, mm.
    pub settled_mm: f64,
    /// As [`Pull::farthest`].
    pub farthest: f32,
    /// Share of the soft elements that may still move after the last comparison.
    pub moving: f64,
}

/// Share of the soft elements that may still move after the last comparison, where images alone draw them.
/// Half or twice as much moves no mean error by 0.003 mm.
pub const STILL_MOVING: f64 = 0.01;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_element_rests_where_links_and_pull_balance_but_not_far_from_its_links() {
        // Links of stiffness 2 hold it at (1, 0, 0); along x and y it is drawn with stiffness 2 to (3, 4, .).
        let mut pull = Pull::none(1, 100.0);
        let close = |at: [f32; 3], to: [f32; 3]| at.iter().zip(to).all(|(a, b)| (a - b).abs() < 1e-5);
        assert!(close(pull.settle(0, 2.0, [2.0, 0.0, 0.0]), [1.0, 0.0, 0.0]));
        (pull.stiffness[0], pull.towards[0]) = ([2.0, 0.0, 0.0, 2.0, 0.0, 0.0], [6.0, 8.0, 0.0]);
        assert!(close(pull.settle(0, 2.0, [2.0, 0.0, 0.0]), [2.0, 2.0, 0.0]));
        pull.farthest = 0.5;
        let held = pull.settle(0, 2.0, [2.0, 0.0, 0.0]);
        assert!(close(held, [1.0 + 0.5 / 5f32.sqrt(), 1.0 / 5f32.sqrt(), 0.0]), "{held:?}");
    }

    #[test]
    fn nothing_limits_what_an_outline_asks_and_images_depart_from_there() {
        // Links of stiffness 2 hold it at (1, 0, 0); its outline asks for y = 9 with stiffness 4, images for z = 3.
        let mut pull = Pull::none(1, 0.5);
        pull.firm = vec![Quadratic { stiffness: [0.0, 0.0, 0.0, 4.0, 0.0, 0.0], towards: [0.0, 36.0, 0.0] }];
        let close = |at: [f32; 3], to: [f32; 3]| at.iter().zip(to).all(|(a, b)| (a - b).abs() < 1e-5);
        assert!(close(pull.settle(0, 2.0, [2.0, 0.0, 0.0]), [1.0, 6.0, 0.0]));
        (pull.stiffness[0], pull.towards[0]) = ([0.0, 0.0, 0.0, 0.0, 0.0, 2.0], [0.0, 0.0, 6.0]);
        assert!(close(pull.settle(0, 2.0, [2.0, 0.0, 0.0]), [1.0, 6.0, 0.5]));
        // Links that slide are softer along x, here by nothing.
        assert!(close(pull.settle_from(0, 2.0, &[0.0; 6], [2.0, 0.0, 0.0], [1.0, 0.0, 0.0]), [1.0, 6.0, 0.5]));
        let lattice = crate::chainmail::Lattice::from_nodes(
            crate::geometry::Grid::axis_aligned([1; 3], [1.0; 3], [0.0; 3]).unwrap(),
            vec![crate::chainmail::Node::Soft],
            vec![crate::chainmail::Material::default().at(20.0)],
        );
        pull.release(&lattice, &[true]);
        assert!(close(pull.settle(0, 2.0, [2.0, 0.0, 0.0]), [1.0, 0.0, 0.0]));
    }
}
