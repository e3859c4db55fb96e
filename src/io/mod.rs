//! Rank 6: files <-> domain types.

mod atomic;

pub use atomic::write_file;
