//! Fuzz target of `mocapd_fuzz::hear`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| mocapd_fuzz::hear(bytes));
