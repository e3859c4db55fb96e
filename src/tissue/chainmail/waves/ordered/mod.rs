//! Waves in which the order matters: each element is processed once, when its best offer is the best of all, and hands on
//! what its links leave of its motion. [`queue`] says which element is next, [`engine`] is the one loop (thesis 5.2).

pub(in crate::chainmail) mod engine;
mod queue;
