//! What a manager answers.

use mom_proto::Code;
use serde::Deserialize;

use crate::Micros;

/// An answer, and for how long it stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// Yes or no.
    pub answer: Answer,
    /// Whether the same question may be answered so without asking again.
    pub standing: Standing,
}

/// Yes or no.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// Yes; for `grab` with what it grants.
    Allow(Grant),
    /// No, because.
    Deny(Denial),
}

/// What an allowed `grab` grants beyond a free token.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Grant {
    /// The token is taken from its present owner.
    pub displace: bool,
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
    },
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
    /// How long ownership lasts without renewal; none = without end.
    pub lease: Option<Micros>,
    /// What happens at its end.
    pub expiry: Expiry,
}

impl Verdict {
    /// Yes, for this question alone.
    pub fn allow() -> Verdict {
        Verdict {
            answer: Answer::Allow(Grant::default()),
            standing: Standing::Once,
        }
    }

    /// Yes, until something changes, whatever the message.
    pub fn allow_always() -> Verdict {
        Verdict::allow().stands(Scope::AnyName)
    }

    /// Yes, and an owner in the way loses the token.
    pub fn displace() -> Verdict {
        Verdict {
            answer: Answer::Allow(Grant { displace: true }),
            standing: Standing::Once,
        }
    }

    /// No.
    pub fn deny(code: Code, rule: impl Into<String>, text: impl Into<String>) -> Verdict {
        let denial = Denial {
            code,
            text: text.into(),
            rule: rule.into(),
            earliest: None,
        };
        Verdict {
            answer: Answer::Deny(denial),
            standing: Standing::Once,
        }
    }

    /// Adds the earliest time at which asking again may help, to a denial.
    #[must_use]
    pub fn earliest(mut self, time: Option<Micros>) -> Verdict {
        if let Answer::Deny(denial) = &mut self.answer {
            denial.earliest = time;
        }
        self
    }

    /// Lets the verdict stand until something changes.
    #[must_use]
    pub fn stands(mut self, scope: Scope) -> Verdict {
        self.standing = Standing::Stands { scope, until: None };
        self
    }

    /// Whether the answer is yes.
    pub fn is_allow(&self) -> bool {
        matches!(self.answer, Answer::Allow(_))
    }
}

impl Standing {
    /// What stands where both have to.
    #[must_use]
    pub fn and(self, other: Standing) -> Standing {
        match (self, other) {
            (
                Standing::Stands {
                    scope: one,
                    until: first,
                },
                Standing::Stands {
                    scope: two,
                    until: second,
                },
            ) => {
                let until = match (first, second) {
                    (Some(first), Some(second)) => Some(first.min(second)),
                    (until, None) | (None, until) => until,
                };
                Standing::Stands {
                    scope: one.min(two),
                    until,
                }
            }
            _ => Standing::Once,
        }
    }
}
