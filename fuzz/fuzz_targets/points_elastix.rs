//! `points_elastix` of the targets.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| aventail_fuzz::points_elastix(data));
