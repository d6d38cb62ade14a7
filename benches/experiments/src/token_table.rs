//! M29: when the robot's token changes its owner. The lab's own configuration in a hub whose clock is moved by hand.

use std::fmt::Write as _;

use anyhow::{Context as _, Result, bail};
use mom_broker::Config;
use mom_hub::{Effect, Hub, Input, PeerId, User};
use mom_plots::{Axis, Plot, Series};
use mom_proto::{Family, Map, Parcel, Path, Value};

use super::{IMAGES, Section, Settings};

const TOKEN: &str = "/robot/token";
const ARM: &str = "/robot/arm";
const SECOND: u64 = 1_000_000;
/// The paper's 3 minutes, µs.
const LEASE: u64 = 180 * SECOND;
/// When the owner renews the last time, µs after it has grabbed.
const RENEWED: u64 = 60 * SECOND;
/// The times of the table since then, µs.
const ASKED: [u64; 4] = [179 * SECOND, LEASE - 1, LEASE, 181 * SECOND];
/// The owner's levels of the table; each is asked by a lower, an equal and a higher one.
const OWNERS: [i32; 3] = [1, 2, 5];

const OWNER: PeerId = PeerId(1);

/// A hub, its time, and what its peers have been told since they were looked at last.
struct Lab {
    hub: Hub,
    now: u64,
    id: u64,
    heard: Vec<(PeerId, Parcel)>,
}

/// What became of a grab.
#[derive(Clone, Debug, PartialEq)]
enum Outcome {
    /// The asker owns it; why the owner lost it.
    Taken(String),
    /// The asker waits in the queue at this place.
    Waits(i64),
    Refused {
        code: String,
        text: String,
        place: Option<i64>,
        retry: Option<i64>,
    },
}

/// One line of the table: the levels, and what became of the grab at each of [`ASKED`].
#[derive(Debug)]
struct Row {
    owner: i32,
    asker: i32,
    outcomes: Vec<Outcome>,
}

/// A peer in the queue.
#[derive(Debug)]
struct Waiter {
    level: i32,
    /// s since the owner's last renewal.
    asked: u64,
    told: Outcome,
    /// From which s on it owns the token.
    got: Option<u64>,
}

