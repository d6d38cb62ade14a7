//! One trial: what happens to a world, by its seed, and what was seen of it.

use std::sync::PoisonError;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use mom_client::{ClientError, DeviceAnswer, Path, TokenGuard};
use mom_tests::datagrams::Weather;
use tokio::time::{Instant, sleep_until, timeout};

use super::log::{Hindered, Log, Seen, now};
use super::plan::{Deed, Way, plan};
use super::rules::{MOST_PAUSE, Rule, Violation, judge};
use super::world::{Kind, OPERATOR, PEOPLE, World};

/// How long one deed may take, such as while the hub is stopped.
const AT_MOST: Duration = Duration::from_secs(1);
/// How long a device may take until it obeys a stop again when all is well again.
const RECOVERY: Duration = Duration::from_secs(30);

/// A bad network of datagrams.
const ROUGH: Weather = Weather {
    cut: false,
    loss: 0.2,
    doubled: 0.1,
    delay: Duration::from_millis(5),
    jitter: Duration::from_millis(40),
};

/// What came of a trial.
#[derive(Debug)]
pub(super) struct Outcome {
    pub(super) seed: u64,
    pub(super) log: Log,
    pub(super) violations: Vec<Violation>,
    /// Why it is not judged.
    pub(super) unjudged: Option<String>,
    plan: Vec<(u64, Deed)>,
}

impl Outcome {
    /// All of it, for who looks for the cause.
    pub(super) fn story(&self, kind: Kind) -> String {
        let mut lines = vec![format!("{kind:?}, MOM_ORACLE_SEED={}", self.seed)];
        lines.extend(
            self.plan
                .iter()
                .map(|(at, deed)| format!("  plan {at} ms: {deed:?}")),
        );
        let begin = self.log.seen.first().map_or(0, |(at, _)| *at);
        let mut seen: Vec<(i64, String)> = Vec::new();
        let mut last = String::new();
        for (at, what) in &self.log.seen {
            let words = format!("{what:?}");
            if words != last {
                seen.push((*at, words.clone()));
            }
            last = words;
        }
        for body in &self.log.bodies {
            for sample in body.iter().step_by(10) {
                seen.push((sample.at, format!("    body {:?}", sample.place)));
            }
        }
        seen.extend(
            self.violations
                .iter()
                .map(|found| (found.at, format!("VIOLATION {found}"))),
        );
        seen.sort_by_key(|(at, _)| *at);
        lines.extend(
            seen.iter()
                .map(|(at, words)| format!("  {:7.1} ms {words}", (at - begin) as f64 / 1000.0)),
        );
        lines.join("\n")
    }
}

/// The longest time for which this process had no turn, µs, since it was asked last.
static PAUSE: AtomicI64 = AtomicI64::new(0);

/// Watches whether this process has its turns; once for all worlds.
pub(super) fn watch_pauses() {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| {
        std::thread::spawn(|| {
            let mut last = now();
            loop {
                std::thread::sleep(Duration::from_millis(10)); // tidy: how long this takes is what it measures
                let here = now();
                PAUSE.fetch_max(here - last - 10_000, Ordering::Relaxed);
                last = here;
            }
        });
    });
}

/// One world's trials, one after the other.
pub(super) struct Trials {
    world: World,
    ways: [f64; 3],
    holder: Option<(usize, TokenGuard)>,
    /// The newest stop that this test has said.
    stop: u64,
}

impl Trials {
    /// Of this kind of device; it rests.
    pub(super) async fn of(kind: Kind, seed: u64) -> Trials {
        watch_pauses();
        let mut trials = Trials {
            world: World::new(kind, seed).await,
            ways: [1.0; 3],
            holder: None,
            stop: 0,
        };
        if let Some(why) = trials.come_to_rest().await {
            panic!("{kind:?} does not begin: {why}; {}", trials.logs());
        }
        trials
    }

    /// The ends of its programs' logs.
    fn logs(&self) -> String {
        let files = std::fs::read_dir(self.world.folder.path())
            .into_iter()
            .flatten()
            .flatten();
        let mut all = String::new();
        for file in files.filter(|file| file.path().extension().is_some_and(|end| end == "log")) {
            let text = std::fs::read_to_string(file.path()).unwrap_or_default();
            let lines: Vec<&str> = text.lines().rev().take(12).collect();
            let lines: Vec<&str> = lines.into_iter().rev().collect();
            all += &format!("\n{}:\n{}", file.file_name().display(), lines.join("\n"));
        }
        all
    }

