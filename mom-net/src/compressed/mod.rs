//! All that one direction of a connection carries, compressed (M16): below every form, above every door.
//!
//! Each write is flushed, so that nothing waits in a compressor for what comes later, and what a compressor has taken is
//! bounded, as by TLS: nothing can overtake it. A reader opens what arrives in bounded steps.

mod packer;
#[cfg(test)]
mod tests;
mod unpacker;

pub(crate) use packer::Packer;
pub(crate) use unpacker::Unpacker;

/// The bytes that one connection is charged: more than what zstd or zlib allocate for both directions, of which a quiet
/// one touches some KiB.
pub const COMPRESSION_MEMORY: usize = 1024 * 1024;
