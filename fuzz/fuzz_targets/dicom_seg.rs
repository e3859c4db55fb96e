//! `dicom_seg` of the targets.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| aventail_fuzz::dicom::seg(data));
