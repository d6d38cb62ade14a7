//! A device by the declaration of its verbs, for those who build one: the kit does the rest.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use mom_client::{Card, CardVerb, Map, Value};

use crate::call::{check_places, read_statement};
use crate::{
    Attachments, Call, DeviceError, DeviceTime, ErrorName, LOOK_AT_REST, Machine, Script, Statement, Word,
    Words,
};

/// µs between two looks at whether what was begun is done.
const LOOK: DeviceTime = 10_000;

/// µs between two calls of [`Device::keep_alive`].
const ALIVE: DeviceTime = 50_000;

/// So much sooner than that it is called where it is asked for something else just then.
const EARLY: DeviceTime = 10_000;

/// A program that had no turn for so many µs hears what has come meanwhile before it looks again: that may be a stop.
const LATE: DeviceTime = 50_000;

/// A device, as its author says it: what it can do, how it stands still, and where it is.
///
/// Scripts are read by [`Device::verbs`], which stand in its card as well. None of its methods may block: nothing is heard meanwhile.
/// [`obey`](crate::obey) has it obey in a channel.
pub trait Device: Send {
    /// What it is called in texts, such as `the cart`; without the article in its card.
    const NAME: &'static str;

    /// What it is, for people.
    const DOES: &'static str = "";

    /// Within so long it stands once it is halted, whatever it did before.
    const STOPS_WITHIN: Duration = Duration::from_secs(1);

    /// The numbers of its position differ by less than this, each in its unit, while it rests.
    const TOLERANCE: f64 = 1.0;

    /// For so long a velocity goes on if no other follows.
    const VELOCITY_HOLDS: Duration = Duration::from_millis(300);

    /// Whether its present statement comes to its end where the token is given away.
    const COMPLETES_ON_GIVE: bool = false;

    /// The statements of its scripts, with the types, units and ranges of their arguments; always the same.
    fn verbs() -> Vec<CardVerb>;

    /// Begins a statement, and comes back at once.
    ///
    /// # Errors
    ///
    /// Why it cannot be begun. All commands end then, and the device is halted.
    fn begin(&mut self, call: &Call) -> Result<(), DeviceError>;

    /// Whether the statement that was begun last is done; asked every 10 ms, and never of a velocity, which ends by itself.
    ///
    /// # Errors
    ///
    /// Why it cannot go on. All commands end then, and the device is halted.
    fn is_done(&mut self) -> Result<bool, DeviceError>;

    /// Comes to a stand at once. Called at each stop, each loss of the link, each change of the owner and at the end, also where it stands.
    fn halt(&mut self);

    /// Where it is, as numbers: by them its rest is measured, and commands are based on them. An empty map = it does not measure.
    fn position(&self) -> Map;

    /// What else its state says. No key replaces one that every device has.
    fn report(&self) -> Map {
        Map::new()
    }

    /// Checks a script before it waits, with the number of each statement.
    ///
    /// # Errors
    ///
    /// What cannot be carried out, [at its statement](DeviceError::at_statement). Nothing of the script is begun then.
    fn plan(&mut self, _calls: &[(&Call, u32)]) -> Result<(), DeviceError> {
        Ok(())
    }

    /// Whether it can tell its mechanism what to do, and hears of it. What is not reached is never said to rest.
    fn is_reached(&self) -> bool {
        true
    }

    /// Whether an emergency stop at the device itself is pressed, such as a button on it or its pendant; `None` if it knows of none. It is
    /// asked at each turn, each 150 ms at the latest. While it is pressed nothing is carried out, and when it was reset nothing either
    /// until an `unstop` that was said after that.
    fn estop(&self) -> Option<bool> {
        None
    }

    /// Tells its mechanism that its program is there, each 50 ms while a statement that moves it is carried out, and not otherwise. So a
    /// mechanism that stands by itself when it has heard nothing for a moment, such as 0.3 s, stands where the program stands still.
    fn keep_alive(&mut self) {}

