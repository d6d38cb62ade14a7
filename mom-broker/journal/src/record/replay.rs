//! Decides a recording again with another configuration.

use std::path::Path as FilePath;
use std::sync::Arc;

use bytes::Bytes;
use mom_hub::{Hub, Input, PeerId, Settings, User};
use mom_proto::{Content, ContextNumber, Family, Limits, Micros, Parcel, Time, Verb};

use super::difference::{Difference, Names};
use super::line::{LoginTold, RecordedLine, RecordedStep, RecordingHead, RequestTold, Told, path};
use super::log::{RecordError, RecordingReader};
use super::outcome::{Outcome, outcomes};
use super::translations::Translations;

/// A replay of a recording with another configuration, one input at a time.
#[derive(Debug)]
pub struct Replay {
    /// The users of the new configuration.
    users: Vec<User>,
    log: RecordingReader,
    head: RecordingHead,
    hub: Hub,
    rules: bool,
    names: Names,
    translations: Translations,
    /// The recorded hub's next deadline; none before its first input, where it is not recorded.
    deadline: Option<Option<Micros>>,
    /// By how much the wall clock was ahead of the hub's time, µs.
    ahead: i64,
    zeros: Bytes,
    summary: Summary,
}

/// The result of a replay.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Inputs.
    pub inputs: u64,
    /// Inputs whose decision differs.
    pub differ: u64,
    /// How often the configuration was changed during the recording; the replay uses the new one throughout.
    pub configured: u64,
    /// Users that the new configuration does not know; they keep their recorded level and groups.
    pub unknown_users: Vec<String>,
    /// Why the recording ends, if it says so.
    pub end: Option<String>,
    /// Whether its last line is damaged and was left out.
    pub torn: bool,
}

impl Replay {
    /// The value of [`Summary::end`] for a recording that ends with its broker.
    pub const WHOLE: &str = super::recorder::STOPPED;

    /// Opens a recording, to be replayed by the hub that `make` builds with these limits and users.
    ///
    /// # Errors
    /// A file that is not a recording, or a configuration from which no hub can be built.
    pub fn open<E: std::fmt::Display>(
        log: &FilePath,
        limits: Limits,
        users: Vec<User>,
        make: impl FnOnce(Settings) -> Result<Hub, E>,
    ) -> Result<Replay, RecordError> {
        let (log, head) = RecordingReader::open(log)?;
        let settings = head.settings(limits).map_err(|text| log.error(text))?;
        let hub = make(settings).map_err(|error| RecordError::Config(error.to_string()))?;
        let mut translations = Translations::default();
        hub.routes().iter().for_each(|route| translations.route(route));
        Ok(Replay {
            users,
            log,
            head,
            hub,
            rules: false,
            names: Names::default(),
            translations,
            deadline: None,
            ahead: 0,
            zeros: Bytes::new(),
            summary: Summary::default(),
        })
    }

    /// Also counts a decision as different if it is the same by another rule.
    pub fn compare_rules(&mut self) {
        self.rules = true;
    }

    /// Replays one input; returns the differences, usually none. None at the recording's end.
    ///
    /// # Errors
    /// A damaged line that is not the last.
    pub fn step(&mut self) -> Result<Option<Vec<Difference>>, RecordError> {
        match self.log.next()? {
            Some(RecordedLine::Step(step)) => {
                self.summary.inputs += 1;
                let differences = self.replay(&step).map_err(|text| self.log.error(text))?;
                self.summary.differ += differences.len() as u64;
                Ok(Some(differences))
            }
            Some(RecordedLine::End(why)) => {
                self.summary.end = Some(why);
                Ok(Some(Vec::new()))
            }
            Some(RecordedLine::Head(_)) => {
                Err(self.log.error("a second head: this is two recordings".to_owned()))
            }
            None => {
                self.summary.torn = self.log.is_torn();
                Ok(None)
            }
        }
    }

    /// The result so far.
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    /// The configuration's file at the time of the recording, without folders.
    pub fn recorded_file(&self) -> Option<&str> {
        self.head.config.as_deref()
    }

    /// Bytes of the recording that are read, and all of them.
    pub fn progress(&self) -> (u64, u64) {
        self.log.progress()
    }

    fn replay(&mut self, step: &RecordedStep) -> Result<Vec<Difference>, String> {
        let mut differences = Vec::new();
        while let Some(at) = self.own_deadline(step.now) {
            let decided = self.handle(at, Input::Tick, None, &[]);
            differences.extend(self.compare(at, &Told::Tick, &[], &decided));
        }
        let input = self.input(&step.input)?;
        let asked = match &step.input {
            Told::Request(request) => Some((request.peer, verb(request))),
            _ => None,
        };
        // Before the decision: a peer that leaves has no name afterwards.
        self.names.note(&self.hub, step.input.peer(), None);
        let decided = self.handle(step.now, input, asked, &step.decided);
        let user = match &step.input {
            Told::Login(login) => Some(login.user.clone()),
            _ => None,
        };
        self.names.note(&self.hub, step.input.peer(), user);
        differences.extend(self.compare(step.now, &step.input, &step.decided, &decided));
        self.deadline = Some(step.deadline);
        Ok(differences)
    }

    /// A deadline that only this hub has: no input in the recording triggers it.
    fn own_deadline(&self, before: Micros) -> Option<Micros> {
        let recorded = self.deadline?;
        let own = self.hub.deadline().filter(|own| *own <= before)?;
        recorded.is_none_or(|recorded| own < recorded).then_some(own)
    }

