//! The simulacrum in a channel (S3): a message for each element, by its name, whenever it is something else; the hub keeps the newest of
//! each for those who join later.

use std::collections::BTreeMap;
use std::time::Duration;

use mom_client::{Delivery, Family, Map, Parcel, Path, Value};
use mom_rsp::Kind;
use mom_rsp_model::ModelElement;
use tokio::time::Instant;

use crate::Simulacrum;
use crate::link::Traffic;
use crate::values::from_wire;

/// The message that tells of packets: sizes, rates, losses, the clock, and the bits that travelled last.
pub const PACKET: &str = "packet";
/// An element is told of at most so often, unless it is activated or deactivated.
const PERIOD: Duration = Duration::from_millis(100);
/// So often packets are told of.
const PACKETS: Duration = Duration::from_millis(500);
/// Bytes of UDP and IPv4 around each packet.
const AROUND: u64 = 28;

/// Tells of one robot.
#[derive(Debug)]
pub struct Teller {
    channel: Path,
    told: BTreeMap<u8, (Map, Instant)>,
    packets: Option<(Traffic, Instant)>,
    events: BTreeMap<u8, i64>,
}

impl Teller {
    /// One that tells in this channel.
    #[must_use]
    pub fn new(channel: Path) -> Self {
        Self {
            channel,
            told: BTreeMap::new(),
            packets: None,
            events: BTreeMap::new(),
        }
    }

    /// An event was heard: how often is part of its element's message.
    pub fn raised(&mut self, element: u8) {
        *self.events.entry(element).or_default() += 1;
    }

    /// What is to be told now. `sent` is the time of a value that is so old.
    pub fn tell(
        &mut self,
        robot: &Simulacrum,
        sent: impl Fn(Duration) -> Option<mom_client::Time>,
        now: Instant,
    ) -> Vec<Parcel> {
        let mut out = Vec::new();
        let up = robot.is_up();
        for (place, element) in (0..).zip(robot.model().elements()) {
            let (mut content, known) = self.content(robot, place, element, up);
            if let Some((told, at)) = self.told.get(&place) {
                let switched = ["activated", "active", "linked", "events"]
                    .iter()
                    .any(|key| told.get(key) != content.get(key));
                if *told == content || (!switched && now < *at + PERIOD) {
                    continue;
                }
            }
            self.told.insert(place, (content.clone(), now));
            if let Some(since) = known.since {
                content.set("since", i64::try_from(since.as_micros()).unwrap_or(i64::MAX));
            }
            let mut parcel = self.parcel(&element.name, content);
            parcel.timestamp = known.age.and_then(&sent);
            out.push(parcel);
        }
        if self.packets.as_ref().is_none_or(|(_, at)| now >= *at + PACKETS) {
            out.push(self.packet(robot, now));
        }
        out
    }

    fn parcel(&self, name: &str, content: Map) -> Parcel {
        let mut parcel = Parcel::new(Family::Message, name)
            .context(self.channel.clone())
            .content(content);
        (parcel.delivery, parcel.echo) = (Some(Delivery::Latest), Some(false));
        parcel
    }

    /// `{place, kind, wanted?, value?, unit?, activated, active, linked, events?, error?}`: what is wanted beside what
    /// is confirmed or heard, in the units of the model, and µs by which the robot's clock may be wrong.
    fn content(&self, robot: &Simulacrum, place: u8, element: &ModelElement, up: bool) -> (Map, Age) {
        let mut map = Map::new()
            .with("place", i64::from(place))
            .with("kind", kind_word(element.kind));
        let now = robot.now();
        let mut known = Age::default();
        robot.with(|middle| {
            map.set("activated", middle.activated(place));
            map.set("active", up && middle.active(place));
            if let Some(wanted) = middle.wanted(place) {
                set_values(&mut map, "wanted", from_wire(element, wanted));
            }
            let reading = middle.read(place).or_else(|| middle.confirmed(place));
            if let Some(reading) = reading {
                set_values(&mut map, "value", from_wire(element, reading.value));
                known.since = Some(Duration::from_micros(now.saturating_sub(reading.at)));
                // The packets of a robot say nothing of what is not active: its value grows old.
                let is_told = element.kind == Kind::Effector || middle.active(place);
                known.age = middle
                    .heard_at()
                    .map(|at| if is_told { at.max(reading.at) } else { reading.at })
                    .map(|at| Duration::from_micros(now.saturating_sub(at)));
            }
        });
        let units: Vec<Value> = element
            .quantities
            .iter()
            .map(|quantity| Value::from(quantity.unit.as_str()))
            .collect();
        if units.iter().any(|unit| unit.as_str() != Some("")) {
            map.set("unit", units);
        }
        if let Some(events) = self.events.get(&place) {
            map.set("events", *events);
        }
        map.set("linked", up);
        (map, known)
    }

