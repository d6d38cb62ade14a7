//! The image server (M37): reacts to the events of its channels.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use mom_client::{Code, Content, Delivery, Event, Family, Map, Parcel, Path, Time, Value, WireError};
use mom_program::others::Others;

use crate::owner::Owner;
use crate::pan::{CameraTime, Slew};
use crate::shot::{Picture, PictureRequest, Purpose, Shot};
use crate::trail::Trail;
use crate::{
    Calibration, CameraSettings, PosePredictor, Renderer, Scene, SettingsChange, SettingsError, View,
};

#[cfg(test)]
mod predicted_tests;
mod real;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod turning_tests;
mod users;

pub use real::{CAMERA_ERROR, CAMERA_RECOVERED};

use real::RealCamera;

/// The message that carries a picture.
pub const IMAGE: &str = "image";
/// The message by which anyone asks for a picture.
pub const REQUEST: &str = "request";
/// The message that a request was refused.
pub const REQUEST_REFUSED: &str = "request-refused";
/// The message by which the token's owner changes the settings; one that changes nothing asks for them.
pub const SETTINGS: &str = "settings";
/// The message that tells all the new settings.
pub const SETTINGS_CHANGED: &str = "settings-changed";
/// The message that tells the requester the settings in use.
pub const SETTINGS_IN_USE: &str = "settings-in-use";
/// The message that a change was refused.
pub const SETTINGS_REFUSED: &str = "settings-refused";
/// The message by which the token's owner tells the camera its measured matrix (M55).
pub const CALIBRATION: &str = "calibration";
/// The message that tells all the new matrix.
pub const CALIBRATION_CHANGED: &str = "calibration-changed";
/// The message that a matrix was refused.
pub const CALIBRATION_REFUSED: &str = "calibration-refused";
/// The message of the robot that tells its state.
const STATE: &str = "state";
/// The priority of images: a receiver behind a narrow link has everything else first, and between their chunks.
pub const IMAGE_PRIORITY: i32 = -10;
/// For how long a motion is taken to go on after the last state: more is far from the truth at each corner.
const HORIZON: Duration = Duration::from_millis(500);
/// The most requests that wait for a picture.
const MOST_REQUESTS: usize = 64;

/// The options of an image server.
#[derive(Debug, Clone, PartialEq)]
pub struct ServerOptions {
    /// The view of the camera.
    pub view: View,
    /// The channel of its images.
    pub channel: Path,
    /// The token whose owner may change the settings.
    pub token: Path,
    /// The settings to begin with.
    pub settings: CameraSettings,
    /// µs between the starts of two broadcast images, at least.
    pub period: CameraTime,
    /// How many past poses the path in the image has (M44).
    pub trail: usize,
}

/// The decisions of the camera's peer, without a connection, a clock or threads.
///
/// `handle_robot`, `handle_token` and `handle_camera` take the events of the three contexts that it joins. After
/// each of them, and whenever [`ImageServer::next_wake`] is due, the driver calls `advance`, which may give a
/// [`Shot`]; its [`Picture`] is returned by `handle_picture`. At most one shot is under way. What is to be sent
/// is pushed to `out`.
///
/// - Every new state of the robot is followed by a broadcast image (M38), at most one per period; while an image
///   is drawn, newer states replace each other.
/// - Anyone may ask for an image, and is answered with one of the newest state, whatever the period.
/// - Only the owner of the token (the robot's, but for a camera with one of its own) changes the settings (M37), by whichever of its user's
///   peers; anyone may ask
///   for them. Whose a peer is the hub knows: [`ImageServer::ask_users`].
/// - Only that owner tells the measured matrix (M55), which images carry from then on, scaled to their size.
#[derive(Debug)]
pub struct ImageServer {
    options: ServerOptions,
    /// What draws, where the camera is not a real one.
    renderer: Arc<Renderer>,
    real: Option<RealCamera>,
    calibration: Option<Arc<Calibration>>,
    owner: Owner,
    changes: Others,
    scene: Scene,
    trail: Trail,
    predictor: PosePredictor,
    state_seq: Option<i64>,
    /// When the robot sent the state, by its parcel's timestamp.
    pose_time: Option<Time>,
    /// Rises with everything that changes the picture.
    revision: u64,
    /// The revision that was broadcast last, or is about to be.
    shown: u64,
    /// When the next broadcast may begin.
    next: CameraTime,
    /// What the mount does, if the camera is on one that turns.
    slew: Option<Slew>,
    drawing: bool,
    requests: VecDeque<PictureRequest>,
    newest: Option<Picture>,
}

