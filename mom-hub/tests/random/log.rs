//! Turns steps into inputs: time that only goes forth, ids that rise, connections that are new after each end.

use std::collections::BTreeMap;
use std::sync::Arc;

use mom_hub::{Effect, Input, PeerClock, PeerId, Route, User};
use mom_proto::{ClockOffset, Family, Map, Parcel, Path, Time, Value};

use crate::lab::{ADMIN, EPOCH, configuration, user};
use crate::steps::{Act, Message, SEATS, Step, Who};

/// What was seen lately and may be answered, rightly or too late.
const LATELY: usize = 4;

/// What the peers and the broker know while a log runs.
#[derive(Debug, Default)]
pub(crate) struct Log {
    now: u64,
    id: u64,
    epoch: u64,
    seats: BTreeMap<usize, Seat>,
    /// The configuration that holds.
    pub(crate) variant: usize,
    offers: Vec<(Path, PeerId)>,
    /// Who is asked for a token, and by whom.
    requests: Vec<(Path, PeerId, String)>,
    questions: Vec<(PeerId, u64)>,
    /// Who has asked last for a token, or sent a message that waits for an answer, and when by ids.
    asks: Option<(PeerId, u64)>,
    /// Who owns which token.
    owners: BTreeMap<Path, PeerId>,
    /// Who may drive through which channel, and the message that it takes.
    drivers: BTreeMap<Path, (PeerId, String)>,
    /// What was sent last, and by whom.
    said: Option<(PeerId, Parcel)>,
}

#[derive(Debug, Default)]
struct Seat {
    /// How often its connection has ended.
    ended: u64,
    /// Who is logged in, and as which peer.
    user: Option<usize>,
    name: Option<String>,
    /// Its connection is lost, and may come back.
    lost: bool,
    /// The hub has closed it, and the broker has still to say that it is gone.
    closed: bool,
}

impl Log {
    pub(crate) fn new() -> Log {
        Log {
            epoch: EPOCH,
            ..Log::default()
        }
    }

    /// The input of a step, and when.
    pub(crate) fn next(&mut self, step: &Step) -> (u64, Input) {
        self.now += step.wait;
        self.id += 1;
        (self.now, self.input(step))
    }

    pub(crate) fn now(&self) -> u64 {
        self.now
    }

    fn input(&mut self, step: &Step) -> Input {
        let owned = match &step.act {
            Act::Configure(variant) => return self.configure(*variant),
            Act::Tick => return Input::Tick,
            _ => self.owned(step),
        };
        let owner = owned.as_ref().map(|(owner, ..)| *owner);
        let away = || self.away(&step.act, step.seat);
        let known = self.known(&step.act).or(owner).or_else(away);
        let seat = known.map_or_else(|| self.awake(step), seat_of);
        let peer = self.peer(seat);
        let place = self.seats.entry(seat).or_default();
        if place.closed || matches!(step.act, Act::Gone) {
            *place = Seat {
                ended: place.ended + 1,
                ..Seat::default()
            };
            return Input::Gone { peer };
        }
        if let Some(input) = self.link(&step.act, seat) {
            return input;
        }
        let mut parcel = match &step.act {
            Act::Stranger => Parcel::new(Family::Token, "grab").context(at("/lab/token")),
            Act::Login { nickname } => return self.login(seat, step.user, *nickname),
            _ if self.seats[&seat].user.is_none() => return self.login(seat, step.user, None),
            act => self.parcel(act, peer),
        };
        if let Some((_, path, name)) = owned {
            parcel.context = Some(path);
            parcel.name = name.map_or(parcel.name, Arc::from);
        }
        let said = matches!(step.act, Act::Send(_)).then(|| parcel.clone());
        self.said = said.map(|parcel| (peer, parcel)).or(self.said.take());
        let mut parcel = Box::new(parcel.id(self.id));
        let clock = self.clock(&mut parcel);
        Input::Request { peer, parcel, clock }
    }

    /// A loss, or a return. Who is lost has to come back before it says anything; some requests
    /// come before that, but no messages.
    fn link(&mut self, act: &Act, seat: usize) -> Option<Input> {
        let message = matches!(act, Act::Send(_) | Act::Again);
        let early = self.id.is_multiple_of(8) && !message;
        let place = self.seats.entry(seat).or_default();
        let lost = match act {
            Act::Lost { .. } => true,
            Act::Resumed => false,
            _ if place.lost && !early => false,
            _ => return None,
        };
        place.lost = lost && place.name.is_some();
        let peer = self.peer(seat);
        Some(match act {
            Act::Lost { grace } => Input::Lost { peer, grace: *grace },
            _ => Input::Resumed { peer },
        })
    }

