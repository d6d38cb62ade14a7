//! The camera that is calibrated: its images, its settings, and its new matrix.

use std::time::Duration;

use mom_client::{Event, Map, Time, Value, from_value};
use tokio::time::{Instant, timeout};

use mom_drive::{ANSWER, DeviceChannel, Pose, RobotState, VerbFailure, closed};

use crate::Calibration;

/// How long to wait for an image by itself before the camera is asked again.
const AGAIN: Duration = Duration::from_millis(300);

/// The camera.
pub(crate) struct Camera {
    pub(crate) channel: DeviceChannel,
    /// The settings to be restored, if they were changed.
    changed: Option<Map>,
}

impl Camera {
    /// A camera whose images can be calibrated.
    ///
    /// # Errors
    /// Nobody is there, or it moves.
    pub(crate) async fn meet(channel: DeviceChannel) -> Result<Camera, VerbFailure> {
        let image = ask_image(&channel).await?;
        if let Some(motion) = motion(&image) {
            return Err(VerbFailure::new(
                format!(
                    "the camera in {} {motion}, so that no one matrix is right",
                    channel.path()
                ),
                "calibrate one that stands: x, y or top; this one computes its matrix for each image",
            ));
        }
        Ok(Camera {
            channel,
            changed: None,
        })
    }

    /// Has it send lossless images without anything drawn in.
    pub(crate) async fn set(&mut self) -> Result<(), VerbFailure> {
        let what = format!("ask {} for its settings", self.channel.path());
        let before = self.channel.ask("settings", Map::new(), &what).await?;
        let wanted = Map::new().with("format", "png").with("overlay", false);
        let mut restore = Map::new();
        for (key, _) in wanted.clone() {
            if let Some(value) = before.get(&key) {
                restore.set(&key, value.clone());
            }
        }
        // Before the answer: it may be changed although the answer is lost.
        self.changed = Some(restore);
        let what = format!("set {}", self.channel.path());
        self.channel.ask("settings", wanted, &what).await.map(|_| ())
    }

    /// Restores the settings that were changed.
    pub(crate) async fn restore(&mut self) -> Result<(), VerbFailure> {
        let Some(before) = self.changed.take() else {
            return Ok(());
        };
        let what = format!("restore the settings of {}", self.channel.path());
        self.channel.ask("settings", before, &what).await.map(|_| ())
    }

    /// When the newest image was taken, by the camera's word.
    pub(crate) async fn newest(&mut self) -> Result<Option<Time>, VerbFailure> {
        Ok(taken(&ask_image(&self.channel).await?))
    }

    /// An image of the robot as it rests, taken later than `after`.
    pub(crate) async fn image_of(
        &mut self,
        state: &RobotState,
        after: Option<Time>,
    ) -> Result<Value, VerbFailure> {
        let shows = |image: &Value| shows(image, state) && taken(image) > after;
        let mut events = self.channel.events();
        let deadline = Instant::now() + ANSWER;
        while Instant::now() < deadline {
            let image = ask_image(&self.channel).await?;
            if shows(&image) {
                return Ok(image);
            }
            // The state is on its way to the camera; the image of it goes to all.
            let next = async {
                loop {
                    match events.next().await.ok_or_else(closed)? {
                        Event::Message(parcel) if parcel.name() == "image" => return Ok(parcel.value()),
                        _ => {}
                    }
                }
            };
            match timeout(AGAIN, next).await {
                Ok(Ok(image)) if shows(&image) => return Ok(image),
                Ok(Err(failure)) => return Err(failure),
                _ => {}
            }
        }
        Err(VerbFailure::new(
            format!(
                "the camera in {} shows no image of the robot's state {} within {} s",
                self.channel.path(),
                state.seq,
                ANSWER.as_secs()
            ),
            "see whether it looks at this robot: mom snap --json tells the state of its image",
        ))
    }

    /// Tells it its matrix.
    pub(crate) async fn publish(
        &mut self,
        calibration: &Calibration,
        size: (usize, usize),
    ) -> Result<(), VerbFailure> {
        let numbers = calibration.projection.numbers();
        let matrix: Vec<Value> = numbers.into_iter().map(Value::Double).collect();
        let content = Map::new()
            .with("matrix", matrix)
            .with("width", size.0 as i64)
            .with("height", size.1 as i64)
            .with("rms", Value::Double(calibration.rms))
            .with("poses", calibration.used() as i64);
        let what = format!("tell {} its matrix", self.channel.path());
        self.channel.ask("calibration", content, &what).await.map(|_| ())
    }
}

/// How the camera of an image moves, if it does.
fn motion(image: &Value) -> Option<&'static str> {
    if image.get("view").and_then(Value::as_str) == Some("wrist") {
        return Some("sits on the wrist and moves with the arm");
    }
    // Only a camera on a mount says where that looks.
    image.get("aim").map(|_| "sits on a mount and turns by command")
}

async fn ask_image(channel: &DeviceChannel) -> Result<Value, VerbFailure> {
    let what = format!("ask {} for an image", channel.path());
    channel.ask("request", Map::new(), &what).await
}

fn taken(image: &Value) -> Option<Time> {
    image.get("taken").and_then(Value::as_time)
}

/// Whether an image was taken of this state, or of a later one in which the robot rests at the same place.
fn shows(image: &Value, state: &RobotState) -> bool {
    let seq = image.get("state-seq").and_then(Value::as_int);
    let pose = image
        .get("pose")
        .cloned()
        .and_then(|pose| from_value::<Pose>(pose).ok());
    seq >= Some(state.seq) && pose.is_some_and(|pose| pose.is_at(&state.pose))
}
