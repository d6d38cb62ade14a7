//! A device that has one fault, or none: a peer of its own with a body of its own, by which it is shown that the oracle finds faults.

use std::collections::VecDeque;
use std::path::Path;
use std::time::Duration;

use mom_client::{
    Channel, Client, Delivery, Event, Events, Family, FenceGate, HUB, Latch, Map, Parcel, Reaction, Value,
};
use mom_tests::programs::PATIENCE;
use mom_trace::Trace;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior, interval};

use super::log::Micros;
use super::rules::Rule;

/// What is wrong with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Plant {
    Nothing,
    ObeysStopLate,
    SaysStoppedBefore,
    BeginsQueuedAfterStop,
    RollsAtMeasuredRest,
    ObeysOldFence,
    NewOwnerBeforeRest,
    IgnoresLostLink,
    GoesOnAfterDeadline,
    UnlatchesAtReconnect,
    OneWheelGoesOn,
    TellsOldPlace,
    GoesOnUnderAGuard,
}

impl Plant {
    pub(super) const FAULTS: [Self; 12] = [
        Self::ObeysStopLate,
        Self::SaysStoppedBefore,
        Self::BeginsQueuedAfterStop,
        Self::RollsAtMeasuredRest,
        Self::ObeysOldFence,
        Self::NewOwnerBeforeRest,
        Self::IgnoresLostLink,
        Self::GoesOnAfterDeadline,
        Self::UnlatchesAtReconnect,
        Self::OneWheelGoesOn,
        Self::TellsOldPlace,
        Self::GoesOnUnderAGuard,
    ];

    /// By what the oracle finds it.
    pub(super) fn breaks(self) -> &'static [Rule] {
        match self {
            Self::Nothing => &[],
            Self::ObeysStopLate => &[Rule::BeginsAfterStop, Rule::RollsOnAfterStop],
            Self::SaysStoppedBefore | Self::OneWheelGoesOn => &[Rule::RollsOnAfterStopped],
            Self::BeginsQueuedAfterStop | Self::UnlatchesAtReconnect => &[Rule::BeginsAfterStopped],
            Self::RollsAtMeasuredRest => &[Rule::MovesAtRest],
            Self::ObeysOldFence => &[Rule::OldOwner],
            Self::NewOwnerBeforeRest => &[Rule::FirstMotionAtRest],
            Self::IgnoresLostLink => &[Rule::LinkLost],
            Self::GoesOnAfterDeadline => &[Rule::Deadline],
            Self::TellsOldPlace => &[Rule::WrongPlace],
            Self::GoesOnUnderAGuard => &[Rule::Unguarded],
        }
    }
}

/// mm/s²: it stands 200 ms after it was told to, at full speed.
const BRAKES: f64 = 1500.0;
/// µs between two looks at its time.
const STEP: Micros = 5_000;
/// µs for which it stands until it says that it has measured that.
const RESTS: Micros = 300_000;
/// µs by which a fault is late.
const LATE: Micros = 4_000_000;
/// µs of a device that says it stands and does not.
const ROLLS: Micros = 2_000_000;

/// Where it is: mm, degrees.
#[derive(Debug, Default, Clone, Copy)]
struct Body {
    now: Micros,
    x: f64,
    heading: f64,
    speed: f64,
    wanted: f64,
    turns: f64,
}

impl Body {
    fn advance(&mut self, now: Micros) {
        while self.now + STEP <= now {
            let seconds = STEP as f64 / 1e6;
            let most = BRAKES * seconds;
            self.speed += (self.wanted - self.speed).clamp(-most, most);
            self.x += self.speed * seconds;
            self.heading += self.turns * seconds;
            self.now += STEP;
        }
    }
}

#[derive(Debug, Clone)]
enum Statement {
    Motor(f64, Micros),
    Wait(Micros),
}

#[derive(Debug, Clone)]
struct Command {
    peer: String,
    id: Option<u64>,
    fence: u64,
    statements: VecDeque<Statement>,
    of: usize,
}

/// The device at work, until it is dropped.
#[derive(Debug)]
pub(super) struct Planted {
    _work: JoinSet<()>,
}

impl Planted {
    pub(super) async fn start(hub: &str, plant: Plant, trace: &Path) -> Planted {
        let client = Client::builder(hub)
            .user("rover-b")
            .password("rover-b")
            .heartbeat(Duration::from_millis(500))
            .link(Duration::from_secs(60))
            .request_timeout(PATIENCE)
            .connect()
            .await
            .expect("the lab knows its users");
        let channel = client
            .channel_as_device("/rover/b/robot")
            .await
            .expect("it is its own");
        let (says, mut said) = mpsc::unbounded_channel();
        let device = Device::new(plant, says, channel, Trace::open(trace).expect("a trace"));
        let mut work = JoinSet::new();
        work.spawn(device.run());
        work.spawn(async move {
            while let Some(parcel) = said.recv().await {
                // What a lost link does not take is not said.
                let _ = client.send(parcel).await;
            }
        });
        Planted { _work: work }
    }
}

