//! Messages over the network: datagrams in fragments, and connections.

use std::collections::{BTreeMap, BTreeSet};

use crate::medium::{Finished, Frame, Medium};
use crate::messages::Messages;
use crate::stream::{Part, Segment, Stream};
use crate::{
    Counts, Fate, MessageId, Micros, Outcome, Position, Reason, SendError, Settings, Station, Transport,
};

/// Octets of IP, UDP and TCP before what they carry.
const IP: u32 = 20;
const UDP: u32 = 8;
const TCP: u32 = 20;
/// The most that a datagram carries, and a message over TCP.
const LONGEST_DATAGRAM: u32 = 65_507;
const LONGEST_MESSAGE: u32 = 16 << 20;

/// Sender and receiver of one direction of a connection.
type Way = (Station, Station);

/// What a frame carries.
#[derive(Clone, Debug)]
enum Load {
    Fragment(MessageId),
    /// Of a connection: it carries a segment, or none, and acknowledges what came the other way.
    Segment {
        way: Way,
        /// Which one of the connections that there were between the two.
        connection: u64,
        segment: Option<Segment>,
        before: u64,
    },
}

/// What is to be done when the time of a way's timer has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Timer {
    Repeat,
    Acknowledge,
}

#[derive(Debug)]
struct Connected {
    connection: u64,
    stream: Stream,
    /// The timers that are set for it.
    set: [Option<Micros>; 2],
}

/// The network, its stations and what is under way.
#[derive(Debug)]
pub struct Radio {
    settings: Settings,
    now: Micros,
    medium: Medium,
    messages: Messages,
    loads: BTreeMap<u64, Load>,
    next_load: u64,
    ways: BTreeMap<Way, Connected>,
    connections: u64,
    timers: BTreeSet<(Micros, Way, Timer)>,
    repeated: u64,
    pure_acks: u64,
}

impl Radio {
    /// A network without stations, at time 0.
    #[must_use]
    pub fn new(settings: Settings) -> Radio {
        Radio {
            medium: Medium::new(settings.clone()),
            settings,
            now: 0,
            messages: Messages::default(),
            loads: BTreeMap::new(),
            next_load: 0,
            ways: BTreeMap::new(),
            connections: 0,
            timers: BTreeSet::new(),
            repeated: 0,
            pure_acks: 0,
        }
    }

    /// Adds a station.
    pub fn add(&mut self, position: Position) -> Station {
        self.medium.add(position)
    }

    /// Says where a station is from now on; nothing, if there is no such station.
    pub fn place(&mut self, station: Station, position: Position) {
        self.medium.place(station, position);
    }

    /// Whether anybody receives what a station sends, and it what others do. At first it is so.
    pub fn set_in_reach(&mut self, station: Station, in_reach: bool) {
        self.medium.set_in_reach(station, in_reach);
    }

    /// The settings.
    #[must_use]
    pub const fn settings(&self) -> &Settings {
        &self.settings
    }

    /// What happened so far.
    #[must_use]
    pub const fn counts(&self) -> Counts {
        Counts {
            repeated: self.repeated,
            pure_acks: self.pure_acks,
            ..self.medium.counts
        }
    }

    /// How many messages are under way.
    #[must_use]
    pub fn under_way(&self) -> usize {
        self.messages.undecided()
    }

    /// Sends a message of so many octets.
    ///
    /// # Errors
    ///
    /// It is not sent, and why.
    pub fn send(
        &mut self,
        now: Micros,
        from: Station,
        to: Station,
        octets: u32,
        transport: Transport,
    ) -> Result<MessageId, SendError> {
        if let Some(station) = [from, to]
            .into_iter()
            .find(|station| !self.medium.knows(*station))
        {
            return Err(SendError::NoStation(station));
        }
        if from == to {
            return Err(SendError::ToItself(from));
        }
        if now < self.now {
            let past = self.now;
            return Err(SendError::Past { now, past });
        }
        let longest = match transport {
            Transport::Datagram => LONGEST_DATAGRAM,
            Transport::Tcp => LONGEST_MESSAGE,
        };
        if octets > longest {
            return Err(SendError::TooLong(octets));
        }
        self.pass(now);
        Ok(match transport {
            Transport::Datagram => self.send_datagram(now, (from, to), octets),
            Transport::Tcp => self.send_segments(now, (from, to), octets),
        })
    }

