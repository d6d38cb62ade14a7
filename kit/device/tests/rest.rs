//! Rest is measured: by a cart that rolls on after a halt, watched by its place and not by its words.

use mom_client::{Card, CardVerb, Map, Value};
use mom_device::{
    AtRest, Command, CommandQueue, DeviceError, DeviceTime, ErrorName, Machine, Order, QueueEvent, Script,
    State, Word, Words,
};

/// mm/s at full speed, and mm/s² by which it slows down: it stands 0.4 s and 80 mm after a halt.
const SPEED: f64 = 400.0;
const BRAKE: f64 = 1000.0;

/// A cart on a rail, which drives one way or the other until its command ends.
#[derive(Debug, Default)]
struct Cart {
    now: DeviceTime,
    x: f64,
    speed: f64,
    /// What it is driven to; none = it brakes.
    drive: Option<f64>,
    until: DeviceTime,
    halts: u32,
    measures: bool,
    brakes: bool,
    lost: bool,
    /// When it was heard last, if that is long ago.
    heard: Option<DeviceTime>,
}

impl Machine for Cart {
    type Action = f64;

    const NAME: &str = "the cart";
    const VERBS: &[&str] = &["go"];
    const STOPPING_TIME: DeviceTime = 500_000;

    fn card(&self) -> Card {
        Card::new("cart", "").verbs([CardVerb::motion("go", "")])
    }

    fn read(verb: Word<'_>, words: &mut Words<'_>) -> Option<Result<f64, DeviceError>> {
        (verb.text == "go").then(|| words.number(verb.text, "a speed, mm/s", "speed"))
    }

    fn is_moving(&self) -> bool {
        // What was meant, and what is not known: it knows nothing of its rolling.
        self.drive.is_some() || self.lost
    }

    fn is_reached(&self) -> bool {
        !self.lost
    }

    fn plan(&mut self, _script: &Script<f64>) -> Result<(), DeviceError> {
        Ok(())
    }

    fn begin(&mut self, speed: &f64, now: DeviceTime) -> Result<(), DeviceError> {
        (self.drive, self.speed, self.until) = (Some(*speed), *speed, now + 2_000_000);
        Ok(())
    }

    fn done_at(&self) -> Option<DeviceTime> {
        Some(self.until)
    }

    fn halt(&mut self, now: DeviceTime) {
        self.advance(now);
        self.halts += 1;
        self.drive = None;
    }

    fn advance(&mut self, now: DeviceTime) {
        // In steps of 1 ms.
        while self.now + 1_000 <= now {
            self.now += 1_000;
            if self.drive.is_none() && self.brakes {
                self.speed -= self.speed.clamp(-BRAKE / 1000.0, BRAKE / 1000.0);
            }
            self.x += self.speed / 1000.0;
        }
    }

    fn known_at(&self) -> Option<DeviceTime> {
        self.heard
    }

    fn position(&self) -> Map {
        match self.measures {
            true => Map::new().with("x", Value::Double(self.x)),
            false => Map::new(),
        }
    }
}

/// A queue with a cart, what it has told, and where the cart was at each millisecond.
struct Track {
    queue: CommandQueue<Cart>,
    now: DeviceTime,
    told: Vec<(DeviceTime, QueueEvent)>,
    places: Vec<f64>,
}

impl Track {
    fn of(measures: bool, brakes: bool) -> Track {
        let cart = Cart {
            measures,
            brakes,
            ..Cart::default()
        };
        let mut track = Track {
            queue: CommandQueue::new(cart),
            now: 0,
            told: Vec::new(),
            places: Vec::new(),
        };
        track.pass(1_000);
        track
    }

    fn act<T>(
        &mut self,
        action: impl FnOnce(&mut CommandQueue<Cart>, DeviceTime, &mut Vec<QueueEvent>) -> T,
    ) -> T {
        let mut events = Vec::new();
        let done = action(&mut self.queue, self.now, &mut events);
        self.told
            .extend(events.into_iter().map(|event| (self.now, event)));
        done
    }

