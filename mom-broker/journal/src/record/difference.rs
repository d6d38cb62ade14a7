//! A decision that differs, for people and for programs.

use std::collections::BTreeMap;
use std::fmt;

use mom_hub::{Hub, PeerId};
use mom_proto::{Path, Time};
use serde_json::{Map, Value as Json, json};

use super::Outcome;
use super::line::Told;

/// An input whose decision differs now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// When it came.
    pub at: Time,
    /// Its line in the recording; for a deadline the line of the next input.
    pub line: u64,
    /// The peer that it came from.
    pub peer: Option<String>,
    /// The peer's user.
    pub user: Option<String>,
    /// What it was: a verb, or one of `gone`, `stored`, `configure`, `tick`.
    pub what: String,
    /// The name of a message.
    pub message: Option<String>,
    /// Where.
    pub context: Option<String>,
    /// Decisions then that are missing now.
    pub was: Vec<Decision>,
    /// Decisions now that were missing then.
    pub is: Vec<Decision>,
}

/// One decision, with names instead of numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Decision {
    /// What.
    pub outcome: Outcome,
    /// The peer concerned.
    pub peer: Option<String>,
    /// Where its rule stands, where that is known: `lab.toml:57`.
    pub place: Option<String>,
}

/// The names of peers, including those that are gone.
#[derive(Debug, Default)]
pub(super) struct Names(BTreeMap<u64, (String, Option<String>)>);

impl Names {
    /// Looks up a peer's present name.
    pub(super) fn note(&mut self, hub: &Hub, peer: Option<u64>, user: Option<String>) {
        let Some(peer) = peer else { return };
        if let Some(name) = hub.peer_name(PeerId(peer)) {
            let known = self.0.entry(peer).or_default();
            known.0 = name.to_string();
            known.1 = user.or(known.1.take());
        }
    }

    fn name(&self, peer: u64) -> String {
        let known = self.0.get(&peer).map(|(name, _)| name.clone());
        known.unwrap_or_else(|| format!("peer {peer}"))
    }
}

impl Difference {
    pub(super) fn new(
        at: Time,
        line: u64,
        input: &Told,
        was: &[Outcome],
        is: &[Outcome],
        names: &Names,
    ) -> Difference {
        let (what, message, context) = match input {
            Told::Login(_) => ("login", None, None),
            Told::Gone(_) => ("gone", None, None),
            Told::Lost(..) => ("lost", None, None),
            Told::Resumed(_) => ("resumed", None, None),
            Told::Request(request) => {
                let message = (request.family == "message").then(|| request.name.clone());
                let verb = if message.is_some() { "send" } else { &request.name };
                (verb, message, request.context.clone())
            }
            Told::Stored(..) => ("stored", None, None),
            Told::Configure(..) => ("configure", None, None),
            Told::Tick => ("tick", None, None),
            Told::Wall(_) => ("wall", None, None),
        };
        let peer = input.peer();
        let decisions =
            |outcomes: &[Outcome]| outcomes.iter().map(|outcome| decision(outcome, names)).collect();
        Difference {
            at,
            line,
            peer: peer.map(|peer| names.name(peer)),
            user: peer.and_then(|peer| names.0.get(&peer)?.1.clone()),
            what: what.to_owned(),
            message,
            context,
            was: decisions(was),
            is: decisions(is),
        }
    }

    /// Looks up where each deciding rule is in the file; the context is the decision's.
    pub fn locate(&mut self, mut place: impl FnMut(&str, &Path) -> Option<String>) {
        let asked = self.context.as_deref();
        for decision in &mut self.is {
            let context = decision.outcome.context().or(asked);
            let context = context.and_then(|context| Path::parse(context).ok());
            if let (Some(rule), Some(context)) = (decision.outcome.rule(), context) {
                decision.place = place(rule, &context);
            }
        }
    }

    /// The decisions then, in words.
    pub fn then(&self) -> String {
        Decisions(self, &self.was).to_string()
    }

    /// The decisions now, in words.
    pub fn now(&self) -> String {
        Decisions(self, &self.is).to_string()
    }

    /// The rule that decides now, and the context that it decides about.
    pub fn rule(&self) -> Option<(&str, &str)> {
        self.is.iter().find_map(|decision| {
            let context = decision.outcome.context().or(self.context.as_deref())?;
            Some((decision.outcome.rule()?, context))
        })
    }

