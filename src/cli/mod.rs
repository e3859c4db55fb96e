//! cli (under construction)

pub mod inspect;
