//! Fuzz target of `mocapd_fuzz::read_mapping`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| mocapd_fuzz::read_mapping(bytes));
