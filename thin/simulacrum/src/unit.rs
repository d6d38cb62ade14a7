//! A mirrored robot as a machine of the hub: its owner commands it in the terms of its model.

use mom_client::{Card, Map};
use mom_device::{Attachments, DeviceError, DeviceTime, ErrorName, Machine, Sample, Script, Word, Words};
use mom_rsp::middle::Notice;
use mom_rsp::{Kind, Motion, Refused};
use mom_rsp_model::ModelElement;
use mom_wheeled::Rover;
use mom_wheels::Chassis;
use mom_wheels::pilot::HOLD;

use crate::playing::Playing;
use crate::teller::thousandths;
use crate::{Action, Simulacrum, Wheels};

mod arrival;
mod checks;
mod course;
mod moved;
mod stop;

use arrival::{Arrival, SLOWEST};
use checks::{is_asked, is_command, is_effector, is_switched};
use moved::Moved;
use stop::Stop;

/// Odometry is in whole mm and degrees.
const TOLERANCE: f64 = 2.0;
/// µs that a statement waits for the robot to confirm its last stop.
const UNCONFIRMED: DeviceTime = 2_000_000;
/// µs between two looks at what comes without a notice.
const LOOK: DeviceTime = 20_000;

/// A robot and what is done with it at present.
///
/// Its program hands it the notices of its middle ([`Mirror::heard`]).
#[derive(Debug)]
pub struct Mirror {
    robot: Simulacrum,
    /// What drives its wheels, if it has some.
    rover: Option<Rover>,
    /// Its wheels, as far as it says often enough where it is.
    wheels: Vec<u8>,
    now: DeviceTime,
    doing: Doing,
    /// The sound that is played, whatever else is done.
    playing: Option<Playing>,
    /// An effector may have another value than its safe one, by a statement that is done.
    is_set: bool,
    stop: Stop,
    moved: Moved,
    failure: Option<DeviceError>,
}

/// What it does of the statement that was begun last.
#[derive(Debug)]
enum Doing {
    Nothing,
    Done(DeviceTime),
    /// The wheels are driven.
    Drives,
    /// These effectors are set until then.
    Set(DeviceTime, Vec<u8>),
    /// These effectors go to where they were set to.
    Arrives(Arrival),
    /// The robot is to say that this element is active, or is not; it was told so then.
    Switches(u8, bool, DeviceTime),
    /// The robot is to acknowledge this command, which then goes on for so many µs.
    Command(u32, DeviceTime),
    /// What a command began goes on until then.
    Runs(DeviceTime),
    /// It begins when the robot has confirmed its last stop; it has waited since then.
    Waits(Action, DeviceTime),
}

impl std::fmt::Debug for Simulacrum {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Simulacrum").field(&self.name()).finish()
    }
}

impl Mirror {
    /// A robot that stands. Where its model has wheels, this is its chassis.
    #[must_use]
    pub fn new(robot: Simulacrum, chassis: Chassis, unit: Option<u32>) -> Self {
        let driver = Wheels::of(&robot, chassis);
        let wheels = driver
            .as_ref()
            .map(|driver| driver.measured(SLOWEST))
            .unwrap_or_default();
        let rover = driver.map(|driver| Rover::new(Box::new(driver), chassis, unit));
        let mut mirror = Self {
            robot,
            rover,
            wheels,
            now: 0,
            doing: Doing::Nothing,
            playing: None,
            is_set: false,
            stop: Stop::default(),
            moved: Moved::default(),
            failure: None,
        };
        mirror.begin_session();
        mirror
    }

    /// The same robot without what it was doing, for another channel; this one has to be left alone.
    #[must_use]
    pub fn again(&self) -> Self {
        Self {
            robot: self.robot.clone(),
            rover: self.rover.as_ref().map(Rover::again),
            wheels: self.wheels.clone(),
            now: self.now,
            doing: Doing::Nothing,
            playing: None,
            is_set: self.is_set,
            stop: self.stop.clone(),
            moved: self.moved.clone(),
            failure: None,
        }
    }

    /// The mirror itself.
    #[must_use]
    pub fn robot(&self) -> &Simulacrum {
        &self.robot
    }