    /// Who does something in place of one that is lost: mostly another peer, so that it stays lost for a while.
    fn awake(&self, step: &Step) -> usize {
        let may = matches!(step.act, Act::Gone | Act::Lost { .. }) || self.id.is_multiple_of(4);
        let awake = |seat: &usize| may || self.seats.get(seat).is_none_or(|place| !place.lost);
        let mut seats = (step.seat..SEATS).chain(0..step.seat);
        seats.find(awake).unwrap_or(step.seat)
    }

    /// Who comes back, if it is not this one.
    fn away(&self, act: &Act, seat: usize) -> Option<PeerId> {
        let mut seats = (seat..SEATS).chain(0..seat);
        let lost = |seat: &usize| self.seats.get(seat).is_some_and(|place| place.lost);
        let found = seats.find(lost).filter(|_| matches!(act, Act::Resumed));
        found.map(|seat| self.peer(seat))
    }

    /// Stamps a message by a clock that is wrong, and known or not; every so often it is too old, or of the future.
    fn clock(&self, parcel: &mut Parcel) -> Option<PeerClock> {
        let known = parcel.family == Family::Message && !self.id.is_multiple_of(3);
        let second = 1_000_000;
        let id = i64::try_from(self.id).unwrap();
        let micros = (id % 7 - 3) * 3600 * second;
        let old = match id % 32 {
            5 => -5 * second,
            11 => 5 * second,
            20..=23 => second * 3 / 4,
            _ => 1000,
        };
        let now = i64::try_from(self.now).unwrap();
        parcel.timestamp = Time::from_micros(now + micros - old);
        parcel.expires = (id % 2 == 1).then_some(1000);
        known.then_some(PeerClock {
            offset: ClockOffset { micros, error: 500 },
            future: 1_000_000,
        })
    }

    /// The peer whose answer it is, where it is the right one.
    fn known(&self, act: &Act) -> Option<PeerId> {
        match act {
            Act::Answer {
                offer: true,
                pick,
                rightly: true,
                ..
            } => pick_of(&self.offers, *pick).map(|(_, to)| *to),
            Act::Answer {
                offer: false,
                pick,
                rightly: true,
                ..
            } => pick_of(&self.requests, *pick).map(|(_, owner, _)| *owner),
            Act::Verdict {
                pick, rightly: true, ..
            } => pick_of(&self.questions, *pick).map(|(asked, _)| *asked),
            Act::Again => self.said.as_ref().map(|(peer, _)| *peer),
            _ => None,
        }
        // A connection that has ended says nothing more.
        .filter(|peer| self.peer(seat_of(*peer)) == *peer)
    }

    /// Where a step is something that only an owner may do, and an owner does it: who, where, and with which message.
    fn owned(&self, step: &Step) -> Option<(PeerId, Path, Option<String>)> {
        let any = usize::try_from(self.id).unwrap();
        let found = match &step.act {
            _ if !step.by_owner => None,
            Act::Send(message) => {
                let path = at(message.path);
                let here = self.drivers.get_key_value(&path);
                let here = here.filter(|(_, (_, name))| name == message.name);
                let elsewhere = || self.drivers.iter().nth(any % self.drivers.len().max(1));
                let found = here.or_else(|| elsewhere().filter(|_| message.name == "command"));
                found.map(|(path, (owner, name))| (*owner, path.clone(), Some(name.clone())))
            }
            // Or who has just asked for something.
            Act::Lost { .. } => {
                let asks = self.asks.filter(|(_, id)| self.id - id < 5);
                let found = self.owners.values().nth(any % self.owners.len().max(1));
                let found = asks.map(|(peer, _)| peer).or(found.copied());
                found.map(|peer| (peer, at("/"), None))
            }
            Act::Ask {
                verb: "renew" | "release",
                path,
                ..
            } => self.owners.get(&at(path)).map(|owner| (*owner, at(path), None)),
            Act::Tell {
                verb: "give", path, ..
            } => {
                let here = self.owners.get_key_value(&at(path));
                let found = here.or_else(|| self.owners.iter().nth(any % self.owners.len().max(1)));
                found.map(|(path, owner)| (*owner, path.clone(), None))
            }
            _ => None,
        };
        found.filter(|(owner, ..)| *owner != ADMIN && self.peer(seat_of(*owner)) == *owner)
    }

