//! What every device does alike, replayed by a cart that has all that the dialogues ask for.

use mom_client::{Card, CardArg, CardVerb, Map, Value};
use mom_device::{DeviceError, DeviceTime, ErrorName, LOOK_AT_REST, Machine, Script, Word, Words};
use mom_device_cases::{Stage, Statements, replay};

/// mm/s, and µs for which a velocity holds.
const SPEED: f64 = 100.0;
const HOLDS: DeviceTime = 200_000;

/// mm from the middle of its rail to an end.
const END: f64 = 1000.0;

#[derive(Debug, Clone, PartialEq)]
enum Deed {
    Go(f64),
    By(f64),
    Jog(f64),
}

/// A cart on a rail that stands at once; `COMPLETES` as its machine's.
#[derive(Debug, Default)]
struct Cart<const COMPLETES: bool> {
    now: DeviceTime,
    x: f64,
    /// Where it will be.
    planned: f64,
    /// mm/s, and until when.
    speed: f64,
    until: DeviceTime,
    jogs: bool,
    /// mm/s, by something that it knows nothing of.
    pushed: f64,
    /// Its emergency stop is pressed.
    is_pressed: bool,
}

impl<const COMPLETES: bool> Cart<COMPLETES> {
    fn drive(&mut self, way: f64, now: DeviceTime) {
        self.speed = SPEED * way.signum();
        self.until = now + (way.abs() / SPEED * 1e6) as DeviceTime;
    }
}

impl<const COMPLETES: bool> Machine for Cart<COMPLETES> {
    type Action = Deed;

    const NAME: &str = "the cart";
    const VERBS: &[&str] = &["go", "by", "jog"];
    const COMPLETES: bool = COMPLETES;

    fn card(&self) -> Card {
        let by = CardVerb {
            relative: true,
            ..CardVerb::motion("by", "Drives so far")
        };
        let jog = CardVerb {
            velocity: true,
            ..CardVerb::motion("jog", "Drives at this speed for a moment")
        };
        Card::new("cart", "A cart on a rail")
            .verbs([
                CardVerb::motion("go", "Drives to a place")
                    .args([CardArg::number("x", "mm").within(-END..=END)]),
                by.args([CardArg::number("way", "mm")]),
                jog.args([CardArg::number("speed", "mm/s")]),
            ])
            .measures("x", "mm", "Where it is")
    }

    fn read(verb: Word<'_>, words: &mut Words<'_>) -> Option<Result<Deed, DeviceError>> {
        let deed = match verb.text {
            "go" => Deed::Go,
            "by" => Deed::By,
            "jog" => Deed::Jog,
            _ => return None,
        };
        Some(words.number(verb.text, "a number", "it").map(deed))
    }

    fn is_relative(deed: &Deed) -> Option<bool> {
        Some(matches!(deed, Deed::By(_)))
    }

    fn never_waits(deed: &Deed) -> bool {
        matches!(deed, Deed::Jog(_))
    }

    fn is_moving(&self) -> bool {
        self.speed != 0.0
    }

    fn estop(&self) -> Option<bool> {
        Some(self.is_pressed)
    }

    fn plan(&mut self, script: &Script<Deed>) -> Result<(), DeviceError> {
        let mut planned = self.planned;
        for (deed, number) in script.actions() {
            planned = match deed {
                Deed::Go(x) => *x,
                Deed::By(way) => planned + way,
                Deed::Jog(_) => planned,
            };
            if planned.abs() > END {
                let error = DeviceError::new(ErrorName::WorkspaceBoundary, "the rail ends before");
                return Err(error.at_statement(number));
            }
        }
        self.planned = planned;
        Ok(())
    }

    fn begin(&mut self, deed: &Deed, now: DeviceTime) -> Result<(), DeviceError> {
        self.advance(now);
        self.jogs = matches!(deed, Deed::Jog(_));
        match deed {
            Deed::Go(x) => self.drive(x - self.x, now),
            Deed::By(way) => self.drive(*way, now),
            Deed::Jog(speed) => (self.speed, self.until) = (*speed, now + HOLDS),
        }
        Ok(())
    }

    fn done_at(&self) -> Option<DeviceTime> {
        Some(self.until)
    }

    fn gives_way(&self) -> bool {
        self.jogs
    }

    /// It goes on at the speed that it has.
    fn give_way(&mut self, _now: DeviceTime) {}

    fn halt(&mut self, now: DeviceTime) {
        self.advance(now);
        (self.speed, self.jogs, self.planned) = (0.0, false, self.x);
        self.pushed = 0.0;
    }

    fn advance(&mut self, now: DeviceTime) {
        let ends = now.min(self.until);
        self.x += self.speed * (ends - self.now).max(0) as f64 / 1e6;
        self.x += self.pushed * (now - self.now) as f64 / 1e6;
        if now >= self.until {
            (self.speed, self.jogs) = (0.0, false);
        }
        self.now = now;
    }

    fn next_wake(&self) -> Option<DeviceTime> {
        Some(self.now + LOOK_AT_REST)
    }

    fn position(&self) -> Map {
        Map::new().with("x", Value::Double(self.x))
    }
}

const STATEMENTS: Statements = Statements {
    go: "go 100",
    back: "go 0",
    wrong: "og 100",
    beyond: Some(("go 1001", "workspace-boundary 5002")),
    relative: Some("by 20"),
    velocity: Some("jog 50"),
};

fn stage<const COMPLETES: bool>() -> Stage<Cart<COMPLETES>> {
    Stage::bare(Cart::default())
        .pushed_by(|cart| cart.pushed = 50.0)
        .pressed_by(|cart, is_pressed| cart.is_pressed = is_pressed)
}

/// Some are played for each of several events; none may be left out in silence.
#[test]
fn a_cart_does_what_every_device_does() {
    assert_eq!(replay(stage::<false>, &STATEMENTS), 57);
}

#[test]
fn a_cart_that_completes_its_statement_does_so_too() {
    assert_eq!(replay(stage::<true>, &STATEMENTS), 61);
}
