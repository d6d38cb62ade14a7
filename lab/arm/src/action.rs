//! What a statement makes the arm do: reading it and writing it.

use std::fmt;

use mom_client::{CardArg, CardVerb};
use mom_device::{DeviceError, Word, Words};

use crate::controller::Grip;
use crate::jog::{self, Velocity};
use crate::pose::{HOME, Pose};
use crate::workspace::WORKSPACE;

/// What a statement makes the arm do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action {
    /// Move the hand to a pose.
    Move(Pose),
    /// Move the hand by so much; the numbers of a pose are differences here.
    By(Pose),
    /// Move the jaws.
    Grip(Grip),
    /// Move the hand at a velocity for so many ms.
    Jog(Velocity, u32),
    /// Move the hand to its home pose.
    Home,
    /// Put everything back to where it was at the start.
    Reset,
}

/// The first words of its statements, but for `wait`.
pub(crate) const VERBS: &[&str] = &["move", "by", "grip", "jog", "home", "reset"];
const GRIPS: [&str; 2] = ["open", "close"];

impl Action {
    /// Its statements as others see them.
    pub(crate) fn verbs() -> [CardVerb; 6] {
        let lengths = |names: [&str; 3], unit: &str| names.map(|name| CardArg::number(name, unit));
        let turns = |names: [&str; 2], unit: &str| names.map(|name| CardArg::number(name, unit));
        let (x, y, z) = (&WORKSPACE.x, &WORKSPACE.y, &WORKSPACE.z);
        let place = [("x", x), ("y", y), ("z", z)]
            .map(|(name, range)| CardArg::number(name, "mm").within(range.clone()));
        let lean = [("spin", &WORKSPACE.spin), ("tilt", &WORKSPACE.tilt)]
            .map(|(name, range)| CardArg::number(name, "°").within(range.clone()));
        let by = CardVerb {
            relative: true,
            ..CardVerb::motion("by", "Moves the hand by so much from where it is")
        };
        let jog = CardVerb {
            velocity: true,
            ..CardVerb::motion("jog", "Moves the hand at a velocity; another one takes its place")
        };
        let grip = CardVerb {
            in_place: true,
            ..CardVerb::motion("grip", "Moves the jaws")
        };
        let lasting = CardArg::whole("ms", "ms").within(1.0..=f64::from(jog::MOST_MS));
        [
            CardVerb::motion("move", "Moves the hand to a pose")
                .args(place)
                .args(lean),
            by.args(lengths(["dx", "dy", "dz"], "mm"))
                .args(turns(["dspin", "dtilt"], "°")),
            grip.args([CardArg::one_of("grip", &GRIPS)]),
            jog.args(lengths(["vx", "vy", "vz"], "mm/s"))
                .args(turns(["vspin", "vtilt"], "°/s"))
                .args([lasting.or(i64::from(jog::DEFAULT_MS))]),
            CardVerb::motion("home", "Moves the hand to where it is at the start"),
            CardVerb::motion(
                "reset",
                "Puts hand, jaws and blocks back, at once: this arm is simulated",
            ),
        ]
    }

    /// Reads what follows a verb; none if there is no such verb.
    pub(crate) fn read(verb: Word<'_>, words: &mut Words<'_>) -> Option<Result<Self, DeviceError>> {
        let mut pose = |takes, [x, y, z, spin, tilt]: [&str; 5]| {
            let mut number = |which| words.number(verb.text, takes, which);
            Ok(Pose {
                x: number(x)?,
                y: number(y)?,
                z: number(z)?,
                spin: number(spin)?,
                tilt: number(tilt)?,
            })
        };
        Some(match verb.text {
            "move" => pose("five numbers, x y z spin tilt", ["x", "y", "z", "spin", "tilt"]).map(Self::Move),
            "by" => {
                let names = ["dx", "dy", "dz", "dspin", "dtilt"];
                pose("five numbers, dx dy dz dspin dtilt", names).map(Self::By)
            }
            "grip" => read_grip(words).map(Self::Grip),
            "jog" => read_jog(verb, words),
            "home" => Ok(Self::Home),
            "reset" => Ok(Self::Reset),
            _ => return None,
        })
    }

    /// Where it moves the hand from this pose, if it does.
    pub(crate) fn target(&self, from: &Pose) -> Option<Pose> {
        match self {
            Self::Move(pose) => Some(*pose),
            Self::By(by) => Some(from.plus(by)),
            Self::Home => Some(HOME),
            Self::Grip(_) | Self::Jog(..) | Self::Reset => None,
        }
    }
}

fn read_grip(words: &mut Words<'_>) -> Result<Grip, DeviceError> {
    let word = words.need("grip", "`open` or `close`", "it")?;
    match word.text {
        "open" => Ok(Grip::Open),
        "close" => Ok(Grip::Close),
        _ => {
            let nearest = word.nearest(&GRIPS);
            let text = format!("there is no `{}`; did you mean `{nearest}`?", word.short());
            Err(DeviceError::syntax(word.at, text).with_nearest(nearest))
        }
    }
}

fn read_jog(verb: Word<'_>, words: &mut Words<'_>) -> Result<Action, DeviceError> {
    let mut number = |which| words.number("jog", "five velocities, vx vy vz vspin vtilt", which);
    let velocity = Velocity::of([
        number("vx")?,
        number("vy")?,
        number("vz")?,
        number("vspin")?,
        number("vtilt")?,
    ]);
    velocity.check().map_err(|error| error.at_position(verb.at))?;
    if words.is_over() {
        return Ok(Action::Jog(velocity, jog::DEFAULT_MS));
    }
    let most = i32::try_from(jog::MOST_MS).unwrap_or(i32::MAX);
    let ms = words.whole("jog", "a sixth number", "for how many ms", 1..=most)?;
    Ok(Action::Jog(velocity, u32::try_from(ms).unwrap_or(jog::MOST_MS)))
}

/// Numbers, each behind a blank.
fn write_numbers(f: &mut fmt::Formatter<'_>, numbers: [f64; 5]) -> fmt::Result {
    numbers.into_iter().try_for_each(|value| {
        // Debug writes very large and very small numbers with an exponent, Display never does.
        let plain = value == 0.0 || (1e-5..1e15).contains(&value.abs());
        if plain {
            write!(f, " {value}")
        } else {
            write!(f, " {value:?}")
        }
    })
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Move(pose) => {
                f.write_str("move")?;
                write_numbers(f, [pose.x, pose.y, pose.z, pose.spin, pose.tilt])
            }
            Self::By(pose) => {
                f.write_str("by")?;
                write_numbers(f, [pose.x, pose.y, pose.z, pose.spin, pose.tilt])
            }
            Self::Jog(velocity, ms) => {
                f.write_str("jog")?;
                write_numbers(f, velocity.numbers())?;
                write!(f, " {ms}")
            }
            Self::Grip(Grip::Open) => f.write_str("grip open"),
            Self::Grip(Grip::Close) => f.write_str("grip close"),
            Self::Home => f.write_str("home"),
            Self::Reset => f.write_str("reset"),
        }
    }
}

/// A velocity stands alone: what would follow it would begin nobody knows where.
pub(crate) fn check_jogs(script: &mom_device::Script<Action>) -> Result<(), DeviceError> {
    let jog = script
        .actions()
        .find(|(action, _)| matches!(action, Action::Jog(..)));
    match jog {
        Some((_, number)) if script.statements().len() > 1 => {
            let error = DeviceError::syntax(0, "`jog` stands alone in its script");
            Err(error.at_statement(number))
        }
        _ => Ok(()),
    }
}
