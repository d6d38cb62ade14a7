//! A robot's end in Rust whose case is replayed over the end in C: what happens to it is written down, with what it does and says, and in
//! the end the library in C is given the same and has to do and say the same.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::OnceLock;

use mom_rsp::robot::{Body, Outgoing, Robot, RobotFault, Settings};
use mom_rsp::{Counters, Dropped, Element, Fragment, Kind, Layout, Motion, Number, Payload, Refused};

use super::c_end;

/// A robot's end in Rust, and what it did, for the end in C.
pub struct Both<'m, const E: usize, const V: usize, const B: usize, const S: usize> {
    robot: Robot<'m, E, V, B, S>,
    elements: &'m [Element<'m>],
    tape: Option<Tape>,
}

/// The program in C that does what a tape says, where it can be had.
pub fn harness() -> Option<&'static PathBuf> {
    static MADE: OnceLock<Option<PathBuf>> = OnceLock::new();
    MADE.get_or_init(|| {
        let main = c_end::folder().join("tests/harness.c");
        c_end::program("c-harness", &[&[main], &c_end::sources()[..]].concat(), &[])
    })
    .as_ref()
}

/// What was done with an end, and what it did.
#[derive(Default)]
struct Tape {
    input: String,
    expected: String,
}

fn hex(bytes: &[u8], to: &mut String) {
    const DIGITS: &[u8; 16] = b"0123456789abcdef";
    if bytes.is_empty() {
        to.push('-');
    }
    for byte in bytes {
        to.push(char::from(DIGITS[usize::from(byte >> 4)]));
        to.push(char::from(DIGITS[usize::from(byte & 15)]));
    }
}

pub fn text(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(2 * bytes.len());
    hex(bytes, &mut text);
    text
}

/// The numbers of a kind and a type in C.
fn kind(kind: Kind) -> u8 {
    match kind {
        Kind::Effector => 0,
        Kind::Sensor => 1,
        Kind::Monitor => 2,
        Kind::Command => 3,
        Kind::Module => 4,
        Kind::Event => 5,
        Kind::MemoryCommand => 6,
        Kind::MemoryEvent => 7,
    }
}

fn payload(payload: Payload) -> (u8, u16) {
    match payload {
        Payload::Nothing => (0, 0),
        Payload::Bytes(most) => (8, most),
        Payload::Numbers(number, count) => {
            let number = match number {
                Number::U8 => 1,
                Number::I8 => 2,
                Number::U16 => 3,
                Number::I16 => 4,
                Number::U32 => 5,
                Number::I32 => 6,
                Number::F32 => 7,
            };
            (number, count)
        }
    }
}

impl Tape {
    fn begin(layout: &Layout<'_>, settings: &Settings, buffers: usize) -> Tape {
        let mut tape = Tape::default();
        let (id, hash, count) = (layout.id(), text(layout.hash()), layout.elements().len());
        let _ = writeln!(tape.input, "layout {id} {hash} {count}");
        for element in layout.elements() {
            tape.element(element);
        }
        let key = settings.key.map_or_else(|| "-".to_owned(), |key| text(&key));
        let (watchdog, budget) = (settings.watchdog, settings.budget);
        let _ = writeln!(tape.input, "robot {key} {watchdog} {budget} {buffers}");
        let _ = writeln!(tape.expected, "largest {}", layout.largest());
        tape
    }

    fn element(&mut self, of: &Element<'_>) {
        let (number, count) = payload(of.payload);
        let (motion, rate) = match of.motion {
            Motion::Absolute { interpolate, rate } => (u8::from(interpolate), rate),
            Motion::Incremental { rate } => (2, rate),
        };
        let is_effector = of.kind == Kind::Effector;
        let rate = rate.filter(|_| is_effector).unwrap_or(0.0).to_bits();
        let module = of.module.map_or(-1, i16::from);
        let (name, digest, kind, safe, period) =
            (of.name, of.digest, kind(of.kind), text(of.safe), of.period);
        let _ = writeln!(
            self.input,
            "element {name} {digest} {kind} {number} {count} {motion} {rate} {safe} {period} {module}"
        );
    }