    /// Its card with what else it says, such as the fields of its state.
    fn describe(card: Card) -> Card {
        card
    }

    /// Lets time pass until `now`, for a simulated body: µs since its program began.
    fn advance(&mut self, _now: DeviceTime) {}
}

/// A [`Device`] as a [`Machine`]. However it ends, the device is halted.
pub struct Declared<D: Device> {
    device: D,
    now: DeviceTime,
    doing: Doing,
    failure: Option<DeviceError>,
    /// When its mechanism was kept alive last.
    kept: DeviceTime,
}

/// What it does of the statement that was begun last.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Doing {
    Nothing,
    /// It is asked whether it is done, at this time next; it moves the device or not.
    Acts {
        moves: bool,
        look: DeviceTime,
        /// It was late, and has waited once for what came meanwhile.
        has_waited: bool,
    },
    /// It was done then.
    Done(DeviceTime),
    /// A velocity, until then.
    Velocity(DeviceTime),
    /// A velocity has given way: the next one goes on from its speed if it begins now.
    GivesWay(DeviceTime),
}

impl<D: Device> fmt::Debug for Declared<D> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct(D::NAME)
            .field("doing", &self.doing)
            .finish_non_exhaustive()
    }
}

impl<D: Device> Drop for Declared<D> {
    fn drop(&mut self) {
        self.device.halt();
    }
}

impl<D: Device> Declared<D> {
    /// This device, which is halted first: it may do what it did before.
    #[must_use]
    pub fn new(mut device: D) -> Self {
        device.halt();
        Self {
            device,
            now: 0,
            doing: Doing::Nothing,
            failure: None,
            kept: DeviceTime::MIN,
        }
    }

    /// The device itself.
    #[must_use]
    pub fn device(&self) -> &D {
        &self.device
    }

    /// The device itself, such as to tell it what its mechanism said.
    pub fn device_mut(&mut self) -> &mut D {
        &mut self.device
    }
}

/// With null for numbers that are not finite: no form can say those, and the whole state would be lost.
fn sayable(said: Map) -> Map {
    said.into_iter()
        .fold(Map::new(), |map, (key, value)| map.with(&key, finite(value)))
}

fn finite(value: Value) -> Value {
    match value {
        Value::Double(number) => number.into(),
        Value::List(values) => Value::List(values.into_iter().map(finite).collect()),
        Value::Map(map) => sayable(map).into(),
        other => other,
    }
}

const fn micros(duration: Duration) -> DeviceTime {
    duration.as_micros() as DeviceTime
}

impl<D: Device> Machine for Declared<D> {
    type Action = Call;

    const NAME: &str = D::NAME;
    /// They are read by the card.
    const VERBS: &[&str] = &[];
    const STOPPING_TIME: DeviceTime = micros(D::STOPS_WITHIN);
    const TOLERANCE: f64 = D::TOLERANCE;
    const COMPLETES: bool = D::COMPLETES_ON_GIVE;

    fn card(&self) -> Card {
        let name = D::NAME.strip_prefix("the ").unwrap_or(D::NAME);
        D::describe(Card::new(name, D::DOES).verbs(D::verbs()))
    }

    fn read(verb: Word<'_>, words: &mut Words<'_>) -> Option<Result<Call, DeviceError>> {
        let verbs: Vec<Arc<CardVerb>> = D::verbs().into_iter().map(Arc::new).collect();
        Some(read_statement(&verbs, verb, words))
    }

    fn attach(call: &mut Call, attachments: &Attachments) -> Result<(), DeviceError> {
        call.attach(attachments)
    }

    fn is_relative(call: &Call) -> Option<bool> {
        let verb = call.verb();
        (verb.moves && !verb.in_place).then_some(verb.relative)
    }

    fn never_waits(call: &Call) -> bool {
        call.verb().velocity
    }

    fn is_moving(&self) -> bool {
        match self.doing {
            Doing::Acts { moves, .. } => moves,
            Doing::Velocity(_) | Doing::GivesWay(_) => true,
            Doing::Nothing | Doing::Done(_) => false,
        }
    }

