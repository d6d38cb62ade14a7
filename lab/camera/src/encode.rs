//! From pixels to JPEG or PNG.

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageResult};
use tiny_skia::Pixmap;

use crate::settings::{CameraSettings, Format};

/// The bytes of an image file; the size is that of the pixels.
pub(crate) fn encode(pixels: &Pixmap, settings: &CameraSettings) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(pixels.data().len() / 8);
    write(pixels, settings, &mut bytes)
        .expect("both encoders take RGB of any size within the limits, and memory takes every byte");
    bytes
}

fn write(pixels: &Pixmap, settings: &CameraSettings, bytes: &mut Vec<u8>) -> ImageResult<()> {
    // The picture covers its background, so that dropping the opacity loses nothing.
    let rgb: Vec<u8> = pixels
        .data()
        .chunks_exact(4)
        .flat_map(|p| [p[0], p[1], p[2]])
        .collect();
    let (width, height, colour) = (pixels.width(), pixels.height(), ExtendedColorType::Rgb8);
    match settings.format {
        Format::Jpeg => {
            JpegEncoder::new_with_quality(bytes, settings.quality).write_image(&rgb, width, height, colour)
        }
        Format::Png => PngEncoder::new_with_quality(bytes, CompressionType::Fast, FilterType::Adaptive)
            .write_image(&rgb, width, height, colour),
    }
}
