//! Waves of which only times count: shortest paths.
//!
//! [`arrival`] packs a lattice's elements in bricks ([`brick`]) of one register, [`dial`] finds least times over them, [`slabs`] the
//! same on several threads, [`paths`] waves from one bone or all of them and the latest times that still count. Times are
//! integers and least sums, so that neither threads nor order change a bit.

pub(in crate::chainmail) mod arrival;
pub(in crate::chainmail) mod brick;
mod dial;
mod paths;
pub(in crate::chainmail) mod slabs;