    /// The two ends have to have done the same.
    fn compare(self) {
        let Some(harness) = harness() else {
            return;
        };
        let did = c_end::run(harness, &self.input);
        if did == self.expected {
            return;
        }
        let same = did
            .lines()
            .zip(self.expected.lines())
            .take_while(|(did, expected)| did == expected)
            .count();
        let done = did
            .lines()
            .take(same)
            .filter(|line| line.starts_with('='))
            .count();
        let is_operation = |line: &&str| {
            ["receive", "poll", "set", "raise", "end", "counts"]
                .iter()
                .any(|verb| line.starts_with(verb))
        };
        let operation = self.input.lines().filter(is_operation).nth(done);
        let around = |text: &str| {
            text.lines()
                .skip(same.saturating_sub(4))
                .take(8)
                .collect::<Vec<_>>()
                .join("\n")
        };
        panic!(
            "operation {done}, {operation:?}: in C\n{}\nin Rust\n{}",
            around(&did),
            around(&self.expected)
        );
    }
}

/// A body that is written down.
struct Recorder<'b, T> {
    body: &'b mut T,
    elements: &'b [Element<'b>],
    /// What it gave, for the body in C.
    gave: String,
    /// What it was told.
    told: String,
}

impl<T: Body> Body for Recorder<'_, T> {
    fn random(&mut self, bytes: &mut [u8]) {
        self.body.random(bytes);
        let _ = writeln!(self.told, "random {}", bytes.len());
        let _ = writeln!(self.gave, "random {}", text(bytes));
    }

    fn effector(&mut self, element: u8, value: &[u8]) {
        let _ = writeln!(self.told, "effector {element} {}", text(value));
        self.body.effector(element, value);
    }

    fn command(&mut self, element: u8, data: &[u8]) {
        let _ = writeln!(self.told, "command {element} {}", text(data));
        self.body.command(element, data);
    }

    fn fragment(&mut self, part: Fragment<'_>) {
        let (element, blob, offset, total) = (part.element, part.blob, part.offset, part.total);
        let bytes = text(part.bytes);
        let _ = writeln!(self.told, "fragment {element} {blob} {offset} {total} {bytes}");
        self.body.fragment(part);
    }

    fn next_fragment(&mut self, into: &mut [u8]) -> Option<Outgoing> {
        self.told.push_str("asked\n");
        let part = self.body.next_fragment(into)?;
        let (element, blob, offset, total) = (part.element, part.blob, part.offset, part.total);
        let bytes = text(&into[..usize::from(part.len)]);
        let _ = writeln!(self.gave, "part {element} {blob} {offset} {total} {bytes}");
        Some(part)
    }

    fn active(&mut self, element: u8, active: bool) {
        let _ = writeln!(self.told, "active {element} {}", u8::from(active));
        self.body.active(element, active);
    }

    fn session(&mut self, up: bool) {
        let _ = writeln!(self.told, "session {}", u8::from(up));
        self.body.session(up);
    }

    fn unknown(&mut self, element: u8) {
        let _ = writeln!(self.told, "unknown {element}");
        self.body.unknown(element);
    }
}

fn refused(result: Result<(), Refused>) -> u8 {
    match result {
        Ok(()) => 0,
        Err(Refused::Element) => 1,
        Err(Refused::Kind) => 2,
        Err(Refused::Size) => 3,
        Err(Refused::Full) => 4,
        Err(Refused::NoSession) => 5,
        Err(Refused::Inactive) => 6,
        Err(other) => panic!("a robot's end refuses nothing as {other:?}"),
    }
}

impl<'m, const E: usize, const V: usize, const B: usize, const S: usize> Both<'m, E, V, B, S> {
    pub fn new(layout: &'m Layout<'m>, settings: Settings) -> Result<Self, RobotFault> {
        let tape = c_end::compiler().map(|_| Tape::begin(layout, &settings, B));
        let robot = Robot::new(layout, settings)?;
        Ok(Both {
            robot,
            elements: layout.elements(),
            tape,
        })
    }

