//! A measurement of the marker.

/// A point of the world in mm, and where it was seen, in pixels from the image's upper left corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// The middle of the marker, mm.
    pub world: [f64; 3],
    /// The middle of its picture, pixels.
    pub pixel: [f64; 2],
}