struct Device {
    plant: Plant,
    /// What it says, one after the other, beside its work.
    says: mpsc::UnboundedSender<Parcel>,
    channel: Channel,
    gate: FenceGate,
    trace: Trace,
    begin: Instant,
    body: Body,
    latch: Latch,
    queue: VecDeque<Command>,
    /// Until when the present statement goes on.
    ends: Option<Micros>,
    fence: u64,
    /// A new owner's first motion waits until it rests.
    changes_hands: bool,
    stood_since: Option<Micros>,
    told: Micros,
    told_rest: bool,
    /// What a fault does later.
    later: Option<(Micros, Later)>,
    old_place: f64,
    kept: VecDeque<Command>,
    /// The stop at which it kept them.
    obeyed: u64,
}

#[derive(Debug, Clone, Copy)]
enum Later {
    Halt,
    Latch,
    StandStraight,
    GoOn,
}

impl Device {
    fn new(plant: Plant, says: mpsc::UnboundedSender<Parcel>, channel: Channel, trace: Trace) -> Self {
        Self {
            plant,
            gate: channel.gate(),
            says,
            channel,
            trace,
            begin: Instant::now(),
            body: Body::default(),
            latch: Latch::default(),
            queue: VecDeque::new(),
            ends: None,
            fence: 0,
            changes_hands: false,
            stood_since: Some(0),
            told: 0,
            told_rest: false,
            later: None,
            old_place: 0.0,
            kept: VecDeque::new(),
            obeyed: 0,
        }
    }

