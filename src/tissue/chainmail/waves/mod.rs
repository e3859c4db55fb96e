//! Waves: how the motion of bones reaches soft elements, before anything relaxes (thesis 2.4 and 5.2 to 5.5).
//!
//! In: a [`super::Lattice`] and the motion of each bone ([`Initiators`]). Out: a displacement for each element that a wave comes to:
//! one wave per bone, weighted by t^-n, or one wave from all bones, of which the first counts ([`blend`]). There are two ways
//! to find it, one contract: for each source the least time at each element by the rules of [`front`], the bone that it came from,
//! and what that bone's motion is worth there. `tests/random.rs` runs both with the same settings and demands the same times and
//! displacements. Where bones come at the same time, [`shortest`] takes the first in the skeleton, [`ordered`] the one whose wave
//! came by the parent first in storage.
//!
//! - [`shortest`]: where bones hand on their motion undiminished in the order of timestamps, as by default, only times count: a
//!   shortest path search over packed cells, eight at a time, on several threads; [`superpose`] blends its waves.
//! - [`ordered`]: the thesis's other variants, in which what an element hands on depends on the order: violation, first moved,
//!   decay, averaging along the front. One loop over a queue, one element at a time.
//!
//! [`front`] has the rules that both obey (sources, links, times, cut-off), [`carry`] what a link leaves of a motion, [`average`] the weights. Where a wave may stop
//! is [`pruning`], what elements of other spacings take over [`prolongation`]. Measured: docs/decisions/chain-mail.md, speed.md.

pub(super) mod average;
pub(super) mod blend;
pub(super) mod carry;
pub(super) mod front;
pub(super) mod ordered;
pub(super) mod prolongation;
pub(super) mod pruning;
pub(super) mod shortest;
pub(super) mod superpose;

pub use average::FirstWave;
pub use blend::{first_wave, spread};
pub use carry::Initiators;
pub use pruning::Pruning;
