//! One robot and its base station, the programs' own, with the radio model between them: in virtual time.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use mom_base_station::circuit::{Circuit, Input, Note, Options, Output, State};
use mom_brs::file::EXTENDED;
use mom_brs::{Code, Command, Direction, Frame, Parser};
use mom_linuxbot::{Robot, Rules};
use mom_radio::{Loss, MessageId, Micros, Outcome, Position, Radio, Settings, Station, Transport};
use mom_wheels::{Chassis, Driver, DriverError, Motors, Sensors, Simulated, WheelTime};

use super::air::{MS, PERIOD, SECOND};

/// A circle of 750 mm across at 250 mm/s: no wall comes.
const MOTORS: [i32; 2] = [300, 200];
/// A command that is executed so long after it was sent is late: the watchdog's limit.
const LATE: Micros = 500 * MS;
/// To open a connection.
const OPENING: Micros = 3 * MS;

/// The wheels, for the robot and for who looks on.
#[derive(Clone)]
struct Wheels(Arc<Mutex<Simulated>>);

impl Wheels {
    fn with<T>(&self, what: impl FnOnce(&mut Simulated) -> T) -> T {
        what(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Driver for Wheels {
    fn set_motors(&mut self, motors: Motors, at: WheelTime) -> Result<(), DriverError> {
        self.with(|wheels| wheels.set_motors(motors, at))
    }

    fn set_leds(&mut self, leds: u8, at: WheelTime) -> Result<(), DriverError> {
        self.with(|wheels| wheels.set_leds(leds, at))
    }

    fn sensors(&mut self, at: WheelTime) -> Result<Sensors, DriverError> {
        self.with(|wheels| wheels.sensors(at))
    }

    fn next_wake(&mut self) -> Option<WheelTime> {
        self.with(Simulated::next_wake)
    }
}

/// A drive, and what happens to its link.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    pub(super) rules: Rules,
    pub(super) circuit: Options,
    /// The share of attempts that is lost.
    pub(super) loss: f64,
    /// Attempts by the radio.
    pub(super) attempts: u32,
    /// When the link is cut, and when it comes back.
    pub(super) cut: Option<Micros>,
    pub(super) back: Option<Micros>,
    pub(super) time: Micros,
    pub(super) seed: u64,
}

/// What came of it; times after the cut.
#[derive(Clone, Debug, Default)]
pub(super) struct Drove {
    /// When the motors were off.
    pub(super) off: Option<Micros>,
    /// When it stood.
    pub(super) stands: Option<Micros>,
    /// mm that it drove after the cut, until it stood or the end.
    pub(super) way: f64,
    /// When the base station held the connection for lost.
    pub(super) known: Option<Micros>,
    /// s after the link was back until the robot executed a command that was not late.
    pub(super) again: Option<Micros>,
    /// MOTOR commands that were sent, and those that came more than a period later or never.
    pub(super) sent: u64,
    pub(super) missed: u64,
    /// ms that they took.
    pub(super) took: Vec<f64>,
    /// Those that were late, and those of them that moved a robot again which its watchdog had stopped.
    pub(super) late: u64,
    pub(super) after_stop: u64,
    pub(super) oldest: Micros,
    /// How often the watchdog stopped it.
    pub(super) stops: u64,
}

struct World<'d> {
    drive: &'d Drive,
    radio: Radio,
    base: Station,
    robot_at: Station,
    wheels: Wheels,
    robot: Robot,
    commands: Parser,
    circuit: Circuit,
    on_air: BTreeMap<MessageId, Vec<u8>>,
    next_command: Micros,
    /// When a connection that is being made is there.
    opens: Option<Micros>,
    in_reach: bool,
    expired: bool,
    drove: Drove,
}

impl Drive {
    pub(super) fn new(rules: Rules, circuit: Options, seed: u64) -> Drive {
        Drive {
            rules,
            circuit,
            loss: 0.0,
            attempts: 7,
            cut: None,
            back: None,
            time: SECOND,
            seed,
        }
    }

    pub(super) fn simulate(&self) -> Drove {
        let mut radio = Radio::new(Settings {
            seed: self.seed,
            loss: Loss::Flat(self.loss),
            attempts: self.attempts,
            ..Settings::default()
        });
        let base = radio.add(Position::default());
        let robot_at = radio.add(Position::new(10.0, 0.0));
        let wheels = Wheels(Arc::new(Mutex::new(Simulated::linuxbot())));
        let robot = Robot::new(Box::new(wheels.clone()), Chassis::LINUXBOT, self.rules);
        let mut world = World {
            drive: self,
            radio,
            base,
            robot_at,
            wheels,
            robot,
            commands: Parser::new(&EXTENDED, Direction::Command),
            circuit: Circuit::new(&EXTENDED, self.circuit, self.seed),
            on_air: BTreeMap::new(),
            next_command: 0,
            opens: None,
            in_reach: true,
            expired: false,
            drove: Drove::default(),
        };
        world.take(0, Input::Connect);
        world.go();
        world.drove.missed += world.on_air_motors();
        world.drove
    }
}

impl World<'_> {
    fn go(&mut self) {
        let mut now = 0;
        let mut watched = self.drive.cut;
        while now < self.drive.time {
            let due = [
                Some(self.drive.time),
                Some(self.next_command),
                self.circuit.next_wake(),
                self.robot.next_wake(),
                self.opens,
                watched,
                self.drive.cut.filter(|cut| self.in_reach && *cut >= now),
                self.drive.back.filter(|back| *back > now),
            ];
            let until = due
                .into_iter()
                .flatten()
                .min()
                .map_or(self.drive.time, |due| due.max(now));
            if let Some(outcome) = self.radio.poll(until) {
                now = outcome.at;
                self.arrived(&outcome);
                continue;
            }
            now = until;
            self.link(now);
            self.robot.advance(now);
            self.look(now);
            if watched.is_some_and(|due| due <= now) {
                watched = self.watch(now);
            }
            if self.opens.is_some_and(|opens| opens <= now) {
                self.opens = None;
                if self.in_reach {
                    // The robot hears of the old connection's end before it takes the new one.
                    self.robot.lost(now);
                    self.commands = Parser::new(&EXTENDED, Direction::Command);
                    self.take(now, Input::Connected);
                }
            }
            self.take(now, Input::Time);
            if self.next_command <= now {
                self.next_command += PERIOD;
                self.command(now);
            }
        }
    }