    fn is_at_rest(&self) -> bool {
        matches!(self.doing, Doing::Nothing | Doing::Done(_))
    }

    fn is_reached(&self) -> bool {
        self.device.is_reached()
    }

    fn estop(&self) -> Option<bool> {
        self.device.estop()
    }

    fn plan(&mut self, script: &Script<Call>) -> Result<(), DeviceError> {
        let verbs = script.statements().iter().map(|statement| match statement {
            Statement::Do(call) => Some(call.verb()),
            Statement::Wait(_) => None,
        });
        check_places(verbs)
            .map_err(|(number, text)| DeviceError::new(ErrorName::Syntax, text).at_statement(number))?;
        let calls: Vec<(&Call, u32)> = script.actions().collect();
        self.device.plan(&calls)
    }

    fn begin(&mut self, call: &Call, now: DeviceTime) -> Result<(), DeviceError> {
        self.now = now;
        let is_velocity = call.verb().velocity;
        if matches!(self.doing, Doing::GivesWay(_)) && !is_velocity {
            self.device.halt();
        }
        self.doing = Doing::Nothing;
        self.device.begin(call)?;
        self.doing = match is_velocity {
            true => Doing::Velocity(now.saturating_add(micros(D::VELOCITY_HOLDS))),
            // Not at once: a stop that came while it began is heard before the next one begins.
            false => Doing::Acts {
                moves: call.verb().moves,
                look: now.saturating_add(LOOK),
                has_waited: false,
            },
        };
        Ok(())
    }

    fn done_at(&self) -> Option<DeviceTime> {
        match self.doing {
            Doing::Done(at) | Doing::Velocity(at) => Some(at),
            _ => None,
        }
    }

    fn pursue(&mut self, until: DeviceTime) -> Option<DeviceTime> {
        if let Doing::Acts {
            moves,
            look,
            has_waited,
        } = self.doing
        {
            if until < look {
                return None;
            }
            let again = |has_waited| Doing::Acts {
                moves,
                look: until.saturating_add(LOOK),
                has_waited,
            };
            if until.saturating_sub(self.now) > LATE && !has_waited {
                self.doing = again(true);
                return None;
            }
            match self.device.is_done() {
                Ok(false) => {
                    self.doing = again(false);
                    return None;
                }
                Ok(true) => {}
                Err(error) => self.failure = Some(error),
            }
            self.doing = Doing::Done(until);
        }
        self.done_at().filter(|done| *done <= until)
    }

    fn take_failure(&mut self) -> Option<DeviceError> {
        self.failure.take()
    }

    fn gives_way(&self) -> bool {
        matches!(self.doing, Doing::Velocity(_))
    }

    fn give_way(&mut self, now: DeviceTime) {
        self.doing = Doing::GivesWay(now);
    }

    fn halt(&mut self, now: DeviceTime) {
        (self.now, self.doing, self.failure) = (now, Doing::Nothing, None);
        self.device.halt();
    }

    fn advance(&mut self, now: DeviceTime) {
        self.now = now;
        self.device.advance(now);
        if self.is_moving() && now.saturating_sub(self.kept) >= ALIVE - EARLY {
            self.kept = now;
            self.device.keep_alive();
        }
        // Nothing has gone on from its speed.
        if matches!(self.doing, Doing::GivesWay(since) if now > since) {
            self.halt(now);
        }
    }

    fn next_wake(&self) -> Option<DeviceTime> {
        match self.doing {
            Doing::Acts { look, .. } => Some(look),
            Doing::GivesWay(since) => Some(since.saturating_add(1)),
            Doing::Velocity(_) => Some(self.now.saturating_add(ALIVE)),
            _ => Some(self.now.saturating_add(LOOK_AT_REST)),
        }
    }

    fn position(&self) -> Map {
        sayable(self.device.position())
    }

    fn report(&self) -> Map {
        sayable(self.device.report())
    }
}