    /// Forgets the connection between two stations, both ways. What was under way is lost; frames that are on the air do no more.
    pub fn close(&mut self, now: Micros, one: Station, other: Station) {
        self.pass(now.max(self.now));
        for way in [(one, other), (other, one)] {
            let Some(gone) = self.ways.remove(&way) else {
                continue;
            };
            self.timers.retain(|(_, of, _)| *of != way);
            let loads = &self.loads;
            let is_of = |id| matches!(loads.get(&id), Some(Load::Segment { way: of, .. }) if *of == way);
            self.medium.forget(way.0, is_of);
            self.loads
                .retain(|_, load| !matches!(load, Load::Segment { way: of, .. } if *of == way));
            for message in gone.stream.unfinished() {
                self.messages.lost(self.now, message, Reason::Closed);
            }
        }
    }

    /// When something happens next by itself; it may be that nobody is told of it.
    #[must_use]
    pub fn next_event(&self) -> Option<Micros> {
        let told = self.messages.first().map(|outcome| outcome.at);
        told.or_else(|| self.next_step())
    }

    /// Lets time pass up to the next fate of a message, and not beyond `until`. After `None` all up to `until` has happened.
    /// What answers a message that arrives is to be sent before the next call, at its time.
    pub fn poll(&mut self, until: Micros) -> Option<Outcome> {
        loop {
            if let Some(outcome) = self.messages.next() {
                return Some(outcome);
            }
            match self.next_step() {
                Some(due) if due <= until => self.step(due),
                _ => {
                    self.now = self.now.max(until);
                    return None;
                }
            }
        }
    }

    fn next_step(&self) -> Option<Micros> {
        let timer = self.timers.first().map(|(due, ..)| *due);
        [timer, self.medium.next()].into_iter().flatten().min()
    }

    /// Lets all happen up to a time.
    fn pass(&mut self, until: Micros) {
        while let Some(due) = self.next_step().filter(|due| *due < until) {
            self.step(due);
        }
        self.now = until;
    }

    fn step(&mut self, due: Micros) {
        self.now = due;
        match self.timers.first().copied() {
            Some((at, way, timer)) if at <= due => {
                self.timers.pop_first();
                self.ring(way, timer);
            }
            _ => {
                for finished in self.medium.step(due) {
                    self.finished(finished);
                }
            }
        }
    }

    fn send_datagram(&mut self, now: Micros, way: Way, octets: u32) -> MessageId {
        let mut left = octets + UDP;
        // Where a fragment ends is counted in units of 8 octets; the last one may be as long as the MTU allows.
        let room = self.settings.mtu.saturating_sub(IP).max(8);
        let whole = room / 8 * 8;
        let parts = if left <= room { 1 } else { left.div_ceil(whole) };
        let message = self.messages.add(now, way.0, way.1, parts);
        for part in 1..=parts {
            let carried = if part == parts { left } else { whole };
            left = left.saturating_sub(carried);
            if !self.queue(way, IP + carried, Load::Fragment(message)) {
                self.messages.lost(now, message, Reason::Overflow);
            }
        }
        message
    }

    fn send_segments(&mut self, now: Micros, way: Way, octets: u32) -> MessageId {
        let longest = self.longest_segment();
        let parts = octets.div_ceil(longest).max(1);
        let message = self.messages.add(now, way.0, way.1, parts);
        self.connect(way);
        for part in 0..parts {
            let octets = octets.saturating_sub(part * longest).min(longest);
            if let Some(connected) = self.ways.get_mut(&way) {
                connected.stream.push(Part { message, octets });
            }
        }
        self.fill(way);
        message
    }

    /// Makes both directions of a connection, if there is none.
    fn connect(&mut self, way: Way) {
        if self.ways.contains_key(&way) {
            return;
        }
        self.connections += 1;
        for way in [way, (way.1, way.0)] {
            let connected = Connected {
                connection: self.connections,
                stream: Stream::new(&self.settings),
                set: [None; 2],
            };
            self.ways.insert(way, connected);
        }
    }

    fn longest_segment(&self) -> u32 {
        self.settings.mtu.saturating_sub(IP + TCP).max(1)
    }

    /// Queues the segments that may go.
    fn fill(&mut self, way: Way) {
        let longest = self.longest_segment();
        while let Some(connected) = self.ways.get_mut(&way) {
            let Some(segment) = connected.stream.pull(self.now, longest, &self.settings) else {
                break;
            };
            self.send_segment(way, Some(segment));
        }
        self.set_timers(way);
    }