    /// Does what this seed says, and judges what the body did.
    pub(super) async fn run(&mut self, seed: u64) -> Outcome {
        let kind = self.world.kind;
        let plan = plan(kind, seed);
        self.begin().await;
        let begin = Instant::now();
        for (at, deed) in &plan {
            sleep_until(begin + Duration::from_millis(*at)).await; // tidy: when what happens is what a seed says
            let _ = timeout(AT_MOST, self.act(deed, seed)).await;
        }
        let stuck = self.come_to_rest().await;
        let mut log = Log {
            seen: self.world.notes.take(),
            pause: PAUSE.load(Ordering::Relaxed),
            bodies: Vec::new(),
        };
        let traced = self.world.reading.more();
        log.bodies = traced.unwrap_or_default();
        let unjudged =
            (log.pause > MOST_PAUSE).then(|| format!("the machine stood still for {} ms", log.pause / 1000));
        let mut violations = judge(&log, &kind.spec());
        if let Some(why) = &stuck {
            let words = format!("{why}; {}", self.logs());
            let (rule, at) = (Rule::DoesNotComeToRest, now());
            violations.push(Violation { rule, at, words });
        }
        Outcome {
            seed,
            log,
            violations,
            unjudged,
            plan,
        }
    }

    /// All are let go, and who goes which way is settled: to where there is room.
    async fn begin(&mut self) {
        let _ = self.world.reading.more();
        let at = self.world.reading.last().map_or(0.0, |sample| sample.place[0]);
        let first = if at > self.world.kind.middle() { -1.0 } else { 1.0 };
        self.ways = [first, -first, -first];
        self.world.notes.take();
        PAUSE.store(0, Ordering::Relaxed);
        self.unstop(Duration::from_secs(2)).await;
    }

    async fn act(&mut self, deed: &Deed, seed: u64) {
        let hinder = |what, begins| Seen::Hinder { what, begins };
        let notes = self.world.notes.clone();
        match deed {
            Deed::Drive(pause, lasts) => self.drive(*pause, *lasts),
            Deed::Stop => self.stop(Duration::ZERO).await,
            Deed::Unstop => self.unstop(Duration::ZERO).await,
            Deed::HandOver(way) => self.hand_over(*way).await,
            Deed::Link(true) => {
                self.world.link.freeze(true);
                notes.note(hinder(Hindered::Link, true));
            }
            Deed::Link(false) => {
                notes.note(hinder(Hindered::Link, false));
                self.world.link.freeze(false);
            }
            Deed::Sever => {
                notes.note(hinder(Hindered::Link, true));
                self.world.link.sever();
                notes.note(hinder(Hindered::Link, false));
            }
            Deed::Wire(frozen) => {
                notes.note(hinder(Hindered::Wire, *frozen));
                let cut = Weather {
                    cut: *frozen,
                    ..Weather::default()
                };
                self.weather(*frozen, cut);
            }
            Deed::Rough => {
                notes.note(hinder(Hindered::Wire, true));
                self.weather(false, ROUGH);
            }
            Deed::Pause(which) => {
                let program = &mut self.world.programs[*which];
                program.pause();
                notes.note(hinder(Hindered::Program(*which), true));
            }
            Deed::GoOn(which) => {
                let program = &mut self.world.programs[*which];
                if program.is_stopped {
                    notes.note(hinder(Hindered::Program(*which), false));
                }
                program.go_on();
            }
            Deed::Kill(which) => {
                let program = &mut self.world.programs[*which];
                program.kill();
                notes.note(hinder(Hindered::Program(*which), true));
            }
            Deed::Restart(which) => {
                let program = &mut self.world.programs[*which];
                if !program.is_running() {
                    notes.note(hinder(Hindered::Program(*which), false));
                    program.start();
                }
            }
            Deed::Reload => self.world.configure(seed, self.world.is_guarded),
            Deed::Guard(is_guarded) => {
                if let Some((_, guard)) = self.holder.take() {
                    let _ = guard.release().await;
                }
                self.world.configure(seed, *is_guarded);
            }
            Deed::Nothing => {}
        }
    }

    /// What the network between the device's program and its robot does.
    fn weather(&self, frozen: bool, weather: Weather) {
        if let Some(wire) = &self.world.wire {
            wire.freeze(frozen);
        }
        if let Some(datagrams) = &self.world.datagrams {
            datagrams.set(weather);
        }
    }

