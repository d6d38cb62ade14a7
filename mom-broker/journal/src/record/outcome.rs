//! Decisions in a form that can be compared.

use mom_hub::{Audit, Effect};
use mom_proto::event::Reason;
use mom_proto::{Family, Parcel, Value, Verb};
use serde::{Deserialize, Serialize};

/// One outcome of an input.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// A request was carried out.
    Ok {
        /// The peer that asked.
        to: u64,
        /// The id of its request.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        id: Option<u64>,
        /// What was granted: the lease in ms, none without end.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        lease: Option<i64>,
        /// What was granted: the deadman time in ms.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        deadman: Option<i64>,
        /// What was granted: the fence.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        fence: Option<u64>,
    },
    /// A request was refused.
    Refused {
        /// The peer that asked.
        to: u64,
        /// The id of its request.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        id: Option<u64>,
        /// The word of the code.
        code: String,
        /// The rule that decided.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        rule: Option<String>,
    },
    /// A request is not answered yet: it waits for a token, a verdict, a disk.
    Waits {
        /// The peer that asked.
        peer: u64,
    },
    /// A message was passed on.
    Passed {
        /// Its sender.
        from: u64,
        /// The channel.
        context: String,
    },
    /// A token has a new owner.
    Granted {
        /// The token.
        context: String,
        /// The peer.
        owner: String,
        /// The fence.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        fence: Option<u64>,
        /// The rule that allowed it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        rule: Option<String>,
    },
    /// An owner lost a token.
    Lost {
        /// The token.
        context: String,
        /// The peer.
        owner: String,
        /// Why.
        reason: String,
    },
    /// A peer holds a token together with others.
    Inhibited {
        /// The token.
        context: String,
        /// The peer.
        peer: String,
    },
    /// A peer has left a shared hold.
    Uninhibited {
        /// The token.
        context: String,
        /// The peer.
        peer: String,
    },
    /// A peer was expelled from a context.
    Expelled {
        /// The context.
        context: String,
        /// The peer.
        peer: String,
    },
    /// Managing peers were asked for a verdict.
    Asked {
        /// The context.
        context: String,
        /// The number of the question.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        question: Option<u64>,
    },
    /// A change of ownership, or an unstop, waits until it is durable.
    Stored {
        /// The token, or the channel.
        context: String,
        /// The number of the ticket.
        ticket: u64,
    },
    /// A connection was ended.
    Closed {
        /// The peer.
        peer: u64,
        /// The word of the code.
        code: String,
    },
}

/// The outcomes of an input, from the hub's effects.
///
/// `asked` is the peer whose request the input was, with its verb.
pub(super) fn outcomes(effects: &[Effect], asked: Option<(u64, Option<Verb>)>) -> Vec<Outcome> {
    let mut outcomes = Vec::new();
    for effect in effects {
        match effect {
            Effect::Reply { to, parcel }
            | Effect::Stats { to, parcel, .. }
            | Effect::Inquire { to, parcel, .. } => {
                outcomes.push(answer(to.0, parcel, asked));
            }
            Effect::Send { from, route, .. } => outcomes.push(Outcome::Passed {
                from: from.0,
                context: route.path.to_string(),
            }),
            Effect::Deliver { parcel, .. } => outcomes.extend(question(parcel)),
            Effect::Audit(fact) => outcomes.extend(told(fact)),
            Effect::Store {
                record,
                ticket: Some(ticket),
            } => outcomes.push(Outcome::Stored {
                context: record.path.to_string(),
                ticket: ticket.0,
            }),
            Effect::Keep {
                record,
                ticket: Some(ticket),
            } => outcomes.push(Outcome::Stored {
                context: record.path.to_string(),
                ticket: ticket.0,
            }),
            Effect::Close {
                peer,
                error: Some(error),
            } => outcomes.push(Outcome::Closed {
                peer: peer.0,
                code: error.code.word().to_owned(),
            }),
            Effect::Route(_)
            | Effect::RouteGone(_)
            | Effect::Store { .. }
            | Effect::Keep { .. }
            | Effect::Close { .. } => {}
        }
    }
    if let Some((peer, _)) = asked.filter(|(peer, _)| !outcomes.iter().any(|one| one.answers(*peer))) {
        outcomes.push(Outcome::Waits { peer });
    }
    outcomes
}

