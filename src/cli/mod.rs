//! Rank 9: arguments and terminal.

pub mod inspect;
pub mod skeleton;
pub mod terminal;
