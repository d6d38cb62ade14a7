//! What a manager answers.

use std::sync::Arc;

use mom_proto::{Code, Micros, Pace};
use serde::Deserialize;

use crate::PeerFacts;

/// An answer, and for how long it stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// Yes or no.
    pub answer: Answer,
    /// Whether the same question may be answered so without asking again.
    pub standing: Standing,
    /// The rule that decided, by its name in the configuration; none = the manager as a whole.
    pub rule: Option<Arc<str>>,
}

/// Yes, no, or not yet.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// Yes; for `grab` with what it grants.
    Allow(Grant),
    /// No, because.
    Deny(Denial),
    /// Peers have to be asked first; then the same question comes again with their answer.
    Defer(Defer),
    /// Not yet, but there is a queue for a free place.
    Queue(Wait),
}

/// Whom to ask, and how long to wait.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Defer {
    /// Tells this question's answer from those of other managers of a chain; the manager's label mostly.
    pub label: Arc<str>,
    /// Whom.
    pub ask: Ask,
    /// How long an answer may take, µs; after that the request is denied.
    pub within: Micros,
}

/// Peers that can be asked for a verdict.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ask {
    /// The peer that made the context.
    Creator,
    /// The members of the context, or of its parent, that these facts fit: one of the users, or in one of the
    /// groups, where either is named, and of at least this level. The first answer holds.
    Chairs {
        /// Names of users.
        users: Arc<[String]>,
        /// Names of groups.
        groups: Arc<[String]>,
        /// The least level; none = any.
        min_level: Option<i32>,
    },
}

impl Ask {
    /// Whether a peer with these facts is one of the chairs; the creator cannot be told by its facts.
    pub fn is_chair(&self, peer: &PeerFacts) -> bool {
        match self {
            Ask::Creator => false,
            Ask::Chairs {
                users,
                groups,
                min_level,
            } => fits(users, groups, *min_level, &peer.user, &peer.groups, peer.level),
        }
    }
}

/// The matching rule for names and level.
pub(crate) fn fits(
    users: &[String],
    groups: &[String],
    min_level: Option<i32>,
    user: &str,
    of: &[String],
    level: i32,
) -> bool {
    let unnamed = users.is_empty() && groups.is_empty();
    let named = || users.iter().any(|listed| listed == user) || groups.iter().any(|group| of.contains(group));
    min_level.is_none_or(|least| level >= least) && (unnamed || named())
}

/// A place in the queue instead of a free token.
#[derive(Clone, Debug, PartialEq)]
pub struct Wait {
    /// The denial for a grab without `wait`.
    pub denial: Denial,
    /// The latest end of the present ownership if the owner does not renew, as far as the manager knows.
    pub expected: Option<Micros>,
}

/// What a yes grants: an allowed `grab` beyond a free token, an allowed message beyond its place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Grant {
    /// The token is taken from its present owner.
    pub displace: bool,
    /// When the ownership ends, whatever its lease; none = as the lease says.
    pub until: Option<Micros>,
    /// The highest priority that a message may have which no token guards; none = any.
    pub priority: Option<i32>,
}

/// Why not.
#[derive(Clone, Debug, PartialEq)]
pub struct Denial {
    /// The error's code, `denied` or `held` mostly.
    pub code: Code,
    /// Plain words.
    pub text: String,
    /// The rule that decided, by its name in the configuration.
    pub rule: String,
    /// The earliest time at which asking again may help.
    pub earliest: Option<Micros>,
}

/// Whether a verdict holds for later questions of the same peer, verb and context.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// For this question alone.
    Once,
    /// For later ones too.
    Stands {
        /// For which messages.
        scope: Scope,
        /// Up to, but not at, this time; none = until something changes.
        until: Option<Micros>,
        /// The rate; none = unlimited.
        rate: Option<Rate>,
        /// Only for messages whose age plus error is not above this, µs; none = any age.
        max_age: Option<Micros>,
    },
}

/// How much a peer may send, as two token buckets that must both have enough.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rate {
    /// Parcels.
    pub parcels: Bucket,
    /// Bytes of content.
    pub bytes: Bucket,
}

/// A token bucket, which refills with time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bucket {
    /// The refill per second; `u64::MAX` = unlimited.
    pub per_second: u64,
    /// Its content when full.
    pub burst: u64,
}

impl Bucket {
    /// No limit.
    pub const UNLIMITED: Bucket = Bucket {
        per_second: u64::MAX,
        burst: u64::MAX,
    };

    /// The bucket as a pace.
    pub fn pace(self) -> Pace {
        match self == Bucket::UNLIMITED {
            true => Pace::UNLIMITED,
            false => Pace::per_second(self.per_second, self.burst),
        }
    }

    fn and(self, other: Bucket) -> Bucket {
        Bucket {
            per_second: self.per_second.min(other.per_second),
            burst: self.burst.min(other.burst),
        }
    }
}

impl Rate {
    /// The lower of both rates.
    #[must_use]
    pub fn and(self, other: Rate) -> Rate {
        Rate {
            parcels: self.parcels.and(other.parcels),
            bytes: self.bytes.and(other.bytes),
        }
    }
}

/// Which messages a standing verdict covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Scope {
    /// Those of the name asked about.
    ThisName,
    /// Those of any name.
    AnyName,
}

/// When ownership ends (M29, design §6).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Expiry {
    /// After the lease the owner still drives, and the next grab takes the token.
    #[default]
    Lazy,
    /// At the end of the lease the token is lost.
    Eager,
}

