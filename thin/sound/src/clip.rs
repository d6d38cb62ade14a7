//! Sounds as samples.

use std::io::Cursor;

use hound::{SampleFormat, WavReader, WavSpec, WavWriter};
use mom_rsp::Sound;
use rubato::audioadapter_buffers::owned::InterleavedOwned;
use rubato::{
    Async, FixedAsync, Resampler as _, SincInterpolationParameters, SincInterpolationType, WindowFunction,
};

use crate::SoundError;

/// The longest clip, s.
const LONGEST: u32 = 60;
/// Samples that are resampled at a time.
const CHUNK: usize = 1024;
/// The length of the filter that keeps what a lower rate cannot hold out of it.
const FILTER: usize = 64;

/// A sound, mono.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Clip {
    rate: u32,
    samples: Vec<i16>,
}

impl Clip {
    /// Reads a WAV file: any rate, one or more channels, which are mixed, samples of 8 to 32 bits or floats.
    ///
    /// # Errors
    ///
    /// What is not a WAV file, empty, longer than 60 s, or of a rate that no sound has.
    pub fn read(wav: &[u8]) -> Result<Self, SoundError> {
        let mut reader = WavReader::new(Cursor::new(wav)).map_err(|error| wrong(&error))?;
        let WavSpec {
            channels,
            sample_rate: rate,
            bits_per_sample: bits,
            sample_format,
        } = reader.spec();
        if !(4000..=384_000).contains(&rate) {
            return Err(SoundError::Rate(rate));
        }
        if reader.duration() == 0 || channels == 0 {
            return Err(SoundError::Empty);
        }
        if reader.duration() > LONGEST * rate {
            return Err(SoundError::Long { most: LONGEST });
        }
        let full = 2_f32.powi(i32::from(bits.clamp(1, 32)) - 1);
        let all: Vec<f32> = match sample_format {
            SampleFormat::Float => reader
                .samples::<f32>()
                .collect::<Result<_, _>>()
                .map_err(|error| wrong(&error))?,
            SampleFormat::Int => {
                let samples = reader.samples::<i32>();
                let scaled = samples.map(|sample| sample.map(|sample| sample as f32 / full));
                scaled.collect::<Result<_, _>>().map_err(|error| wrong(&error))?
            }
        };
        let mixed = all
            .chunks_exact(usize::from(channels))
            .map(|frame| whole(frame.iter().sum::<f32>() / f32::from(channels)));
        Ok(Self {
            rate,
            samples: mixed.collect(),
        })
    }

    /// A tone of so many Hz, at half of the full scale, for so many seconds.
    #[must_use]
    pub fn tone(pitch: f64, seconds: f64, rate: u32) -> Self {
        let step = std::f64::consts::TAU * pitch / f64::from(rate);
        let count = (seconds * f64::from(rate)).round() as usize;
        let sample = |at: usize| whole(0.5 * (step * at as f64).sin() as f32);
        Self {
            rate,
            samples: (0..count).map(sample).collect(),
        }
    }

    /// The clip as a WAV file of 16 bits.
    ///
    /// # Errors
    ///
    /// One that is too long for a WAV file.
    pub fn to_wav(&self) -> Result<Vec<u8>, SoundError> {
        let spec = WavSpec {
            channels: 1,
            sample_rate: self.rate,
            bits_per_sample: 16,
            sample_format: SampleFormat::Int,
        };
        let mut file = Cursor::new(Vec::new());
        let mut writer = WavWriter::new(&mut file, spec).map_err(|error| wrong(&error))?;
        for sample in &self.samples {
            writer.write_sample(*sample).map_err(|error| wrong(&error))?;
        }
        writer.finalize().map_err(|error| wrong(&error))?;
        Ok(file.into_inner())
    }

    /// The same sound with another number of samples a second.
    ///
    /// # Errors
    ///
    /// Rates that differ too much.
    pub fn at(self, rate: u32) -> Result<Self, SoundError> {
        if rate == self.rate {
            return Ok(self);
        }
        let failed = |error: &dyn std::fmt::Display| SoundError::Wav(error.to_string());
        let ratio = f64::from(rate) / f64::from(self.rate);
        let filter = SincInterpolationParameters::new(FILTER, WindowFunction::BlackmanHarris2)
            .oversampling_factor(256)
            .interpolation(SincInterpolationType::Linear);
        let mut resampler = Async::<f32>::new_sinc(ratio, 1.0, &filter, CHUNK, 1, FixedAsync::Input)
            .map_err(|error| failed(&error))?;
        let length = self.samples.len();
        let scaled = self.samples.iter().map(|sample| f32::from(*sample) / 32_768.0);
        let input =
            InterleavedOwned::new_from(scaled.collect(), 1, length).map_err(|error| failed(&error))?;
        let output = resampler
            .process_all(&input, length, None)
            .map_err(|error| failed(&error))?;
        let samples = output.take_data().into_iter().map(whole).collect();
        Ok(Self { rate, samples })
    }