    /// Something was heard of the robot; an error ends all commands.
    ///
    /// # Errors
    ///
    /// `link` for a session that is lost, or a command of which nobody knows whether it was executed.
    pub fn heard(&mut self, notice: &Notice) -> Result<(), DeviceError> {
        let name = self.robot.name().to_owned();
        let (awaited, lasts) = match self.doing {
            Doing::Command(ticket, lasts) => (Some(ticket), lasts),
            _ => (None, 0),
        };
        let lost = |text: String| Err(DeviceError::new(ErrorName::Link, text));
        match notice {
            Notice::Done { ticket, .. } if awaited == Some(*ticket) => {
                // It began before it was acknowledged.
                self.doing = match lasts {
                    0 => Doing::Done(self.now),
                    _ => Doing::Runs(self.now.saturating_add(lasts)),
                };
                Ok(())
            }
            Notice::Failed { ticket, .. } if awaited == Some(*ticket) => {
                self.doing = Doing::Nothing;
                lost(format!(
                    "{name} did not acknowledge it, and in the paper's mode it is not sent again"
                ))
            }
            Notice::Unknown { ticket, .. } if awaited == Some(*ticket) => {
                self.doing = Doing::Nothing;
                lost(format!(
                    "{name} was lost before it acknowledged it: it was executed once, or not at all, and is not sent again"
                ))
            }
            Notice::Active { .. } => {
                self.settle();
                Ok(())
            }
            // What was written before is forgotten, and the robot rests.
            Notice::Up => {
                self.begin_session();
                Ok(())
            }
            Notice::Ended => {
                self.stand();
                lost(format!("{name} has ended its session, and rests"))
            }
            Notice::Lost => {
                self.stand();
                lost(format!(
                    "{name} is lost: nothing was heard of it for too long, and its watchdog has it rest"
                ))
            }
            _ => Ok(()),
        }
    }

