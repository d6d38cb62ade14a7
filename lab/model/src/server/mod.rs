//! The model server: reacts to the events of its channels (M62).

use std::collections::BTreeMap;
use std::sync::Arc;

use mom_client::{Code, Delivery, Event, Family, Map, Parcel, Path, Time, Value, WireError};
use mom_program::others::Others;
use mom_vision::blocks::Coloured;

use crate::object::{as_number, difference};
use crate::objects::LONGEST_NAME;
use crate::owners::Owners;
use crate::{Image, Look, Object, Objects};

mod fuse;
#[cfg(test)]
mod tests;
mod users;
mod write;

/// The message with all objects, to a peer that joins or asks.
pub const OBJECTS: &str = "objects";
/// The message with what has changed, to all.
pub const CHANGED: &str = "objects-changed";
/// The message by which anyone asks for objects.
pub const QUERY: &str = "query";
/// The message that a question was refused.
pub const QUERY_REFUSED: &str = "query-refused";
/// The message by which the owner of a token writes an object.
pub const WRITE: &str = "write";
/// The message that a write was refused.
pub const WRITE_REFUSED: &str = "write-refused";
/// A camera's message with an image, and that by which one is asked for.
const IMAGE: &str = "image";
const REQUEST: &str = "request";
/// The robot's message that tells its state.
const STATE: &str = "state";

/// µs without an image after which a camera is asked for one: cameras show what changes, and at rest say nothing. With the
/// driver's tick and the camera's answer it makes a second.
const QUIET: i64 = 700_000;
/// µs after which a camera that has not answered is asked again.
const UNANSWERED: i64 = 5_000_000;
/// An image that claims to be taken so many µs from now tells nothing of the present.
const FUTURE: i64 = 1_000_000;
/// µs between two tellings that objects were seen where they were.
const SEEN_PERIOD: i64 = 1_000_000;
/// What is not reported at once by itself.
const MINOR: [&str; 4] = ["name", "seen", "error", "cameras"];

/// A block that the model looks for.
#[derive(Debug, Clone, PartialEq)]
pub struct Kind {
    /// What it is called.
    pub name: String,
    /// mm of its edges.
    pub size: f64,
    /// Red, green and blue.
    pub colour: [u8; 3],
}

/// The options of a model server.
#[derive(Debug, Clone, PartialEq)]
pub struct ServerOptions {
    /// The channel in which it tells.
    pub channel: Path,
    /// The token whose owner writes all objects.
    pub token: Path,
    /// The cameras' channels.
    pub cameras: Vec<Path>,
    /// What it looks for; an object is there once it is seen or written.
    pub kinds: Vec<Kind>,
}

/// What is known of a camera.
#[derive(Debug, Default)]
struct Eye {
    /// Its newest image.
    look: Option<Look>,
    /// When its newest image came.
    heard: Option<Time>,
    /// When it was asked last.
    asked: Option<Time>,
    /// Its peer: a question to that one alone disturbs nobody else.
    peer: Option<Arc<str>>,
}

/// The decisions of the model's peer, without a connection, a clock or threads. Times are the hub's.
///
/// Each `handle_*` takes the events of a context. [`ModelServer::handle_camera`] gives the image that is to be looked at,
/// and [`ModelServer::handle_look`] takes what was seen there; the driver leaves out images for which it has no time.
/// [`ModelServer::advance`] is called a few times each second, and [`ModelServer::ask_users`] after each event.
#[derive(Debug)]
pub struct ModelServer {
    options: ServerOptions,
    objects: Objects,
    /// What all were told of each object, and when they were told since when things were seen.
    told: BTreeMap<String, Map>,
    told_seen: Option<Time>,
    /// Rises with every message of changes, and from one start of the server to the next.
    seq: i64,
    eyes: Vec<Eye>,
    owners: Owners,
    foreign: Others,
    /// What the arm says that it holds.
    holding: Option<String>,
    /// When it looked at its clock first.
    begun: Option<Time>,
    /// While the link to the hub is down, nobody is asked.
    unlinked: bool,
}

impl ModelServer {
    /// A server that has not seen anything, and starts now. Its changes are numbered from this time in ms, so that
    /// who follows a server that is started again is not told numbers that it has passed.
    #[must_use]
    pub fn new(options: ServerOptions, now: Time) -> ModelServer {
        ModelServer {
            eyes: options.cameras.iter().map(|_| Eye::default()).collect(),
            options,
            objects: Objects::default(),
            told: BTreeMap::new(),
            told_seen: None,
            seq: now.micros() / 1000,
            owners: Owners::default(),
            foreign: Others::default(),
            holding: None,
            begun: None,
            unlinked: false,
        }
    }

    /// What is known.
    #[must_use]
    pub fn objects(&self) -> &Objects {
        &self.objects
    }

