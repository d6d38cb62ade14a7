//! What one image shows.

use mom_vision::blocks::{self, Sighting};
use mom_vision::{Picture, Projection, marker};

use crate::Micros;
use crate::task::palette;

/// What one image shows.
#[derive(Debug, Clone)]
pub struct Seen {
    /// Which camera's.
    pub camera: usize,
    /// When it was taken.
    pub taken: Micros,
    /// When the hand was where it shows it, as far as the camera knows: a drawn image shows the newest state that had come.
    pub shows: Micros,
    /// How well these times are known, µs.
    pub error: Micros,
    /// From mm on the table to its pixels, by the camera's word.
    pub projection: Projection,
    /// The middle of the ball on the gripper.
    pub marker: Option<[f64; 2]>,
    /// The blocks, in the order of [`NAMES`](crate::task::NAMES).
    pub blocks: Vec<Option<Sighting>>,
}

impl Seen {
    /// Looks at an image; takes milliseconds of a processor.
    #[must_use]
    pub fn look(camera: usize, taken: Micros, projection: Projection, picture: &Picture) -> Seen {
        let marker = marker::find(picture, marker::COLOUR).ok();
        Seen {
            camera,
            taken,
            shows: taken,
            error: 0,
            projection,
            marker: marker.map(|spot| spot.middle),
            blocks: blocks::find(picture, &palette()),
        }
    }
}