    /// Whether something failed since [`Mirror::take_failure`] was called last.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        self.failure.is_some() || self.rover.as_ref().is_some_and(Rover::has_failed)
    }

    /// What failed since this was asked last, if something did.
    pub fn take_failure(&mut self) -> Option<DeviceError> {
        let rover = self.rover.as_mut().and_then(Rover::take_failure);
        rover.or(self.failure.take())
    }

    /// The robot rests by the end of its last session, as far as nothing has been heard of it in this one.
    fn begin_session(&mut self) {
        self.stop.begin_session(&self.robot);
        self.moved.all(&self.robot, self.now);
        self.rest();
    }

    /// Has all effectors take their safe values.
    fn rest(&mut self) {
        let robot = self.robot.clone();
        for (place, element) in (0..).zip(robot.model().elements()) {
            if element.kind == Kind::Effector {
                self.write_safe(place, element);
            }
        }
        self.is_set = false;
    }

    fn write_safe(&mut self, place: u8, element: &ModelElement) {
        // Without a session the robot has its safe values already, as has what is switched off.
        let can_be_told = self.robot.is_up() && self.robot.with(|middle| middle.activated(place));
        if element.quantities.is_empty() || !can_be_told {
            return;
        }
        if self
            .robot
            .with(|middle| middle.wanted(place).is_some_and(|wanted| wanted != element.safe))
        {
            self.moved.one(place, self.now);
        }
        let taken = match element.motion {
            Motion::Absolute { .. } => self.robot.write(place, &element.safe),
            Motion::Incremental { .. } => {
                // It makes none of the steps that it was told and has not made yet: a step of 0 would not take them back.
                if self.is_set {
                    self.stop.hold(&self.robot, place);
                }
                Ok(())
            }
        };
        // What is just being switched on again has its safe value.
        if let Err(error) = taken
            && error != Refused::Inactive
        {
            tracing::error!(robot = self.robot.name(), element = element.name, %error, "a safe value was rejected");
        }
    }

    /// Has the robot stand, also where it is held to do so already: nothing that it was told before begins once it has confirmed that.
    fn stand(&mut self) {
        if matches!(self.doing, Doing::Command(..) | Doing::Runs(_)) {
            self.moved.all(&self.robot, self.now);
        }
        self.doing = Doing::Nothing;
        self.playing = None;
        let now = self.now;
        if let Some(rover) = &mut self.rover {
            rover.halt(now);
        }
        self.rest();
        self.stop.all(&self.robot);
        self.robot.hurry();
    }

    /// The robot may have confirmed a stop: what waits for that begins.
    fn settle(&mut self) {
        if !self.stop.settle(&self.robot) {
            return;
        }
        // After a stop; what a statement has left set stays where only steps were taken back.
        if !self.is_set {
            self.rest();
        }
        if let Doing::Waits(..) = self.doing
            && let Doing::Waits(action, _) = std::mem::replace(&mut self.doing, Doing::Nothing)
            && let Err(error) = self.start(&action)
        {
            self.fail(error);
        }
    }

    fn fail(&mut self, error: DeviceError) {
        self.stand();
        // The first one is what there is to be told.
        self.failure.get_or_insert(error);
    }

    fn refused(&self, refused: Refused) -> DeviceError {
        let text = format!("{} rejected it: {refused}", self.robot.name());
        DeviceError::new(ErrorName::Link, text)
    }

    fn switch(&self, element: &str, active: bool) -> Result<Doing, DeviceError> {
        let (place, _) = self.named(element, is_switched, "what can be switched")?;
        let switched = self.robot.with(|middle| middle.set_activated(place, active));
        switched.map_err(|error| self.refused(error))?;
        self.robot.hurry();
        Ok(Doing::Switches(place, active, self.now))
    }

    fn begin_other(&mut self, action: &Action) -> Result<Doing, DeviceError> {
        if let Some(why) = self.robot.trouble() {
            let text = format!("{} is not reached: {why}", self.robot.name());
            return Err(DeviceError::new(ErrorName::Link, text));
        }
        let taken = match action {
            Action::Set { settings, ms } => {
                self.is_set = true;
                let values = settings
                    .iter()
                    .map(|setting| self.value(setting, is_effector, "the effectors"))
                    .collect::<Result<Vec<_>, _>>()?;
                let arrival = Arrival::of(&self.robot, &values);
                for (place, bytes) in &values {
                    self.moved.one(*place, self.now);
                    self.robot
                        .write(*place, bytes)
                        .map_err(|error| self.refused(error))?;
                }
                self.robot.hurry();
                return Ok(match ms {
                    Some(ms) => {
                        let until = self.now.saturating_add(DeviceTime::from(*ms) * 1000);
                        Doing::Set(until, values.into_iter().map(|(place, _)| place).collect())
                    }
                    None => Doing::Arrives(arrival),
                });
            }
            Action::Do(setting) => {
                let (place, bytes) = self.value(setting, is_command, "the commands")?;
                let ticket = self.robot.command(place, &bytes);
                let ticket = ticket.map_err(|error| self.refused(error))?;
                self.moved.all(&self.robot, self.now);
                let element = self.robot.model().elements().get(usize::from(place));
                let lasts = element.map_or(0, |element| DeviceTime::from(element.lasts) * 1000);
                return Ok(Doing::Command(ticket, lasts));
            }
            Action::Play { element, sound, on } => {
                let (place, kind) = self.speaker(element)?;
                let playing = Playing::begin(place, kind, &sound.bytes, self.now);
                let playing = playing.map_err(|error| Self::sound_fault(&sound.name, &error))?;
                let end = if *on { self.now } else { playing.end() };
                self.playing = Some(playing);
                return Ok(Doing::Done(end));
            }
            Action::Show { element, bytes } => {
                let (place, _) = self.bytes(element)?;
                self.robot
                    .with(|middle| middle.send_blob(place, &bytes.bytes))
                    .map(drop)
            }
            Action::Activate { element, active } => return self.switch(element, *active),
            Action::Ask(element) => {
                let (place, _) = self.named(element, is_asked, "what can be asked")?;
                self.robot.with(|middle| middle.ask(place))
            }
            Action::Period(ms) => self.robot.set_period(*ms),
            Action::Clear => self.robot.with(|middle| middle.clear_buffers()),
            Action::Wheels(_) => Ok(()),
        };
        taken.map_err(|error| self.refused(error))?;
        self.robot.hurry();
        Ok(Doing::Done(self.now))
    }
}

impl Machine for Mirror {
    type Action = Action;

    const NAME: &str = "the robot";
    const VERBS: &[&str] = Action::VERBS;
    const PERIOD: DeviceTime = 100_000;
    // As its wheels; the robot's watchdog does not wait for longer.
    const PATIENCE: DeviceTime = HOLD;
    const TOLERANCE: f64 = TOLERANCE;

    fn card(&self) -> Card {
        let wheels = self.rover.as_ref().map(Machine::card);
        let card = wheels.unwrap_or_else(|| Card::new("robot", ""));
        let does = "A robot that is mirrored here by its model".to_owned();
        Card { does, ..card }
            .verbs(Action::verbs_of_models(self.robot.model()))
            .measures("loss", "", "The share of packets that are lost")
            .measures("round-trip", "µs", "The round trip to the robot")
    }

    fn read(verb: Word<'_>, words: &mut Words<'_>) -> Option<Result<Action, DeviceError>> {
        Action::read(verb, words)
    }

