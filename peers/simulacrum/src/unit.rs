//! A mirrored robot as a machine of the hub: its owner commands it in the terms of its model.

use mom_client::Map;
use mom_device::{Attachments, DeviceError, DeviceTime, ErrorName, Machine, Script, Word, Words};
use mom_rover::Rover;
use mom_rsp::middle::Notice;
use mom_rsp::{Kind, Motion, Payload, Refused, Sound};
use mom_rsp_model::ModelElement;
use mom_sound::{Clip, Encoder, SoundError};
use mom_wheels::Chassis;

use crate::playing::Playing;
use crate::teller::thousandths;
use crate::{Action, Setting, Simulacrum, Wheels, to_wire};

/// A robot and what is done with it at present.
///
/// Its program hands it the notices of its middle ([`Mirror::heard`]).
#[derive(Debug)]
pub struct Mirror {
    robot: Simulacrum,
    /// What drives its wheels, if it has some.
    rover: Option<Rover>,
    now: DeviceTime,
    doing: Doing,
    /// The sound that is played, whatever else is done.
    playing: Option<Playing>,
    /// An effector may have another value than its safe one, by a statement that is done.
    is_set: bool,
    /// Effectors that are switched off until the robot has confirmed it, so that they forget the steps that they have not made.
    held: Vec<u8>,
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
    /// The end of this command is awaited.
    Command(u32),
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
        let wheels = Wheels::of(&robot, chassis);
        let rover = wheels.map(|wheels| Rover::new(Box::new(wheels), chassis, unit));
        let mut mirror = Self {
            robot,
            rover,
            now: 0,
            doing: Doing::Nothing,
            playing: None,
            is_set: false,
            held: Vec::new(),
            failure: None,
        };
        mirror.rest();
        mirror
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
        let awaited = match self.doing {
            Doing::Command(ticket) => Some(ticket),
            _ => None,
        };
        let lost = |text: String| Err(DeviceError::new(ErrorName::Link, text));
        match notice {
            Notice::Done { ticket, .. } if awaited == Some(*ticket) => {
                self.doing = Doing::Done(self.now);
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
            Notice::Active {
                element,
                active: false,
            } if self.held.contains(element) => {
                self.held.retain(|held| held != element);
                if let Err(error) = self.robot.with(|middle| middle.set_activated(*element, true)) {
                    tracing::error!(robot = name, element, %error, "it stays switched off");
                }
                self.robot.hurry();
                Ok(())
            }
            // What was written before is forgotten, and the robot rests.
            Notice::Up => {
                self.held.clear();
                self.rest();
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

    /// Whether something failed since this was asked last.
    pub fn take_failure(&mut self) -> Option<DeviceError> {
        let rover = self.rover.as_mut().and_then(Rover::take_failure);
        rover.or(self.failure.take())
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
        // Pictures and sounds end by themselves.
        if element.quantities.is_empty() || !self.robot.is_up() {
            // Without a session the robot has its safe values already.
            return;
        }
        let taken = match element.motion {
            Motion::Absolute { .. } => self.robot.write(place, &element.safe),
            Motion::Incremental { .. } => self.hold(place),
        };
        if let Err(error) = taken {
            tracing::error!(robot = self.robot.name(), element = element.name, %error, "a safe value was not taken");
        }
    }

    /// An effector that moves by steps makes none of those that it was told and has not made yet: a step of 0 would not take them back.
    fn hold(&mut self, place: u8) -> Result<(), Refused> {
        if !self.is_set || !self.robot.with(|middle| middle.activated(place)) {
            return Ok(());
        }
        self.held.push(place);
        self.robot.with(|middle| middle.set_activated(place, false))
    }

    fn stand(&mut self) {
        self.doing = Doing::Nothing;
        self.playing = None;
        let now = self.now;
        if let Some(rover) = &mut self.rover {
            rover.halt(now);
        }
        self.rest();
    }

    /// The element that a statement names.
    fn named(
        &self,
        name: &str,
        is_right: impl Fn(Kind) -> bool,
        what: &str,
    ) -> Result<(u8, &ModelElement), DeviceError> {
        let syntax = |text: String| DeviceError::new(ErrorName::Syntax, text);
        let Some((place, element)) = self.robot.element(name) else {
            let all = self.robot.model().elements().iter();
            let right: Vec<&str> = all
                .filter(|element| is_right(element.kind))
                .map(|element| element.name.as_str())
                .collect();
            return Err(syntax(format!(
                "{} has no element `{name}`; {what} are {}",
                self.robot.name(),
                right.join(", ")
            )));
        };
        match is_right(element.kind) {
            true => Ok((place, element)),
            false => Err(syntax(format!("`{name}` is not one of {what}"))),
        }
    }

    fn value(
        &self,
        setting: &Setting,
        is_right: impl Fn(Kind) -> bool,
        what: &str,
    ) -> Result<(u8, Vec<u8>), DeviceError> {
        let (place, element) = self.named(&setting.element, is_right, what)?;
        let bytes = to_wire(element, &setting.values);
        let bytes = bytes.map_err(|error| DeviceError::new(ErrorName::Syntax, error.to_string()))?;
        Ok((place, bytes))
    }

    /// Whether an action is one of this robot.
    fn check(&self, action: &Action) -> Result<(), DeviceError> {
        match action {
            Action::Wheels(_) if self.rover.is_none() => {
                let text = format!("{} has no wheels in its model", self.robot.name());
                Err(DeviceError::new(ErrorName::Syntax, text))
            }
            Action::Wheels(mom_fleet::Action::Leds(_)) => {
                let text = format!("{} has no LEDs; `set` sets its effectors", self.robot.name());
                Err(DeviceError::new(ErrorName::Syntax, text))
            }
            Action::Set { settings, ms } => settings.iter().try_for_each(|setting| {
                let (place, _) = self.value(setting, is_effector, "the effectors")?;
                let element = self.robot.model().elements().get(usize::from(place));
                let speeds = element.map_or(&[][..], |element| &element.quantities);
                match ms.is_none() && speeds.iter().any(|quantity| quantity.unit.ends_with("/s")) {
                    true => {
                        let text = format!(
                            "`{}` is a speed: say for how long, as in `set {0} 100 for 1000`",
                            setting.element
                        );
                        Err(DeviceError::new(ErrorName::Syntax, text))
                    }
                    false => Ok(()),
                }
            }),
            Action::Do(setting) => self.value(setting, is_command, "the commands").map(drop),
            Action::Play { element, sound, .. } => {
                let (_, kind) = self.speaker(element)?;
                let heard = Clip::read(&sound.bytes).and_then(|_| Encoder::new(kind));
                heard
                    .map(drop)
                    .map_err(|error| Self::sound_fault(&sound.name, &error))
            }
            Action::Show { element, bytes } => {
                self.bytes(element)?;
                match bytes.bytes.is_empty() {
                    true => {
                        let text = format!("`{}` is empty", bytes.name);
                        Err(DeviceError::new(ErrorName::Syntax, text))
                    }
                    false => Ok(()),
                }
            }
            Action::Activate { element, .. } => {
                self.named(element, is_switched, "what can be switched").map(drop)
            }
            Action::Ask(element) => self.named(element, is_asked, "what can be asked").map(drop),
            Action::Wheels(_) | Action::Period(_) | Action::Clear => Ok(()),
        }
    }

    /// The effector of type bytes that a statement names, and what sound it plays.
    fn bytes(&self, name: &str) -> Result<(u8, Option<Sound>), DeviceError> {
        let (place, element) = self.named(name, is_effector, "the effectors")?;
        match element.payload {
            Payload::Bytes(_) => Ok((place, element.sound)),
            _ => {
                let text = format!("`{name}` takes numbers: `set` sets it");
                Err(DeviceError::new(ErrorName::Syntax, text))
            }
        }
    }

    /// The effector that plays sounds, and which.
    fn speaker(&self, name: &str) -> Result<(u8, Sound), DeviceError> {
        let (place, sound) = self.bytes(name)?;
        let sound = sound.ok_or_else(|| {
            let text = format!("`{name}` plays no sound by its model; `show` hands bytes to it");
            DeviceError::new(ErrorName::Syntax, text)
        })?;
        Ok((place, sound))
    }

    fn sound_fault(name: &str, error: &SoundError) -> DeviceError {
        DeviceError::new(ErrorName::Syntax, format!("`{name}` cannot be played: {error}"))
    }

    fn refused(&self, refused: Refused) -> DeviceError {
        let text = format!("{} does not take it: {refused}", self.robot.name());
        DeviceError::new(ErrorName::Link, text)
    }

    fn begin_other(&mut self, action: &Action) -> Result<Doing, DeviceError> {
        if !self.robot.is_up() {
            let text = format!(
                "{} is not reached: it has no session at present",
                self.robot.name()
            );
            return Err(DeviceError::new(ErrorName::Link, text));
        }
        let taken = match action {
            Action::Set { settings, ms } => {
                let mut places = Vec::new();
                self.is_set = true;
                for setting in settings {
                    let (place, bytes) = self.value(setting, is_effector, "the effectors")?;
                    self.robot
                        .write(place, &bytes)
                        .map_err(|error| self.refused(error))?;
                    places.push(place);
                }
                self.robot.hurry();
                return Ok(match ms {
                    Some(ms) => Doing::Set(self.now.saturating_add(DeviceTime::from(*ms) * 1000), places),
                    None => Doing::Done(self.now),
                });
            }
            Action::Do(setting) => {
                let (place, bytes) = self.value(setting, is_command, "the commands")?;
                let ticket = self.robot.command(place, &bytes);
                return Ok(Doing::Command(ticket.map_err(|error| self.refused(error))?));
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
            Action::Activate { element, active } => {
                let (place, _) = self.named(element, is_switched, "what can be switched")?;
                self.robot.with(|middle| middle.set_activated(place, *active))
            }
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

fn is_effector(kind: Kind) -> bool {
    kind == Kind::Effector
}

fn is_command(kind: Kind) -> bool {
    matches!(kind, Kind::Command | Kind::MemoryCommand)
}

fn is_switched(kind: Kind) -> bool {
    matches!(kind, Kind::Effector | Kind::Sensor | Kind::Monitor | Kind::Module)
}

fn is_asked(kind: Kind) -> bool {
    matches!(kind, Kind::Sensor | Kind::Monitor | Kind::MemoryEvent)
}

impl Machine for Mirror {
    type Action = Action;

    const NAME: &str = "the robot";
    const VERBS: &[&str] = Action::VERBS;
    const PERIOD: DeviceTime = 100_000;
    // Odometry in whole mm and degrees.
    const TOLERANCE: f64 = 2.0;

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
        drives || matches!(self.doing, Doing::Set(..) | Doing::Command(_))
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
        self.doing = match (action, &mut self.rover) {
            (Action::Wheels(action), Some(rover)) => {
                rover.begin(action, now)?;
                self.robot.hurry();
                Doing::Drives
            }
            (_, rover) => {
                if let Some(rover) = rover.as_mut().filter(|rover| rover.is_moving()) {
                    rover.halt(now);
                }
                self.begin_other(action)?
            }
        };
        Ok(())
    }

    fn done_at(&self) -> Option<DeviceTime> {
        match &self.doing {
            Doing::Drives => self.rover.as_ref().and_then(Machine::done_at),
            Doing::Done(at) | Doing::Set(at, _) => Some(*at),
            Doing::Nothing | Doing::Command(_) => None,
        }
    }

    fn gives_way(&self) -> bool {
        matches!(self.doing, Doing::Drives) && self.rover.as_ref().is_some_and(Machine::gives_way)
    }

    fn halt(&mut self, now: DeviceTime) {
        self.now = now;
        self.stand();
        self.robot.hurry();
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
        // Later than its end by a moment, so that a `set` that follows at once sets other values without a rest between.
        if let Doing::Set(until, places) = &self.doing
            && now > *until
        {
            let (robot, places) = (self.robot.clone(), places.clone());
            for place in places {
                if let Some(element) = robot.model().elements().get(usize::from(place)) {
                    self.write_safe(place, element);
                }
            }
            self.doing = Doing::Nothing;
        }
    }

    fn next_wake(&self) -> Option<DeviceTime> {
        let rover = self.rover.as_ref().and_then(Machine::next_wake);
        let set = match self.doing {
            Doing::Set(until, _) => Some(until.saturating_add(1)),
            _ => None,
        };
        let playing = self.playing.as_ref().and_then(Playing::next_wake);
        [rover, set, playing].into_iter().flatten().min()
    }

    fn known_at(&self) -> Option<DeviceTime> {
        let age = DeviceTime::try_from(self.robot.age()?.as_micros()).ok()?;
        Some(self.now.saturating_sub(age))
    }

    fn position(&self) -> Map {
        self.rover.as_ref().map(Machine::position).unwrap_or_default()
    }

    /// `{…of its wheels, linked, period, loss, round-trip?}`: ms, a share, µs.
    fn report(&self) -> Map {
        let mut map = self.rover.as_ref().map(Machine::report).unwrap_or_default();
        map.set("linked", self.robot.is_up());
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

impl Mirror {
    /// What was set for a time rests, unless it is set anew.
    fn end_set(&mut self, places: &[u8], next: &Action) {
        let again: &[Setting] = match next {
            Action::Set { settings, .. } => settings,
            _ => &[],
        };
        let robot = self.robot.clone();
        for place in places {
            let Some(element) = robot.model().elements().get(usize::from(*place)) else {
                continue;
            };
            if again.iter().all(|setting| setting.element != element.name) {
                self.write_safe(*place, element);
            }
        }
    }
}
