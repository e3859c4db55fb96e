//! Rank 4: the chain mail. Elements on a grid, linked to their neighbours with min, max and shear.

mod arrival;
mod blend;
mod brick;
mod brought;
mod carry;
mod dial;
mod engine;
mod extend;
mod front;
mod growth;
mod islands;
mod lattice;
mod let_go;
mod links;
mod mail;
mod material;
mod mend;
mod options;
mod propagate;
mod pull;
mod queue;
mod relax;
mod rest;
mod settle;
mod slabs;
mod stencil;
mod superpose;
#[cfg(test)]
mod tests;
mod turn;
mod untangle;

pub use blend::{FirstWave, first_wave, spread};
pub use carry::{Carry, Initiators};
pub use extend::fades_within;
pub use front::{Front, LinkTime, Order, Structures};
pub use growth::VolumeChange;
pub use lattice::{Lattice, Node, Tissue};
pub use let_go::LetGo;
pub use links::{LinkReport, check_links};
pub use mail::{Mail, organs};
pub use material::{Constraint, Knot, Material, MaterialName, Organs, organ_label};
pub use options::{ChainmailOptions, Combination};
pub use propagate::{Elements, Propagation, propagate, regions};
pub use pull::{Comparison, ImagePull, Passes, Pull};
pub use relax::Elasticity;