    /// What to look for in images: the kinds, and written objects whose hue no other has.
    #[must_use]
    pub fn wanted(&self) -> Vec<Coloured> {
        let kinds = self.options.kinds.iter().map(|kind| (&kind.name, kind.colour));
        let mut wanted: Vec<Coloured> = Vec::new();
        for (name, colour) in kinds.chain(self.objects.iter().map(|object| (&object.name, object.colour))) {
            let coloured = Coloured {
                name: name.clone(),
                colour,
            };
            if coloured.has_hue() && !wanted.iter().any(|other| other.is_like(&coloured)) {
                wanted.push(coloured);
            }
        }
        wanted
    }

    /// Takes an event of a camera's channel, by the camera's index in the options; gives an image to look at.
    pub fn handle_camera(&mut self, camera: usize, event: &Event, now: Time) -> Option<Image> {
        let Event::Message(parcel) = event else {
            return None;
        };
        let eye = self.eyes.get_mut(camera)?;
        if parcel.name() != IMAGE {
            return None;
        }
        let image = Image::of(&parcel.value())?;
        (eye.heard, eye.asked) = (Some(now), None);
        eye.peer.clone_from(&parcel.sender);
        let ahead = image.taken().micros() - now.micros();
        if ahead > FUTURE {
            tracing::debug!(camera, ahead, "an image says that it is taken in the future, µs");
            return None;
        }
        Some(image)
    }

    /// Takes what was seen in a camera's image.
    pub fn handle_look(&mut self, camera: usize, look: Look, now: Time, out: &mut Vec<Parcel>) {
        let Some(eye) = self.eyes.get_mut(camera) else {
            return;
        };
        let taken = eye.look.as_ref().map(|look| look.taken);
        if taken.is_some_and(|taken| look.taken < taken) {
            return;
        }
        eye.look = Some(look);
        self.fuse(camera, now);
        self.tell(now, out);
    }

    /// Takes an event of the robot's channel: what it holds. Its simulated blocks are none of the model's business.
    pub fn handle_robot(&mut self, event: &Event, now: Time, out: &mut Vec<Parcel>) {
        if let Event::Message(parcel) = event
            && parcel.name() == STATE
        {
            let state = parcel.value();
            self.holding = state.get("holding").and_then(Value::as_str).map(str::to_owned);
            self.note_held();
            self.tell(now, out);
        }
    }

    /// Takes an event of a token: who owns it (M33).
    pub fn handle_token(&mut self, token: &Path, event: &Event) {
        self.owners.handle(token, event);
    }

    /// Takes the hub's answer about a token.
    pub fn handle_token_info(&mut self, token: &Path, info: &Map) {
        self.owners.handle_info(token, info);
    }

    /// Takes an event of the model's own channel.
    pub fn handle_model(&mut self, event: &Event, now: Time, out: &mut Vec<Parcel>) {
        match event {
            Event::Message(parcel) if parcel.name() == QUERY => {
                let answer = self.answer_to(&parcel.value(), now);
                out.push(self.answer(parcel, answer, QUERY_REFUSED));
            }
            Event::Message(parcel) if parcel.name() == WRITE => {
                self.take_write(parcel, now, out);
            }
            Event::Joined(member) => {
                let mut snapshot = self.message(OBJECTS, self.snapshot(self.objects.iter(), now));
                snapshot.address = Some(vec![member.peer.as_str().into()]);
                out.push(snapshot);
            }
            // Without names of who joined, all are told.
            Event::Count(_) => out.push(self.message(OBJECTS, self.snapshot(self.objects.iter(), now))),
            event if event.is_gap() => {
                out.push(self.message(OBJECTS, self.snapshot(self.objects.iter(), now)));
            }
            Event::LinkDown => self.unlinked = true,
            Event::Rejoined | Event::Resumed => {
                self.unlinked = false;
                out.push(self.message(OBJECTS, self.snapshot(self.objects.iter(), now)));
            }
            _ => {}
        }
    }

    /// Asks the cameras that have said nothing for a while, and tells what is due.
    pub fn advance(&mut self, now: Time, out: &mut Vec<Parcel>) {
        if self.unlinked {
            return;
        }
        self.begun.get_or_insert(now);
        let since = |time: Option<Time>| time.map_or(i64::MAX, |time| now.micros() - time.micros());
        for (eye, channel) in self.eyes.iter_mut().zip(&self.options.cameras) {
            if since(eye.heard) < QUIET || since(eye.asked) < UNANSWERED {
                continue;
            }
            let mut request = Parcel::new(Family::Message, REQUEST).context(channel.clone());
            request.echo = Some(false);
            // One that has not answered may be gone, and another in its place.
            request.address = eye
                .asked
                .is_none()
                .then(|| eye.peer.clone().map(|peer| vec![peer]))
                .flatten();
            eye.asked = Some(now);
            out.push(request);
        }
        self.tell(now, out);
    }

    fn note_held(&mut self) {
        let names: Vec<String> = self.objects.iter().map(|object| object.name.clone()).collect();
        for name in names {
            if let Some(object) = self.objects.get_mut(&name) {
                object.held = self.holding.as_ref() == Some(&name);
            }
        }
    }

