//! The queues of tokens: who waits comes in turn, and nobody before.

use std::collections::{BTreeMap, BTreeSet};

use mom_proto::Path;

use crate::lab::Rules;
use crate::look::{Look, Looks};
use crate::owners::{Lost, Owned};
use crate::seen::Seen;

/// A grab that waits.
#[derive(Clone, Debug)]
pub(crate) struct Waiter {
    pub(crate) name: String,
    /// The id of its request.
    id: u64,
    level: i32,
    since: u64,
    place: usize,
    /// Whether a peer was asked about it, which may be quicker about others.
    asked: bool,
}

/// The queues of all tokens, by events and replies only.
#[derive(Debug, Default)]
pub(crate) struct Queues {
    waiting: BTreeMap<Path, Vec<Waiter>>,
    /// Who was the first and is about to be granted the token, once that is durable.
    called: BTreeMap<Path, Waiter>,
    /// To whom a token is about to go over from its owner, once that is durable.
    promised: BTreeMap<Path, String>,
    /// Tokens for which a peer waits twice, so that it is not known which of its grabs is meant.
    unclear: BTreeSet<Path>,
    /// Tokens that are reserved since a restart.
    reserved: BTreeSet<Path>,
    /// Tokens whose order of waiting has changed while some waited.
    mixed: BTreeSet<Path>,
}

/// What is told to who begins to wait, or comes nearer.
pub(crate) struct Told<'a> {
    pub(crate) path: &'a Path,
    pub(crate) name: &'a str,
    pub(crate) level: i32,
    pub(crate) place: usize,
    /// The grabs of this peer that may be meant.
    pub(crate) ids: Vec<u64>,
    pub(crate) rules: Option<&'a Rules>,
    pub(crate) at: u64,
}

impl Queues {
    /// A place was told.
    pub(crate) fn told(&mut self, told: &Told<'_>, seen: &mut Seen) {
        if self.unclear.contains(told.path) {
            return;
        }
        let calm = told.rules.is_some_and(|rules| rules.calm);
        if !calm && !self.waiting.get(told.path).is_none_or(|queue| fits(queue, told)) {
            self.call(told.path);
        }
        let queue = self.waiting.entry(told.path.clone()).or_default();
        if let Some(index) = queue.iter().position(|waiter| waiter.name == told.name) {
            assert_eq!(index + 1, told.place, "the place of {} is told", told.name);
            queue[index].place = told.place;
            return;
        }
        let index = told.place - 1;
        assert!(index <= queue.len(), "a place in the queue: {queue:?}");
        let (before, after) = queue.split_at(index);
        let fifo = after.is_empty();
        let by_level = before.iter().all(|other| other.level >= told.level)
            && after.iter().all(|other| other.level < told.level);
        let right = match told.rules {
            Some(rules) if rules.by_level => by_level,
            Some(_) => fifo,
            None => fifo || by_level,
        };
        assert!(
            right || self.mixed.contains(told.path),
            "{} waits at its place: {queue:?}",
            told.name
        );
        if !fifo {
            seen.note("waits before others");
        }
        if index > 0 {
            seen.note("waits behind others");
        }
        // Where one peer has two grabs on their way, the first of them waits and the other is refused; but not
        // where a peer is asked about both.
        if told.ids.len() > 1 && !calm {
            self.unclear.insert(told.path.clone());
        }
        let waiter = Waiter {
            name: told.name.to_owned(),
            id: told.ids[0],
            level: told.level,
            since: told.at,
            place: told.place,
            asked: false,
        };
        queue.insert(index, waiter);
    }

    /// A grant to this peer is being stored, where it is not known whether that is in its turn.
    pub(crate) fn promise(&mut self, path: &Path, name: &str) {
        self.promised.insert(path.clone(), name.to_owned());
    }

    /// What others are told says that the grant which is being stored is in its turn: who waits for it was called.
    fn call(&mut self, path: &Path) {
        let (Some(name), Some(queue)) = (self.promised.get(path), self.waiting.get_mut(path)) else {
            return;
        };
        if let Some(place) = queue.iter().position(|waiter| waiter.name == *name) {
            self.called.insert(path.clone(), queue.remove(place));
        }
    }

    /// A grant to this peer is being stored: in its turn, or by other ways.
    pub(crate) fn stored(&mut self, path: &Path, name: &str, in_turn: bool) {
        let queue = self.waiting.get(path);
        let first = queue.and_then(|queue| queue.first()).filter(|first| !first.asked);
        let place = queue.and_then(|queue| queue.iter().position(|waiter| waiter.name == name));
        match place {
            // For whom a token is kept passes by those for whom it is not.
            Some(place) if in_turn && (place == 0 || self.reserved.contains(path)) => {
                let queue = self.waiting.get_mut(path).unwrap();
                self.called.insert(path.clone(), queue.remove(place));
            }
            _ => {
                let decided = !in_turn || self.reserved.contains(path);
                assert!(first.is_none() || decided, "{name} passes by {first:?} to {path}");
                self.promise(path, name);
            }
        }
    }

