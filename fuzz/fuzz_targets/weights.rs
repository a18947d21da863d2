#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| snake_fuzz::load_model(bytes));