    fn is_reached(&self) -> bool {
        self.robot.is_up()
    }

    fn attach(action: &mut Action, attachments: &Attachments) -> Result<(), DeviceError> {
        action.attach(attachments)
    }

    fn is_moving(&self) -> bool {
        let drives = self.rover.as_ref().is_some_and(Machine::is_moving);
        let acts = !matches!(self.doing, Doing::Nothing | Doing::Done(_) | Doing::Drives);
        drives || acts || self.stop.is_awaited()
    }

    fn is_at_rest(&self) -> bool {
        !self.is_moving() && !self.is_set && self.playing.is_none()
    }

    fn plan(&mut self, script: &Script<Action>) -> Result<(), DeviceError> {
        for (action, number) in script.actions() {
            self.check(action).map_err(|error| error.at_statement(number))?;
        }
        Ok(())
    }

    fn begin(&mut self, action: &Action, now: DeviceTime) -> Result<(), DeviceError> {
        self.now = now;
        if let Doing::Set(_, places) = std::mem::replace(&mut self.doing, Doing::Nothing) {
            self.end_set(&places, action);
        }
        if self.stop.is_under_way() {
            self.doing = Doing::Waits(action.clone(), now);
            return Ok(());
        }
        self.start(action)
    }

    fn done_at(&self) -> Option<DeviceTime> {
        match &self.doing {
            Doing::Drives => self.rover.as_ref().and_then(Machine::done_at),
            Doing::Done(at) | Doing::Set(at, _) | Doing::Runs(at) => Some(*at),
            Doing::Nothing
            | Doing::Arrives(_)
            | Doing::Switches(..)
            | Doing::Command(..)
            | Doing::Waits(..) => None,
        }
    }

    fn gives_way(&self) -> bool {
        matches!(self.doing, Doing::Drives) && self.rover.as_ref().is_some_and(Machine::gives_way)
    }

    fn halt(&mut self, now: DeviceTime) {
        self.now = now;
        self.stand();
    }

    fn advance(&mut self, now: DeviceTime) {
        self.now = now;
        if let Some(rover) = &mut self.rover {
            rover.advance(now);
        }
        if let Some(playing) = &mut self.playing {
            let sent = playing.advance(&self.robot, now);
            if sent.is_err() || playing.next_wake().is_none() {
                self.playing = None;
            }
            if let Err(error) = sent {
                self.failure = self.failure.take().or(Some(error));
            }
        }
        self.settle();
        self.go_on();
        if self.is_moving() {
            self.moved.goes_on(now);
        }
    }

    fn next_wake(&self) -> Option<DeviceTime> {
        let rover = self.rover.as_ref().and_then(Machine::next_wake);
        let doing = match self.doing {
            Doing::Set(until, _) | Doing::Runs(until) => Some(until.saturating_add(1)),
            Doing::Arrives(_) | Doing::Switches(..) | Doing::Waits(..) => Some(self.now.saturating_add(LOOK)),
            _ => None,
        };
        let stop = self.stop.is_under_way().then(|| self.now.saturating_add(LOOK));
        let playing = self.playing.as_ref().and_then(Playing::next_wake);
        [rover, doing, stop, playing].into_iter().flatten().min()
    }

    fn known_at(&self) -> Option<DeviceTime> {
        let age = DeviceTime::try_from(self.robot.age()?.as_micros()).ok()?;
        Some(self.now.saturating_sub(age))
    }

    fn position(&self) -> Map {
        self.rover.as_ref().map(Machine::position).unwrap_or_default()
    }

    fn measured(&self, at: DeviceTime) -> Option<Sample> {
        self.moved.sample(&self.robot, self.position(), &self.wheels, at)
    }

    /// `{…of its wheels, linked, unreached-why?, period, loss, round-trip?}`: words, ms, a share, µs.
    fn report(&self) -> Map {
        let mut map = self.rover.as_ref().map(Machine::report).unwrap_or_default();
        let trouble = self.robot.trouble();
        map.set("linked", trouble.is_none());
        if let Some(why) = trouble {
            map.set("unreached-why", why);
        }
        let (period, loss, round_trip) = self
            .robot
            .with(|middle| (middle.period(), middle.loss(), middle.round_trip()));
        map.set("period", i64::from(period));
        map.set("loss", thousandths(loss));
        if let Some(micros) = round_trip.and_then(|micros| i64::try_from(micros).ok()) {
            map.set("round-trip", micros);
        }
        map
    }
}
