//! A device that declares its verbs does what every device does.

use mom_client::{Card, CardArg, CardType, CardVerb, Event, Family, Map, Parcel, Value};
use mom_device::{
    Attachments, Call, Declared, Device, DeviceError, DeviceTime, ErrorName, Machine as _, Script,
};
use mom_device_cases::{Stage, Statements, replay};

/// mm/s.
const SPEED: f64 = 100.0;
/// mm from the middle of its rail to an end.
const END: f64 = 1000.0;

/// A cart on a rail, as its author would write it, with a simulated motor.
#[derive(Debug, Default)]
struct Cart<const COMPLETES: bool> {
    now: DeviceTime,
    x: f64,
    planned: f64,
    speed: f64,
    /// Where it is told to drive.
    to: Option<f64>,
    is_pressed: bool,
    /// When it was kept alive last.
    kept: DeviceTime,
    halts: u32,
}

impl<const COMPLETES: bool> Device for Cart<COMPLETES> {
    const NAME: &str = "the cart";
    const COMPLETES_ON_GIVE: bool = COMPLETES;

    fn verbs() -> Vec<CardVerb> {
        let x = CardArg::number("x", "mm").within(-2.0 * END..=2.0 * END);
        vec![
            CardVerb::motion("go", "Drives to a place").args([x]),
            CardVerb::motion("by", "Drives so far")
                .relative()
                .args([CardArg::number("way", "mm")]),
            CardVerb::motion("jog", "Drives at this speed")
                .velocity()
                .args([CardArg::number("speed", "mm/s")]),
        ]
    }

    fn describe(card: Card) -> Card {
        card.measures("x", "mm", "Where it is")
    }

    fn begin(&mut self, call: &Call) -> Result<(), DeviceError> {
        self.to = match call.name() {
            "go" => Some(call.number("x")?),
            "by" => Some(self.x + call.number("way")?),
            _ => None,
        };
        self.speed = match self.to {
            Some(to) => SPEED * (to - self.x).signum(),
            None => call.number("speed")?,
        };
        Ok(())
    }

    fn is_done(&mut self) -> Result<bool, DeviceError> {
        Ok(self.to.is_none())
    }

    fn halt(&mut self) {
        (self.speed, self.to, self.planned) = (0.0, None, self.x);
        self.halts += 1;
    }

    fn position(&self) -> Map {
        Map::new().with("x", Value::Double(self.x))
    }

    fn estop(&self) -> Option<bool> {
        Some(self.is_pressed)
    }

    fn keep_alive(&mut self) {
        self.kept = self.now;
    }

    fn plan(&mut self, calls: &[(&Call, u32)]) -> Result<(), DeviceError> {
        let mut planned = self.planned;
        for (call, number) in calls {
            planned = match call.name() {
                "go" => call.number("x")?,
                "by" => planned + call.number("way")?,
                _ => planned,
            };
            if planned.abs() > END {
                let error = DeviceError::new(ErrorName::WorkspaceBoundary, "the rail ends before");
                return Err(error.at_statement(*number));
            }
        }
        self.planned = planned;
        Ok(())
    }

