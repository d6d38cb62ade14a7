//! On what terms a token is owned, the place in its queue, and why an ownership ended.

use std::time::Duration;

use mom_proto::Map;

use crate::words::{millis_of, number, text};

/// A lease is renewed at this fraction of it, so that two renewals may fail.
const RENEW_AT: u32 = 3;

/// How long an ownership lasts without a renewal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct RenewalTerms {
    /// Until others may take it.
    pub(crate) lease: Option<Duration>,
    /// Until it ends by itself.
    pub(crate) deadman: Option<Duration>,
}

/// The hub's terms of a grant.
#[derive(Clone, Debug, Default)]
pub(crate) struct GrantTerms {
    pub(crate) fence: u64,
    pub(crate) terms: RenewalTerms,
    pub(crate) delegation: Option<Loan>,
}

/// The terms of a loan: an ownership that another peer gave and that returns to it (M41).
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Loan {
    /// The peer that gave it, and to which it returns.
    pub from: String,
    /// Its duration from the grant on; none = unlimited.
    pub time: Option<Duration>,
    /// Its number of guarded messages; none = unlimited.
    pub commands: Option<u64>,
}

/// The place of a grab in the queue of its token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Place {
    /// 1 for the next.
    pub place: u64,
    /// The expected time until its grant, if nobody before it renews; none = unknown.
    pub expected: Option<Duration>,
}

/// Why an ownership ended, and who caused it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lost {
    /// A word of [`Reason`](crate::event::Reason), `disconnected` for a lost link, or the code's word of a
    /// refused renewal.
    pub reason: String,
    /// The peer that caused it, if one did.
    pub by: Option<String>,
}

impl RenewalTerms {
    pub(crate) fn read(map: &Map) -> RenewalTerms {
        RenewalTerms {
            lease: millis_of(map, "lease"),
            deadman: millis_of(map, "deadman"),
        }
    }

    /// Until the next renewal; none = none is needed.
    pub(crate) fn renewal(self) -> Option<Duration> {
        let shorter = self.lease.into_iter().chain(self.deadman).min();
        shorter.map(|time| time / RENEW_AT)
    }
}

impl GrantTerms {
    /// Reads `{fence, lease?, deadman?, from?, for?, commands?}`.
    pub(crate) fn read(map: &Map) -> Option<GrantTerms> {
        Some(GrantTerms {
            fence: number(map, "fence")?,
            terms: RenewalTerms::read(map),
            delegation: text(map, "from").map(|from| Loan {
                from: from.to_owned(),
                time: millis_of(map, "for"),
                commands: number(map, "commands"),
            }),
        })
    }
}

impl Lost {
    pub(crate) fn new(reason: &str, by: Option<String>) -> Lost {
        Lost {
            reason: reason.to_owned(),
            by,
        }
    }
}
