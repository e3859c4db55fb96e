//! Rank 4: the chain mail. Elements on a grid, linked to their neighbours with min, max and shear (Schill, Gibson; thesis 2.4).
//!
//! In: a planning CT with bones ([`Tissue`]) and their motions ([`Initiators`]). Out: the push field of the patient ([`Propagation`]).
//! [`propagate()`] is the way through, in the order of the folders:
//!
//! 1. `lattice`: elements, material, which links slide.
//! 2. `relaxation`: where links and images pull.
//! 3. `waves`: what bones bring to tissue before it relaxes, and where `relaxation` begins.
//!
//! [`ChainMail`] is all that does not depend on the motions, for many fractions of a patient; [`Variant`] chooses
//! which of the thesis's chain mails it is, and nothing else does. At the end the field is continued beyond the elements, folds of the full grid settle anew
//! and each link is checked. Decisions: docs/decisions/chain-mail.md and thesis.md.

mod chain_mail;
mod extend;
mod lattice;
mod links;
mod mend;
mod options;
mod propagate;
mod relaxation;
mod sides;
#[cfg(test)]
mod tests;
mod variants;
mod waves;

pub use chain_mail::{ChainMail, organs};
pub use extend::fades_within;
pub use lattice::{
    Constraint, Knot, Lattice, Material, MaterialName, Node, Organs, SlidingRegion, Slip, SlipOptions, Tissue,
    organ_label,
};
pub use links::{LinkReport, check_links};
pub use options::{ChainmailOptions, RelaxationLevel};
pub use propagate::{Elements, Propagation, propagate, regions};
pub use relaxation::{Comparison, ImagePull, Passes, Pull, Quadratic, STILL_MOVING, VolumeChange};
pub use variants::{Carry, Combination, Elasticity, Front, LinkTime, Order, Structures, Variant};
pub use waves::{FirstWave, Initiators, Pruning, first_wave, spread};
