//! What one image shows.

use bytes::Bytes;
use mom_client::{Time, Value};
use mom_vision::blocks::{Coloured, Sighting, find};
use mom_vision::{Picture, Projection};

use crate::object::as_number;

/// An image as a camera sent it, before anybody has looked at it.
#[derive(Debug, Clone)]
pub struct Image {
    bytes: Bytes,
    projection: Projection,
    taken: Time,
    state: Option<i64>,
}

/// What is seen in an image.
#[derive(Debug, Clone)]
pub struct Look {
    /// From mm on the table to its pixels.
    pub projection: Projection,
    /// When it was taken, by the hub's clock.
    pub taken: Time,
    /// The number of the robot's state that it shows, if the camera says so.
    pub state: Option<i64>,
    /// What is seen of each object that was looked for, by its name.
    pub seen: Vec<(String, Sighting)>,
}

impl Image {
    /// Reads the content of a camera's `image`; none without a matrix or a time.
    #[must_use]
    pub fn of(content: &Value) -> Option<Image> {
        let matrix = content.get("matrix")?.as_list()?;
        let numbers: Vec<f64> = matrix.iter().filter_map(as_number).collect();
        Some(Image {
            bytes: content.get("image")?.as_binary()?.clone(),
            projection: Projection::new(numbers.try_into().ok()?)?,
            taken: content.get("taken")?.as_time()?,
            state: content.get("state-seq").and_then(Value::as_int),
        })
    }

    /// When it was taken, as the camera says.
    #[must_use]
    pub fn taken(&self) -> Time {
        self.taken
    }

    /// Decodes it and looks for objects; takes some ms of a processor.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn look(&self, wanted: &[Coloured]) -> Result<Look, String> {
        let picture = Picture::decode(&self.bytes)?;
        let found = find(&picture, wanted);
        let names = wanted.iter().map(|wanted| wanted.name.clone());
        Ok(Look {
            projection: self.projection,
            taken: self.taken,
            state: self.state,
            seen: names
                .zip(found)
                .filter_map(|(name, sighting)| Some((name, sighting?)))
                .collect(),
        })
    }
}

impl Look {
    /// What is seen of an object.
    #[must_use]
    pub fn sighting(&self, name: &str) -> Option<&Sighting> {
        self.seen
            .iter()
            .find(|(seen, _)| seen == name)
            .map(|(_, sighting)| sighting)
    }
}
