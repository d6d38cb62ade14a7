//! Random numbers by a seed, in the place of the system's: keys, nonces, and how tables are hashed.
//!
//! The C library's function is defined here once more, and a program's own definition goes before a library's. It is the simulation's
//! program alone that has it.
#![expect(unsafe_code, reason = "a function of the C library is defined")]

use std::sync::atomic::{AtomicU64, Ordering};

static STATE: AtomicU64 = AtomicU64::new(0);

/// Begins anew with this seed.
pub fn seed(seed: u64) {
    STATE.store(seed, Ordering::SeqCst);
}

/// SplitMix64.
fn next() -> u64 {
    let mut z = STATE.fetch_add(0x9e37_79b9_7f4a_7c15, Ordering::SeqCst);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// As the C library's: fills `length` bytes, and says how many those are.
///
/// # Safety
/// `buffer` has room for `length` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn getrandom(buffer: *mut u8, length: usize, _flags: u32) -> isize {
    for at in 0..length {
        // SAFETY: the caller has that much room.
        unsafe { buffer.add(at).write((next() >> 32) as u8) };
    }
    isize::try_from(length).unwrap_or(isize::MAX)
}
