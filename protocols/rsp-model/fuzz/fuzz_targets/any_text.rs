//! What holds for any bytes, as TOML and as XMI: the same function as in the property tests.

#![no_main]

#[path = "../../tests/any_text/mod.rs"]
mod any_text;

libfuzzer_sys::fuzz_target!(|data: &[u8]| any_text::any_bytes(data));