    /// Lets so many ms pass; the queue is called when it asks for it only, the cart always goes on.
    fn pass(&mut self, ms: i64) {
        let end = self.now + ms * 1000;
        while self.now < end {
            self.now += 1_000;
            if self.queue.next_wake().is_some_and(|due| due <= self.now) {
                self.act(|queue, now, events| queue.advance(now, events));
            } else {
                // As a body does.
                self.act(|queue, now, events| queue.note(now, |cart| cart.advance(now), events));
            }
            self.places.push(self.queue.machine().x);
        }
    }

    fn change_hands(&mut self) {
        self.act(|queue, now, events| queue.halt(now, "the token changed hands", events));
        self.act(|queue, now, events| queue.change_hands(now, events));
    }

    fn go(&mut self, peer: &str, fence: u64) -> Result<(), DeviceError> {
        let order = Order {
            peer: peer.into(),
            id: None,
            fence: Some(fence),
        };
        let speed = if fence.is_multiple_of(2) { -SPEED } else { SPEED };
        let script = Script::read::<Cart>(&format!("go {speed}")).expect("a script");
        let command = Command {
            order,
            script,
            use_by: None,
        };
        self.act(|queue, now, events| queue.submit(command, now, events))
    }

    fn states(&self) -> impl Iterator<Item = (DeviceTime, &State)> {
        self.told.iter().filter_map(|(at, event)| match event {
            QueueEvent::State(state) => Some((*at, state)),
            _ => None,
        })
    }

    fn began(&self, peer: &str) -> Option<DeviceTime> {
        let mut told = self.told.iter();
        let began =
            told.find(|(_, event)| matches!(event, QueueEvent::Executing(of) if &*of.order.peer == peer));
        began.map(|(at, _)| *at)
    }

    /// How far it was moved between two times.
    fn moved(&self, from: DeviceTime, to: DeviceTime) -> f64 {
        let place = |at: DeviceTime| self.places[usize::try_from(at / 1000 - 1).expect("later than 0")];
        (place(to) - place(from)).abs()
    }
}

#[test]
fn a_stopped_device_moves_by_its_word_until_it_has_stood_for_three_tenths_of_a_second() {
    let mut track = Track::of(true, true);
    track.go("alice", 1).expect("taken");
    track.pass(600);
    track.act(|queue, now, events| queue.stop(now, "smoke", ErrorName::Stopped, events));
    let stopped = track.now;
    track.pass(2_000);
    assert!(track.moved(stopped, track.now) > 70.0, "it rolls");
    let (rested, state) = track
        .states()
        .find(|(at, state)| *at >= stopped && !state.moving)
        .expect("it comes to rest");
    assert!(state.stopped && state.rest == Some(AtRest::Measured));
    assert!(
        track.moved(rested - 300_000, track.now) < 1.0,
        "it stood before it said so"
    );
    let (first, state) = track.states().find(|(_, state)| state.stopped).expect("told");
    assert!(
        first == stopped && state.moving && state.rest.is_none(),
        "at once, and not as one that stands"
    );
}

#[test]
fn the_first_motion_of_a_new_owner_begins_at_rest() {
    let mut track = Track::of(true, true);
    track.go("alice", 1).expect("taken");
    track.pass(600);
    track.change_hands();
    track.go("bob", 2).expect("taken");
    let asked = track.now;
    track.pass(3_000);
    let began = track.began("bob").expect("it begins");
    assert!(track.moved(asked, began) > 70.0, "it rolled first");
    assert!(
        track.moved(began - 300_000, began) < 1.0,
        "it stood when the motion began"
    );
    // Who drives on does not wait.
    track.go("bob", 2).expect("taken");
    assert!(track.now - began > 2_000_000 || track.queue.is_busy());
}

