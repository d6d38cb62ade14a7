//! From the bytes of an image to its pixels.

use std::io::Cursor;

use image::{ImageReader, Limits};

/// Longer edges are refused: a camera that sends them means no good.
const LONGEST: u32 = 8192;

/// The pixels of an image, row by row, red, green and blue.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Width times height of them.
    pub pixels: Vec<[u8; 3]>,
}

impl Picture {
    /// Reads a PNG or JPEG file; the error says what is wrong with it.
    ///
    /// # Errors
    ///
    /// What cannot be read, or is larger than 8192 pixels in a direction.
    pub fn decode(bytes: &[u8]) -> Result<Picture, String> {
        let mut reader = ImageReader::new(Cursor::new(bytes))
            .with_guessed_format()
            .map_err(|error| error.to_string())?;
        let mut limits = Limits::default();
        (limits.max_image_width, limits.max_image_height) = (Some(LONGEST), Some(LONGEST));
        reader.limits(limits);
        let image = reader.decode().map_err(|error| error.to_string())?.into_rgb8();
        Ok(Picture {
            width: image.width() as usize,
            height: image.height() as usize,
            pixels: image.pixels().map(|pixel| pixel.0).collect(),
        })
    }
}
