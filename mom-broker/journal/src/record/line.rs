//! The lines of a recording: its head, inputs with their decisions, its end.

use mom_hub::{Holder, Hub, Input, PeerClock, Record, Settings, StopRow, Ticket, User};
use mom_proto::{ClockOffset, Content, ContextNumber, Family, Limits, Parcel, Path, Time, Verb};
use serde::{Deserialize, Serialize};

use super::Outcome;
use super::value::Recorded;
use crate::ConfigFile;

/// The form of recordings that this program writes and reads.
pub(super) const VERSION: u32 = 2;

/// One line of a recording.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum RecordedLine {
    /// The first.
    Head(Box<RecordingHead>),
    /// One input of the hub.
    Step(Box<RecordedStep>),
    /// The last line of a recording that was ended early, with the reason.
    End(String),
}

/// What a replay needs before the first input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) struct RecordingHead {
    /// The form of the lines.
    pub(super) form: u32,
    /// The broker's version.
    pub(super) version: String,
    /// Wall time at monotonic time 0.
    pub(super) anchor: Time,
    /// The upper part of fences.
    pub(super) epoch: u64,
    /// The configuration's file, without folders.
    #[serde(default)]
    pub(super) config: Option<String>,
    /// The SHA-256 of its text.
    #[serde(default)]
    pub(super) hash: Option<String>,
    /// Whether changes of ownership waited until they were durable.
    pub(super) durable: bool,
    /// What was durable before the start.
    #[serde(default)]
    pub(super) records: Vec<OldRecord>,
    /// Whether stops were kept.
    #[serde(default)]
    pub(super) keeps_stops: bool,
    /// What was stopped before the start, and whether that could not be read.
    #[serde(default)]
    pub(super) stops: Vec<StopRow>,
    #[serde(default)]
    pub(super) stops_unread: bool,
    /// The limits, for readers of the file; a replay uses those of its own configuration.
    pub(super) limits: Limits,
}

/// The stored record of a token.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) struct OldRecord {
    path: String,
    fence: u64,
    owner: Option<(String, String)>,
    before: Option<(String, String)>,
    lease: Option<u64>,
}

/// An input and its decision.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) struct RecordedStep {
    /// Monotonic µs.
    pub(super) now: u64,
    /// The input.
    pub(super) input: Told,
    /// The decision.
    pub(super) decided: Vec<Outcome>,
    /// The hub's next deadline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) deadline: Option<u64>,
}

/// An input as recorded: without secrets and without the content of messages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Told {
    Login(LoginTold),
    Gone(u64),
    /// With how many µs it has to come back.
    Lost(u64, u64),
    Resumed(u64),
    Request(Box<RequestTold>),
    Stored(u64, bool),
    /// The configuration was changed: its file's name and the SHA-256 of its text, as far as known.
    Configure(Option<String>, Option<String>),
    Tick,
    /// The wall clock was set: by how many µs it is ahead from now on.
    Wall(i64),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) struct LoginTold {
    pub(super) peer: u64,
    pub(super) user: String,
    pub(super) level: i32,
    pub(super) groups: Vec<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) nickname: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) id: Option<u64>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) struct RequestTold {
    pub(super) peer: u64,
    pub(super) family: String,
    pub(super) name: String,
    /// The context; a number that the peer used is recorded as its path.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) context: Option<String>,
    /// A number of no context.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) number: Option<u64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) id: Option<u64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) address: Option<Vec<String>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) fence: Option<u64>,
    /// Of a message: when it was created by its sender's clock, µs since the epoch, and for how long it is worth anything.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) timestamp: Option<i64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) expires: Option<u64>,
    /// The estimate of that clock: offset and error in µs, and how far ahead a stamp may be.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) clock: Option<(i64, u64, u64)>,
    /// The size of content that is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) size: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) content: Option<Recorded>,
}

impl RecordingHead {
    pub(super) fn new(settings: &Settings, config: &ConfigFile) -> RecordingHead {
        RecordingHead {
            form: VERSION,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            anchor: settings.anchor,
            epoch: settings.epoch,
            config: config.name.clone(),
            hash: config.sha256.clone(),
            durable: settings.durable,
            records: settings.records.iter().map(OldRecord::new).collect(),
            keeps_stops: settings.keeps_stops,
            stops: settings.stops.iter().map(StopRow::from).collect(),
            stops_unread: settings.stops_unread,
            limits: settings.limits.clone(),
        }
    }

    /// The settings of a hub that replays what was recorded, with these limits.
    pub(super) fn settings(&self, limits: Limits) -> Result<Settings, String> {
        let records = self.records.iter().map(OldRecord::record);
        Ok(Settings {
            anchor: self.anchor,
            epoch: self.epoch,
            durable: self.durable,
            records: records.collect::<Result<_, _>>()?,
            keeps_stops: self.keeps_stops,
            stops: self
                .stops
                .iter()
                .cloned()
                .map(StopRow::record)
                .collect::<Result<_, _>>()?,
            stops_unread: self.stops_unread,
            limits,
            ..Settings::default()
        })
    }
}