    async fn run(mut self) {
        let mut events: Events = self.channel.events();
        let mut ticks = interval(Duration::from_millis(5));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                event = events.next() => match event {
                    Some(event) => self.hear(&event),
                    None => return,
                },
                _ = ticks.tick() => self.pass(),
            }
        }
    }

    /// Lets time pass.
    fn pass(&mut self) {
        let now = Micros::try_from(self.begin.elapsed().as_micros()).unwrap_or(Micros::MAX);
        let body = &mut self.body;
        self.trace.until(now, |at| {
            body.advance(at);
            [body.x, body.heading]
        });
        self.body.advance(now);
        let stands = self.body.speed.abs() < 1.0 && self.body.wanted == 0.0;
        self.stood_since = stands.then(|| self.stood_since.unwrap_or(now));
        if let Some((_, later)) = self.later.take_if(|(due, _)| *due <= now) {
            self.do_late(later);
        }
        if self.plant == Plant::RollsAtMeasuredRest {
            self.body.turns = if self.rests() { 12.0 } else { 0.0 };
        }
        self.work();
        if now - self.told >= 50_000 && !stands || self.rests() != self.told_rest {
            self.tell();
        }
    }

    fn do_late(&mut self, later: Later) {
        match later {
            Later::Halt => self.halt(),
            Later::Latch => {
                self.halt();
                self.tell();
            }
            Later::StandStraight => self.body.turns = 0.0,
            Later::GoOn => self.queue = std::mem::take(&mut self.kept),
        }
    }

    /// By its word.
    fn rests(&self) -> bool {
        self.stood_since
            .is_some_and(|since| self.body.now - since >= RESTS)
    }

    /// Goes on with its queue.
    fn work(&mut self) {
        let now = self.body.now;
        if self.ends.is_some_and(|ends| ends > now) {
            return;
        }
        if self.ends.take().is_some() {
            self.body.wanted = 0.0;
            if let Some(command) = self
                .queue
                .front()
                .filter(|command| command.statements.is_empty())
                .cloned()
            {
                self.queue.pop_front();
                self.status(&command, "finished");
            }
        }
        let free = self.latch.may_move().is_ok()
            || matches!(
                self.plant,
                Plant::BeginsQueuedAfterStop
                    | Plant::UnlatchesAtReconnect
                    | Plant::IgnoresLostLink
                    | Plant::ObeysStopLate
                    | Plant::SaysStoppedBefore
            );
        if self.changes_hands && self.rests() {
            self.changes_hands = false;
        }
        let waits = self.changes_hands && self.plant != Plant::NewOwnerBeforeRest;
        let Some(command) = self.queue.front_mut().filter(|_| free && !waits) else {
            return;
        };
        let Some(statement) = command.statements.pop_front() else {
            return;
        };
        let command = command.clone();
        let lasts = match statement {
            Statement::Motor(speed, lasts) => {
                self.body.wanted = speed;
                match self.plant {
                    Plant::GoesOnAfterDeadline => lasts + ROLLS,
                    _ => lasts,
                }
            }
            Statement::Wait(lasts) => lasts,
        };
        self.ends = Some(now + lasts);
        self.status(&command, "executing");
    }

    fn hear(&mut self, event: &Event) {
        self.pass();
        if let Some(reaction) = self.latch.observe(event) {
            self.react(event, &reaction);
        }
        match event {
            Event::Message(parcel) if parcel.name() == "command" => self.take(parcel),
            Event::Message(parcel)
                if parcel.name() == "halt"
                    && parcel.sender.as_deref() == Some(HUB)
                    && self.plant != Plant::ObeysOldFence
                    && !(self.plant == Plant::GoesOnUnderAGuard && parcel.value().get("guard").is_some()) =>
            {
                self.halt();
            }
            Event::Grabbed { fence, .. } => self.take_owner(*fence),
            Event::Rejoined | Event::Resumed => {
                if self.plant == Plant::UnlatchesAtReconnect {
                    self.queue = std::mem::take(&mut self.kept);
                }
                self.tell();
            }
            _ => {}
        }
    }

    fn react(&mut self, event: &Event, reaction: &Reaction) {
        let now = self.body.now;
        match reaction {
            // It is told again of the stop that it has left.
            Reaction::Stop(_)
                if self.plant == Plant::UnlatchesAtReconnect && self.latch.number() == self.obeyed => {}
            Reaction::Stop(_) => match self.plant {
                Plant::ObeysStopLate => self.later = self.later.or(Some((now + LATE, Later::Latch))),
                Plant::SaysStoppedBefore => {
                    self.later = Some((now + ROLLS, Later::Halt));
                    self.tell();
                }
                Plant::BeginsQueuedAfterStop | Plant::UnlatchesAtReconnect => {
                    self.kept = self.queue.clone();
                    self.obeyed = self.latch.number();
                    self.halt();
                    if self.plant == Plant::BeginsQueuedAfterStop {
                        self.later = Some((now + 500_000, Later::GoOn));
                    }
                    self.tell();
                }
                Plant::OneWheelGoesOn if self.body.wanted != 0.0 => {
                    self.body.turns = 60.0;
                    self.later = Some((now + ROLLS, Later::StandStraight));
                    self.halt();
                    self.tell();
                }
                _ => {
                    self.halt();
                    self.tell();
                }
            },
            Reaction::Halt if matches!(event, Event::LinkDown) && self.plant == Plant::IgnoresLostLink => {}
            Reaction::Halt if self.plant == Plant::UnlatchesAtReconnect && !self.kept.is_empty() => {}
            Reaction::Halt => self.halt(),
            Reaction::Free => {
                self.kept.clear();
                self.later = None;
                self.tell();
            }
            Reaction::Same => self.tell(),
        }
    }

    fn take_owner(&mut self, fence: u64) {
        if fence <= self.fence {
            return;
        }
        self.fence = fence;
        if self.plant != Plant::ObeysOldFence {
            self.halt();
        }
        self.changes_hands = true;
    }

    fn take(&mut self, parcel: &Parcel) {
        let script = parcel.value();
        let statements = statements(script.as_str().unwrap_or_default());
        let command = Command {
            peer: parcel.sender.as_deref().unwrap_or_default().to_owned(),
            id: parcel.id,
            fence: parcel.fence.unwrap_or(0),
            of: statements.len(),
            statements,
        };
        if self.gate.check(parcel).is_err() || self.latch.may_move().is_err() || command.of == 0 {
            return self.status(&command, "error");
        }
        self.take_owner(command.fence);
        self.queue.push_back(command);
    }

    /// Ends all commands.
    fn halt(&mut self) {
        self.body.wanted = 0.0;
        self.ends = None;
        for command in std::mem::take(&mut self.queue) {
            self.status(&command, "error");
        }
    }

    fn status(&self, command: &Command, state: &str) {
        let begun = command.of - command.statements.len();
        let mut content = Map::new()
            .with("peer", command.peer.as_str())
            .with("state", state)
            .with("statement", i64::try_from(begun).unwrap_or(0))
            .with("of", i64::try_from(command.of).unwrap_or(0));
        if let Some(id) = command.id.and_then(|id| i64::try_from(id).ok()) {
            content.set("id", id);
        }
        self.say("status", content);
    }

    fn tell(&mut self) {
        self.told = self.body.now;
        self.told_rest = self.rests();
        let x = match self.plant {
            Plant::TellsOldPlace => self.old_place,
            _ => self.body.x,
        };
        if self.told_rest {
            self.old_place = self.body.x;
        }
        let stopped = self.latch.may_move().is_err();
        let mut content = Map::new()
            .with("x", Value::Double(x))
            .with("moving", !self.told_rest)
            .with("stopped", stopped)
            .with("stop", i64::try_from(self.latch.number()).unwrap_or(0));
        if self.told_rest {
            content.set("rest", "measured");
        }
        self.say("state", content);
    }

    fn say(&self, name: &str, content: Map) {
        let mut parcel = Parcel::new(Family::Message, name)
            .context(self.channel.path().clone())
            .content(content);
        parcel.echo = Some(false);
        if name == "state" {
            parcel.delivery = Some(Delivery::Latest);
        }
        let _ = self.says.send(parcel);
    }
}

fn statements(script: &str) -> VecDeque<Statement> {
    let statement = |text: &str| {
        let words: Vec<&str> = text.split_whitespace().collect();
        let number = |index: usize| words.get(index).and_then(|word| word.parse::<f64>().ok());
        let ms = |index: usize| number(index).map(|ms| (ms * 1000.0) as Micros);
        match words.first() {
            Some(&"motor") => Some(Statement::Motor(number(1)?, ms(3)?)),
            Some(&"wait") => Some(Statement::Wait(ms(1)?)),
            _ => None,
        }
    };
    script.split(';').filter_map(statement).collect()
}