    /// Does something with the end and a body, and writes it down: `operation` is the line for C.
    fn record<T: Body, R>(
        &mut self,
        operation: impl FnOnce() -> String,
        body: &mut T,
        act: impl FnOnce(&mut Robot<'m, E, V, B, S>, &mut Recorder<'_, T>) -> R,
        result: impl FnOnce(&R) -> String,
    ) -> R {
        let operation = self.tape.as_ref().map(|_| operation());
        let mut recorder = Recorder {
            body,
            elements: self.elements,
            gave: String::new(),
            told: String::new(),
        };
        let done = act(&mut self.robot, &mut recorder);
        let (gave, told) = (recorder.gave, recorder.told);
        if let Some(operation) = operation {
            self.write(&gave, &operation, &told, &result(&done));
        }
        done
    }

    fn write(&mut self, gave: &str, operation: &str, told: &str, result: &str) {
        let Some(tape) = &mut self.tape else {
            return;
        };
        tape.input.push_str(gave);
        tape.input.push_str(operation);
        tape.input.push('\n');
        tape.expected.push_str(told);
        let robot = &self.robot;
        let _ = write!(
            tape.expected,
            "={result} | {} {} {} {} {} ",
            u8::from(robot.is_up()),
            robot.wake().unwrap_or(u64::MAX),
            robot.deadline().unwrap_or(u64::MAX),
            robot.period(),
            robot.free_buffers()
        );
        for element in 0..E {
            let active = robot.is_active(element as u8);
            tape.expected.push(if active { '1' } else { '0' });
        }
        tape.expected.push('\n');
    }

    pub fn receive(&mut self, now: u64, datagram: &mut [u8], body: &mut impl Body) -> Result<(), Dropped> {
        let operation = format!("receive {now} {}", text(datagram));
        self.record(
            || operation,
            body,
            |robot, body| robot.receive(now, datagram, body),
            |outcome| {
                let number = outcome.map_or_else(|reason| 1 + reason as u8, |()| 0);
                format!(" {number}")
            },
        )
    }

    pub fn poll(&mut self, now: u64, out: &mut [u8], body: &mut impl Body) -> Option<usize> {
        let operation = format!("poll {now} {}", out.len());
        let (len, _) = self.record(
            || operation,
            body,
            |robot, body| {
                let len = robot.poll(now, out, body);
                (len, text(&out[..len.unwrap_or(0)]))
            },
            |(_, sent)| format!(" {sent}"),
        );
        len
    }

    pub fn end(&mut self, now: u64, body: &mut impl Body) {
        self.record(
            || format!("end {now}"),
            body,
            |robot, body| robot.end(now, body),
            |()| String::new(),
        );
    }

    pub fn set(&mut self, element: u8, value: &[u8]) -> Result<(), Refused> {
        let outcome = self.robot.set(element, value);
        let operation = format!("set {element} {}", text(value));
        self.write("", &operation, "", &format!(" {}", refused(outcome)));
        outcome
    }

    pub fn raise(&mut self, element: u8, data: &[u8]) -> Result<(), Refused> {
        let outcome = self.robot.raise(element, data);
        let operation = format!("raise {element} {}", text(data));
        self.write("", &operation, "", &format!(" {}", refused(outcome)));
        outcome
    }

    pub fn is_up(&self) -> bool {
        self.robot.is_up()
    }

    pub fn is_active(&self, element: u8) -> bool {
        self.robot.is_active(element)
    }

    pub fn wake(&self) -> Option<u64> {
        self.robot.wake()
    }

    pub fn period(&self) -> u16 {
        self.robot.period()
    }

    pub fn free_buffers(&self) -> u8 {
        self.robot.free_buffers()
    }

    pub fn counters(&self) -> &Counters {
        self.robot.counters()
    }

    /// How much was done with both ends so far.
    pub fn steps(&self) -> usize {
        self.tape.as_ref().map_or(0, |tape| tape.input.lines().count())
    }
}

impl<const E: usize, const V: usize, const B: usize, const S: usize> Drop for Both<'_, E, V, B, S> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            return;
        }
        let counters = self.robot.counters();
        let mut counts = format!(" {}", counters.accepted());
        for (_, count) in counters.iter() {
            let _ = write!(counts, " {count}");
        }
        self.write("", "counts", "", &counts);
        if let Some(tape) = self.tape.take() {
            tape.compare();
        }
    }
}
