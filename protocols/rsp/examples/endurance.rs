//! Both ends of the protocol as programs that check each other: no value is wrong, nothing is done twice, nothing is lost while a
//! session lasts (S15, S19 to S22).
//!
//! ```sh
//! cargo run --release -p mom-rsp --example endurance -- robot 127.0.0.1:7701
//! cargo run --release -p mom-rsp --example endurance -- middle 127.0.0.1:7701 100000 1
//! ```
//!
//! The middle ends both after so many data packets of either direction, one each so many ms. Each prints what it found, and ends with 1
//! if that is wrong.

use std::error::Error;
use std::io::Write as _;
use std::net::{SocketAddr, UdpSocket};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use mom_rsp::middle::{Middle, Notice, Settings, State};
use mom_rsp::robot::{self, Body, Robot, slot, values};
use mom_rsp::{Element, Key, Kind, Layout, Motion, Number, Payload, Type};

const KEY: Key = [7; 32];
/// Who says nothing for so long is not there, ms.
const SILENCE: u16 = 2000;
/// At most so long nothing is looked at. A socket's own timeout is as coarse as the kernel's ticks, 4 ms, and packets come each ms.
const NAP: Duration = Duration::from_micros(200);

const VALUE: u8 = 0;
const STEPS: u8 = 1;
const ECHO: u8 = 2;
const COMMAND: u8 = 3;
const MEMORY_COMMAND: u8 = 4;
const EVENT: u8 = 5;
const MEMORY_EVENT: u8 = 6;
const SUM: u8 = 7;

const fn element(name: &str, kind: Kind, numbers: u16, motion: Motion) -> Element<'_> {
    const SAFE: &[u8] = &[0; 8];
    Element {
        name,
        kind,
        payload: Payload::Numbers(Number::U32, numbers),
        motion,
        safe: SAFE.split_at(4 * numbers as usize).0,
        period: 0,
        module: None,
        of: None,
        digest: 0,
    }
}

const NEWEST: Motion = Motion::Absolute {
    interpolate: false,
    rate: None,
};

/// A number beside its complement is a value that no mistake makes.
static ELEMENTS: [Element<'static>; 8] = [
    element("value", Kind::Effector, 2, NEWEST),
    element("steps", Kind::Effector, 1, Motion::Incremental { rate: None }),
    element("echo", Kind::Sensor, 2, NEWEST),
    element("command", Kind::Command, 2, NEWEST),
    element("memory-command", Kind::MemoryCommand, 2, NEWEST),
    element("event", Kind::Event, 2, NEWEST),
    element("memory-event", Kind::MemoryEvent, 2, NEWEST),
    element("sum", Kind::Sensor, 1, NEWEST),
];

static LAYOUT: Layout<'static> = Layout::new(0xe0d0, [3; 32], &ELEMENTS);

type End = Robot<'static, 8, { values(&LAYOUT) }, 4, { slot(&LAYOUT) }>;

fn proven(number: u32) -> [u8; 8] {
    let mut bytes = [0; 8];
    let (one, other) = bytes.split_at_mut(4);
    one.copy_from_slice(&number.to_be_bytes());
    other.copy_from_slice(&(!number).to_be_bytes());
    bytes
}

/// The number of a proven value; none for what was never written.
fn number(bytes: &[u8]) -> Option<u32> {
    let (one, other) = bytes.split_first_chunk::<4>()?;
    let (one, other) = (
        u32::from_be_bytes(*one),
        u32::from_be_bytes(other.try_into().ok()?),
    );
    (one == !other).then_some(one)
}

/// Numbers that come one after the other.
#[derive(Debug, Default)]
struct Row {
    last: u32,
    seen: u64,
    /// That were there before.
    again: u64,
    /// That lack before the newest, and nothing ended between.
    lack: u64,
    /// That are none.
    wrong: u64,
}

impl Row {
    /// One of those of which each comes once.
    fn each(&mut self, bytes: &[u8]) {
        let Some(number) = self.checked(bytes) else { return };
        self.again += u64::from(number <= self.last);
        self.lack += u64::from(number > self.last + 1);
        self.last = self.last.max(number);
    }

    /// One of those of which the newest counts: it never goes back.
    fn newest(&mut self, bytes: &[u8]) {
        let Some(number) = self.checked(bytes) else { return };
        self.again += u64::from(number < self.last);
        self.last = self.last.max(number);
    }

    fn checked(&mut self, bytes: &[u8]) -> Option<u32> {
        let number = number(bytes);
        self.seen += 1;
        self.wrong += u64::from(number.is_none());
        number
    }

    fn is_right(&self) -> bool {
        self.again + self.lack + self.wrong == 0 && self.seen > 0
    }
}

#[derive(Default)]
struct Checked {
    values: Row,
    commands: Row,
    memory_commands: Row,
    sum: u32,
    sessions: u32,
}

impl Body for Checked {
    fn random(&mut self, bytes: &mut [u8]) {
        random(bytes);
    }

