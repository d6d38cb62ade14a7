//! Stopping devices, and letting them go, as the hub's own requests: one for a channel or a whole session (M43).

use std::time::Duration;

use mom_proto::{Family, Map, Parcel, Path, STOP, Value};

use crate::error::bad_reply;
use crate::peer::shared::verb;
use crate::words::{map_of, millis, name_list, number, owned, text};
use crate::{Client, ClientError, StopState};

/// For how long the hub waits for the word of devices, unless the request says otherwise.
const WITHIN: Duration = Duration::from_secs(1);

/// A stop or unstop that is about to be asked for; from [`Client::stop`] and [`Client::unstop`].
///
/// ```no_run
/// # async fn example(client: mom_client::Client) -> Result<(), mom_client::ClientError> {
/// let report = client.stop("/robot").reason("smoke").send().await?;
/// for channel in &report.channels {
///     println!("{}: stop {}, {:?}", channel.path, channel.number, channel.devices);
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
#[must_use = "a stop does nothing until it is sent"]
pub struct Stopping {
    client: Client,
    verb: &'static str,
    path: String,
    content: Map,
    within: Duration,
}

/// What came of a stop or an unstop.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StopReport {
    /// The channels that have devices or a guard, and those that had devices and are not there; 1024 at most.
    pub channels: Vec<ToldChannel>,
    /// How many other channels were told.
    pub others: u64,
    /// Channels that this peer may see and not stop.
    pub denied: Vec<Path>,
}

/// One channel that was told.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ToldChannel {
    /// Which.
    pub path: Path,
    /// The number of the stop, or of the newest one that the unstop was to lift.
    pub number: u64,
    /// Whether a device is meant to be there: a token guards it, or one was there before.
    pub guarded: bool,
    /// Whether the hub knows of it after a restart.
    pub kept: bool,
    /// What each device said.
    pub devices: Vec<(String, DeviceAnswer)>,
    /// Newer stops, which hold on: the unstop did not lift them.
    pub newer: Vec<StopState>,
    /// Why the unstop was not handed out, or that the stop cannot be kept.
    pub error: Option<String>,
}

/// What a device said to a stop or an unstop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceAnswer {
    /// That it obeys, and how it stands.
    Obeys(Standing),
    /// Nothing in time.
    Silent,
    /// Its connection was lost; it finds the stop when it comes back.
    Lost,
}

/// How a device says that it stands that obeys a stop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Standing {
    /// How it knows that it rests; none if it does not know yet, or says nothing of it.
    pub rest: Option<Rest>,
    /// It moves still, or does not know that it does not.
    pub moving: bool,
    /// It cannot tell its mechanism what to do.
    pub unreached: bool,
    /// An emergency stop at the device itself is pressed: an `unstop` does not let it go.
    pub estop: bool,
}

/// How a device knows that it rests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rest {
    /// By measurements since it was stopped.
    Measured,
    /// It does not measure, and the time has passed in which it stops.
    NotMeasured,
}

impl Client {
    /// Stops all devices of a channel, or of all channels below a session in which this peer has the right `stop`. It joins
    /// nothing, goes before everything else, and is answered when each device has said that it obeys and rests, or after a second.
    pub fn stop(&self, path: &str) -> Stopping {
        self.stopping("stop", path, Map::new())
    }

    /// Lifts the stops of channels up to these numbers, which are the newest that its user has seen: those of
    /// [`StopState`]. A newer one holds on, and is named.
    pub fn unstop<'a>(&self, path: &str, stops: impl IntoIterator<Item = (&'a Path, u64)>) -> Stopping {
        let int = |number: u64| i64::try_from(number).unwrap_or(i64::MAX);
        let stops: Map = stops
            .into_iter()
            .map(|(path, number)| (path.to_string(), Value::Int(int(number))))
            .collect();
        let own = stops.get(path).cloned();
        let content = match own.filter(|_| stops.iter().len() == 1) {
            Some(number) => Map::new().with(STOP, number),
            None => Map::new().with("stops", stops),
        };
        self.stopping("unstop", path, content)
    }

    /// How the devices of a channel stand by the hub's books.
    ///
    /// # Errors
    /// As [`Client::info`].
    pub async fn stops(&self, channel: &str) -> Result<StopState, ClientError> {
        Ok(StopState::from_reply(&self.info(channel).await?))
    }

    fn stopping(&self, verb: &'static str, path: &str, content: Map) -> Stopping {
        Stopping {
            client: self.clone(),
            verb,
            path: path.to_owned(),
            content,
            within: WITHIN,
        }
    }
}

