//! Fuzz target of `mocapd_fuzz_targets::decode_samples`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| mocapd_fuzz_targets::decode_samples(bytes));