    /// Tells all what has changed: at once where something moved, and once each second that it was seen again.
    fn tell(&mut self, now: Time, out: &mut Vec<Parcel>) {
        let due = self
            .told_seen
            .is_none_or(|told| now.micros() - told.micros() >= SEEN_PERIOD || now < told);
        let mut changes = Vec::new();
        for object in self.objects.iter() {
            let after = object.to_map();
            let before = self.told.get(&object.name);
            let change = before.map_or_else(|| after.clone(), |before| difference(before, &after));
            let major = before.is_none() || change.keys().any(|key| !MINOR.contains(&key));
            if major || (due && change.len() > 1) {
                self.told.insert(object.name.clone(), after);
                changes.push(Value::from(change));
            }
        }
        let gone: Vec<String> = self
            .told
            .keys()
            .filter(|name| self.objects.get(name).is_none())
            .cloned()
            .collect();
        self.told.retain(|name, _| !gone.contains(name));
        if changes.is_empty() && gone.is_empty() {
            return;
        }
        if due {
            self.told_seen = Some(now);
        }
        self.seq += 1;
        let gone: Vec<Value> = gone.into_iter().map(Value::from).collect();
        let content = Map::new()
            .with("seq", self.seq)
            .with("objects", changes)
            .with("gone", gone);
        out.push(self.message(CHANGED, content));
    }

    /// The answer to a question for objects.
    fn answer_to(&self, query: &Value, now: Time) -> Result<Map, WireError> {
        let bad = |text: &str| WireError::new(Code::BAD_CONTENT, text);
        let name = match query.get("name") {
            Some(name) => Some(
                name.as_str()
                    .ok_or_else(|| bad("name is an object's name").slot("content/name"))?,
            ),
            None => None,
        };
        if name.is_some_and(|name| name.len() > LONGEST_NAME) {
            let text = format!("an object's name must not exceed {LONGEST_NAME} bytes");
            return Err(bad(&text).slot("content/name"));
        }
        let oldest = match query.get("max-age") {
            Some(age) => {
                let age = as_number(age).filter(|age| *age >= 0.0);
                Some(age.ok_or_else(|| bad("max-age is a number of ms").slot("content/max-age"))?)
            }
            None => None,
        };
        let near = match query.get("near") {
            Some(place) => {
                Some(place_of(place).ok_or_else(|| bad("near is [x, y] in mm").slot("content/near"))?)
            }
            None => None,
        };
        let is_fresh = |object: &Object| {
            oldest.is_none_or(|oldest| object.age_at(now).is_some_and(|age| age as f64 <= oldest))
        };
        let mut found: Vec<&Object> = match name {
            Some(name) => vec![self.named(name, now)?],
            None => self.objects.iter().filter(|object| is_fresh(object)).collect(),
        };
        if let Some(old) = found.iter().find(|object| !is_fresh(object)) {
            let error = WireError::new(Code::EXPIRED, self.objects.too_old(old, now));
            return Err(error.detail("age", old.age_at(now).unwrap_or_default()));
        }
        if let Some([x, y]) = near {
            let distance = |object: &Object| (object.x - x).hypot(object.y - y);
            found.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        }
        Ok(self.snapshot(found, now))
    }

    fn named(&self, name: &str, now: Time) -> Result<&Object, WireError> {
        self.objects.get(name).ok_or_else(|| {
            let error =
                WireError::new(Code::BAD_CONTENT, self.objects.no_such(name, now)).slot("content/name");
            match self.objects.meant(name) {
                Some(meant) => error
                    .detail("nearest", meant.name.as_str())
                    .detail("age", meant.age_at(now).unwrap_or_default()),
                None => error,
            }
        })
    }

    fn snapshot<'a>(&self, objects: impl IntoIterator<Item = &'a Object>, now: Time) -> Map {
        let told = |object: &Object| {
            let aged = Object {
                age: object.age_at(now),
                ..object.clone()
            };
            Value::from(aged.to_map())
        };
        let objects: Vec<Value> = objects.into_iter().map(told).collect();
        Map::new().with("seq", self.seq).with("objects", objects)
    }

    /// A message to the sender of `to`.
    fn answer(&self, to: &Parcel, content: Result<Map, WireError>, refused: &str) -> Parcel {
        let asker = to.sender.clone().unwrap_or_default();
        let (name, content) = match content {
            Ok(content) => (OBJECTS, content),
            Err(error) => (refused, error.to_map()),
        };
        let mut parcel = self.message(name, content.with("by", &*asker));
        parcel.address = Some(vec![asker]);
        parcel.reference = to.id;
        parcel
    }

    /// A message to all but ourselves.
    fn message(&self, name: &str, content: Map) -> Parcel {
        let mut parcel = Parcel::new(Family::Message, name)
            .context(self.options.channel.clone())
            .content(content);
        parcel.delivery = Some(Delivery::Reliable);
        parcel.echo = Some(false);
        parcel
    }
}

/// Two numbers of mm.
fn place_of(value: &Value) -> Option<[f64; 2]> {
    let list = value.as_list()?;
    let numbers: Vec<f64> = list.iter().filter_map(as_number).collect();
    (list.len() == 2).then(|| numbers.try_into().ok()).flatten()
}
