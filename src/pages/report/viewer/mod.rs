//! The viewer inside the page of a run: three linked planes to scroll through, drawn by the page's
//! own script from volumes that the page holds (docs/decisions/pages.md). Without scripts it
//! stays hidden.

mod data;
mod markup;
mod places;
mod structures;

pub use data::{View, embed, embed_whole};
pub(super) use markup::{policy, policy_of_files, section};
