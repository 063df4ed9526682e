#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| tilecast_fuzz_harness::run("ply", bytes));
