//! Elastic relaxation: bones are held, every other element settles where its links and the images pull it.
//!
//! In: a [`super::Lattice`] with displacements to begin with. Out: the displacements at which the links' energy and that of an
//! [`ImagePull`] are least, sweep by sweep ([`relax`]; Gibson 1997, Rodriguez, Sorkine and Alexa 2007). Links at rest are made
//! once per patient ([`rest`]); they turn with the tissue ([`turn`]), slide where a surface is declared ([`crossing`]) and change
//! their rest lengths in organs that change their volume ([`growth`]). [`settle`] runs all of it at one spacing and frees
//! elements of the images whose cells tangle ([`untangle`]). What was tried: docs/decisions/chain-mail.md.

mod crossing;
pub(super) mod growth;
pub(super) mod pull;
pub(super) mod relax;
pub(super) mod rest;
pub(super) mod settle;
mod stencil;
mod turn;
pub(super) mod untangle;

pub use growth::VolumeChange;
pub use pull::{Comparison, ImagePull, Passes, Pull, Quadratic, STILL_MOVING};