    fn parcel(&self, act: &Act, peer: PeerId) -> Parcel {
        let token = |verb: &str, path: Path| Parcel::new(Family::Token, verb).context(path);
        match act {
            Act::Ask { family, verb, path } => Parcel::new(*family, *verb).context(at(path)),
            Act::Create { path, spec } => Parcel::new(Family::Context, "create")
                .context(at(path))
                .content(spec.clone()),
            Act::Send(message) => message.parcel(self.epoch),
            Act::Again => match &self.said {
                Some((_, parcel)) => parcel.clone(),
                None => Parcel::new(Family::Message, "say").context(at("/lab/talk")),
            },
            Act::Tell {
                family,
                verb,
                path,
                content,
                peer,
            } => {
                let mut content = content.clone();
                if let Some((key, who)) = peer {
                    content.set(key, self.name_of(*who));
                }
                let parcel = Parcel::new(*family, *verb).context(at(path));
                match content.is_empty() {
                    true => parcel,
                    false => parcel.content(content),
                }
            }
            Act::Answer {
                verb, offer, pick, ..
            } => match offer {
                true => {
                    let offered = pick_of(&self.offers, *pick);
                    token(verb, offered.map_or(at("/yard/key"), |(path, _)| path.clone()))
                }
                false => {
                    let asked = pick_of(&self.requests, *pick);
                    let path = asked.map_or(at("/yard/key"), |(path, ..)| path.clone());
                    let who = asked.map_or("nobody", |(.., who)| who);
                    token(verb, path).content(Map::new().with("peer", who))
                }
            },
            Act::Verdict {
                pick,
                number,
                allow,
                stands,
                ..
            } => {
                let mine = |(asked, _): &&(PeerId, u64)| *asked == peer;
                let seen = pick_of(&self.questions, *pick).or_else(|| self.questions.iter().find(mine));
                let seen = seen.and_then(|(_, number)| i64::try_from(*number).ok());
                let content = Map::new()
                    .with("consult", number.or(seen).unwrap_or_default())
                    .with("allow", *allow)
                    .with("stands", *stands);
                Parcel::new(Family::Manager, "verdict").content(content)
            }
            Act::Login { .. }
            | Act::Stranger
            | Act::Gone
            | Act::Lost { .. }
            | Act::Resumed
            | Act::Configure(_)
            | Act::Tick => unreachable!("no request of its own"),
        }
    }

    fn login(&mut self, seat: usize, wished: usize, nickname: Option<&str>) -> Input {
        // One of them is always there.
        let number = (wished..wished + 2)
            .find(|number| user(*number, self.variant).is_some())
            .unwrap();
        let place = self.seats.entry(seat).or_default();
        place.user = Some(number);
        Input::Login {
            peer: self.peer(seat),
            user: user(number, self.variant).unwrap(),
            nickname: nickname.map(str::to_owned),
            id: Some(self.id),
        }
    }

    fn configure(&mut self, variant: usize) -> Input {
        let mut users: Vec<(PeerId, Option<User>)> = Vec::new();
        for (seat, place) in &self.seats {
            if let Some(number) = place.user.filter(|_| place.name.is_some() && !place.closed) {
                let (old, new) = (user(number, self.variant), user(number, variant));
                if old != new {
                    users.push((self.peer(*seat), new));
                }
            }
        }
        self.variant = variant;
        Input::Configure(Box::new(configuration(variant, users)))
    }

    /// Takes in what the effects of an input tell its peers and the broker.
    pub(crate) fn learn(&mut self, effects: &[Effect]) {
        for effect in effects {
            match effect {
                Effect::Reply { to, parcel } if parcel.is(Family::Reply, "ok") => {
                    let name = parcel.value();
                    let name = name.get("limits").and_then(|_| name.get("peer")?.as_str());
                    if let (Some(name), true) = (name, self.peer(seat_of(*to)) == *to) {
                        self.seats.entry(seat_of(*to)).or_default().name = Some(name.to_owned());
                    }
                }
                Effect::Deliver { to, parcel } => self.hear(to, parcel),
                Effect::Route(route) => self.learn_owner(route),
                Effect::Close { peer, .. } if self.peer(seat_of(*peer)) == *peer => {
                    self.seats.entry(seat_of(*peer)).or_default().closed = true;
                }
                _ => {}
            }
        }
    }

