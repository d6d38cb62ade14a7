//! A program that calls one element over and over, at the middle or at the robot, and who watches what passes.

use fastrand::Rng;
use mom_rsp::middle::{Middle, Notice, State};
use mom_rsp::robot::Body;
use mom_rsp::{Direction, Header, Item, Items, Type};

use super::super::probe::{COMMAND, MEMORY_COMMAND, MEMORY_EVENT, PROBE};
use super::super::world::{End, Scene};
use super::super::{MS, SECOND};

/// After so long without an acknowledgement a memory event in paper mode counts as failed, and is asked for.
const PATIENCE: u64 = SECOND;

/// One call, or one event.
#[derive(Clone, Debug, Default)]
pub(super) struct Call {
    at: u64,
    /// µs until its acknowledgement was heard, without help.
    pub(super) took: Option<u64>,
    /// It was given up, or had to be asked for.
    pub(super) failed: bool,
    /// How often it was carried out, and how often before anybody asked.
    pub(super) executed: usize,
    pub(super) executed_by_itself: usize,
}

/// A datagram on its way.
#[derive(Clone, Debug)]
pub(super) struct Arrow {
    pub(super) down: bool,
    pub(super) sent: u64,
    pub(super) lost: bool,
    pub(super) arrived: Option<u64>,
    /// What it has for the element; empty for nothing.
    pub(super) label: String,
}

/// What one datagram has for the element.
struct Passing {
    label: String,
    /// In map and payload.
    bytes: usize,
    /// The id that it acknowledges.
    ack: Option<u8>,
}

/// What passed, times in µs since the call.
#[derive(Clone, Debug, Default)]
pub(super) struct Told {
    pub(super) arrows: Vec<Arrow>,
    pub(super) executed: Vec<u64>,
    /// The end of the call, and what it was.
    pub(super) over: Option<(u64, &'static str)>,
}

pub(super) struct Caller {
    random: Rng,
    element: u8,
    ids: usize,
    paper: bool,
    /// The time of the packet that the robot takes.
    now: u64,
    calls: Vec<Call>,
    /// When the next call is due; none while one is under way.
    next: Option<u64>,
    asked: Option<u64>,
    is_up: bool,
    /// Bytes of map and payload for the element.
    pub(super) bytes: usize,
    /// Packets with a call, and with an acknowledgement, that are still to be lost.
    to_lose: [bool; 2],
    told: Told,
    is_watched: bool,
}

impl Caller {
    pub(super) fn new(element: u8, ids: usize, paper: bool, seed: u64) -> Caller {
        Caller {
            random: Rng::with_seed(seed),
            element,
            ids,
            paper,
            now: 0,
            calls: Vec::new(),
            next: None,
            asked: None,
            is_up: false,
            bytes: 0,
            to_lose: [false; 2],
            told: Told::default(),
            is_watched: false,
        }
    }

    /// The first packet with the call and the first with its acknowledgement are lost, and all is watched.
    pub(super) fn script(&mut self) {
        self.to_lose = [true; 2];
        self.is_watched = true;
    }

    pub(super) fn is_done(&self) -> bool {
        self.calls.len() == self.ids && self.next.is_some()
    }

    pub(super) fn calls(&self) -> &[Call] {
        &self.calls
    }

    /// What passed, from the first call on.
    pub(super) fn told(self) -> Told {
        let begin = self.calls.first().map_or(0, |call| call.at);
        let mut told = self.told;
        told.arrows.retain(|arrow| arrow.sent >= begin);
        for arrow in &mut told.arrows {
            arrow.sent -= begin;
            arrow.arrived = arrow.arrived.map(|at| at - begin);
        }
        told
    }

    fn is_of_middle(&self) -> bool {
        matches!(self.element, COMMAND | MEMORY_COMMAND)
    }

    /// Whether the next call is due; it begins then.
    fn begins(&mut self, now: u64) -> Option<[u8; 2]> {
        let is_due = self.is_up && self.calls.len() < self.ids && self.next.is_some_and(|next| next <= now);
        if !is_due {
            return None;
        }
        self.next = None;
        self.calls.push(Call {
            at: now,
            ..Call::default()
        });
        Some((self.calls.len() as u16 - 1).to_be_bytes())
    }

    /// The call under way is over: acknowledged, or not.
    fn over(&mut self, now: u64, success: bool) {
        if self.next.is_some() {
            return;
        }
        let pause = self.random.u64(1..40 * MS);
        let is_asked = self.asked.take().is_some();
        self.next = Some(now + pause);
        if let Some(call) = self.calls.last_mut() {
            call.failed = is_asked || !success;
            call.took = (!call.failed).then(|| now - call.at);
            let word = if success { "acknowledged" } else { "Failed" };
            self.told.over = self.told.over.or(Some((now - call.at, word)));
        }
    }

    /// It is carried out, or delivered.
    fn executed(&mut self, now: u64, data: &[u8]) {
        let is_asked = self.asked.is_some();
        let number = data.try_into().map(u16::from_be_bytes).map(usize::from);
        if let Some(call) = number.ok().and_then(|number| self.calls.get_mut(number)) {
            call.executed += 1;
            call.executed_by_itself += usize::from(!is_asked);
            self.told.executed.push(now - call.at);
        }
    }

