#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| gs3_fuzz::readers::splat(data));
