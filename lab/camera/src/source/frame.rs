//! One picture of a real camera: the file as it came, and the same at another size.

use std::io::Cursor;

use bytes::Bytes;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType as PngFilter, PngEncoder};
use image::imageops::FilterType;
use image::{ImageError, ImageFormat, ImageReader, Limits, RgbImage};

use crate::{CameraSettings, Format, SettingsChange, SettingsError};

/// The largest file: with what goes beside it, it fits into a parcel of 8 MiB.
pub(crate) const LARGEST: usize = (8 << 20) - (256 << 10);
/// The most pixels that are decoded.
const MOST_PIXELS: u64 = 16 << 20;
/// The most memory that decoding one picture may take.
const MOST_MEMORY: u64 = 128 << 20;

/// Why bytes are no picture that can be shown.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// Neither JPEG nor PNG.
    #[error("{0} bytes came that are neither JPEG nor PNG")]
    Unknown(usize),
    /// It begins as a picture, and then is none.
    #[error("a broken picture came: {0}")]
    Broken(String),
    /// It says that it has more pixels than are decoded.
    #[error("a picture of {0}x{1} pixels came; {MOST_PIXELS} pixels are the most")]
    TooManyPixels(u32, u32),
    /// The file is larger than a parcel.
    #[error("a picture larger than {LARGEST} bytes came")]
    TooLarge,
}

/// A picture as the camera gave it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Frame {
    pub(crate) bytes: Bytes,
    pub(crate) format: Format,
    pub(crate) width: u32,
    pub(crate) height: u32,
}

/// What the owner of the token wants of a real camera's pictures; what is not named stays as the camera gives it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Rendition {
    width: Option<u32>,
    height: Option<u32>,
    quality: Option<u8>,
    format: Option<Format>,
}

impl Frame {
    /// Reads the head of a file. Nothing is decoded.
    pub(crate) fn read(bytes: Bytes) -> Result<Frame, FrameError> {
        if bytes.len() > LARGEST {
            return Err(FrameError::TooLarge);
        }
        let unknown = FrameError::Unknown(bytes.len());
        let format = match image::guess_format(&bytes) {
            Ok(ImageFormat::Jpeg) => Format::Jpeg,
            Ok(ImageFormat::Png) => Format::Png,
            _ => return Err(unknown),
        };
        let (width, height) = reader(&bytes, format).into_dimensions().map_err(broken)?;
        if u64::from(width) * u64::from(height) > MOST_PIXELS {
            return Err(FrameError::TooManyPixels(width, height));
        }
        Ok(Frame {
            bytes,
            format,
            width,
            height,
        })
    }

    /// The picture as it is wanted, decoded only if something is; and its JPEG quality, if it was encoded here.
    pub(crate) fn rendered(&self, wanted: &Rendition) -> Result<(Frame, Option<u8>), FrameError> {
        if !wanted.changes(self) {
            return Ok((self.clone(), None));
        }
        let format = wanted.format.unwrap_or(self.format);
        let quality = wanted.quality.unwrap_or(CameraSettings::default().quality);
        let mut pixels = reader(&self.bytes, self.format).decode().map_err(broken)?;
        let (width, height) = wanted.size_of(self);
        if (width, height) != (self.width, self.height) {
            pixels = pixels.resize_exact(width, height, FilterType::Triangle);
        }
        let pixels = pixels.into_rgb8();
        let frame = Frame {
            bytes: encode(&pixels, format, quality).map_err(broken)?.into(),
            format,
            width,
            height,
        };
        if frame.bytes.len() > LARGEST {
            return Err(FrameError::TooLarge);
        }
        Ok((frame, (format == Format::Jpeg).then_some(quality)))
    }
}

impl Rendition {
    /// What the change names, or the first setting that is outside its limits.
    ///
    /// # Errors
    /// [`SettingsError`]; overlays cannot be drawn into a picture whose matrix is not known.
    pub fn with(self, change: &SettingsChange) -> Result<Rendition, SettingsError> {
        let checked = CameraSettings::default().with(change)?;
        if change.overlay == Some(true) {
            return Err(SettingsError::Setting {
                setting: "overlay",
                value: "on".to_owned(),
                limits: "off for a camera by URL: its overlays go beside the image only".to_owned(),
            });
        }
        Ok(Rendition {
            width: change.width.map(|_| checked.width).or(self.width),
            height: change.height.map(|_| checked.height).or(self.height),
            quality: change.quality.map(|_| checked.quality).or(self.quality),
            format: change.format.as_ref().map(|_| checked.format).or(self.format),
        })
    }

    /// The wanted size, as far as one is named.
    pub(crate) fn size(&self) -> (Option<u32>, Option<u32>) {
        (self.width, self.height)
    }

    /// The quality of JPEG, unless frames like this one go out as they came.
    pub(crate) fn quality_used(&self, frame: Option<&Frame>) -> Option<u8> {
        let usual = CameraSettings::default().quality;
        let changes = frame.map_or(*self != Rendition::default(), |frame| self.changes(frame));
        changes.then(|| self.quality.unwrap_or(usual))
    }

    /// Whether anything else is wanted than what the frame is already: to encode it once more would only cost time and
    /// quality.
    fn changes(&self, frame: &Frame) -> bool {
        self.quality.is_some()
            || self.format.is_some_and(|format| format != frame.format)
            || self.size_of(frame) != (frame.width, frame.height)
    }

    pub(crate) fn format(&self) -> Option<Format> {
        self.format
    }

    /// The largest size within the wanted one that has the frame's shape; it is never enlarged.
    fn size_of(&self, frame: &Frame) -> (u32, u32) {
        let part =
            |wanted: Option<u32>, size: u32| wanted.map_or(1.0, |wanted| f64::from(wanted) / f64::from(size));
        let scale = part(self.width, frame.width)
            .min(part(self.height, frame.height))
            .min(1.0);
        let scaled = |size: u32| ((f64::from(size) * scale).round() as u32).max(1);
        (scaled(frame.width), scaled(frame.height))
    }
}

fn reader(bytes: &Bytes, format: Format) -> ImageReader<Cursor<&[u8]>> {
    let format = match format {
        Format::Jpeg => ImageFormat::Jpeg,
        Format::Png => ImageFormat::Png,
    };
    let mut reader = ImageReader::with_format(Cursor::new(&bytes[..]), format);
    let mut limits = Limits::default();
    limits.max_alloc = Some(MOST_MEMORY);
    reader.limits(limits);
    reader
}

fn encode(pixels: &RgbImage, format: Format, quality: u8) -> Result<Vec<u8>, ImageError> {
    let mut bytes = Vec::with_capacity(pixels.len() / 8);
    match format {
        Format::Jpeg => pixels.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, quality))?,
        Format::Png => {
            let encoder =
                PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, PngFilter::Adaptive);
            pixels.write_with_encoder(encoder)?;
        }
    }
    Ok(bytes)
}

#[expect(clippy::needless_pass_by_value, reason = "it is what map_err gives")]
fn broken(error: ImageError) -> FrameError {
    FrameError::Broken(error.to_string())
}