impl ImageServer {
    /// A server that has seen no robot yet.
    ///
    /// # Errors
    ///
    /// [`SettingsError::Setting`] for a setting outside its limits.
    pub fn new(options: ServerOptions) -> Result<ImageServer, SettingsError> {
        Ok(ImageServer {
            renderer: Arc::new(Renderer::new(options.view, options.settings)?),
            real: None,
            calibration: None,
            owner: Owner::default(),
            changes: Others::default(),
            scene: Scene::default(),
            trail: Trail::new(options.trail),
            predictor: PosePredictor::new(HORIZON),
            state_seq: None,
            pose_time: None,
            revision: 0,
            shown: 0,
            next: 0,
            slew: None,
            drawing: false,
            requests: VecDeque::new(),
            newest: None,
            options,
        })
    }

    /// The server with a matrix that was measured before.
    #[must_use]
    pub fn calibrated(mut self, calibration: Option<Calibration>) -> ImageServer {
        self.calibration = calibration.map(Arc::new);
        self
    }

    /// The measured matrix, if there is one.
    pub fn calibration(&self) -> Option<&Calibration> {
        self.calibration.as_deref()
    }

    /// Takes an event of the robot's channel: its states.
    pub fn handle_robot(&mut self, event: &Event) {
        if let Event::Message(parcel) = event
            && parcel.name() == STATE
            && let Some(content) = &parcel.content
            && let Err(error) = self.take_state(content, parcel)
        {
            tracing::warn!(%error, "a state of the robot cannot be read");
        }
    }

    /// Takes an event of the robot's token: who owns it (M33).
    pub fn handle_token(&mut self, event: &Event) {
        self.owner.handle(event);
    }

    /// Handles the hub's answer about the token when it is joined or queried.
    pub fn handle_token_info(&mut self, info: &Map) {
        self.owner.handle_info(info);
    }

    /// Takes an event of the camera's own channel: requests, settings and a measured matrix.
    pub fn handle_camera(&mut self, event: &Event, out: &mut Vec<Parcel>) {
        let Event::Message(parcel) = event else { return };
        match parcel.name() {
            REQUEST => self.take_request(parcel, out),
            SETTINGS => self.hear_settings(parcel, out),
            CALIBRATION => {
                let answer = self.take_calibration(parcel);
                let refused =
                    |error: WireError| self.answer(CALIBRATION_REFUSED, error.to_map(), &request_of(parcel));
                out.push(answer.unwrap_or_else(refused));
            }
            _ => {}
        }
    }

    /// Takes what the mount does from now on, if there is one: images show where it looks when they are taken.
    pub fn handle_slew(&mut self, slew: Option<Slew>) {
        self.slew = slew;
    }

    /// Takes a finished picture.
    pub fn handle_picture(&mut self, picture: Picture, out: &mut Vec<Parcel>) {
        self.drawing = false;
        if self.has_no_frame() {
            // The real camera failed while its last frame was decoded: nobody takes that for what it sees now.
            self.refuse_purpose(&picture.purpose, out);
            return;
        }
        match &picture.content {
            Ok(content) => {
                self.note_recovery(out);
                self.send(content, &picture.purpose, out);
                self.newest = Some(picture);
            }
            Err(error) => self.refuse_picture(error, &picture.purpose, out),
        }
    }

    /// Notes that drawing a picture failed: its revision is skipped.
    pub fn handle_failure(&mut self) {
        self.drawing = false;
    }

    /// Sends the newest picture where it need not be drawn again, and gives the next shot if there is one.
    /// `wall` is the time of day by the hub's clock.
    pub fn advance(&mut self, now: CameraTime, wall: Time, out: &mut Vec<Parcel>) -> Option<Shot> {
        self.take_aim(now);
        if self.drawing || self.is_blind(out) {
            return None;
        }
        let purpose = Purpose {
            broadcast: self.shown != self.revision && now >= self.next,
            requests: self.requests.drain(..).collect(),
        };
        if purpose == Purpose::default() {
            return None;
        }
        if purpose.broadcast {
            self.shown = self.revision;
            self.next = now.saturating_add(self.options.period);
        }
        if let Some(content) = self.reusable(wall) {
            self.send(&content, &purpose, out);
            return None;
        }
        self.drawing = true;
        Some(self.shot(purpose, wall))
    }