/// Seconds of waiting by the second of asking.
type Curve = (&'static str, Vec<(f64, f64)>);

/// One fact beside the table.
#[derive(Debug)]
struct Fact {
    what: &'static str,
    seen: String,
}

impl Lab {
    fn new() -> Result<Lab> {
        Ok(Lab {
            hub: Config::lab().hub()?,
            now: 0,
            id: 0,
            heard: Vec::new(),
        })
    }

    fn enter(&mut self, peer: PeerId, level: i32) -> Result<()> {
        let user = User {
            name: format!("user-{}", peer.0),
            level,
            groups: Vec::new(),
            details: Map::new(),
        };
        let (nickname, id) = (None, Some(1));
        self.give(Input::Login {
            peer,
            user,
            nickname,
            id,
        });
        for path in ["/robot", ARM] {
            // Who may not join is refused here already; what counts is what the grab says.
            self.ask(peer, Family::Context, "join", path, Map::new())?;
        }
        Ok(())
    }

    fn ask(&mut self, peer: PeerId, family: Family, verb: &str, path: &str, content: Map) -> Result<()> {
        self.id += 1;
        let mut parcel = Parcel::new(family, verb).context(Path::parse(path)?).id(self.id);
        if !content.is_empty() {
            parcel = parcel.content(content);
        }
        self.give(Input::Request {
            peer,
            parcel: Box::new(parcel),
            clock: None,
        });
        Ok(())
    }

    fn grab(&mut self, peer: PeerId, content: Map) -> Result<Outcome> {
        self.heard.clear();
        self.ask(peer, Family::Token, "grab", TOKEN, content)?;
        self.outcome(peer).context("the hub does not answer a grab")
    }

    /// What the last parcels say of a grab of this peer.
    fn outcome(&self, peer: PeerId) -> Option<Outcome> {
        let mut mine = self
            .heard
            .iter()
            .filter(|(to, _)| *to == peer)
            .map(|(_, parcel)| parcel);
        mine.find_map(|parcel| match (parcel.family, parcel.name()) {
            (Family::Reply, _) if parcel.reference == Some(self.id) => Some(Outcome::Taken(self.lost())),
            (Family::Event, "queued") => Some(Outcome::Waits(int(parcel, "place").unwrap_or_default())),
            (Family::Error, code) => Some(Outcome::Refused {
                code: code.to_owned(),
                text: word(parcel, "text"),
                place: int(parcel, "place"),
                retry: int(parcel, "retry-after"),
            }),
            _ => None,
        })
    }

    /// Why an owner was told that it has lost the token.
    fn lost(&self) -> String {
        let released = self.heard.iter().find(|(_, parcel)| parcel.name() == "released");
        released.map_or_else(String::new, |(_, parcel)| word(parcel, "reason"))
    }

    fn give(&mut self, input: Input) {
        let mut effects = Vec::new();
        self.hub.handle(self.now, input, &mut effects);
        for effect in effects {
            match effect {
                Effect::Reply { to, parcel } => self.heard.push((to, parcel.as_ref().clone())),
                Effect::Deliver { to, parcel } => {
                    self.heard
                        .extend(to.into_iter().map(|to| (to, parcel.as_ref().clone())));
                }
                _ => {}
            }
        }
    }

    /// Lets time pass until then.
    fn pass(&mut self, until: u64) {
        while let Some(due) = self.hub.deadline().filter(|due| *due <= until) {
            self.now = due.max(self.now);
            self.give(Input::Tick);
            if self.hub.deadline() == Some(due) {
                break;
            }
        }
        self.now = until;
        self.give(Input::Tick);
    }

    /// The owner of this level has the token and has renewed it now; one asker of each other level is there.
    fn owned(owner: i32, askers: &[i32]) -> Result<Lab> {
        let mut lab = Lab::new()?;
        lab.enter(OWNER, owner)?;
        for (peer, level) in (2..).map(PeerId).zip(askers) {
            lab.enter(peer, *level)?;
        }
        lab.grab(OWNER, Map::new())?;
        lab.pass(RENEWED);
        lab.ask(OWNER, Family::Token, "renew", TOKEN, Map::new())?;
        Ok(lab)
    }

    /// Whether this peer was told since the last look that it owns the token.
    fn owns(&self, peer: PeerId) -> bool {
        self.heard.iter().any(|(to, parcel)| {
            *to == peer && parcel.family == Family::Reply && parcel.value().get("lease").is_some()
        })
    }

    /// Whether a command of this peer is admitted, now.
    fn commands(&mut self, peer: PeerId) -> Result<bool> {
        self.heard.clear();
        let mut parcel = Parcel::new(Family::Message, "command").context(Path::parse(ARM)?);
        self.id += 1;
        parcel.id = Some(self.id);
        self.give(Input::Request {
            peer,
            parcel: Box::new(parcel),
            clock: None,
        });
        let refused = |(to, parcel): &(PeerId, Parcel)| *to == peer && parcel.family == Family::Error;
        Ok(!self.heard.iter().any(refused))
    }
}

fn int(parcel: &Parcel, key: &str) -> Option<i64> {
    parcel.value().get(key).and_then(Value::as_int)
}

fn word(parcel: &Parcel, key: &str) -> String {
    let value = parcel.value();
    value
        .get(key)
        .and_then(Value::as_str)
        .unwrap_or_default()
        .to_owned()
}

pub(super) fn run(settings: &Settings) -> Result<Section> {
    let rows = rows()?;
    let curves = curves(if settings.quick { 60 } else { 5 })?;
    Ok(Section {
        markdown: markdown(&rows, &queue()?, &facts()?),
        plots: vec![("experiment-token-table.svg", plot(curves))],
    })
}

fn rows() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for owner in OWNERS {
        for asker in [owner - 1, owner, owner + 1] {
            let outcomes = ASKED.map(|asked| {
                let mut lab = Lab::owned(owner, &[asker])?;
                lab.pass(RENEWED + asked);
                lab.grab(PeerId(2), Map::new())
            });
            rows.push(Row {
                owner,
                asker,
                outcomes: outcomes.into_iter().collect::<Result<_>>()?,
            });
        }
    }
    Ok(rows)
}

/// What the paper's sentence says of a grab.
fn paper(owner: i32, asker: i32, since_renewal: u64) -> bool {
    asker > owner || since_renewal >= LEASE
}

/// Those who wait for a token of an owner of level 3, in the order in which they ask.
fn queue() -> Result<Vec<Waiter>> {
    let waiting = [(1, 10), (3, 20), (2, 30)];
    let mut lab = Lab::owned(3, &waiting.map(|(level, _)| level))?;
    let mut queue = Vec::new();
    for ((level, asked), peer) in waiting.into_iter().zip((2..).map(PeerId)) {
        lab.pass(RENEWED + asked * SECOND);
        queue.push(Waiter {
            level,
            asked,
            told: lab.grab(peer, unlimited())?,
            got: None,
        });
    }
    // Nobody renews: each of them has it for the 3 minutes.
    for second in 40..=1000 {
        lab.heard.clear();
        lab.pass(RENEWED + second * SECOND);
        for (waiter, peer) in queue.iter_mut().zip((2..).map(PeerId)) {
            if waiter.got.is_none() && lab.owns(peer) {
                waiter.got = Some(second);
            }
        }
    }
    Ok(queue)
}

