//! What a statement of a robot's scripts makes it do.

use std::ops::RangeInclusive;
use std::sync::Arc;

use mom_client::{Card, CardArg, CardType, CardVerb, FieldType};
use mom_device::{DeviceError, Word, Words};

/// Coordinates of points, mm: what five characters of the fleet's wire hold (W3).
pub const PLACES: RangeInclusive<i32> = -9999..=99_999;
/// Distances from a leader, mm.
const DISTANCES: RangeInclusive<i32> = 250..=10_000;
/// The longest time for which one statement sets the motors, in ms.
const LONGEST: i32 = 60_000;

/// What a statement makes the robot do.
///
/// | statement | does |
/// |---|---|
/// | `motor left right ms` | sets the motors, −1000 to 1000 per mille each, for 1 to 60 000 ms; then they stop, unless another `motor`
/// follows |
/// | `leds data` | sets the LEDs, a bit each, 0 to 255 |
/// | `goto x y` | drives there, mm, and is done when it is there |
/// | `via x y …` | drives there by way of points: `via 1000 0 1000 1000 0 1000` is to the third by the first and the second (W17) |
/// | `follow leader distance` | drives where the peer of this name drove, mm behind it, until another command comes (W22); the last of its
/// script |
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Sets both motors for so many ms.
    Motor {
        /// The left one, per mille.
        left: i32,
        /// The right one, per mille.
        right: i32,
        /// For how long.
        ms: i32,
    },
    /// Sets the LEDs.
    Leds(i32),
    /// Drives to the last point by way of the others, mm.
    Drive(Vec<(i32, i32)>),
    /// Follows a leader.
    Follow {
        /// The leader's peer, as the hub names it.
        leader: Arc<str>,
        /// How far behind, mm along its trail.
        distance: i32,
    },
}

impl Action {
    /// The verbs.
    pub const VERBS: &[&str] = &["motor", "leds", "goto", "via", "follow"];

    /// The verbs of robots that are mirrored by a model (`mom-simulacrum`): what follows them only that model knows.
    pub const OF_MODELS: &[&str] = &[
        "set",
        "do",
        "play",
        "show",
        "activate",
        "deactivate",
        "ask",
        "period",
        "clear",
    ];

    /// Its statements as others see them.
    #[must_use]
    pub fn verbs() -> [CardVerb; 5] {
        let within = |arg: CardArg, range: &RangeInclusive<i32>| {
            arg.within(f64::from(*range.start())..=f64::from(*range.end()))
        };
        let place = || ["x", "y"].map(|name| within(CardArg::whole(name, "mm"), &PLACES));
        let motor = |name| CardArg::whole(name, "‰").within(-1000.0..=1000.0);
        let lasting = CardArg::whole("ms", "ms").within(1.0..=f64::from(LONGEST));
        let follow = CardVerb {
            last: true,
            ..CardVerb::motion("follow", "Drives where a peer drove, until the next command")
        };
        [
            CardVerb::motion("motor", "Sets the motors for a time").args([
                motor("left"),
                motor("right"),
                lasting,
            ]),
            CardVerb::new("leds", "Sets the LEDs, a bit each")
                .args([CardArg::whole("data", "").within(0.0..=255.0)]),
            CardVerb::motion("goto", "Drives to a place").args(place()),
            CardVerb::motion("via", "Drives to the last of these places by way of the others")
                .args(place())
                .repeating(2),
            follow.args([
                CardArg::new("leader", CardType::Word),
                within(CardArg::whole("distance", "mm"), &DISTANCES),
            ]),
        ]
    }

    /// Reads what follows a verb; `None` if there is no such verb.
    ///
    /// # Errors
    ///
    /// `syntax`, at the word that is wrong.
    pub fn read(verb: Word<'_>, words: &mut Words<'_>) -> Option<Result<Self, DeviceError>> {
        Some(match verb.text {
            "motor" => motor(words),
            "leds" => words
                .whole("leds", "a mask of bits", "it", 0..=255)
                .map(Self::Leds),
            "goto" => point("goto", words).map(|point| Self::Drive(vec![point])),
            "via" => points(words).map(Self::Drive),
            "follow" => follow(words),
            _ => return None,
        })
    }
}

/// The card of a robot on wheels, without its statements.
#[must_use]
pub fn card_of(does: &str) -> Card {
    Card::new("robot", does)
        .measures("x", "mm", "Where it is")
        .measures("y", "mm", "Where it is")
        .measures("heading", "°", "Where it faces")
        .measures("battery", "%", "What is left in the battery")
        .tells("leds", FieldType::Whole, "The LEDs, a bit each")
        .tells(
            "switches",
            FieldType::Whole,
            "The switches that are pressed, a bit each",
        )
        .tells(
            "charging",
            FieldType::Boolean,
            "Whether the battery is being charged",
        )
}

