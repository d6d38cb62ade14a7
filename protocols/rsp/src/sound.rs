//! What the bytes of a sound are (S13, S26).

use core::fmt;

/// Sound, mono, in blocks of 20 ms, each a blob of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sound {
    /// How a block is written.
    pub codec: AudioCodec,
    /// Samples a second.
    pub rate: u32,
}

/// How a block of sound is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AudioCodec {
    /// Samples of 16 bits, little-endian.
    Pcm,
    /// A packet of Opus (RFC 6716).
    Opus,
}

impl AudioCodec {
    /// All of them.
    pub const ALL: [AudioCodec; 2] = [AudioCodec::Pcm, AudioCodec::Opus];

    /// What it is called in a model's file.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            AudioCodec::Pcm => "pcm",
            AudioCodec::Opus => "opus",
        }
    }

    /// Whether it knows sounds of so many samples a second. A block is a whole number of them.
    #[must_use]
    pub const fn takes(self, rate: u32) -> bool {
        match self {
            AudioCodec::Pcm => 8000 <= rate && rate <= 96_000 && rate.is_multiple_of(Sound::BLOCKS),
            AudioCodec::Opus => matches!(rate, 8000 | 12_000 | 16_000 | 24_000 | 48_000),
        }
    }
}

impl Sound {
    /// Blocks a second.
    pub const BLOCKS: u32 = 50;

    /// For how long a block sounds, µs.
    pub const PERIOD: u64 = 20_000;

    /// Samples of a block.
    #[must_use]
    pub const fn samples(self) -> usize {
        (self.rate / Sound::BLOCKS) as usize
    }

    /// The most bytes of a block.
    #[must_use]
    pub const fn block(self) -> usize {
        match self.codec {
            AudioCodec::Pcm => 2 * self.samples(),
            // The longest packet of one frame (RFC 6716, 3.2.1).
            AudioCodec::Opus => 1275,
        }
    }
}

impl fmt::Display for Sound {
    /// As in a model's file: `pcm 48900`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.codec.word(), self.rate)
    }
}
