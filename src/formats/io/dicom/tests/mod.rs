//! Tests of this room: objects are made in memory and written into a temporary folder.

#![expect(clippy::float_cmp, reason = "stored integers come back exactly")]

mod bones;
mod ct;
mod dose;
mod find;
mod like;
mod make;
mod mr;
mod multi;
mod pixels;
mod places;
mod segmentation;
mod structures;
mod world;
