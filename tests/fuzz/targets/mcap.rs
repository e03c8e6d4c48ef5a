#![no_main]
#[path = "../laws.rs"]
#[allow(dead_code, clippy::unwrap_used)]
mod laws;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| laws::mcap(bytes));