fn unlimited() -> Map {
    Map::new().with("wait", "unlimited")
}

fn facts() -> Result<Vec<Fact>> {
    let asker = PeerId(2);
    let at = |second: u64| RENEWED + second * SECOND;
    let mut facts = Vec::new();
    let mut commands = Lab::owned(1, &[1])?;
    for second in 1..180 {
        commands.pass(at(second));
        if !commands.commands(OWNER)? {
            bail!("a command of the owner is refused");
        }
    }
    commands.pass(at(180));
    facts.push(Fact {
        what: "the owner sends a command each second, and does not renew; an equal asks at 180 s",
        seen: show(&commands.grab(asker, Map::new())?),
    });
    let mut again = Lab::owned(1, &[1])?;
    again.pass(at(100));
    let _ = again.grab(OWNER, Map::new())?;
    again.pass(at(200));
    facts.push(Fact {
        what: "the owner grabs its own token again at 100 s; an equal asks at 200 s",
        seen: show(&again.grab(asker, Map::new())?),
    });
    let mut nobody = Lab::owned(1, &[1])?;
    nobody.pass(at(600));
    let drives = nobody.commands(OWNER)?;
    nobody.ask(OWNER, Family::Token, "renew", TOKEN, Map::new())?;
    facts.push(Fact {
        what: "nobody asks until 600 s; then the owner sends a command and renews, and an equal asks",
        seen: format!(
            "command {}; then {}",
            if drives { "admitted" } else { "refused" },
            show(&nobody.grab(asker, Map::new())?)
        ),
    });
    Ok(facts)
}

/// The seconds until an asker has the token, by when it asks.
fn curves(step: usize) -> Result<Vec<Curve>> {
    let names = ["a lower or equal level", "a higher level"];
    let levels = [2, 3];
    let curve = |level: i32| {
        let times = (0..=240).step_by(step);
        let point = |asked: u64| {
            let mut lab = Lab::owned(2, &[level])?;
            lab.pass(RENEWED + asked * SECOND);
            let start = lab.now;
            let mut taken = matches!(lab.grab(PeerId(2), unlimited())?, Outcome::Taken(_));
            while !taken {
                let due = lab.hub.deadline().context("nobody gets the token")?;
                lab.pass(due);
                taken = lab.owns(PeerId(2));
            }
            Ok((asked as f64, (lab.now - start) as f64 / SECOND as f64))
        };
        times.map(point).collect::<Result<Vec<_>>>()
    };
    let curves = names.into_iter().zip(levels);
    curves.map(|(name, level)| Ok((name, curve(level)?))).collect()
}

fn show(outcome: &Outcome) -> String {
    match outcome {
        Outcome::Taken(reason) => format!("taken ({reason})"),
        Outcome::Waits(place) => format!("waits at place {place}"),
        Outcome::Refused {
            code, place, retry, ..
        } => {
            let mut text = format!("`{code}`");
            if let Some(retry) = retry {
                let _ = write!(text, ", again in {retry} ms");
            }
            if let Some(place) = place {
                let _ = write!(text, ", place {place}");
            }
            text
        }
    }
}