fn motor(words: &mut Words<'_>) -> Result<Action, DeviceError> {
    let takes = "two motors and a time, left right ms";
    let mut whole = |which, range| words.whole("motor", takes, which, range);
    Ok(Action::Motor {
        left: whole("left", -1000..=1000)?,
        right: whole("right", -1000..=1000)?,
        ms: whole("ms", 1..=LONGEST)?,
    })
}

fn point(verb: &str, words: &mut Words<'_>) -> Result<(i32, i32), DeviceError> {
    let mut whole = |which| words.whole(verb, "two coordinates, x y in mm", which, PLACES);
    Ok((whole("x")?, whole("y")?))
}

fn points(words: &mut Words<'_>) -> Result<Vec<(i32, i32)>, DeviceError> {
    let mut points = vec![point("via", words)?];
    while !words.is_over() {
        points.push(point("via", words)?);
    }
    Ok(points)
}

fn follow(words: &mut Words<'_>) -> Result<Action, DeviceError> {
    let takes = "a leader and a distance, peer mm";
    Ok(Action::Follow {
        leader: words.need("follow", takes, "the leader")?.text.into(),
        distance: words.whole("follow", takes, "the distance", DISTANCES)?,
    })
}

#[cfg(test)]
mod tests {
    use mom_client::Map;
    use mom_device::{DeviceTime, Machine, Script, Statement};

    use super::*;

    /// A robot that does nothing.
    #[derive(Debug)]
    struct Idle;

    impl Machine for Idle {
        type Action = Action;

        const NAME: &str = "the robot";
        const VERBS: &[&str] = Action::VERBS;

        fn card(&self) -> Card {
            Card::new("robot", "").verbs(Action::verbs())
        }
        fn read(verb: Word<'_>, words: &mut Words<'_>) -> Option<Result<Action, DeviceError>> {
            Action::read(verb, words)
        }
        fn is_moving(&self) -> bool {
            false
        }
        fn plan(&mut self, _: &Script<Action>) -> Result<(), DeviceError> {
            Ok(())
        }
        fn begin(&mut self, _: &Action, _: DeviceTime) -> Result<(), DeviceError> {
            Ok(())
        }
        fn done_at(&self) -> Option<DeviceTime> {
            None
        }
        fn halt(&mut self, _: DeviceTime) {}
        fn advance(&mut self, _: DeviceTime) {}
        fn position(&self) -> Map {
            Map::new()
        }
    }

    fn read(text: &str) -> Result<Vec<Statement<Action>>, DeviceError> {
        Script::read::<Idle>(text).map(|script| script.statements().to_vec())
    }

    #[test]
    fn places_are_those_of_the_wire() {
        assert_eq!(PLACES, mom_brs::LOWEST..=mom_brs::HIGHEST);
    }

    #[test]
    fn statements_are_read() {
        let motor = Action::Motor {
            left: 50,
            right: -50,
            ms: 1500,
        };
        for (text, expected) in [
            ("motor 50 -50 1500", Statement::Do(motor)),
            ("leds 255", Statement::Do(Action::Leds(255))),
            ("goto -5 99999", Statement::Do(Action::Drive(vec![(-5, 99_999)]))),
            (
                "via 1 2 3 4 # by a",
                Statement::Do(Action::Drive(vec![(1, 2), (3, 4)])),
            ),
            (
                "follow rover-a 500",
                Statement::Do(Action::Follow {
                    leader: "rover-a".into(),
                    distance: 500,
                }),
            ),
            ("wait 5", Statement::Wait(5)),
        ] {
            assert_eq!(read(text), Ok(vec![expected]), "{text}");
        }
    }

    #[test]
    fn mistakes_are_told_with_their_place() {
        for (text, column, words) in [
            (
                "motor 1001 0 5",
                7,
                "statement 1: `motor` takes two motors and a time, left right ms: left is a whole number from -1000 to 1000, not `1001`",
            ),
            (
                "motor 0 0",
                10,
                "statement 1: `motor` takes two motors and a time, left right ms; ms is missing",
            ),
            (
                "via 1 2 3",
                10,
                "statement 1: `via` takes two coordinates, x y in mm; y is missing",
            ),
            (
                "follow rover-a 10",
                16,
                "statement 1: `follow` takes a leader and a distance, peer mm: the distance is a whole number from 250 to 10000, not `10`",
            ),
            (
                "gogo 1 2",
                1,
                "statement 1: there is no `gogo`; did you mean `goto`?",
            ),
            (
                "leds 1 2",
                8,
                "statement 1: `leds` ends before `2`; is a `;` or a new line missing?",
            ),
        ] {
            let error = read(text).expect_err(text);
            assert_eq!(
                (error.text(), error.place()),
                (words, Some((1, column))),
                "{text}"
            );
        }
    }
}
