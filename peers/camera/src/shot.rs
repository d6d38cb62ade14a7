//! A shot and its picture: the input and output of the drawing thread.

use std::sync::Arc;

use mom_client::{Map, Time, Value};

use crate::{Calibration, DrawnPose, Image, Overlay, Renderer, Scene};

/// A picture to be drawn: the input of drawing, and the receivers.
#[derive(Debug, Clone)]
pub struct Shot {
    pub(crate) renderer: Arc<Renderer>,
    /// The measured matrix, if there is one: it takes the place of the renderer's.
    pub(crate) calibration: Option<Arc<Calibration>>,
    pub(crate) scene: Scene,
    pub(crate) state_seq: Option<i64>,
    /// When the robot said that it was there.
    pub(crate) pose_time: Option<Time>,
    pub(crate) taken: Time,
    pub(crate) revision: u64,
    pub(crate) purpose: Purpose,
}

/// The receivers of a picture.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Purpose {
    /// All members of the channel.
    pub(crate) broadcast: bool,
    /// Peers that asked, with the ids of their requests.
    pub(crate) requests: Vec<PictureRequest>,
}

/// A peer that asked for a picture.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PictureRequest {
    pub(crate) peer: Arc<str>,
    pub(crate) id: Option<u64>,
}

/// A finished picture.
#[derive(Debug, Clone)]
pub struct Picture {
    pub(crate) content: Map,
    pub(crate) revision: u64,
    pub(crate) purpose: Purpose,
}

impl Shot {
    /// Draws and encodes; takes milliseconds of a processor.
    #[must_use]
    pub fn take(self) -> Picture {
        let image = self.renderer.render(&self.scene);
        Picture {
            content: self.content(image),
            revision: self.revision,
            purpose: self.purpose,
        }
    }

    fn content(&self, image: Image) -> Map {
        let mut map = Map::new()
            .with("image", Value::Binary(image.bytes.into()))
            .with("media-type", image.media_type)
            .with("width", image.width)
            .with("height", image.height)
            .with("view", self.renderer.view().name())
            .with("quality", u32::from(self.renderer.settings().quality))
            .with("taken", self.taken);
        if let Some(seq) = self.state_seq {
            map.set("state-seq", seq);
        }
        if let Some(time) = self.pose_time {
            map.set("pose-time", time);
        }
        let matrix = match &self.calibration {
            Some(measured) => {
                map.set("calibrated", measured.facts());
                measured.scaled(image.width, image.height)
            }
            None => image.matrix,
        };
        let matrix: Vec<Value> = matrix.into_iter().map(Value::Double).collect();
        map.set("matrix", matrix);
        let DrawnPose { x, y, z, spin, tilt } = self.scene.pose.drawable();
        let pose = [("x", x), ("y", y), ("z", z), ("spin", spin), ("tilt", tilt)]
            .into_iter()
            .fold(Map::new(), |map, (key, number)| {
                map.with(key, Value::Double(number))
            });
        map.set("pose", pose);
        let overlays: Vec<Value> = Overlay::of(&self.scene)
            .iter()
            .map(|overlay| overlay.to_map().into())
            .collect();
        map.set("overlays", overlays);
        map
    }
}
