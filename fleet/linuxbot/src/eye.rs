//! The robot's camera: what it sees, as a JPEG file (W22).

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use mom_wheels::eye::{HEIGHT, WIDTH, draw};
use mom_wheels::{Floor, Pose};

/// Between two pictures, at least; a request before that gets the latest again.
const BETWEEN: Duration = Duration::from_millis(200);
const QUALITY: u8 = 75;

/// The eye of a simulated robot: draws when it is asked, five times a second at most.
#[derive(Debug)]
pub struct Eye {
    floor: Floor,
    latest: Mutex<Option<(Instant, Bytes)>>,
}

impl Eye {
    /// An eye that sees the walls of this floor.
    #[must_use]
    pub fn new(floor: Floor) -> Self {
        Self {
            floor,
            latest: Mutex::new(None),
        }
    }

    /// The picture of a robot at this pose, as a JPEG file of 320 × 240 pixels; `None` if it cannot be encoded. It takes milliseconds of
    /// a processor, and those who ask meanwhile wait for it.
    pub fn picture(&self, pose: Pose) -> Option<Bytes> {
        self.picture_at(pose, Instant::now())
    }

    fn picture_at(&self, pose: Pose, now: Instant) -> Option<Bytes> {
        // Whole even if another one broke down while it drew.
        let mut latest = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((taken, picture)) = &*latest
            && now.saturating_duration_since(*taken) < BETWEEN
        {
            return Some(picture.clone());
        }
        let picture = encode(&draw(self.floor, pose))?;
        *latest = Some((now, picture.clone()));
        Some(picture)
    }
}

fn encode(pixels: &[u8]) -> Option<Bytes> {
    let mut file = Vec::with_capacity(16 * 1024);
    JpegEncoder::new_with_quality(&mut file, QUALITY)
        .write_image(pixels, WIDTH, HEIGHT, ExtendedColorType::Rgb8)
        .inspect_err(|error| tracing::warn!(%error, "the picture is not encoded"))
        .ok()?;
    Some(file.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_drawn_five_times_a_second_at_most() {
        let (eye, begin) = (Eye::new(Floor::ARENA), Instant::now());
        let looks = |heading: f64, ms: u64| {
            let pose = Pose::new(2500.0, 2500.0, heading);
            let picture = eye.picture_at(pose, begin + Duration::from_millis(ms));
            picture.expect("it is encoded")
        };
        let first = looks(0.0, 0);
        assert_eq!(looks(90.0, 199), first, "it is the latest again");
        let second = looks(90.0, 200);
        assert_ne!(second, first);
        assert_eq!(looks(0.0, 399), second);
        assert_eq!(looks(0.0, 400), first, "a picture has nothing but the pose in it");
        let decoded = image::load_from_memory(&first).expect("a JPEG file");
        assert_eq!((decoded.width(), decoded.height()), (WIDTH, HEIGHT));
    }
}
