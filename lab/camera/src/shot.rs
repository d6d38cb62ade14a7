//! A shot and its picture: the input and output of the drawing thread.

use std::sync::Arc;

use bytes::Bytes;
use mom_client::{Map, Time, Value};

use crate::overlay::{POSE, PREDICTED};
use crate::source::{Frame, FrameError};
use crate::{Calibration, DrawnPose, Overlay, Renderer, Rendition, Scene, View};

/// A picture to be drawn: the input of drawing, and the receivers.
#[derive(Debug, Clone)]
pub struct Shot {
    pub(crate) renderer: Arc<Renderer>,
    /// The frame of a real camera, which takes the place of drawing.
    pub(crate) taken_frame: Option<TakenFrame>,
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

/// A frame of a real camera.
#[derive(Debug, Clone)]
pub(crate) struct TakenFrame {
    pub(crate) frame: Arc<Frame>,
    pub(crate) rendition: Rendition,
    /// The camera's name.
    pub(crate) view: Arc<str>,
}

/// The file of a picture, drawn or taken.
struct PictureFile {
    bytes: Bytes,
    media_type: &'static str,
    width: u32,
    height: u32,
    view: Arc<str>,
    /// As far as it was encoded here.
    quality: Option<u8>,
    matrix: Option<[f64; 12]>,
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
    /// The content of its message; the error of a frame that cannot be decoded.
    pub(crate) content: Result<Map, FrameError>,
    pub(crate) revision: u64,
    pub(crate) purpose: Purpose,
}

impl Shot {
    /// Draws and encodes; takes milliseconds of a processor.
    #[must_use]
    pub fn take(self) -> Picture {
        let file = match &self.taken_frame {
            Some(taken) => taken.file(),
            None => Ok(self.draw()),
        };
        Picture {
            content: file.map(|file| self.content(file)),
            revision: self.revision,
            purpose: self.purpose,
        }
    }

    fn draw(&self) -> PictureFile {
        let image = self.renderer.render(&self.scene);
        PictureFile {
            bytes: image.bytes.into(),
            media_type: image.media_type,
            width: image.width,
            height: image.height,
            view: self.renderer.view().name().into(),
            quality: Some(self.renderer.settings().quality),
            matrix: Some(image.matrix),
        }
    }

    fn content(&self, file: PictureFile) -> Map {
        let mut map = Map::new()
            .with("image", Value::Binary(file.bytes))
            .with("media-type", file.media_type)
            .with("width", file.width)
            .with("height", file.height)
            .with("view", &*file.view)
            .with("taken", self.taken);
        if let Some(quality) = file.quality {
            map.set("quality", u32::from(quality));
        }
        if let Some(seq) = self.state_seq {
            map.set("state-seq", seq);
        }
        if let Some(time) = self.pose_time {
            map.set("pose-time", time);
        }
        if self.renderer.view() == View::Pan {
            map.set("aim", self.scene.aim.to_map());
        }
        let matrix = match &self.calibration {
            Some(measured) => {
                map.set("calibrated", measured.facts());
                Some(measured.scaled(file.width, file.height))
            }
            None => file.matrix,
        };
        if let Some(matrix) = matrix {
            let matrix: Vec<Value> = matrix.into_iter().map(Value::Double).collect();
            map.set("matrix", matrix);
        }
        if self.taken_frame.is_some() && self.pose_time.is_none() && self.state_seq.is_none() {
            // A real camera where no robot has told where it is.
            return map;
        }
        let DrawnPose { x, y, z, spin, tilt } = self.scene.pose.drawable();
        let pose = [("x", x), ("y", y), ("z", z), ("spin", spin), ("tilt", tilt)]
            .into_iter()
            .fold(Map::new(), |map, (key, number)| {
                map.with(key, Value::Double(number))
            });
        map.set("pose", pose);
        let overlays: Vec<Value> = Overlay::of(&self.scene)
            .iter()
            .map(|overlay| {
                let map = overlay.to_map();
                match (overlay.name.as_str(), self.pose_time) {
                    (POSE, Some(time)) => map.with("time", time).into(),
                    (PREDICTED, _) => map.with("time", self.taken).into(),
                    _ => map.into(),
                }
            })
            .collect();
        map.set("overlays", overlays);
        map
    }
}

impl TakenFrame {
    fn file(&self) -> Result<PictureFile, FrameError> {
        let (frame, quality) = self.frame.rendered(&self.rendition)?;
        Ok(PictureFile {
            bytes: frame.bytes,
            media_type: frame.format.media_type(),
            width: frame.width,
            height: frame.height,
            view: Arc::clone(&self.view),
            quality,
            matrix: None,
        })
    }
}
