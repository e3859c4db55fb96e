//! Rank 9: arguments and terminal.

pub mod terminal;
