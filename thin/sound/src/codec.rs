//! Blocks of 20 ms.

use mom_rsp::{AudioCodec, Sound};

use crate::SoundError;
#[cfg(feature = "opus")]
use crate::clip::whole;

/// By how much a block that stands for lost ones is quieter than the one before, in halves.
const FADE: i16 = 2;

/// Bits a second of Opus: a block of 20 ms has 80 bytes.
#[cfg(feature = "opus")]
const BITS: i32 = 32_000;

/// Makes blocks of samples.
pub struct Encoder {
    sound: Sound,
    #[cfg(feature = "opus")]
    opus: Option<Box<opus_rs::OpusEncoder>>,
}

impl Encoder {
    /// One for this sound.
    ///
    /// # Errors
    ///
    /// Opus in a program that was built without.
    pub fn new(sound: Sound) -> Result<Self, SoundError> {
        check(sound)?;
        Ok(Self {
            sound,
            #[cfg(feature = "opus")]
            opus: match sound.codec {
                AudioCodec::Pcm => None,
                AudioCodec::Opus => {
                    let application = opus_rs::Application::Audio;
                    let mut opus = opus_rs::OpusEncoder::new(rate(sound), 1, application).map_err(failed)?;
                    opus.bitrate_bps = BITS;
                    Some(Box::new(opus))
                }
            },
        })
    }

    /// The block of the next 20 ms; samples that lack are silence.
    ///
    /// # Errors
    ///
    /// What the codec does not take.
    pub fn block(&mut self, samples: &[i16]) -> Result<Vec<u8>, SoundError> {
        let size = self.sound.samples();
        let mut whole = samples.get(..size).unwrap_or(samples).to_vec();
        whole.resize(size, 0);
        #[cfg(feature = "opus")]
        if let Some(opus) = &mut self.opus {
            let mut block = vec![0; self.sound.block()];
            let length = opus.encode_i16(&whole, size, &mut block).map_err(failed)?;
            block.truncate(length);
            return Ok(block);
        }
        Ok(whole.into_iter().flat_map(i16::to_le_bytes).collect())
    }
}

/// Makes samples of blocks, in the robot.
pub struct Decoder {
    sound: Sound,
    /// What was played last, of which something is made for what is lost.
    last: Vec<i16>,
    #[cfg(feature = "opus")]
    opus: Option<Box<opus_rs::OpusDecoder>>,
}

impl Decoder {
    /// One for this sound.
    ///
    /// # Errors
    ///
    /// Opus in a program that was built without.
    pub fn new(sound: Sound) -> Result<Self, SoundError> {
        check(sound)?;
        Ok(Self {
            sound,
            last: vec![0; sound.samples()],
            #[cfg(feature = "opus")]
            opus: match sound.codec {
                AudioCodec::Pcm => None,
                AudioCodec::Opus => Some(Box::new(
                    opus_rs::OpusDecoder::new(rate(sound), 1).map_err(failed)?,
                )),
            },
        })
    }

    /// The samples of the next 20 ms. A block that is none sounds as a lost one.
    pub fn block(&mut self, block: &[u8]) -> Vec<i16> {
        #[cfg(feature = "opus")]
        if self.opus.is_some() {
            return self.opus(block);
        }
        if block.len() != self.sound.block() {
            return self.lost();
        }
        let samples = block.chunks_exact(2);
        self.last = samples
            .map(|pair| i16::from_le_bytes([pair[0], pair[1]]))
            .collect();
        self.last.clone()
    }

    /// What is played for a block that is lost: with Opus what that foresees, else the last block again, more and more quiet.
    pub fn lost(&mut self) -> Vec<i16> {
        #[cfg(feature = "opus")]
        if self.opus.is_some() {
            return self.opus(&[]);
        }
        for sample in &mut self.last {
            *sample /= FADE;
        }
        self.last.clone()
    }

    #[cfg(feature = "opus")]
    fn opus(&mut self, block: &[u8]) -> Vec<i16> {
        let size = self.sound.samples();
        let mut samples = vec![0.0; size];
        let Some(opus) = &mut self.opus else {
            return vec![0; size];
        };
        // What is not a packet is nothing to be heard.
        if opus.decode(block, size, &mut samples).is_err() {
            samples.fill(0.0);
        }
        samples.into_iter().map(whole).collect()
    }
}

fn check(sound: Sound) -> Result<(), SoundError> {
    match sound.codec {
        AudioCodec::Opus if !cfg!(feature = "opus") => Err(SoundError::NoOpus),
        _ => Ok(()),
    }
}

#[cfg(feature = "opus")]
fn rate(sound: Sound) -> i32 {
    i32::try_from(sound.rate).unwrap_or(0)
}

#[cfg(feature = "opus")]
fn failed(error: &'static str) -> SoundError {
    SoundError::Opus(error.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Clip, level};

    fn heard(sound: Sound, lost: impl Fn(usize) -> bool) -> (Vec<i16>, usize) {
        let clip = Clip::tone(440.0, 1.0, sound.rate);
        let (mut encoder, mut decoder) = (Encoder::new(sound).unwrap(), Decoder::new(sound).unwrap());
        let (mut samples, mut bytes) = (Vec::new(), 0);
        for (number, block) in clip.blocks(sound).enumerate() {
            let block = encoder.block(&block).unwrap();
            bytes += block.len();
            samples.extend(match lost(number) {
                true => decoder.lost(),
                false => decoder.block(&block),
            });
        }
        (samples, bytes)
    }

    #[test]
    fn opus_sounds_as_the_samples_do_in_a_fraction_of_the_bytes() {
        let wanted = level(Clip::tone(440.0, 1.0, 48_000).samples()).unwrap();
        for rate in [16_000, 48_000] {
            let sound = Sound {
                codec: AudioCodec::Opus,
                rate,
            };
            let (samples, bytes) = heard(sound, |_| false);
            assert_eq!(samples.len(), rate as usize);
            let level = level(&samples[samples.len() / 2..]).unwrap();
            assert!(
                (level - wanted).abs() < 1.0,
                "{rate}: {level} dB, {wanted} expected"
            );
            assert!(
                bytes <= 4400 && bytes < samples.len() / 3,
                "{rate}: {bytes} bytes a second"
            );
        }
    }

    #[test]
    fn a_lost_block_is_no_silence_and_many_are() {
        for codec in AudioCodec::ALL {
            let sound = Sound { codec, rate: 16_000 };
            let block = sound.samples();
            let (samples, _) = heard(sound, |number| number == 20);
            let lost = level(&samples[20 * block..21 * block]).unwrap_or(-99.0);
            assert!(lost > -30.0, "{codec:?}: {lost} dB");
            let (samples, _) = heard(sound, |number| number >= 20);
            let end = level(&samples[48 * block..]).unwrap_or(-99.0);
            assert!(end < -30.0, "{codec:?}: {end} dB");
        }
    }

    #[test]
    fn what_is_no_block_harms_nobody() {
        for codec in AudioCodec::ALL {
            let sound = Sound { codec, rate: 16_000 };
            let mut decoder = Decoder::new(sound).unwrap();
            for length in 0..40_usize {
                let bytes: Vec<u8> = (0..length).map(|at| (at * 37 + length * 11) as u8).collect();
                assert_eq!(decoder.block(&bytes).len(), sound.samples(), "{codec:?} {length}");
            }
        }
    }
}