/// The lease of a token.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Terms {
    /// How long ownership lasts without renewal; none = unlimited.
    pub lease: Option<Micros>,
    /// What happens at its end.
    pub expiry: Expiry,
    /// The owner loses the token if it does not renew for so long; none = no such limit.
    pub deadman: Option<Micros>,
    /// The longest ownership while others wait; none = as long as it renews.
    pub hold: Option<Micros>,
    /// Whether the queue is ordered by level, and by arrival only among equals.
    pub by_level: bool,
    /// The least time that an owner keeps the token after another peer has begun to wait, even if `hold` is over.
    pub notice: Micros,
}

impl Verdict {
    /// Yes, for this question alone.
    pub fn allow() -> Verdict {
        Verdict {
            answer: Answer::Allow(Grant::default()),
            standing: Standing::Once,
            rule: None,
        }
    }

    /// Yes, until something changes, whatever the message.
    pub fn allow_always() -> Verdict {
        Verdict::allow().stands(Scope::AnyName)
    }

    /// Yes, and the present owner loses the token.
    pub fn displace() -> Verdict {
        Verdict {
            answer: Answer::Allow(Grant {
                displace: true,
                ..Grant::default()
            }),
            ..Verdict::allow()
        }
    }

    /// No.
    pub fn deny(code: Code, rule: impl Into<String>, text: impl Into<String>) -> Verdict {
        let rule = rule.into();
        let denial = Denial {
            code,
            text: text.into(),
            rule: rule.clone(),
            earliest: None,
        };
        Verdict {
            answer: Answer::Deny(denial),
            standing: Standing::Once,
            rule: Some(rule.into()),
        }
    }

    /// Asks these peers first.
    pub fn defer(label: impl Into<Arc<str>>, ask: Ask, within: Micros) -> Verdict {
        let label = label.into();
        Verdict {
            answer: Answer::Defer(Defer {
                label: Arc::clone(&label),
                ask,
                within,
            }),
            standing: Standing::Once,
            rule: Some(label),
        }
    }

    /// Names the rule that decided.
    #[must_use]
    pub fn by(mut self, rule: &Arc<str>) -> Verdict {
        self.rule = Some(Arc::clone(rule));
        self
    }

    /// Adds the earliest time at which asking again may help, to a denial.
    #[must_use]
    pub fn earliest(mut self, time: Option<Micros>) -> Verdict {
        if let Answer::Deny(denial) = &mut self.answer {
            denial.earliest = time;
        }
        self
    }

    /// Turns a denial into a place in the queue for grabs with `wait`.
    #[must_use]
    pub fn or_wait(mut self, expected: Option<Micros>) -> Verdict {
        if let Answer::Deny(denial) = self.answer {
            self.answer = Answer::Queue(Wait { denial, expected });
            self.standing = Standing::Once;
        }
        self
    }

    /// Ends an ownership that is granted at this time, whatever its lease.
    #[must_use]
    pub fn until(mut self, time: Option<Micros>) -> Verdict {
        if let Answer::Allow(grant) = &mut self.answer {
            grant.until = time;
        }
        self
    }

    /// Lets the verdict stand until something changes.
    #[must_use]
    pub fn stands(self, scope: Scope) -> Verdict {
        self.stands_until(scope, None)
    }

    /// Lets the verdict stand up to, but not at, this time.
    #[must_use]
    pub fn stands_until(mut self, scope: Scope, until: Option<Micros>) -> Verdict {
        self.standing = Standing::Stands {
            scope,
            until,
            rate: None,
            max_age: None,
        };
        self
    }

    /// Limits a standing yes to this rate.
    #[must_use]
    pub fn at_rate(mut self, limit: Rate) -> Verdict {
        if let Standing::Stands { rate, .. } = &mut self.standing {
            *rate = Some(limit);
        }
        self
    }

    /// Limits a standing yes to messages whose age plus error is not above this, µs.
    #[must_use]
    pub fn up_to_age(mut self, limit: Option<Micros>) -> Verdict {
        if let Standing::Stands { max_age, .. } = &mut self.standing {
            *max_age = limit;
        }
        self
    }

    /// Brings the priority of messages that no token guards down to this.
    #[must_use]
    pub fn up_to_priority(mut self, most: Option<i32>) -> Verdict {
        if let Answer::Allow(grant) = &mut self.answer {
            grant.priority = most;
        }
        self
    }

    /// Whether the answer is yes.
    pub fn is_allow(&self) -> bool {
        matches!(self.answer, Answer::Allow(_))
    }
}

impl Standing {
    /// What stands if both verdicts must allow.
    #[must_use]
    pub fn and(self, other: Standing) -> Standing {
        match (self, other) {
            (
                Standing::Stands {
                    scope: one,
                    until: first,
                    rate: slow,
                    max_age: young,
                },
                Standing::Stands {
                    scope: two,
                    until: second,
                    rate: other_rate,
                    max_age: other_age,
                },
            ) => Standing::Stands {
                scope: one.min(two),
                until: both(first, second, Micros::min),
                rate: both(slow, other_rate, Rate::and),
                max_age: both(young, other_age, Micros::min),
            },
            _ => Standing::Once,
        }
    }

    /// The same without a rate; a denial has none.
    #[must_use]
    pub fn without_rate(mut self) -> Standing {
        if let Standing::Stands { rate, .. } = &mut self {
            *rate = None;
        }
        self
    }

    /// The rate of a verdict; none = unlimited.
    pub fn rate(&self) -> Option<Rate> {
        match self {
            Standing::Once => None,
            Standing::Stands { rate, .. } => *rate,
        }
    }
}

fn both<T>(one: Option<T>, other: Option<T>, merge: impl FnOnce(T, T) -> T) -> Option<T> {
    match (one, other) {
        (Some(one), Some(other)) => Some(merge(one, other)),
        (one, None) => one,
        (None, other) => other,
    }
}
