//! Rank 4: the chain mail. Elements on a grid, linked to their neighbours with min, max and shear.

mod blend;
mod carry;
mod extend;
mod front;
mod lattice;
mod links;
mod material;
mod propagate;
mod relax;

pub use carry::Carry;
pub use front::{Front, LinkTime};
pub use lattice::{Lattice, Node, Tissue};
pub use links::{LinkReport, check_links};
pub use material::{Constraint, Knot, Material, MaterialName};
pub use propagate::{ChainmailOptions, Initiators, Propagation, propagate};
