//! `dicom_reg` of the targets.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| aventail_fuzz::dicom::reg(data));