    /// Queues a segment, or an acknowledgement alone.
    fn send_segment(&mut self, way: Way, segment: Option<Segment>) {
        let back = (way.1, way.0);
        let Some(connected) = self.ways.get_mut(&back) else {
            return;
        };
        let before = connected.stream.acknowledged();
        let connection = connected.connection;
        self.set_timers(back);
        let octets = segment.as_ref().map_or(0, |segment| segment.octets);
        let number = segment.as_ref().map(|segment| segment.number);
        let load = Load::Segment {
            way,
            connection,
            segment,
            before,
        };
        let queued = self.queue(way, IP + TCP + octets, load);
        if let (false, Some(number), Some(connected)) = (queued, number, self.ways.get_mut(&way)) {
            // As if it were lost on the way.
            connected.stream.left(number);
        }
    }

    fn queue(&mut self, way: Way, packet: u32, load: Load) -> bool {
        let id = self.next_load;
        self.next_load += 1;
        let frame = Frame {
            id,
            to: way.1,
            packet,
        };
        let queued = self.medium.enqueue(self.now, way.0, frame);
        if queued {
            self.loads.insert(id, load);
        }
        queued
    }

    /// A frame has been delivered, or given up.
    fn finished(&mut self, frame: Finished) {
        match self.loads.remove(&frame.id) {
            None => {}
            Some(Load::Fragment(message)) => {
                self.messages.attempted(message, frame.attempts);
                match frame.delivered {
                    true => self.messages.arrived(frame.at, message),
                    false => self.messages.lost(frame.at, message, Reason::GivenUp),
                }
            }
            Some(Load::Segment {
                way,
                connection,
                segment,
                before,
            }) => {
                let of_now = |connected: &&mut Connected| connected.connection == connection;
                let Some(connected) = self.ways.get_mut(&way).filter(of_now) else {
                    return;
                };
                if let Some(segment) = &segment {
                    connected.stream.left(segment.number);
                    for message in &segment.messages {
                        self.messages.attempted(*message, frame.attempts);
                    }
                }
                if frame.delivered {
                    self.segment_arrived(way, segment, before);
                }
            }
        }
    }

    fn segment_arrived(&mut self, way: Way, segment: Option<Segment>, before: u64) {
        let back = (way.1, way.0);
        if let Some(connected) = self.ways.get_mut(&back) {
            let is_news = connected.stream.acknowledge(self.now, before, &self.settings);
            if is_news && let Some(again) = connected.stream.go_on(self.now) {
                self.repeated += 1;
                self.send_segment(back, Some(again));
            }
            self.fill(back);
        }
        let (Some(segment), Some(connected)) = (segment, self.ways.get_mut(&way)) else {
            return;
        };
        let delay = self.settings.delayed_ack;
        let arrival = connected
            .stream
            .arrive(self.now, segment.number, segment.messages, delay);
        for part in arrival.parts {
            self.messages.arrived(self.now, part);
        }
        if arrival.at_once {
            self.pure_acks += 1;
            self.send_segment(back, None);
        }
        self.set_timers(way);
    }

    fn ring(&mut self, way: Way, timer: Timer) {
        let Some(connected) = self.ways.get_mut(&way) else {
            return;
        };
        match timer {
            Timer::Repeat => {
                let again = connected.stream.repeat(self.now, &self.settings);
                connected.set[0] = None;
                if again.is_some() {
                    self.repeated += 1;
                    self.send_segment(way, again);
                }
            }
            Timer::Acknowledge => {
                connected.set[1] = None;
                self.pure_acks += 1;
                self.send_segment((way.1, way.0), None);
            }
        }
        self.set_timers(way);
    }

    /// Brings the timers of a way up to date.
    fn set_timers(&mut self, way: Way) {
        let Some(connected) = self.ways.get_mut(&way) else {
            return;
        };
        let wanted = [
            (Timer::Repeat, connected.stream.timer()),
            (Timer::Acknowledge, connected.stream.ack_due()),
        ];
        for ((timer, due), set) in wanted.into_iter().zip(&mut connected.set) {
            if *set == due {
                continue;
            }
            if let Some(old) = *set {
                self.timers.remove(&(old, way, timer));
            }
            if let Some(due) = due {
                self.timers.insert((due, way, timer));
            }
            *set = due;
        }
    }
}

impl Outcome {
    /// How long it took, or until it was lost, in µs.
    #[must_use]
    pub const fn took(&self) -> Micros {
        self.at - self.sent
    }

    /// Whether it has arrived.
    #[must_use]
    pub const fn is_delivered(&self) -> bool {
        matches!(self.fate, Fate::Delivered { .. })
    }
}
