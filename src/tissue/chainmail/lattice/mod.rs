//! What the chain mail is made of: elements on a grid, and what each lets its neighbours do.
//!
//! In: a planning CT with bones, skin and organs ([`Tissue`]), the material by grey value ([`Material`], thesis 5.1 and
//! Fig. 13). Out: a [`Lattice`] of elements at one spacing, each outside, soft or of one bone ([`Node`]), with the least and
//! greatest length and the shear of its links ([`Constraint`]). Which links slide is in [`slip`], which elements images have
//! no hold on in [`islands`]. How the numbers were chosen: docs/decisions/chain-mail.md.

mod elements;
pub(super) mod islands;
pub(super) mod material;
mod node;
pub(super) mod slip;

pub use elements::{Lattice, Tissue};
pub use material::{Constraint, Knot, Material, MaterialName, Organs, organ_label};
pub use node::Node;
pub use slip::{SlidingRegion, Slip, SlipOptions};