    fn advance(&mut self, now: DeviceTime) {
        let way = self.speed * (now - self.now) as f64 / 1e6;
        self.now = now;
        match self.to {
            Some(to) if (to - self.x).abs() <= way.abs() => (self.x, self.speed, self.to) = (to, 0.0, None),
            _ => self.x += way,
        }
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

fn stage<const COMPLETES: bool>() -> Stage<Declared<Cart<COMPLETES>>> {
    Stage::bare(Declared::new(Cart::default()))
        .pushed_by(|cart| cart.device_mut().speed = 50.0)
        .pressed_by(|cart, is_pressed| cart.device_mut().is_pressed = is_pressed)
        .kept_by(|cart| cart.device().kept)
}

#[test]
fn a_declared_cart_does_what_every_device_does() {
    assert_eq!(replay(stage::<false>, &STATEMENTS), 58);
}

#[test]
fn one_that_completes_its_statement_does_so_too() {
    assert_eq!(replay(stage::<true>, &STATEMENTS), 62);
}

/// The tools of a kitchen: what no motion shows.
#[derive(Debug, Default)]
struct Kitchen {
    told: Vec<String>,
    fails: bool,
}

impl Device for Kitchen {
    const NAME: &str = "the kitchen";

    fn verbs() -> Vec<CardVerb> {
        vec![
            CardVerb::new("light", "Switches the light")
                .args([CardArg::one_of("to", &["on", "off"]).or("on")]),
            CardVerb::new("play", "Plays a sound").args([CardArg::new("sound", CardType::Attachment)]),
            CardVerb::motion("follow", "Follows a path")
                .args([CardArg::number("x", "mm")])
                .repeating(1),
            CardVerb {
                last: true,
                ..CardVerb::motion("clean", "Cleans until it is told otherwise")
            },
        ]
    }

    fn begin(&mut self, call: &Call) -> Result<(), DeviceError> {
        let told = match call.name() {
            "light" => format!("light {}", call.word("to")?),
            "play" => format!("play {:?}", call.bytes("sound")?),
            "follow" => format!("follow {:?}", call.numbers().collect::<Vec<_>>()),
            _ => format!("clean {}", call.number("where")?),
        };
        self.told.push(told);
        Ok(())
    }

    fn is_done(&mut self) -> Result<bool, DeviceError> {
        match self.fails {
            true => Err(DeviceError::new(ErrorName::Obstacle, "a cat is in the way")),
            false => Ok(true),
        }
    }

    fn halt(&mut self) {
        self.told.push("halt".to_owned());
    }

    fn position(&self) -> Map {
        Map::new()
    }
}

fn told(script: &str, attached: &Map) -> Result<Vec<String>, DeviceError> {
    let attachments = Attachments::of(attached)?;
    let script = Script::read_with::<Declared<Kitchen>>(script, &attachments)?;
    let mut kitchen = Declared::new(Kitchen::default());
    kitchen.plan(&script)?;
    for ((call, _), now) in script.actions().zip((1..).map(|turn| turn * 20_000)) {
        kitchen.advance(now);
        kitchen.begin(call, now)?;
        assert_eq!(kitchen.pursue(now), None, "what has come is heard before it ends");
        assert_eq!(kitchen.pursue(now + 10_000), Some(now + 10_000));
    }
    Ok(kitchen.device().told[1..].to_vec())
}

#[test]
fn a_statement_is_told_with_its_values() {
    let sounds = Map::new().with("bell", Value::Binary(vec![1, 2].into()));
    let script = "light; light off; wait 5; play bell; follow 1 2 3";
    let found = told(script, &sounds);
    assert_eq!(
        found.unwrap(),
        ["light on", "light off", "play [1, 2]", "follow [1.0, 2.0, 3.0]"]
    );
    for (script, words) in [
        (
            "light offf",
            "statement 1: there is no `offf`; did you mean `off`?",
        ),
        (
            "light on; foll 1",
            "statement 2: there is no `foll`; did you mean `follow`?",
        ),
        (
            "follow",
            "statement 1: `follow` takes `follow x/mm …`; x is missing",
        ),
        (
            "clean; light",
            "statement 1: `clean` must be the last statement of its script",
        ),
        (
            "play drum",
            "statement 1: `drum` did not come with the script, but bell",
        ),
        (
            "clean",
            "the program of the device asks `clean` for `where`, which is not a number of it",
        ),
    ] {
        assert_eq!(told(script, &sounds).unwrap_err().to_string(), words, "{script}");
    }
}

#[test]
fn the_ends_of_a_range_are_in_it() {
    for (script, is_in) in [
        ("go -2000", true),
        ("go 2000", true),
        ("go -2000.1", false),
        ("go 2000.1", false),
    ] {
        let read = Script::read::<Declared<Cart<false>>>(script);
        assert_eq!(read.is_ok(), is_in, "{script}: {read:?}");
    }
}

#[test]
fn what_cannot_go_on_ends_its_command_and_halts_the_device() {
    let mut stage = Stage::new(Declared::new(Kitchen::default()));
    stage.note(|kitchen| kitchen.device_mut().fails = true);
    stage.act("alice command 1 5: follow 1; light");
    stage.act("after 10");
    let heard = stage.heard();
    assert!(
        heard.contains(&"status alice/1 error 1/2 obstacle 5110".to_owned()),
        "{heard:?}"
    );
    let machine = stage.server().machine();
    assert_eq!(machine.device().told.last().map(String::as_str), Some("halt"));
}

#[test]
fn whatever_ends_it_the_device_is_halted() {
    #[derive(Debug)]
    struct Wheel(std::sync::Arc<std::sync::Mutex<Vec<&'static str>>>);
    impl Device for Wheel {
        const NAME: &str = "the wheel";
        fn verbs() -> Vec<CardVerb> {
            vec![CardVerb::motion("spin", "Spins")]
        }
        fn begin(&mut self, _: &Call) -> Result<(), DeviceError> {
            self.0.lock().unwrap().push("spin");
            Ok(())
        }
        fn is_done(&mut self) -> Result<bool, DeviceError> {
            Ok(false)
        }
        fn halt(&mut self) {
            self.0.lock().unwrap().push("halt");
        }
        fn position(&self) -> Map {
            Map::new()
        }
    }
    let told = std::sync::Arc::default();
    let mut wheel = Declared::new(Wheel(std::sync::Arc::clone(&told)));
    let script = Script::read::<Declared<Wheel>>("spin").unwrap();
    wheel.begin(script.actions().next().unwrap().0, 0).unwrap();
    drop(wheel);
    assert_eq!(*told.lock().unwrap(), ["halt", "spin", "halt"]);
}

/// Begins slowly, as what waits for a bus, and is done at once.
#[derive(Debug, Default)]
struct Slow(Vec<String>);

impl Device for Slow {
    const NAME: &str = "the slow one";

    fn verbs() -> Vec<CardVerb> {
        vec![CardVerb::motion("go", "Goes").args([CardArg::whole("to", "")])]
    }

    fn begin(&mut self, call: &Call) -> Result<(), DeviceError> {
        self.0.push(format!("go {}", call.number("to")?));
        Ok(())
    }

    fn is_done(&mut self) -> Result<bool, DeviceError> {
        self.0.push("done?".to_owned());
        Ok(true)
    }

    fn halt(&mut self) {
        self.0.push("halt".to_owned());
    }

    fn position(&self) -> Map {
        Map::new().with("x", 0.0)
    }
}

#[test]
fn what_came_while_a_statement_blocked_is_heard_before_the_next_one_begins() {
    for (blocked, told) in [(300, vec!["go 1", "halt"]), (2000, vec!["go 1", "halt", "halt"])] {
        let mut stage = Stage::new(Declared::new(Slow::default()));
        stage.note(|slow| slow.device_mut().0.clear());
        stage.act("alice command 1 5: go 1; go 2; go 3");
        stage.act("alice command 2 5: go 4");
        // The program comes back, and finds a stop.
        stage.act(&format!("frozen {blocked}"));
        stage.act("bob stop");
        stage.act("after 1000");
        let slow = stage.server().machine().device();
        assert_eq!(slow.0, told, "{blocked} ms");
    }
}

#[test]
fn what_is_always_late_comes_to_its_end_all_the_same() {
    let mut stage = Stage::new(Declared::new(Slow::default()));
    stage.act("alice command 1 5: go 1; go 2");
    for _ in 0..8 {
        stage.act("frozen 100");
    }
    let heard = stage.heard();
    assert!(
        heard.iter().any(|line| line == "status alice/1 finished 2/2"),
        "{heard:?}"
    );
}

/// Its sensor is broken, and says so by numbers that are none.
#[derive(Debug)]
struct Blind;

impl Device for Blind {
    const NAME: &str = "the blind one";

    fn verbs() -> Vec<CardVerb> {
        vec![CardVerb::motion("go", "Goes")]
    }

    fn begin(&mut self, _: &Call) -> Result<(), DeviceError> {
        Ok(())
    }

    fn is_done(&mut self) -> Result<bool, DeviceError> {
        Ok(true)
    }

    fn halt(&mut self) {}

    fn position(&self) -> Map {
        Map::new().with("x", Value::Double(f64::NAN))
    }

    fn report(&self) -> Map {
        let wheel = Map::new().with("speed", Value::Double(f64::INFINITY));
        Map::new().with("wheels", vec![Value::from(wheel)])
    }
}

#[test]
fn what_is_not_a_number_is_said_as_null_and_measures_nothing() {
    let machine = Declared::new(Blind);
    let wheel = Map::new().with("speed", Value::Null);
    assert_eq!(machine.position(), Map::new().with("x", Value::Null));
    assert_eq!(
        machine.report(),
        Map::new().with("wheels", vec![Value::from(wheel)])
    );
    // It is known to stand by its stopping time.
    assert_eq!(machine.measured(0), None);
}

/// A device that asks for its commands, as its link is slow.
#[test]
fn one_that_pulls_asks_while_it_is_owned_free_and_idle() {
    let mut stage = stage::<false>().begin();
    stage.set(|server| server.pulling(1_000_000));
    let asks = |stage: &mut Stage<Declared<Cart<false>>>, now: DeviceTime| {
        let (gate, mut out) = (stage.gate.clone(), Vec::new());
        let due = stage.server().asks_at(&gate);
        stage.server().ask(&gate, now, &mut out);
        let said: Vec<(String, Option<i64>)> = out
            .iter()
            .map(|parcel| {
                (
                    parcel.name().to_owned(),
                    parcel.value().get("wait").and_then(Value::as_int),
                )
            })
            .collect();
        (due, said)
    };
    assert_eq!(asks(&mut stage, 0), (None, Vec::new()), "nobody owns its token");
    stage.act("gate alice 5");
    let next = ("next".to_owned(), Some(1000));
    let (due, said) = asks(&mut stage, 5_000_000);
    assert!(
        due.is_some_and(|due| due <= 5_000_000) && said == [next.clone()],
        "{due:?}"
    );
    assert_eq!(asks(&mut stage, 5_999_999), (Some(6_000_000), Vec::new()), "once");
    assert_eq!(asks(&mut stage, 6_000_000), (Some(6_000_000), vec![next]));
    // A command that answers nothing is refused, but for the safe state.
    stage.act("alice command 1 5: wait 100");
    let refused = stage.heard().pop();
    assert_eq!(refused.as_deref(), Some("status alice/1 error 0/0 bad-slot 220"));
    stage.act("hub command - 5: wait 100");
    assert_eq!(asks(&mut stage, 9_000_000), (None, Vec::new()), "it is busy");
    stage.act("bob stop 3");
    assert_eq!(asks(&mut stage, 9_000_000), (None, Vec::new()), "it is stopped");
    stage.act("gate - 5");
    stage.act("bob unstop 3");
    assert_eq!(
        asks(&mut stage, 9_000_000),
        (None, Vec::new()),
        "nobody owns it any more"
    );
}

#[test]
fn what_a_device_cannot_carry_out_ends_all_that_waits() {
    let mut stage = stage::<false>().begin();
    stage.act("alice command 1 5: wait 100");
    stage.act("alice command 2 5: wait 100");
    stage.heard();
    let (error, mut out) = (DeviceError::new(ErrorName::Battery, "it is empty"), Vec::new());
    // A time before the latest one counts as that.
    stage.server().fail(0, &error, &mut out);
    let ends: Vec<String> = out
        .iter()
        .filter_map(|parcel| Some(parcel.value().get("error")?.get("name")?.as_str()?.to_owned()))
        .collect();
    assert!(
        ends.len() == 2 && ends.iter().all(|name| name == "battery" || name == "halted"),
        "{ends:?}"
    );
}

#[test]
fn what_comes_with_commands_that_wait_is_bounded() {
    let mut stage = Stage::new(Declared::new(Kitchen::default()));
    let sound = Map::new().with("bell", Value::Binary(vec![0; 5 << 20].into()));
    let play = |id: u64| {
        let content = Map::new()
            .with("script", "wait 1000; play bell")
            .with("attachments", sound.clone());
        let mut parcel = Parcel::new(Family::Message, "command").content(content);
        (parcel.sender, parcel.id, parcel.fence) = (Some("alice".into()), Some(id), Some(5));
        Event::Message(parcel)
    };
    for id in [1, 2] {
        stage.tell(&play(id));
    }
    assert_eq!(
        stage.heard(),
        [
            "status alice/1 waiting 0/2",
            "status alice/1 executing 1/2",
            "status alice/2 error 0/0 queue-full 5103"
        ]
    );
}

#[test]
fn its_card_says_how_soon_it_stands_and_its_errors_where_they_are() {
    let cart = Declared::new(Cart::<false>::default());
    assert_eq!(mom_device::card(&cart).stops_within, Some(1000));
    let error = told("light on; follow x", &Map::new()).unwrap_err();
    assert_eq!((error.position(), error.may_be_retried()), (Some(17), false));
    assert!(DeviceError::new(ErrorName::Busy, "it is").may_be_retried());
    assert_eq!(ErrorName::Estop.to_string(), "estop");
}
