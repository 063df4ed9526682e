#![no_main]

libfuzzer_sys::fuzz_target!(
    init: tilecast_fuzz_harness::compute_alone(),
    |bytes: &[u8]| tilecast_fuzz_harness::run("wire", bytes)
);