    fn effector(&mut self, element: u8, value: &[u8]) {
        match element {
            // Its safe value is nothing that was written.
            VALUE if value != [0; 8] => self.values.newest(value),
            STEPS => {
                let step = value.try_into().map_or(0, u32::from_be_bytes);
                self.sum = self.sum.wrapping_add(step);
            }
            _ => {}
        }
    }

    fn command(&mut self, element: u8, data: &[u8]) {
        match element {
            COMMAND => self.commands.each(data),
            _ => self.memory_commands.each(data),
        }
    }

    fn session(&mut self, up: bool) {
        self.sessions += u32::from(up);
    }
}

/// No secrets are kept with it.
fn random(bytes: &mut [u8]) {
    use std::hash::{BuildHasher as _, RandomState};
    for chunk in bytes.chunks_mut(8) {
        let random = RandomState::new().hash_one(0).to_le_bytes();
        chunk.copy_from_slice(random.get(..chunk.len()).unwrap_or_default());
    }
}

fn micros(begin: Instant) -> u64 {
    u64::try_from(begin.elapsed().as_micros()).unwrap_or(u64::MAX)
}

fn nap(now: u64, wake: Option<u64>) {
    let until = Duration::from_micros(wake.unwrap_or(u64::MAX).saturating_sub(now));
    std::thread::sleep(until.min(NAP));
}

fn robot(address: &str) -> Result<bool, Box<dyn Error>> {
    let socket = UdpSocket::bind(address)?;
    socket.set_nonblocking(true)?;
    writeln!(std::io::stdout(), "listens on {}", socket.local_addr()?)?;
    let settings = robot::Settings {
        key: Some(KEY),
        watchdog: SILENCE,
        ..robot::Settings::default()
    };
    let mut end = End::new(&LAYOUT, settings).map_err(|fault| fault.to_string())?;
    let (mut body, begin) = (Checked::default(), Instant::now());
    let (mut buffer, mut out) = ([0; 2048], [0; 2048]);
    let (mut events, mut held) = (0, 0);
    let mut middle: Option<SocketAddr> = None;
    loop {
        while let Ok((length, from)) = socket.recv_from(&mut buffer) {
            let datagram = buffer.get_mut(..length).unwrap_or_default();
            if end.receive(micros(begin), datagram, &mut body).is_ok() {
                middle = Some(from);
            }
        }
        let _ = end.set(ECHO, &proven(body.values.last));
        let _ = end.set(SUM, &body.sum.to_be_bytes());
        // As many as there is room for.
        while end.is_up() && end.raise(EVENT, &proven(events + 1)).is_ok() {
            events += 1;
        }
        while end.is_up() && end.raise(MEMORY_EVENT, &proven(held + 1)).is_ok() {
            held += 1;
        }
        while let Some(length) = end.poll(micros(begin), &mut out, &mut body) {
            if let (Some(to), Some(datagram)) = (middle, out.get(..length)) {
                // What the system has no room for is lost.
                let _ = socket.send_to(datagram, to);
            }
        }
        if body.sessions > 0 && !end.is_up() {
            break;
        }
        nap(micros(begin), end.wake());
    }
    // The middle waits for its end to be answered.
    let over = Instant::now() + Duration::from_secs(1);
    while Instant::now() < over {
        while let Ok((length, from)) = socket.recv_from(&mut buffer) {
            let datagram = buffer.get_mut(..length).unwrap_or_default();
            let _ = end.receive(micros(begin), datagram, &mut body);
            while let Some(length) = end.poll(micros(begin), &mut out, &mut body) {
                let _ = socket.send_to(out.get(..length).unwrap_or_default(), from);
            }
        }
        nap(0, None);
    }
    let Checked {
        values,
        commands,
        memory_commands,
        sum,
        sessions,
    } = &body;
    let right = values.is_right() && commands.is_right() && memory_commands.is_right() && *sessions == 1;
    writeln!(
        std::io::stdout(),
        "robot: {} packets taken, {sessions} session, values {values:?}, commands {commands:?}, memory commands {memory_commands:?}, sum {sum}, events {events}, memory events {held}: {}",
        end.counters().accepted(),
        if right { "right" } else { "WRONG" }
    )?;
    Ok(right)
}

/// What the middle has written, and heard.
#[derive(Default)]
struct Said {
    value: u32,
    steps: u32,
    commands: u32,
    memory_commands: u32,
    done: u64,
    unknown: u64,
    echoes: Row,
    events: Row,
    memory_events: Row,
    sum: u32,
    ups: u32,
}