    /// When [`ImageServer::advance`] is to be called next; `None` while there is nothing to wait for.
    pub fn next_wake(&self) -> Option<CameraTime> {
        let turns = self.slew.is_some_and(|slew| slew.target() != self.scene.aim);
        let waits = !self.drawing && (self.shown != self.revision || turns) && !self.has_no_frame();
        waits.then_some(self.next)
    }

    /// The camera looks where its mount has turned it by now.
    fn take_aim(&mut self, now: CameraTime) {
        let Some(slew) = self.slew else { return };
        let aim = slew.at(now);
        if aim != self.scene.aim {
            self.scene.aim = aim;
            self.revision += 1;
        }
    }

    fn take_state(&mut self, content: &Content, parcel: &Parcel) -> Result<(), WireError> {
        let state = content.to_value()?;
        let seq = state.get("seq").and_then(Value::as_int);
        // A restarted arm counts from 0, so a lower number is news as well.
        if seq.is_some() && seq == self.state_seq {
            return Ok(());
        }
        // Without its controller the robot may move, but nobody knows how: nothing is predicted.
        let linked = state.get("linked").and_then(Value::as_bool) != Some(false);
        let moving = match linked {
            true => state.get("moving").and_then(Value::as_bool),
            false => Some(false),
        };
        let aim = self.scene.aim;
        self.scene = mom_client::from_value(state)?;
        self.scene.aim = aim;
        self.predictor.observe(parcel, &self.scene.pose, moving);
        self.trail.push(self.scene.pose);
        (self.state_seq, self.pose_time) = (seq, parcel.timestamp);
        // The next frame of a real camera shows it; an earlier one does not.
        self.revision += u64::from(self.real.is_none());
        Ok(())
    }

    fn take_request(&mut self, parcel: &Parcel, out: &mut Vec<Parcel>) {
        let request = request_of(parcel);
        if self.requests.len() < MOST_REQUESTS {
            self.requests.push_back(request);
            return;
        }
        let text = format!("{MOST_REQUESTS} requests wait for an image already; ask again in a moment");
        let error = WireError::new(Code::TRY_LATER, text);
        out.push(self.answer(REQUEST_REFUSED, error.to_map(), &request));
    }

    /// Answers a change of the settings, or a question for them.
    fn hear_settings(&mut self, parcel: &Parcel, out: &mut Vec<Parcel>) {
        match read_change(parcel) {
            Ok(change) if change == SettingsChange::default() => {
                out.push(self.answer(SETTINGS_IN_USE, self.settings_map(), &request_of(parcel)));
            }
            Ok(_) if self.keep_foreign(parcel, out) => {}
            _ => {
                let answer = self.change_by(parcel.sender.as_deref(), parcel);
                out.push(answer);
            }
        }
    }

    /// The answer to a change that this peer answers for.
    fn change_by(&mut self, peer: Option<&str>, parcel: &Parcel) -> Parcel {
        let changed = read_change(parcel).and_then(|change| {
            self.owner
                .check(peer, &self.options.token, "changes the settings")?;
            self.change_settings(&change)
        });
        if let Err(error) = changed {
            return self.answer(SETTINGS_REFUSED, error.to_map(), &request_of(parcel));
        }
        let by = parcel.sender.as_deref().unwrap_or_default();
        let mut changed = self.message(SETTINGS_CHANGED, self.settings_map().with("by", by));
        changed.reference = parcel.id;
        changed
    }

    fn take_calibration(&mut self, parcel: &Parcel) -> Result<Parcel, WireError> {
        let sender = parcel.sender.as_deref();
        self.owner
            .check(sender, &self.options.token, "tells the camera its matrix")?;
        let calibration = Calibration::of(parcel, self.options.view)?;
        let mut changed = self.message(CALIBRATION_CHANGED, calibration.to_map());
        changed.reference = parcel.id;
        self.calibration = Some(Arc::new(calibration));
        self.revision += 1;
        Ok(changed)
    }

