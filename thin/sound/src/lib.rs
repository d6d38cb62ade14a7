//! Sounds of thin robots (S13, S25, S26): WAV files, another rate, and blocks of 20 ms as samples or, with the feature `opus`, as Opus.
//!
//! A [`Clip`] is read from a WAV file. An [`Encoder`] makes blocks of its samples, each of which is a blob of a mirrored robot's
//! effector, and a [`Decoder`] in the robot makes samples of them again, also of blocks that are lost.
//!
//! ```
//! use mom_rsp::{AudioCodec, Sound};
//! use mom_sound::{Clip, Decoder, Encoder};
//!
//! let sound = Sound { codec: AudioCodec::Pcm, rate: 16_000 };
//! let clip = Clip::tone(440.0, 0.1, sound.rate);
//! let (mut encoder, mut decoder) = (Encoder::new(sound)?, Decoder::new(sound)?);
//! let mut heard = Vec::new();
//! for samples in clip.blocks(sound) {
//!     let block = encoder.block(&samples)?;
//!     assert_eq!(block.len(), 640);
//!     heard.extend(decoder.block(&block));
//! }
//! assert_eq!(heard, clip.samples());
//! # Ok::<(), mom_sound::SoundError>(())
//! ```

mod clip;
mod codec;

pub use clip::Clip;
pub use codec::{Decoder, Encoder};

/// Why something is not a sound.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SoundError {
    /// It is not a WAV file that can be read: why.
    #[error("it is not a WAV file that can be read: {0}")]
    Wav(String),
    /// It has no sample.
    #[error("it is empty")]
    Empty,
    /// It has more samples than a clip may have.
    #[error("it lasts longer than {most} s")]
    Long {
        /// Seconds.
        most: u32,
    },
    /// Its rate is out of what sounds have.
    #[error("it has {0} samples a second; 4000 to 384000 can be read")]
    Rate(u32),
    /// The program was built without this codec.
    #[error("this program was built without Opus: build it with --features opus")]
    NoOpus,
    /// The codec does not take it.
    #[error("Opus cannot encode it: {0}")]
    Opus(String),
}

/// How loud samples are, in dB below full scale (0 is the loudest); `None` for silence.
#[must_use]
pub fn level(samples: &[i16]) -> Option<f64> {
    let sum: f64 = samples.iter().map(|sample| f64::from(*sample).powi(2)).sum();
    let mean = sum / samples.len().max(1) as f64;
    (mean > 0.0).then(|| 10.0 * (mean / f64::from(i16::MAX).powi(2)).log10())
}
