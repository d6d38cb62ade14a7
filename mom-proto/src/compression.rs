//! The ways of compressing what a connection carries (M16), as a login asks for them.

use std::fmt;

/// A way of compressing on which the two ends of a connection may agree at login.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Compression {
    /// The content of each message by itself ([`Packed`](crate::Packed)), in the binary form.
    Zstd,
    /// All bytes that follow in one direction, in any form: frames of zstd (RFC 8878).
    StreamZstd,
    /// The same as streams of zlib (RFC 1950), which every language has at hand.
    StreamDeflate,
}

/// Stands in the binary form before all that follows compressed: a frame of one byte, its kind. XML and JSON need no such mark:
/// nothing in them begins as zstd or zlib do.
pub const STREAM_MARK: [u8; 5] = [0, 0, 0, 1, 2];

/// The base-2 logarithm of the largest window that a stream of zstd may need: 128 KiB are kept to read it.
pub const STREAM_WINDOW_LOG: u32 = 17;

impl Compression {
    /// Every way.
    pub const ALL: [Compression; 3] = [
        Compression::Zstd,
        Compression::StreamZstd,
        Compression::StreamDeflate,
    ];

    /// The word for it in `compress`.
    pub fn word(self) -> &'static str {
        match self {
            Compression::Zstd => "zstd",
            Compression::StreamZstd => "stream-zstd",
            Compression::StreamDeflate => "stream-deflate",
        }
    }

    /// The way of this word, none for one that is not known.
    pub fn of(word: &str) -> Option<Compression> {
        Compression::ALL.into_iter().find(|way| way.word() == word)
    }

    /// Whether it compresses all that follows.
    pub fn is_stream(self) -> bool {
        self != Compression::Zstd
    }
}

impl fmt::Display for Compression {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}