    fn change_settings(&mut self, change: &SettingsChange) -> Result<(), WireError> {
        let bad_content = |error: SettingsError| WireError::new(Code::BAD_CONTENT, error.to_string());
        if let Some(real) = &mut self.real {
            self.revision += u64::from(real.change(change).map_err(bad_content)?);
            return Ok(());
        }
        let settings = self.renderer.settings().with(change).map_err(bad_content)?;
        if settings != self.renderer.settings() {
            self.renderer = Arc::new(Renderer::new(self.options.view, settings).map_err(bad_content)?);
            self.revision += 1;
        }
        Ok(())
    }

    fn settings_map(&self) -> Map {
        match &self.real {
            Some(real) => real.settings_map(),
            None => settings_map(&self.renderer.settings()),
        }
    }

    /// The newest picture's content, if nothing has changed since.
    fn reusable(&self, wall: Time) -> Option<Map> {
        if self.real.is_none() && self.predictor.is_moving() {
            // It is further ahead by now.
            return None;
        }
        let newest = self
            .newest
            .as_ref()
            .filter(|newest| newest.revision == self.revision)?;
        let content = newest.content.clone().ok()?;
        Some(match self.real {
            Some(_) => content,
            None => content.with("taken", wall),
        })
    }

    fn shot(&self, purpose: Purpose, wall: Time) -> Shot {
        let newest = self.real.as_ref().and_then(RealCamera::newest);
        Shot {
            purpose,
            revision: self.revision,
            calibration: self.calibration.clone(),
            ..newest.unwrap_or_else(|| self.shot_now(wall))
        }
    }

    /// Of the scene as it is now.
    fn shot_now(&self, wall: Time) -> Shot {
        Shot {
            taken_frame: None,
            renderer: Arc::clone(&self.renderer),
            calibration: self.calibration.clone(),
            scene: Scene {
                trail: self.trail.up_to(self.scene.pose),
                predicted: self
                    .predictor
                    .is_moving()
                    .then(|| self.predictor.at(wall))
                    .flatten(),
                ..self.scene.clone()
            },
            state_seq: self.state_seq,
            pose_time: self.pose_time,
            taken: wall,
            revision: self.revision,
            purpose: Purpose::default(),
        }
    }

    fn send(&self, content: &Map, purpose: &Purpose, out: &mut Vec<Parcel>) {
        for request in &purpose.requests {
            // Not `latest`: the next broadcast would take the place of the answer in a slow peer's queue.
            out.push(self.answer(IMAGE, content.clone(), request));
        }
        if purpose.broadcast {
            let mut image = self.message(IMAGE, content.clone());
            image.delivery = Some(Delivery::Latest);
            out.push(image);
        }
    }

    /// A message to one peer.
    fn answer(&self, name: &str, content: Map, to: &PictureRequest) -> Parcel {
        let mut parcel = self.message(name, content);
        parcel.address = Some(vec![Arc::clone(&to.peer)]);
        parcel.reference = to.id;
        parcel
    }

    /// A message to all without echo.
    fn message(&self, name: &str, content: Map) -> Parcel {
        let mut parcel = Parcel::new(Family::Message, name)
            .context(self.options.channel.clone())
            .content(content);
        parcel.delivery = Some(Delivery::Reliable);
        parcel.priority = (name == IMAGE).then_some(IMAGE_PRIORITY);
        parcel.echo = Some(false);
        parcel
    }
}

/// What is to change; nothing is a question for the settings.
fn read_change(parcel: &Parcel) -> Result<SettingsChange, WireError> {
    match &parcel.content {
        Some(content) => content.read(),
        None => Ok(SettingsChange::default()),
    }
}

fn request_of(parcel: &Parcel) -> PictureRequest {
    PictureRequest {
        peer: parcel.sender.clone().unwrap_or_default(),
        id: parcel.id,
    }
}

fn settings_map(settings: &CameraSettings) -> Map {
    Map::new()
        .with("width", settings.width)
        .with("height", settings.height)
        .with("quality", u32::from(settings.quality))
        .with("format", settings.format.name())
        .with("overlay", settings.overlay)
}