#[test]
fn who_owns_what_does_not_come_to_rest_is_refused() {
    let mut track = Track::of(true, false);
    track.go("alice", 1).expect("taken");
    track.pass(300);
    track.change_hands();
    track.go("bob", 2).expect("taken");
    let asked = track.now;
    track.pass(1_999);
    assert!(track.queue.is_busy(), "twice the stopping time and a second");
    track.pass(2);
    assert!(track.began("bob").is_none() && !track.queue.is_busy());
    let refused = track.told.iter().find_map(|(at, event)| match event {
        QueueEvent::Failed(of, error) if &*of.order.peer == "bob" => Some((*at, error)),
        _ => None,
    });
    let (at, error) = refused.expect("it is refused");
    assert_eq!((at - asked, error.name()), (2_000_000, ErrorName::ChangingHands));
    assert!(error.to_string().contains("still moves"), "{error}");
    assert!(track.queue.machine().halts >= 2, "it was told again");
}

#[test]
fn without_a_measurement_the_stopping_time_is_waited_for() {
    let mut track = Track::of(false, true);
    track.go("alice", 1).expect("taken");
    track.pass(600);
    track.act(|queue, now, events| queue.stop(now, "smoke", ErrorName::Stopped, events));
    let stopped = track.now;
    track.pass(1_000);
    let (at, state) = track
        .states()
        .find(|(at, state)| *at >= stopped && !state.moving)
        .expect("its time passes");
    assert_eq!(
        (at - stopped, state.rest),
        (Cart::STOPPING_TIME, Some(AtRest::NotMeasured))
    );
    track.act(|queue, now, events| queue.unstop(now, events));
    track.go("alice", 1).expect("taken");
    track.pass(100);
    track.change_hands();
    let halted = track.now;
    track.go("bob", 2).expect("taken");
    track.pass(1_000);
    assert_eq!(
        track.began("bob").expect("it begins") - halted,
        Cart::STOPPING_TIME
    );
}

#[test]
fn what_is_not_reached_never_rests() {
    let mut track = Track::of(true, true);
    track.go("alice", 1).expect("taken");
    track.pass(600);
    track.act(|queue, now, events| queue.note(now, |cart| cart.lost = true, events));
    track.act(|queue, now, events| queue.stop(now, "smoke", ErrorName::Stopped, events));
    track.pass(10_000);
    let state = track.queue.state();
    assert!(state.stopped && state.moving && !state.reached && state.rest.is_none());
    let told = track.told.len();
    track.pass(10_000);
    assert_eq!(track.told.len(), told, "there is nothing new to tell");
    track.act(|queue, now, events| queue.note(now, |cart| cart.lost = false, events));
    track.pass(299);
    assert!(
        track.queue.state().moving,
        "what was measured before says nothing"
    );
    track.pass(100);
    let state = track.queue.state();
    assert!(!state.moving && state.reached && state.rest == Some(AtRest::Measured));
    let (_, last) = track.states().last().expect("told");
    assert!(!last.moving && last.reached, "and it was told");
}

#[test]
fn each_stop_and_halt_reaches_the_machine() {
    let mut track = Track::of(true, true);
    for count in 1..4 {
        track.act(|queue, now, events| queue.halt(now, "test", events));
        assert_eq!(track.queue.machine().halts, 2 * count - 1);
        track.act(|queue, now, events| queue.stop(now, "test", ErrorName::Stopped, events));
        assert_eq!(track.queue.machine().halts, 2 * count);
    }
    assert!(
        track.queue.state().rest.is_some() && !track.queue.state().moving,
        "it rested all the time"
    );
}

#[test]
fn old_news_does_not_say_that_it_rests() {
    let mut track = Track::of(true, true);
    assert_eq!(track.queue.state().rest, Some(AtRest::Measured));
    let heard = track.now;
    track.act(|queue, now, events| queue.note(now, |cart| cart.heard = Some(heard), events));
    track.pass(10_000);
    track.act(|queue, now, events| queue.stop(now, "smoke", ErrorName::Stopped, events));
    assert_eq!(track.queue.state().rest, None, "it was heard ten seconds ago");
    track.pass(1_000);
    assert_eq!(track.queue.state().rest, None);
    track.act(|queue, now, events| queue.note(now, |cart| cart.heard = None, events));
    track.pass(400);
    assert_eq!(track.queue.state().rest, Some(AtRest::Measured));
}

