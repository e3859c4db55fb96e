//! Rank 4: the chain mail. Elements on a grid, linked to their neighbours with min, max and shear.

mod blend;
mod extend;
mod front;
mod lattice;
mod material;
mod propagate;
mod relax;

pub use front::{Front, LinkTime};
pub use lattice::{Lattice, Node, Tissue};
pub use material::{Constraint, Knot, Material, MaterialName};
pub use propagate::{ChainmailOptions, Propagation, propagate};

use serde::{Deserialize, Serialize};

/// How many links of the result lie outside their valid region, and by how much.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct LinkReport {
    /// Links between active elements.
    pub links: usize,
    /// Links outside [min, max] along the link or beyond shear across it.
    pub violated: usize,
    /// Violated links in percent.
    pub violated_percent: f64,
    /// Mean excess of the violated links, mm.
    pub mean_excess_mm: f64,
    /// 95th percentile of the excess of the violated links, mm.
    pub p95_excess_mm: f64,
    /// Largest excess, mm.
    pub max_excess_mm: f64,
}