    fn handle(
        &mut self,
        now: Micros,
        input: Input,
        asked: Option<(u64, Option<Verb>)>,
        recorded: &[Outcome],
    ) -> Vec<Outcome> {
        let mut effects = Vec::new();
        self.hub.handle(now, input, &mut effects);
        let mut from = 0;
        // The first of each kind and context here corresponds to the first there.
        let mut left: Vec<&Outcome> = recorded.iter().collect();
        // A change that waits for the disk only here would wait forever.
        loop {
            let own = self.translations.note(&effects[from..], &mut left);
            from = effects.len();
            if own.is_empty() {
                return outcomes(&effects, asked);
            }
            for ticket in own {
                let stored = Input::Stored { ticket, ok: true };
                self.hub.handle(now, stored, &mut effects);
            }
        }
    }

    fn compare(&self, now: Micros, input: &Told, was: &[Outcome], is: &[Outcome]) -> Option<Difference> {
        let (was, is) = (self.only(was, is), self.only(is, was));
        if was.is_empty() && is.is_empty() {
            return None;
        }
        Some(Difference::new(
            self.wall(now),
            self.log.line(),
            input,
            &was,
            &is,
            &self.names,
        ))
    }

    /// Decisions in one list that are missing in the other.
    fn only(&self, these: &[Outcome], those: &[Outcome]) -> Vec<Outcome> {
        let decision = |outcome: &Outcome| outcome.decision(self.rules);
        let mut left: Vec<Outcome> = those.iter().filter_map(decision).collect();
        let mut only = Vec::new();
        for outcome in these {
            let Some(decision) = decision(outcome) else {
                continue;
            };
            match left.iter().position(|other| *other == decision) {
                Some(same) => drop(left.swap_remove(same)),
                None => only.push(outcome.clone()),
            }
        }
        only
    }

    fn wall(&self, now: Micros) -> Time {
        let since = i64::try_from(now).unwrap_or(i64::MAX).saturating_add(self.ahead);
        Time::from_micros(self.head.anchor.micros().saturating_add(since)).unwrap_or(Time::MAX)
    }

    fn input(&mut self, told: &Told) -> Result<Input, String> {
        Ok(match told {
            Told::Login(login) => Input::Login {
                peer: PeerId(login.peer),
                user: self.user(login),
                nickname: login.nickname.clone(),
                id: login.id,
            },
            Told::Gone(peer) => Input::Gone { peer: PeerId(*peer) },
            Told::Lost(peer, grace) => Input::Lost {
                peer: PeerId(*peer),
                grace: *grace,
            },
            Told::Resumed(peer) => Input::Resumed { peer: PeerId(*peer) },
            Told::Request(request) => Input::Request {
                peer: PeerId(request.peer),
                parcel: Box::new(self.parcel(request)?),
                clock: request.peer_clock(),
            },
            Told::Stored(ticket, ok) => match self.translations.ticket(*ticket) {
                Some(ticket) => Input::Stored { ticket, ok: *ok },
                // Nothing was stored here.
                None => Input::Tick,
            },
            Told::Configure(..) => {
                self.summary.configured += 1;
                Input::Tick
            }
            Told::Tick => Input::Tick,
            Told::Wall(ahead) => {
                self.ahead = *ahead;
                Input::Wall { ahead: *ahead }
            }
        })
    }

    /// The user as the new configuration has it, or as it was.
    fn user(&mut self, login: &LoginTold) -> User {
        let mut user = login.user();
        match self.users.iter().find(|known| known.name == user.name) {
            Some(known) => {
                user.level = known.level;
                user.groups.clone_from(&known.groups);
            }
            None if self.summary.unknown_users.contains(&user.name) => {}
            None => self.summary.unknown_users.push(user.name.clone()),
        }
        user
    }

    fn parcel(&mut self, told: &RequestTold) -> Result<Parcel, String> {
        let family = Family::from_word(&told.family);
        let family = family.ok_or_else(|| format!("unknown family {:?}", told.family))?;
        let mut parcel = Parcel::new(family, told.name.as_str());
        parcel.context = told.context.as_deref().map(path).transpose()?;
        // It named no context then, so it must not name one now.
        parcel.number = told.number.map(|_| ContextNumber(u64::MAX));
        parcel.id = told.id;
        parcel.address = told
            .address
            .as_ref()
            .map(|names| names.iter().map(|name| Arc::from(name.as_str())).collect());
        parcel.fence = told
            .fence
            .map(|fence| self.translations.fence(parcel.context.as_ref(), fence));
        parcel.timestamp = told.timestamp.and_then(Time::from_micros);
        parcel.expires = told.expires;
        parcel.content = match (&told.content, told.size) {
            (Some(content), _) => Some(content.0.clone()),
            (None, Some(size)) => Some(Content::Encoded(self.zeros(size))),
            (None, None) => None,
        };
        if verb(told) == Some(Verb::Verdict) {
            self.translations.verdict(&mut parcel);
        }
        Ok(parcel)
    }

    /// Content of the message's size; the hub looks at nothing else of it.
    fn zeros(&mut self, size: usize) -> Bytes {
        if self.zeros.len() < size {
            self.zeros = vec![0; size].into();
        }
        self.zeros.slice(..size)
    }
}

fn verb(told: &RequestTold) -> Option<Verb> {
    Verb::of(Family::from_word(&told.family)?, &told.name).ok()
}