    fn link(&mut self, now: Micros) {
        let gone =
            self.drive.cut.is_some_and(|cut| now >= cut) && self.drive.back.is_none_or(|back| now < back);
        self.in_reach = !gone;
        self.radio.set_in_reach(self.robot_at, self.in_reach);
    }

    /// Looks whether the robot stands, each ms after the cut until it does.
    fn watch(&mut self, now: Micros) -> Option<Micros> {
        let cut = self.drive.cut?;
        let speeds = self.wheels.with(|wheels| wheels.wheel_speeds(now));
        self.drove.way += (speeds[0] + speeds[1]).abs() / 2.0 / 1000.0;
        if self.wheels.with(|wheels| wheels.is_standing(now)) {
            self.drove.stands = Some(now - cut);
            return None;
        }
        Some(now + MS)
    }

    /// Notes what the watchdog did.
    fn look(&mut self, now: Micros) {
        let expired = self.robot.status(now).is_some_and(|status| status.expired);
        if expired && !self.expired {
            self.drove.stops += 1;
            if let Some(cut) = self.drive.cut.filter(|cut| *cut <= now) {
                self.drove.off.get_or_insert(now - cut);
            }
        }
        self.expired = expired;
    }

    fn command(&mut self, now: Micros) {
        // What is sent in the last period has no time to arrive.
        if self.circuit.state() != State::Writable || self.drive.time - now <= PERIOD {
            return;
        }
        if let Ok(frame) = Frame::new(&Command::MOTOR, &MOTORS) {
            if self.circuit.send(frame).is_ok() {
                self.drove.sent += 1;
            }
            self.poll(now);
        }
    }

    fn take(&mut self, now: Micros, input: Input<'_>) {
        self.circuit.take(now, input);
        self.poll(now);
    }

    /// Does what the base station asks for.
    fn poll(&mut self, now: Micros) {
        while let Some(output) = self.circuit.poll(now) {
            match output {
                Output::Connect => self.opens = self.in_reach.then_some(now + OPENING),
                Output::Close | Output::Abort => {
                    self.opens = None;
                    self.drove.missed += self.on_air_motors();
                    self.on_air.clear();
                    self.radio.close(now, self.base, self.robot_at);
                }
                Output::Write(bytes) => self.send(now, self.base, self.robot_at, bytes.as_bytes()),
                Output::Note(Note::Ended(_)) => {
                    if let Some(cut) = self.drive.cut.filter(|cut| *cut <= now) {
                        self.drove.known.get_or_insert(now - cut);
                    }
                }
                Output::Note(_) => {}
            }
        }
    }

    fn send(&mut self, now: Micros, from: Station, to: Station, bytes: &[u8]) {
        let octets = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
        if let Ok(message) = self.radio.send(now, from, to, octets, Transport::Tcp) {
            self.on_air.insert(message, bytes.to_vec());
        }
    }

    /// MOTOR commands that have not arrived.
    fn on_air_motors(&self) -> u64 {
        let motors = self.on_air.values().filter(|bytes| bytes.starts_with(b"06"));
        motors.count() as u64
    }

    fn arrived(&mut self, outcome: &Outcome) {
        let now = outcome.at;
        let Some(bytes) = self.on_air.remove(&outcome.message) else {
            return;
        };
        if !outcome.is_delivered() {
            return;
        }
        if outcome.from == self.robot_at {
            self.take(now, Input::Bytes(&bytes));
            return;
        }
        self.robot.advance(now);
        self.look(now);
        let frames: Vec<Frame> = self.commands.feed(&bytes).collect();
        for frame in frames {
            if frame.code() == Code::MOTOR {
                self.note(now, outcome.took());
            }
            if let Some(reply) = self.robot.take(&frame, now) {
                self.send(now, self.robot_at, self.base, reply.encode().as_bytes());
            }
        }
        self.look(now);
    }

    /// A MOTOR is executed, so long after it was sent.
    fn note(&mut self, now: Micros, took: Micros) {
        self.drove.took.push(took as f64 / MS as f64);
        self.drove.missed += u64::from(took > PERIOD);
        self.drove.oldest = self.drove.oldest.max(took);
        if took > LATE {
            self.drove.late += 1;
            self.drove.after_stop += u64::from(self.expired);
        } else if let Some(back) = self.drive.back.filter(|back| now >= *back) {
            self.drove.again.get_or_insert(now - back);
        }
    }
}