    /// Samples a second.
    #[must_use]
    pub fn rate(&self) -> u32 {
        self.rate
    }

    /// Its samples.
    #[must_use]
    pub fn samples(&self) -> &[i16] {
        &self.samples
    }

    /// Its samples in blocks of a sound of the same rate, the last one filled with silence.
    pub fn blocks(&self, sound: Sound) -> impl Iterator<Item = Vec<i16>> + '_ {
        let size = sound.samples().max(1);
        self.samples.chunks(size).map(move |samples| {
            let mut block = samples.to_vec();
            block.resize(size, 0);
            block
        })
    }
}

fn wrong(error: &hound::Error) -> SoundError {
    SoundError::Wav(error.to_string())
}

/// -1 to 1 as 16 bits; what is louder is cut off.
pub(crate) fn whole(sample: f32) -> i16 {
    (sample * 32_768.0).round() as i16
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How much of a pitch is in samples, 0 to 1 of full scale.
    fn strength(clip: &Clip, pitch: f64) -> f64 {
        let step = std::f64::consts::TAU * pitch / f64::from(clip.rate);
        let (mut sin, mut cos) = (0.0, 0.0);
        for (at, sample) in clip.samples.iter().enumerate() {
            let (s, c) = (step * at as f64).sin_cos();
            let sample = f64::from(*sample) / 32_768.0;
            (sin, cos) = (sin + s * sample, cos + c * sample);
        }
        2.0 * f64::hypot(sin, cos) / clip.samples.len() as f64
    }

    #[test]
    fn a_wav_file_is_read_as_it_was_written() {
        let clip = Clip::tone(440.0, 0.5, 44_100);
        assert_eq!(Clip::read(&clip.to_wav().unwrap()), Ok(clip));
    }

    #[test]
    fn channels_are_mixed_and_floats_and_8_bits_are_read() {
        for (bits_per_sample, sample_format) in [
            (32, SampleFormat::Float),
            (8, SampleFormat::Int),
            (24, SampleFormat::Int),
        ] {
            let spec = WavSpec {
                channels: 2,
                sample_rate: 8000,
                bits_per_sample,
                sample_format,
            };
            let mut file = Cursor::new(Vec::new());
            let mut writer = WavWriter::new(&mut file, spec).unwrap();
            for _ in 0..10 {
                match sample_format {
                    SampleFormat::Float => {
                        writer.write_sample(0.75_f32).unwrap();
                        writer.write_sample(-0.25_f32).unwrap();
                    }
                    SampleFormat::Int => {
                        let full = 1_i32 << (bits_per_sample - 1);
                        writer.write_sample(full / 4 * 3).unwrap();
                        writer.write_sample(-full / 4).unwrap();
                    }
                }
            }
            writer.finalize().unwrap();
            let clip = Clip::read(&file.into_inner()).unwrap();
            assert_eq!(
                clip.samples(),
                [8192; 10],
                "{sample_format:?} of {bits_per_sample}"
            );
        }
    }

    #[test]
    fn another_rate_keeps_the_pitch_and_the_length_and_leaves_out_what_it_cannot_hold() {
        for (from, to) in [(44_100, 48_900), (48_000, 16_000), (8000, 48_000)] {
            let clip = Clip::tone(1000.0, 1.0, from).at(to).unwrap();
            let seconds = clip.samples.len() as f64 / f64::from(to);
            assert!((seconds - 1.0).abs() < 0.01, "{from} to {to}: {seconds} s");
            assert!((strength(&clip, 1000.0) - 0.5).abs() < 0.01, "{from} to {to}");
        }
        // 12 kHz would be heard as 4 kHz.
        let folded = Clip::tone(12_000.0, 1.0, 48_000).at(16_000).unwrap();
        assert!(strength(&folded, 4000.0) < 0.005);
    }

    #[test]
    fn what_is_no_sound_is_refused() {
        let empty = Clip {
            rate: 8000,
            samples: Vec::new(),
        };
        assert_eq!(Clip::read(&empty.to_wav().unwrap()), Err(SoundError::Empty));
        let long = Clip {
            rate: 4000,
            samples: vec![0; 4000 * 60 + 1],
        };
        assert_eq!(
            Clip::read(&long.to_wav().unwrap()),
            Err(SoundError::Long { most: 60 })
        );
        let wav = Clip::tone(440.0, 0.1, 8000).to_wav().unwrap();
        for bad in [&b"hello"[..], &wav[..30], &wav[..wav.len() - 1]] {
            assert!(
                matches!(Clip::read(bad), Err(SoundError::Wav(_))),
                "{}",
                bad.len()
            );
        }
    }
}