    fn learn_owner(&mut self, route: &Route) {
        let Some(guard) = &route.guard else {
            drop(self.drivers.remove(&route.path));
            return;
        };
        match guard.owner.as_ref().map(|owner| owner.peer) {
            Some(owner) => {
                self.owners.insert(guard.token.clone(), owner);
                let name = guard.names.first().filter(|name| **name != "*");
                let name = name.map_or("command", |name| name).to_owned();
                self.drivers.insert(route.path.clone(), (owner, name));
            }
            None => {
                self.owners.remove(&guard.token);
                self.drivers.remove(&route.path);
            }
        }
    }

    fn hear(&mut self, to: &[PeerId], parcel: &Parcel) {
        let content = parcel.value();
        let path = || parcel.context.clone().unwrap();
        let named = |key: &str| {
            let name = content.get(key).and_then(Value::as_str);
            let peer = |peer: &&PeerId| self.name_at(seat_of(**peer)) == name;
            to.iter().find(peer).copied()
        };
        match (parcel.family, parcel.name()) {
            (Family::Event, "offer") => {
                if let Some(peer) = named("to") {
                    keep(&mut self.offers, (path(), peer));
                }
            }
            (Family::Event, "requested") => {
                let asks = content.get("peer").and_then(Value::as_str).unwrap();
                let owner = to.iter().find(|peer| Some(**peer) != named("peer"));
                if let Some(owner) = owner {
                    keep(&mut self.requests, (path(), *owner, asks.to_owned()));
                    self.note_asking(Some(asks));
                }
            }
            (Family::Manager, "consult") => {
                for peer in to {
                    keep(&mut self.questions, (*peer, parcel.id.unwrap()));
                }
                let asks = content.get("message").and_then(|_| content.get("peer")?.as_str());
                self.note_asking(asks);
            }
            _ => {}
        }
    }

    fn note_asking(&mut self, name: Option<&str>) {
        let peer = name.and_then(|name| self.named(name));
        self.asks = peer.map(|peer| (peer, self.id)).or(self.asks);
    }

    /// The hub was started anew: all connections have ended, and its time begins again.
    pub(crate) fn restart(&mut self, epoch: u64) {
        for seat in 0..SEATS {
            let place = self.seats.entry(seat).or_default();
            *place = Seat {
                ended: place.ended + 1,
                ..Seat::default()
            };
        }
        self.now = 0;
        self.epoch = epoch;
        self.offers.clear();
        self.requests.clear();
        self.questions.clear();
        self.asks = None;
        self.owners.clear();
        self.drivers.clear();
        self.said = None;
    }

    /// All connections that are there.
    pub(crate) fn peers(&self) -> Vec<PeerId> {
        (0..SEATS).map(|seat| self.peer(seat)).collect()
    }

    fn peer(&self, seat: usize) -> PeerId {
        let ended = self.seats.get(&seat).map_or(0, |place| place.ended);
        PeerId(1 + seat as u64 + ended * SEATS as u64)
    }

    fn name_at(&self, seat: usize) -> Option<&str> {
        self.seats.get(&seat)?.name.as_deref()
    }

    fn named(&self, name: &str) -> Option<PeerId> {
        let seat = (0..SEATS).find(|seat| self.name_at(*seat) == Some(name));
        seat.map(|seat| self.peer(seat))
    }

    fn name_of(&self, who: Who) -> String {
        self.name_at(who.0).unwrap_or("nobody").to_owned()
    }
}

fn seat_of(peer: PeerId) -> usize {
    usize::try_from(peer.0 - 1).unwrap() % SEATS
}

/// The lately seen one of this number, the last first.
fn pick_of<T>(seen: &[T], pick: usize) -> Option<&T> {
    let last = seen.len().checked_sub(1)?;
    seen.get(last.saturating_sub(pick % LATELY))
}

fn keep<T>(seen: &mut Vec<T>, new: T) {
    seen.push(new);
    if seen.len() > LATELY {
        seen.remove(0);
    }
}

impl Message {
    fn parcel(&self, epoch: u64) -> Parcel {
        let mut parcel = Parcel::new(Family::Message, self.name).context(at(self.path));
        parcel.address = self
            .to
            .as_ref()
            .map(|to| to.iter().map(|name| Arc::from(*name)).collect());
        parcel.fence = self.fence.map(|number| (epoch << 20) + number);
        parcel.echo = self.echo;
        parcel.receipt = self.receipt.then_some(true);
        parcel
    }
}

/// A path that is one.
pub(crate) fn at(path: &str) -> Path {
    Path::parse(path).unwrap()
}