    /// A request was answered: if it waited, it waits no more.
    pub(crate) fn answered(&mut self, path: &Path, id: u64) {
        if self.called.get(path).is_some_and(|waiter| waiter.id == id) {
            self.called.remove(path);
        }
        if let Some(queue) = self.waiting.get_mut(path) {
            queue.retain(|waiter| waiter.id != id);
        }
    }

    /// Others are asked about the grab of this peer, perhaps one that has just come (`new`); whether it has waited.
    pub(crate) fn asked_about(&mut self, path: &Path, name: &str, new: bool) -> bool {
        let queue = self.waiting.get_mut(path).into_iter().flatten();
        let Some(waiter) = queue.into_iter().find(|waiter| waiter.name == name) else {
            return false;
        };
        match new {
            // It may be about either of two.
            true => drop(self.unclear.insert(path.clone())),
            false => waiter.asked = true,
        }
        !new
    }

    /// A peer was granted a token: waiting peers are not passed by.
    pub(crate) fn granted(&self, path: &Path, name: &str, lost: Option<&Lost>) {
        let reason = lost.map(|lost| &*lost.reason);
        let goes_back = lost.is_some_and(|lost| {
            lost.owned.from.as_deref() == Some(name) && !matches!(&*lost.reason, "broken" | "deleted")
        });
        let promised = self.promised.get(path).is_some_and(|known| known == name);
        let decided = matches!(reason, Some("given" | "preempted")) || goes_back || promised;
        if decided || self.reserved.contains(path) {
            return;
        }
        let first = self.waiting.get(path).and_then(|queue| queue.first());
        let first = self.called.get(path).or(first).filter(|first| !first.asked);
        assert!(
            first.is_none_or(|first| first.name == name),
            "{name} passes by {first:?} to {path}, after {lost:?}"
        );
    }

    /// Whether a peer waits.
    pub(crate) fn waits(&self, path: &Path) -> bool {
        self.waiting.get(path).is_some_and(|queue| !queue.is_empty())
    }

    /// The queue is as the hub says, and everybody was told so; a free token waits for nobody.
    pub(crate) fn check(&mut self, path: &Path, look: &Look, rules: Option<&Rules>, stopped: bool) {
        match look.reserved {
            true => self.reserved.insert(path.clone()),
            false => self.reserved.remove(path),
        };
        if !stopped {
            self.promised.remove(path);
        }
        if self.unclear.contains(path) {
            self.waiting.remove(path);
            if look.queue.is_empty() {
                self.unclear.remove(path);
            }
            return;
        }
        let none = Vec::new();
        let queue = self.waiting.get(path).unwrap_or(&none);
        let names: Vec<&str> = queue.iter().map(|waiter| &*waiter.name).collect();
        let calm = rules.is_some_and(|rules| rules.calm);
        // Where a free token is kept from some, whose grant is being stored waits, or has grabbed it directly.
        assert!(
            names == look.queue || (stopped && !calm),
            "who waits for {path}: {names:?}, {look:?}"
        );
        for (index, waiter) in queue.iter().enumerate().filter(|_| !stopped) {
            assert_eq!(
                waiter.place,
                index + 1,
                "the place told last for {path}: {queue:?}"
            );
        }
        let free = look.owner.is_none() && look.holders.is_empty() && !look.reserved && !stopped;
        if calm && free {
            assert!(queue.is_empty(), "{path} is free, and yet these wait: {queue:?}");
        }
    }

    /// Until when an owner may keep its token at the longest, because others wait.
    pub(crate) fn turn_end(&self, path: &Path, owned: &Owned, rules: &Rules) -> Option<u64> {
        let queue = self.waiting.get(path)?;
        let first = queue.iter().map(|waiter| waiter.since).min()?;
        let (hold, notice) = rules.hold?;
        Some((owned.turn + hold).max(first + notice))
    }

    /// A new configuration: the order in which peers wait may be another one from now on.
    pub(crate) fn mix(&mut self) {
        let waiting = self.waiting.iter().filter(|(_, queue)| !queue.is_empty());
        self.mixed.extend(waiting.map(|(path, _)| path.clone()));
    }

    /// Forgets the tokens that are no more, after all who waited for them were told.
    pub(crate) fn keep(&mut self, looks: &Looks) {
        for (path, queue) in &self.waiting {
            assert!(
                !looks.lack(path) || queue.is_empty(),
                "{path} is gone, and yet these wait: {queue:?}"
            );
        }
        self.waiting.retain(|_, queue| !queue.is_empty());
        self.called.retain(|path, _| !looks.lack(path));
        self.mixed.retain(|path| self.waiting.contains_key(path));
    }
}

/// Whether a place that is told is the one in this queue, or the next one.
fn fits(queue: &[Waiter], told: &Told<'_>) -> bool {
    let known = queue.iter().position(|waiter| waiter.name == told.name);
    let place = known.unwrap_or(queue.len()) + 1;
    place == told.place
}