    /// `{linked, period, confirmed, heard?, loss, round-trip?, offset?, error?, sent, received, down-rate, up-rate,
    /// down, up, down-map, up-map, free-buffers, accepted, dropped}`: ms, whether the robot has confirmed that, µs
    /// since it was heard, the share of its packets that is lost, µs (three times), packets (twice), bytes/s with UDP
    /// and IP (twice), the first bytes of the newest packets in hexadecimal (twice), the bits of device maps that were
    /// 1 since this was told last, as they were before they were sealed (twice), and how many datagrams were taken and
    /// dropped, by reason.
    fn packet(&mut self, robot: &Simulacrum, now: Instant) -> Parcel {
        let traffic = robot.take_traffic();
        let int = |value: u64| i64::try_from(value).unwrap_or(i64::MAX);
        let mut map = Map::new().with("linked", robot.is_up());
        robot.with(|middle| {
            map.set("period", i64::from(middle.period()));
            map.set("loss", thousandths(middle.loss()));
            map.set("confirmed", middle.is_confirmed());
            map.set("free-buffers", i64::from(middle.free_buffers()));
            if let Some(micros) = middle.round_trip() {
                map.set("round-trip", int(micros));
            }
        });
        if let Some(clock) = robot.clock() {
            map.set("offset", clock.offset);
            map.set("error", int(clock.error));
        }
        map.set("sent", int(traffic.sent.0));
        map.set("received", int(traffic.received.0));
        if let Some((before, at)) = &self.packets {
            let seconds = now.duration_since(*at).as_secs_f64().max(0.001);
            let rate = |new: (u64, u64), old: (u64, u64)| {
                let bytes = new.1.saturating_sub(old.1) + AROUND * new.0.saturating_sub(old.0);
                int((bytes as f64 / seconds).round() as u64)
            };
            map.set("down-rate", rate(traffic.sent, before.sent));
            map.set("up-rate", rate(traffic.received, before.received));
        }
        let [down, up] = &traffic.lit;
        map.set("down-map", hexadecimal(down));
        map.set("up-map", hexadecimal(up));
        if let Some(age) = robot.age() {
            map.set("heard", int(u64::try_from(age.as_micros()).unwrap_or(u64::MAX)));
        }
        map.set("down", hexadecimal(&traffic.down));
        map.set("up", hexadecimal(&traffic.up));
        let counters = robot.counters();
        map.set("accepted", i64::from(counters.accepted()));
        let dropped = counters.iter().filter(|(_, times)| *times > 0);
        let dropped = dropped.fold(Map::new(), |map, (why, times)| {
            map.with(&why.to_string(), i64::from(times))
        });
        map.set("dropped", dropped);
        self.packets = Some((traffic, now));
        self.parcel(PACKET, map)
    }
}

/// How old a value is, and since when it is this one.
#[derive(Debug, Default)]
struct Age {
    age: Option<Duration>,
    since: Option<Duration>,
}

fn set_values(map: &mut Map, key: &str, values: Vec<f64>) {
    if !values.is_empty() {
        map.set(key, values.into_iter().map(Value::Double).collect::<Vec<_>>());
    }
}

/// A share, to three places.
pub(crate) fn thousandths(share: f32) -> Value {
    Value::Double(f64::from((share * 1000.0).round()) / 1000.0)
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// What a kind is called in a model's file.
fn kind_word(kind: Kind) -> &'static str {
    match kind {
        Kind::Effector => "effector",
        Kind::Sensor => "sensor",
        Kind::Monitor => "monitor",
        Kind::Command => "command",
        Kind::Module => "module",
        Kind::Event => "event",
        Kind::MemoryCommand => "memory-command",
        Kind::MemoryEvent => "memory-event",
    }
}