fn answer(to: u64, parcel: &Parcel, asked: Option<(u64, Option<Verb>)>) -> Outcome {
    let content = parcel.value();
    let text = |key: &str| content.get(key).and_then(Value::as_str).map(str::to_owned);
    if parcel.family == Family::Error {
        return Outcome::Refused {
            to,
            id: parcel.reference,
            code: parcel.name().to_owned(),
            rule: text("rule"),
        };
    }
    // Only a grant has all of them; `info` reports the fence, too, but grants nothing.
    let info = asked.is_some_and(|(peer, verb)| peer == to && verb == Some(Verb::Info));
    let grant = !info && content.get("fence").is_some() && content.get("lease").is_some();
    let int = |key: &str| content.get(key).and_then(Value::as_int).filter(|_| grant);
    Outcome::Ok {
        to,
        id: parcel.reference,
        lease: int("lease"),
        deadman: int("deadman"),
        fence: int("fence").and_then(|fence| u64::try_from(fence).ok()),
    }
}

fn question(parcel: &Parcel) -> Option<Outcome> {
    let context = parcel.context.as_ref()?.to_string();
    parcel.is(Family::Manager, "consult").then_some(Outcome::Asked {
        context,
        question: parcel.id,
    })
}

/// What a fact says about control. Facts are used because events depend on who is listening.
fn told(fact: &Audit) -> Option<Outcome> {
    let context = fact.context.as_ref()?.to_string();
    let peer = fact.peer.as_deref().unwrap_or_default().to_owned();
    Some(match fact.what {
        "granted" => Outcome::Granted {
            context,
            owner: peer,
            fence: fact.fence,
            rule: fact.rule.as_deref().map(str::to_owned),
        },
        "lost" => Outcome::Lost {
            context,
            owner: peer,
            reason: fact.reason.map(Reason::word).unwrap_or_default().to_owned(),
        },
        "inhibited" => Outcome::Inhibited { context, peer },
        "uninhibited" => Outcome::Uninhibited { context, peer },
        "expelled" => Outcome::Expelled { context, peer },
        // All other facts have a reply that says the same.
        _ => return None,
    })
}

impl Outcome {
    fn answers(&self, peer: u64) -> bool {
        match self {
            Outcome::Ok { to, .. } | Outcome::Refused { to, .. } => *to == peer,
            Outcome::Passed { from, .. } => *from == peer,
            _ => false,
        }
    }

    /// The number of the peer concerned, where it is not given by name.
    pub(super) fn peer(&self) -> Option<u64> {
        match self {
            Outcome::Ok { to: peer, .. }
            | Outcome::Refused { to: peer, .. }
            | Outcome::Waits { peer }
            | Outcome::Passed { from: peer, .. }
            | Outcome::Closed { peer, .. } => Some(*peer),
            _ => None,
        }
    }

    /// The context concerned, where it is not the request's.
    pub(super) fn context(&self) -> Option<&str> {
        match self {
            Outcome::Passed { context, .. }
            | Outcome::Granted { context, .. }
            | Outcome::Lost { context, .. }
            | Outcome::Inhibited { context, .. }
            | Outcome::Uninhibited { context, .. }
            | Outcome::Expelled { context, .. }
            | Outcome::Asked { context, .. }
            | Outcome::Stored { context, .. } => Some(context),
            _ => None,
        }
    }

    /// The rule that decided, as far as it is known.
    pub fn rule(&self) -> Option<&str> {
        match self {
            Outcome::Refused { rule, .. } | Outcome::Granted { rule, .. } => rule.as_deref(),
            _ => None,
        }
    }

    /// The outcome without running numbers, and without the rule unless rules are compared. None for outcomes that
    /// are no decision.
    pub(super) fn decision(&self, rules: bool) -> Option<Outcome> {
        let mut outcome = self.clone();
        match &mut outcome {
            Outcome::Stored { .. } => return None,
            Outcome::Ok { fence, .. } => *fence = None,
            Outcome::Asked { question, .. } => *question = None,
            Outcome::Granted { fence, rule, .. } => (*fence, *rule) = (None, rule.take().filter(|_| rules)),
            Outcome::Refused { rule, .. } if !rules => *rule = None,
            _ => {}
        }
        Some(outcome)
    }
}