impl OldRecord {
    fn new(record: &Record) -> OldRecord {
        let holder = |holder: &Holder| (holder.user.clone(), holder.name.clone());
        OldRecord {
            path: record.path.to_string(),
            fence: record.fence,
            owner: record.owner.as_ref().map(holder),
            before: record.before.as_ref().map(holder),
            lease: record.lease,
        }
    }

    fn record(&self) -> Result<Record, String> {
        let holder = |holder: &(String, String)| Holder {
            user: holder.0.clone(),
            name: holder.1.clone(),
        };
        Ok(Record {
            path: path(&self.path)?,
            fence: self.fence,
            owner: self.owner.as_ref().map(holder),
            before: self.before.as_ref().map(holder),
            lease: self.lease,
        })
    }
}

impl Told {
    /// The recorded form of an input; `hub` is in the state before it.
    pub(super) fn of(input: &Input, hub: &Hub) -> Told {
        match input {
            Input::Login {
                peer,
                user,
                nickname,
                id,
            } => Told::Login(LoginTold {
                peer: peer.0,
                user: user.name.clone(),
                level: user.level,
                groups: user.groups.clone(),
                nickname: nickname.clone(),
                id: *id,
            }),
            Input::Gone { peer } => Told::Gone(peer.0),
            Input::Lost { peer, grace } => Told::Lost(peer.0, *grace),
            Input::Resumed { peer } => Told::Resumed(peer.0),
            Input::Request { peer, parcel, clock } => {
                Told::Request(Box::new(RequestTold::of(peer.0, parcel, *clock, hub)))
            }
            Input::Stored {
                ticket: Ticket(ticket),
                ok,
            } => Told::Stored(*ticket, *ok),
            Input::Configure(_) => Told::Configure(None, None),
            Input::Tick => Told::Tick,
            Input::Wall { ahead } => Told::Wall(*ahead),
        }
    }

    /// The peer that it comes from.
    pub(super) fn peer(&self) -> Option<u64> {
        match self {
            Told::Login(login) => Some(login.peer),
            Told::Gone(peer) | Told::Lost(peer, _) | Told::Resumed(peer) => Some(*peer),
            Told::Request(request) => Some(request.peer),
            Told::Stored(..) | Told::Configure(..) | Told::Tick | Told::Wall(_) => None,
        }
    }
}

impl LoginTold {
    /// The user as it was then.
    pub(super) fn user(&self) -> User {
        User {
            name: self.user.clone(),
            level: self.level,
            groups: self.groups.clone(),
            details: mom_proto::Map::new(),
        }
    }
}

impl RequestTold {
    fn of(peer: u64, parcel: &Parcel, clock: Option<PeerClock>, hub: &Hub) -> RequestTold {
        // The path first, as the hub does.
        let named = || hub.path(parcel.number?);
        let context = parcel.context.as_ref().or_else(named).map(Path::to_string);
        let content = parcel.content.as_ref();
        // A replay needs the content of requests for control only; anything else is private.
        let control = matches!(parcel.family, Family::Context | Family::Token | Family::Manager)
            // A whole configuration, at which the hub does not look.
            && !parcel.is(Family::Context, Verb::WhatIf.word());
        let message = parcel.family == Family::Message;
        let address = parcel.address.as_ref();
        RequestTold {
            peer,
            family: parcel.family.word().to_owned(),
            name: parcel.name().to_owned(),
            number: parcel
                .number
                .filter(|_| context.is_none())
                .map(|ContextNumber(number)| number),
            context,
            id: parcel.id,
            address: address.map(|names| names.iter().map(|name| name.to_string()).collect()),
            fence: parcel.fence,
            timestamp: parcel.timestamp.filter(|_| message).map(Time::micros),
            expires: parcel.expires.filter(|_| message),
            clock: clock
                .filter(|_| message)
                .map(|clock| (clock.offset.micros, clock.offset.error, clock.future)),
            size: content.filter(|_| !control).map(Content::size),
            content: content.filter(|_| control).cloned().map(Recorded),
        }
    }

    /// The estimate of the sender's clock.
    pub(super) fn peer_clock(&self) -> Option<PeerClock> {
        self.clock.map(|(micros, error, future)| PeerClock {
            offset: ClockOffset { micros, error },
            future,
        })
    }
}

/// A path of a recording.
pub(super) fn path(text: &str) -> Result<Path, String> {
    Path::parse(text).map_err(|error| format!("{text:?} is not a path: {}", error.text))
}