    /// The difference for programs.
    pub fn to_json(&self) -> Json {
        let decisions = |decisions: &[Decision]| decisions.iter().map(Decision::to_json).collect::<Vec<_>>();
        let mut json = Map::new();
        json.insert("at".to_owned(), self.at.to_string().into());
        json.insert("line".to_owned(), self.line.into());
        let texts = [
            ("peer", &self.peer),
            ("user", &self.user),
            ("message", &self.message),
            ("context", &self.context),
        ];
        json.insert("what".to_owned(), self.what.as_str().into());
        for (key, text) in texts {
            if let Some(text) = text {
                json.insert(key.to_owned(), text.as_str().into());
            }
        }
        json.insert("was".to_owned(), decisions(&self.was).into());
        json.insert("is".to_owned(), decisions(&self.is).into());
        json.into()
    }
}

fn decision(outcome: &Outcome, names: &Names) -> Decision {
    Decision {
        outcome: outcome.clone(),
        peer: outcome.peer().map(|peer| names.name(peer)),
        place: None,
    }
}

impl Decision {
    fn to_json(&self) -> Json {
        let told = serde_json::to_value(&self.outcome).unwrap_or_default();
        let mut json = Map::new();
        // One key, the kind; its members beside it read better.
        if let Json::Object(told) = told {
            for (kind, members) in told {
                json.insert("what".to_owned(), kind.into());
                if let Json::Object(members) = members {
                    json.extend(members);
                }
            }
        }
        if let Some(peer) = &self.peer {
            for key in ["to", "from", "peer"] {
                json.shift_remove(key);
            }
            json.insert("peer".to_owned(), json!(peer));
        }
        if let Some(place) = &self.place {
            json.insert("place".to_owned(), json!(place));
        }
        json.into()
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} ", self.at)?;
        match (&self.peer, self.what.as_str()) {
            (Some(peer), what) => write!(formatter, "{peer}: {what}")?,
            (None, "tick") => formatter.write_str("time passed")?,
            (None, what) => formatter.write_str(what)?,
        }
        for text in [&self.message, &self.context].into_iter().flatten() {
            write!(formatter, " {text}")?;
        }
        formatter.write_str(": ")?;
        write!(
            formatter,
            "{} -> {}",
            Decisions(self, &self.was),
            Decisions(self, &self.is)
        )
    }
}

/// The decisions of one side, in words.
struct Decisions<'a>(&'a Difference, &'a [Decision]);

impl fmt::Display for Decisions<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Decisions(difference, decisions) = self;
        if decisions.is_empty() {
            return formatter.write_str("nothing");
        }
        for (index, decision) in decisions.iter().enumerate() {
            if index > 0 {
                formatter.write_str(", ")?;
            }
            if let Some(peer) = decision
                .peer
                .as_ref()
                .filter(|peer| Some(*peer) != difference.peer.as_ref())
            {
                write!(formatter, "{peer}: ")?;
            }
            write!(formatter, "{}", decision.outcome)?;
            match (decision.outcome.rule(), &decision.place) {
                (Some(rule), Some(place)) => write!(formatter, " by {rule:?} ({place})")?,
                (Some(rule), None) => write!(formatter, " by {rule:?}")?,
                (None, _) => {}
            }
        }
        Ok(())
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Outcome::Ok { lease, deadman, .. } => {
                formatter.write_str("ok")?;
                for (word, time) in [("lease", lease), ("deadman", deadman)] {
                    if let Some(time) = time {
                        write!(formatter, " {word} {time} ms")?;
                    }
                }
                Ok(())
            }
            Outcome::Refused { code, .. } => write!(formatter, "refused {code}"),
            Outcome::Waits { .. } => formatter.write_str("waits"),
            Outcome::Passed { context, .. } => write!(formatter, "passed to {context}"),
            Outcome::Granted { context, owner, .. } => write!(formatter, "{owner} owns {context}"),
            Outcome::Lost {
                context,
                owner,
                reason,
            } => write!(formatter, "{owner} loses {context} ({reason})"),
            Outcome::Inhibited { context, peer } => write!(formatter, "{peer} inhibits {context}"),
            Outcome::Uninhibited { context, peer } => write!(formatter, "{peer} ends inhibiting {context}"),
            Outcome::Expelled { context, peer } => write!(formatter, "{peer} is expelled from {context}"),
            Outcome::Asked { context, .. } => write!(formatter, "a peer is asked about {context}"),
            Outcome::Stored { context, .. } => write!(formatter, "{context} is stored"),
            Outcome::Closed { code, .. } => write!(formatter, "closed {code}"),
        }
    }
}
