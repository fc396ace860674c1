//! Fuzz target of `mocapd_fuzz_targets::round_trip`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| mocapd_fuzz_targets::round_trip(bytes));