    /// The owner sends a command, and waits for nothing.
    fn drive(&mut self, pause: u64, lasts: u64) {
        let (who, fence) = match &self.holder {
            Some((who, guard)) => (*who, Some(guard.fence())),
            // Anybody may.
            None if !self.world.is_guarded => (0, None),
            None => return,
        };
        let ways = self.ways[who];
        let (script, last) = self.world.kind.script(ways, pause, lasts);
        let owner = PEOPLE[who].to_owned();
        let notes = self.world.notes.clone();
        let mut all = self.world.lasts.lock().unwrap_or_else(PoisonError::into_inner);
        all[who] = last;
        drop(all);
        notes.note(Seen::Command {
            owner: owner.clone(),
            ways,
            fenced: fence.is_some(),
        });
        let message = self.world.people[who].channel.message("command").content(script);
        let message = match fence {
            Some(fence) => message.fence(fence),
            None => message,
        };
        tokio::spawn(async move {
            match message.send_acknowledged().await {
                Err(ClientError::Refused(_)) => notes.note(Seen::Ended { owner }),
                Ok(receipt) if receipt.delivered == 0 => notes.note(Seen::Ended { owner }),
                _ => {}
            }
        });
    }

    async fn stop(&mut self, within: Duration) {
        let client = &self.world.operator().client;
        let asked = client
            .stop(self.world.kind.channel_path())
            .within(within)
            .send()
            .await;
        if let Ok(report) = asked {
            for channel in report.channels {
                self.stop = self.stop.max(channel.number);
                self.world.notes.note(Seen::Stop {
                    number: channel.number,
                });
            }
        }
    }

    /// Lets it go from all stops that there are.
    async fn unstop(&mut self, within: Duration) {
        let path = self.world.kind.channel_path();
        let client = self.world.operator().client.clone();
        let Ok(state) = client.stops(path).await else {
            return;
        };
        self.stop = self.stop.max(state.number);
        if !state.stopped {
            return;
        }
        self.world.notes.note(Seen::Unstop { number: self.stop });
        let place = Path::parse(path).expect("a path");
        let _ = client
            .unstop(path, [(&place, self.stop)])
            .within(within)
            .send()
            .await;
    }

    async fn hand_over(&mut self, way: Way) {
        // The token is of no use.
        if !self.world.is_guarded {
            return;
        }
        let old = self.holder.take();
        let from = old.as_ref().map_or(OPERATOR, |(who, _)| *who);
        // Above the operator is nobody: she lets go.
        let way = if from == OPERATOR { Way::LetGo } else { way };
        let to = match way {
            Way::Take => OPERATOR,
            _ if from == 0 => 1,
            _ => 0,
        };
        match (way, old) {
            (Way::Give, Some((_, guard))) => {
                let give = guard
                    .give(PEOPLE[to])
                    .within(Duration::from_millis(900))
                    .into_future();
                let accept = async {
                    loop {
                        if let Ok(guard) = self.world.people[to].token.accept().await {
                            return guard;
                        }
                        tokio::time::sleep(Duration::from_millis(5)).await; // tidy: the offer is under way
                    }
                };
                let (_, accepted) = tokio::join!(give, accept);
                self.holder = Some((to, accepted));
            }
            (_, old) => {
                if let Some((_, guard)) = old.filter(|_| !matches!(way, Way::Take)) {
                    let _ = guard.release().await;
                }
                if let Ok(guard) = self.world.people[to].token.grab().await {
                    let owner = PEOPLE[to].to_owned();
                    self.world.notes.note(Seen::Grant {
                        owner,
                        fence: guard.fence(),
                    });
                    self.holder = Some((to, guard));
                }
            }
        }
    }

    /// Heals all, and stops the device until it says that it rests; why not, if it does not.
    async fn come_to_rest(&mut self) -> Option<String> {
        self.world.heal();
        if !self.world.is_guarded {
            self.world.configure(0, true);
        }
        if let Some((_, guard)) = self.holder.take() {
            let _ = timeout(AT_MOST, guard.release()).await;
        }
        let path = self.world.kind.channel_path();
        let client = self.world.operator().client.clone();
        let until = Instant::now() + RECOVERY;
        let mut last = String::new();
        while Instant::now() < until {
            let asked = client.stop(path).within(Duration::from_secs(3)).send().await;
            let report = match asked {
                Ok(report) => report,
                Err(error) => {
                    last = error.to_string();
                    tokio::time::sleep(Duration::from_millis(100)).await; // tidy: the hub begins again meanwhile
                    continue;
                }
            };
            let mut rests = false;
            for channel in &report.channels {
                self.stop = self.stop.max(channel.number);
                self.world.notes.note(Seen::Stop {
                    number: channel.number,
                });
                rests = channel.devices.iter().any(|(_, answer)| {
                    matches!(answer, DeviceAnswer::Obeys(standing) if standing.rest.is_some() && !standing.moving && !standing.unreached)
                });
            }
            if rests {
                return None;
            }
            last = format!("{report:?}");
            tokio::time::sleep(Duration::from_millis(100)).await; // tidy: its programs begin again meanwhile
        }
        Some(format!("it does not come to rest when all is well: {last}"))
    }
}
