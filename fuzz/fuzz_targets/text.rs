#![no_main]

use snake_io::PointFormat;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| snake_fuzz::read_cloud(bytes, PointFormat::Text));