    /// The id of the call under way: ids go from 1 to 255, and on with 1.
    fn id(&self) -> u8 {
        (self.calls.len().saturating_sub(1) % 255) as u8 + 1
    }

    /// What a datagram has for the element.
    fn item(&self, direction: Direction, datagram: &[u8]) -> Option<Passing> {
        let header = Header::decode(datagram).ok()?;
        if !matches!(header.kind, Type::Data | Type::UpData) {
            return None;
        }
        let mut items = Items::parse(&PROBE, direction, datagram.get(Header::LEN..)?).ok()?;
        let (_, item) = items.find(|(element, _)| *element == self.element)?;
        let length = if self.element == MEMORY_EVENT { 2 } else { 0 };
        Some(match item {
            Item::Call { id, data } => Passing {
                label: format!("call {id}"),
                bytes: 1 + length + data.len(),
                ack: None,
            },
            Item::Ack(0) => Passing {
                label: "held?".to_owned(),
                bytes: 1,
                ack: None,
            },
            Item::Ack(id) => Passing {
                label: format!("ACK {id}"),
                bytes: 1,
                ack: Some(id),
            },
            _ => return None,
        })
    }

    fn leaves(&mut self, now: u64, direction: Direction, datagram: &[u8]) -> bool {
        let item = self.item(direction, datagram);
        let is_ack = item.as_ref().is_some_and(|item| item.ack.is_some());
        self.bytes += item.as_ref().map_or(0, |item| item.bytes);
        let [call, ack] = &mut self.to_lose;
        let lost = item.is_some() && std::mem::take(if is_ack { ack } else { call });
        if self.is_watched {
            self.told.arrows.push(Arrow {
                down: direction == Direction::Down,
                sent: now,
                lost,
                arrived: None,
                label: item.map(|item| item.label).unwrap_or_default(),
            });
        }
        !lost
    }

    fn reaches(&mut self, now: u64, direction: Direction, datagram: &[u8]) {
        if self.is_watched {
            let down = direction == Direction::Down;
            let under_way = |arrow: &&mut Arrow| arrow.down == down && !arrow.lost && arrow.arrived.is_none();
            if let Some(arrow) = self.told.arrows.iter_mut().find(under_way) {
                arrow.arrived = Some(now);
            }
        }
        // A command's acknowledgement is told by the middle's end itself.
        let ack = self.item(direction, datagram).and_then(|item| item.ack);
        if !self.is_of_middle() && direction == Direction::Down && ack == Some(self.id()) {
            self.over(now, true);
        }
    }
}

impl Body for Caller {
    fn random(&mut self, bytes: &mut [u8]) {
        self.random.fill(bytes);
    }

    fn effector(&mut self, _: u8, _: &[u8]) {}

    fn command(&mut self, _: u8, data: &[u8]) {
        self.executed(self.now, data);
    }
}

impl Scene for Caller {
    fn at_middle(&mut self, now: u64, middle: &mut Middle<'_>) {
        if middle.state() == State::Up && !self.is_up {
            (self.is_up, self.next) = (true, Some(now + 200 * MS));
        }
        while let Some(notice) = middle.next_notice() {
            match notice {
                Notice::Done { .. } => self.over(now, true),
                Notice::Failed { .. } | Notice::Unknown { .. } => self.over(now, false),
                Notice::Raised { data, .. } => self.executed(now, &data),
                _ => {}
            }
        }
        if self.is_of_middle() {
            if let Some(data) = self.begins(now) {
                // One is under way at a time, so there is room.
                let _ = middle.command(self.element, &data);
            }
            return;
        }
        let since = self.asked.or(self.calls.last().map(|call| call.at));
        let is_overdue = self.next.is_none() && since.is_some_and(|since| now >= since + PATIENCE);
        if self.paper && is_overdue && middle.ask(self.element).is_ok() {
            self.asked = Some(now);
        }
    }

    fn at_robot(&mut self, now: u64, end: &mut impl End) {
        if !self.is_of_middle()
            && let Some(data) = self.begins(now)
        {
            // As above.
            let _ = end.raise(self.element, &data);
        }
    }

    fn leaves_middle(&mut self, now: u64, datagram: &[u8]) -> bool {
        self.leaves(now, Direction::Down, datagram)
    }

    fn leaves_robot(&mut self, now: u64, datagram: &[u8]) -> bool {
        self.leaves(now, Direction::Up, datagram)
    }

    fn reaches_robot(&mut self, now: u64, datagram: &[u8]) {
        self.now = now;
        self.reaches(now, Direction::Down, datagram);
    }

    fn reaches_middle(&mut self, now: u64, datagram: &[u8]) {
        self.reaches(now, Direction::Up, datagram);
    }

    fn wake(&self) -> Option<u64> {
        self.next.filter(|_| self.calls.len() < self.ids)
    }
}