impl Stopping {
    /// The reason, for those who find the devices stopped.
    pub fn reason(mut self, reason: &str) -> Stopping {
        self.content.set("reason", reason);
        self
    }

    /// Only these devices of the channel.
    pub fn only<'a>(mut self, devices: impl IntoIterator<Item = &'a str>) -> Stopping {
        let devices: Vec<Value> = devices.into_iter().map(Value::from).collect();
        self.content.set("only", devices);
        self
    }

    /// Waits so long for the devices' word, at most 10 s; 0 for not at all.
    pub fn within(mut self, within: Duration) -> Stopping {
        self.within = within;
        self
    }

    /// Sends it, and waits for the answer.
    ///
    /// # Errors
    /// `Refused` with `denied`, `unknown-path`, `wrong-kind` (a token), `bad-content` and others; a lost link, a time-out.
    pub async fn send(self) -> Result<StopReport, ClientError> {
        let mut parcel = verb(Family::Context, self.verb, &Path::parse(&self.path)?);
        parcel.content = Some(self.content.with("within", millis(self.within)).into());
        StopReport::from_reply(&self.client.request(parcel).await?)
    }
}

impl StopReport {
    fn from_reply(reply: &Parcel) -> Result<StopReport, ClientError> {
        let map = map_of(reply);
        let channels = map.get("channels").and_then(Value::as_list);
        let channels = channels.ok_or_else(|| bad_reply("channels"))?;
        let read = |channel: &Value| channel.as_map().and_then(ToldChannel::from_map);
        Ok(StopReport {
            channels: channels
                .iter()
                .map(|channel| read(channel).ok_or_else(|| bad_reply("proper channels")))
                .collect::<Result<_, _>>()?,
            others: number(&map, "others").unwrap_or_default(),
            denied: name_list(&map, "denied")
                .iter()
                .filter_map(|path| Path::parse(path).ok())
                .collect(),
        })
    }
}

impl Standing {
    fn from_map(map: &Map) -> Standing {
        Standing {
            rest: match text(map, "rest") {
                Some("measured") => Some(Rest::Measured),
                Some("not-measured") => Some(Rest::NotMeasured),
                _ => None,
            },
            moving: map.get("moving").and_then(Value::as_bool) == Some(true),
            unreached: map.get("reached").and_then(Value::as_bool) == Some(false),
            estop: map.get("estop").and_then(Value::as_bool) == Some(true),
        }
    }
}

impl ToldChannel {
    fn from_map(map: &Map) -> Option<ToldChannel> {
        let list = |key: &str| map.get(key).and_then(Value::as_list).unwrap_or_default();
        let flag = |key: &str| map.get(key).and_then(Value::as_bool) == Some(true);
        let device = |device: &Value| {
            let map = device.as_map()?;
            let answer = match text(map, "word")? {
                "silent" => DeviceAnswer::Silent,
                "lost" => DeviceAnswer::Lost,
                _ => DeviceAnswer::Obeys(Standing::from_map(map)),
            };
            Some((owned(map, "peer")?, answer))
        };
        let newer = list("newer").iter().filter_map(Value::as_map).map(|map| {
            let mut state = StopState::from_map(map);
            state.stopped = true;
            state.only.extend(owned(map, "device"));
            state
        });
        Some(ToldChannel {
            path: Path::parse(text(map, "path")?).ok()?,
            number: number(map, "number")?,
            guarded: flag("guard"),
            kept: flag("kept"),
            devices: list("devices").iter().map(device).collect::<Option<_>>()?,
            newer: newer.collect(),
            error: owned(map, "error"),
        })
    }

    /// Whether every device has obeyed and none still moves; a guarded channel has one at least.
    pub fn is_obeyed(&self) -> bool {
        let obeys = self
            .devices
            .iter()
            .all(|(_, answer)| matches!(answer, DeviceAnswer::Obeys(standing) if !standing.moving && !standing.unreached));
        obeys && !(self.guarded && self.devices.is_empty()) && self.newer.is_empty() && self.error.is_none()
    }
}
