//! Fuzz target of `mocapd_fuzz::config`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| mocapd_fuzz::config(bytes));