impl Said {
    fn hear(&mut self, middle: &mut Middle<'_>) {
        while let Some(notice) = middle.next_notice() {
            match notice {
                Notice::Up => self.ups += 1,
                Notice::Done { .. } => self.done += 1,
                Notice::Unknown { .. } | Notice::Failed { .. } => self.unknown += 1,
                Notice::Raised {
                    element: EVENT, data, ..
                } => self.events.each(&data),
                Notice::Raised { data, .. } => self.memory_events.each(&data),
                Notice::Changed { element: ECHO } => {
                    let value = middle.read(ECHO).map(|reading| reading.value.to_vec());
                    // 0 is what it has before the first.
                    let value = value.filter(|value| *value != proven(0));
                    if let Some(value) = value {
                        self.echoes.newest(&value);
                    }
                }
                Notice::Changed { element: SUM } => {
                    let sum = middle.read(SUM).and_then(|reading| reading.value.try_into().ok());
                    self.sum = sum.map_or(self.sum, u32::from_be_bytes);
                }
                _ => {}
            }
        }
    }

    fn say(&mut self, middle: &mut Middle<'_>) -> Result<(), mom_rsp::Refused> {
        self.value += 1;
        middle.write(VALUE, &proven(self.value))?;
        self.steps += 1;
        middle.write(STEPS, &1_u32.to_be_bytes())?;
        while middle.command(COMMAND, &proven(self.commands + 1)).is_ok() {
            self.commands += 1;
        }
        while middle
            .command(MEMORY_COMMAND, &proven(self.memory_commands + 1))
            .is_ok()
        {
            self.memory_commands += 1;
        }
        Ok(())
    }
}

impl Said {
    /// Whether all is right, which is told.
    fn report(&self, sent: u64, heard: u64, took: Duration, loss: f32) -> Result<bool, Box<dyn Error>> {
        let Said {
            done,
            unknown,
            echoes,
            events,
            memory_events,
            sum,
            steps,
            ..
        } = self;
        let rows = [echoes, events, memory_events];
        // What is held is asked for while other events go on, and not only when it is quiet.
        let flows = memory_events.seen * 10 >= events.seen;
        let right = rows.iter().all(|row| row.is_right()) && sum == steps && *unknown == 0 && flows;
        writeln!(
            std::io::stdout(),
            "middle: {sent} packets sent and {heard} taken in {:.1} s, {:.1} % lost upwards, commands {done} done, {unknown} unknown, sum {sum} of {steps}, echoes {echoes:?}, events {events:?}, memory events {memory_events:?}: {}",
            took.as_secs_f64(),
            loss * 100.0,
            if right { "right" } else { "WRONG" }
        )?;
        Ok(right)
    }
}

fn middle(address: &str, packets: u64, period: u16) -> Result<bool, Box<dyn Error>> {
    let socket = UdpSocket::bind("0.0.0.0:0")?;
    socket.connect(address)?;
    socket.set_nonblocking(true)?;
    let settings = Settings {
        key: Some(KEY),
        period,
        silence: SILENCE,
        ..Settings::default()
    };
    let mut middle = Middle::new(&LAYOUT, settings, random)?;
    let (mut said, begin) = (Said::default(), Instant::now());
    let (mut sent, mut heard, mut told) = (0_u64, 0_u64, Instant::now());
    let mut buffer = [0; 2048];
    middle.start(0);
    while middle.state() != State::Idle {
        while let Ok(length) = socket.recv(&mut buffer) {
            let datagram = buffer.get_mut(..length).unwrap_or_default();
            let is_data = datagram.get(4) == Some(&(Type::UpData as u8));
            if middle.receive(micros(begin), datagram).is_ok() {
                heard += u64::from(is_data);
            }
        }
        said.hear(&mut middle);
        let is_over = sent.min(heard) >= packets;
        while let Some(datagram) = middle.poll(micros(begin)) {
            let is_data = datagram.get(4) == Some(&(Type::Data as u8));
            // What the system has no room for is lost.
            let _ = socket.send(datagram);
            sent += u64::from(is_data);
            if is_data && !is_over {
                said.say(&mut middle)?;
            }
        }
        // What was written last is to arrive, too.
        let all = said.done >= u64::from(said.commands) + u64::from(said.memory_commands)
            && said.sum == said.steps
            && said.echoes.last == said.value;
        if is_over && all && middle.state() == State::Up {
            middle.end(micros(begin));
        }
        if said.ups > 0 && middle.state() == State::Calling {
            writeln!(std::io::stderr(), "the session was lost after {sent} packets")?;
            break;
        }
        if told.elapsed() > Duration::from_secs(10) {
            told = Instant::now();
            writeln!(
                std::io::stdout(),
                "middle: {} of {packets} packets",
                sent.min(heard)
            )?;
        }
        nap(micros(begin), middle.wake());
    }
    said.report(sent, heard, begin.elapsed(), middle.loss())
}

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let done = match *words {
        ["robot", address] => robot(address),
        ["middle", address, packets, period] => match (packets.parse(), period.parse()) {
            (Ok(packets), Ok(period)) => middle(address, packets, period),
            _ => Err("middle ADDRESS:PORT PACKETS MS: how many packets, and the ms between them".into()),
        },
        _ => Err("robot ADDRESS:PORT, or middle ADDRESS:PORT PACKETS MS".into()),
    };
    match done {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "{error}");
            ExitCode::from(2)
        }
    }
}
