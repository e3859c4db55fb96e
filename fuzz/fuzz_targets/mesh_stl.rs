//! `mesh_stl` of the targets.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| aventail_fuzz::mesh_stl(data));
