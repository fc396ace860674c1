//! Fuzz target of `mocapd_fuzz_targets::read_lsl`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| mocapd_fuzz_targets::read_lsl(bytes));
