//! A library of postures: the record of each, the datalist of all, and one page that shows their spread.

mod gallery;
mod histogram;
mod manifest;
mod page;
mod record;

pub use gallery::Gallery;
pub use manifest::{About, Manifest, Rejected};
pub use page::library_page;
pub use record::{PostureRecord, RECORD, Totals};