fn markdown(rows: &[Row], queue: &[Waiter], facts: &[Fact]) -> String {
    let mut text = "The paper: the token's manager \"will only allow change of ownership if the requesting user has a higher access levels, or if the token ownership has not been renewed for 3 minutes\". \
                    Here the hub decides, with the lab's own configuration (`config/lab.toml`) and with its time moved by hand to the microsecond. The owner has renewed at 0 s; an asker of a lower, the same or a higher level grabs at the time of the column. \
                    What differs from the paper's sentence is in bold.\n\n\
                    **Inputs:** the levels and the times; users without a group. Nothing is drawn, so the seed does not matter.\n\n| owner | asker |"
        .to_owned();
    for asked in ASKED {
        let _ = write!(text, " {} s |", asked as f64 / SECOND as f64);
    }
    text += "\n|---:|---:|---|---|---|---|\n";
    let (mut cases, mut different, mut words) = (0, 0, Vec::new());
    for row in rows {
        let _ = write!(text, "| {} | {} |", row.owner, row.asker);
        for (asked, outcome) in ASKED.into_iter().zip(&row.outcomes) {
            let differs = paper(row.owner, row.asker, asked) != matches!(outcome, Outcome::Taken(_));
            cases += 1;
            different += usize::from(differs);
            let mark = if differs { "**" } else { "" };
            let _ = write!(text, " {mark}{}{mark} |", show(outcome));
            if let Outcome::Refused { code, text, .. } = outcome
                && !words.iter().any(|(known, _)| *known == code)
            {
                words.push((code, text));
            }
        }
        text.push('\n');
    }
    text += "\nThe first refusal of each code in its words:";
    for (code, words) in words {
        let _ = write!(text, " `{code}`: \"{words}\";");
    }
    text.pop();
    text += ".\n\nBeside the table:\n\n| what | seen |\n|---|---|\n";
    for fact in facts {
        let _ = writeln!(text, "| {} | {} |", fact.what, fact.seen);
    }
    text += "\nA grab may say that it waits. The owner here is of level 3; those who wait do not renew either, once they own it:\n\n| level | asks at | is told | owns it from |\n|---:|---:|---|---:|\n";
    for waiter in queue {
        let Waiter {
            level,
            asked,
            told,
            got,
        } = waiter;
        let got = got.map_or_else(|| "never".to_owned(), |second| format!("{second} s"));
        let _ = writeln!(text, "| {level} | {asked} s | {} | {got} |", show(told));
    }
    let _ = write!(
        text,
        "\n{} of {cases} decisions are the paper's; {different} are not. The difference is in who may ask at all: the lab lets users of level 1 and more drive, so one of level 0, a guest or a device, is refused whatever the time. \
         The paper is silent on four points, and the hub's answers are readings of M29: the 3 minutes are over at 180 s and not after them; only `renew`, or a grab of one's own, renews, commands do not; an owner whose time is over drives on, and may renew, until another peer asks; \
         and who is refused may wait in a queue, which goes by level and then by arrival. The plot shows how long one that waits has to.\n\n![Time until the asker owns the token](images/{IMAGES}-token-table.svg)\n",
        cases - different
    );
    text
}

fn plot(curves: Vec<Curve>) -> String {
    let plot = Plot::new(
        "How long an asker waits for a token that its owner does not renew (M29)",
        Axis::linear("s since the owner's last renewal, when asked"),
        Axis::linear("s until the asker owns it").from_to(0.0, 200.0),
    );
    let plot = curves
        .into_iter()
        .fold(plot, |plot, (name, curve)| plot.with(Series::line(name, curve)));
    plot.mark_x(180.0, "the paper: 3 minutes").to_svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lab_decides_as_the_paper_but_for_who_may_not_drive() {
        for row in rows().unwrap() {
            for (asked, outcome) in ASKED.into_iter().zip(&row.outcomes) {
                let taken = matches!(outcome, Outcome::Taken(_));
                let want = paper(row.owner, row.asker, asked) && row.asker >= 1;
                assert_eq!(taken, want, "{row:?}");
                if let Outcome::Taken(reason) = outcome {
                    assert_eq!(reason, if asked < LEASE { "preempted" } else { "expired" });
                }
            }
        }
    }

    #[test]
    fn the_paper_s_rule() {
        for (owner, asker, at, want) in [
            (1, 1, LEASE - 1, false),
            (1, 1, LEASE, true),
            (2, 1, LEASE - 1, false),
            (2, 1, LEASE, true),
            (1, 2, 0, true),
        ] {
            assert_eq!(paper(owner, asker, at), want, "{owner} {asker} {at}");
        }
    }

    #[test]
    fn the_queue_is_by_level_and_then_by_time() {
        let queue = queue().unwrap();
        let waits = |waiter: &Waiter| matches!(waiter.told, Outcome::Waits(_));
        assert!(queue.iter().all(waits), "{queue:?}");
        let got: Vec<Option<u64>> = queue.iter().map(|waiter| waiter.got).collect();
        assert_eq!(got, [Some(540), Some(180), Some(360)], "levels 1, 3, 2");
    }

    #[test]
    fn who_asks_waits_for_what_is_left() {
        let curves = curves(90).unwrap();
        assert_eq!(curves[0].1, [(0.0, 180.0), (90.0, 90.0), (180.0, 0.0)]);
        assert!(curves[1].1.iter().all(|(_, waits)| *waits == 0.0));
    }

    #[test]
    fn facts_beside_the_table() {
        let facts = facts().unwrap();
        let seen: Vec<&str> = facts.iter().map(|fact| fact.seen.as_str()).collect();
        assert_eq!(seen[0], "taken (expired)");
        assert_eq!(seen[1], "`held`, again in 80000 ms, place 1");
        assert_eq!(
            seen[2],
            "command admitted; then `held`, again in 180000 ms, place 1"
        );
    }
}
