//! What holds for any bytes: the same function as in the property tests.

#![no_main]

#[path = "../../tests/any_bytes/mod.rs"]
mod any_bytes;

libfuzzer_sys::fuzz_target!(|data: &[u8]| any_bytes::any_uplink(data));