/// The deadline of a command that was ended while it waited is not that of a later one.
#[test]
fn each_command_of_a_new_owner_has_its_own_time() {
    let mut track = Track::of(true, false);
    track.go("alice", 1).expect("taken");
    track.pass(300);
    track.change_hands();
    track.go("bob", 2).expect("taken");
    track.pass(1_500);
    track.act(|queue, now, events| queue.halt(now, "the link to the hub was lost", events));
    track.pass(3_000);
    track.go("bob", 2).expect("taken");
    let asked = track.now;
    track.pass(1_999);
    assert!(track.queue.is_busy(), "it waits");
    track.act(|queue, now, events| queue.note(now, |cart| cart.brakes = true, events));
    track.go("bob", 2).expect("taken");
    track.pass(2);
    let refused = track.told.iter().filter(|(at, event)| {
        *at >= asked
            && matches!(event, QueueEvent::Failed(_, error) if error.name() == ErrorName::ChangingHands)
    });
    assert_eq!(refused.count(), 2, "both had waited since the first was sent");
}

#[test]
fn a_push_is_told_though_nothing_else_is() {
    let mut track = Track::of(true, true);
    track.pass(1_000);
    let told = track.told.len();
    assert_eq!(track.queue.state().rest, Some(AtRest::Measured));
    track.act(|queue, now, events| queue.note(now, |cart| cart.x += 20.0, events));
    let (_, pushed) = track.states().last().expect("told");
    assert!(
        track.told.len() == told + 1 && pushed.rest.is_none(),
        "{pushed:?}"
    );
    track.pass(400);
    let (_, last) = track.states().last().expect("told");
    assert_eq!(last.rest, Some(AtRest::Measured), "and where it rests now");
}

/// Nobody calls the queue for seconds, as when its program is stopped; then all that was due is due at once.
#[test]
fn of_a_program_that_stood_still_no_later_statement_begins() {
    for (script, silence, ended) in [
        ("go 400; go -400; go 400", 5_000, true),
        ("wait 100; go 400", 5_000, true),
        // Its last statement ended while nobody looked, within what the mechanism does by itself.
        ("go 400", 2_500, false),
        // No longer than a busy machine may take.
        ("wait 100; go 400", 900, false),
    ] {
        let mut track = Track::of(true, true);
        let order = Order {
            peer: "alice".into(),
            id: None,
            fence: None,
        };
        let command = Command {
            order,
            script: Script::read::<Cart>(script).expect("a script"),
            use_by: None,
        };
        track
            .act(|queue, now, events| queue.submit(command, now, events))
            .expect("taken");
        track.pass(1_000 * i64::from(script == "go 400"));
        let begun = |track: &Track| {
            let told = track.told.iter();
            told.filter(|(_, event)| matches!(event, QueueEvent::Executing(_)))
                .count()
        };
        let before = begun(&track);
        track.now += silence * 1000;
        track.act(|queue, now, events| queue.advance(now, events));
        let failed = track.told.iter().find_map(|(_, event)| match event {
            QueueEvent::Failed(_, error) => Some(error.to_string()),
            _ => None,
        });
        assert_eq!(failed.is_some(), ended, "{script}: {failed:?}");
        if ended {
            assert_eq!(begun(&track), before, "{script}: nothing begins");
            assert!(failed.is_some_and(|text| text.contains("stood still")));
            assert!(!track.queue.is_busy() && track.queue.machine().drive.is_none());
        }
    }
}

/// News that waited for a program that stood still seem as new as the program is awake.
#[test]
fn what_was_measured_while_the_program_stood_still_is_not_new() {
    let mut track = Track::of(true, true);
    track.go("alice", 1).expect("taken");
    track.pass(500);
    track.act(|queue, now, events| queue.stop(now, "a test", ErrorName::Stopped, events));
    while track.queue.machine().speed != 0.0 {
        track.pass(1);
    }
    track.pass(150);
    assert_eq!(track.queue.state().rest, None);
    track.now += 3_000_000;
    track.act(|queue, now, events| queue.advance(now, events));
    assert_eq!(track.queue.state().rest, None);
    track.pass(400);
    assert_eq!(track.queue.state().rest, Some(AtRest::Measured));
}
