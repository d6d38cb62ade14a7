//! `quota`: limits how often and how much, by peer and level.

use std::sync::Arc;

use mom_proto::{Code, Verb, WireError};
use serde::Deserialize;

use crate::bucket::{HIGHEST, Over, RateCounts};
use crate::params::Verbs;
use crate::who::{Who, WhoParams};
use crate::{Bucket, Manager, Question, Rate, Setup, Verdict};

/// The most peers that one limit counts at once: more than a broker's default limit of connections.
const PEERS: usize = 16_384;

/// The most limits of one manager: each question checks all of them.
const MOST: usize = 64;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    limits: Vec<LimitParams>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct LimitParams {
    name: Option<String>,
    users: Option<Vec<String>>,
    groups: Option<Vec<String>>,
    min_level: Option<i32>,
    verbs: Option<Vec<String>>,
    /// A second.
    parcels: Option<u64>,
    burst: Option<u64>,
    /// A second.
    bytes: Option<u64>,
    bytes_burst: Option<u64>,
}

/// Counts requests by the first limit that covers them, and allows those that none covers.
///
/// It does not count messages itself: it returns the rate, and the broker counts messages as they are admitted.
#[derive(Debug)]
struct Quota {
    label: Arc<str>,
    limits: Vec<QuotaLimit>,
}

#[derive(Debug)]
struct QuotaLimit {
    name: Arc<str>,
    who: Who,
    verbs: Verbs,
    counts: RateCounts,
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let Params { limits } = setup.params()?;
    if limits.is_empty() {
        return Err(setup.error("limits", "a quota needs at least one limit"));
    }
    if limits.len() > MOST {
        return Err(setup.error("limits", &format!("a quota has at most {MOST} limits")));
    }
    let limits = limits.into_iter().enumerate();
    let limits: Result<Vec<QuotaLimit>, WireError> = limits
        .map(|(index, limit)| make_limit(setup, index, limit))
        .collect();
    Ok(Box::new(Quota {
        label: setup.label.into(),
        limits: limits?,
    }))
}

fn make_limit(setup: &Setup<'_>, index: usize, params: LimitParams) -> Result<QuotaLimit, WireError> {
    let place = format!("limits/{index}");
    let key = |key: &str| format!("{place}/{key}");
    let verbs = match &params.verbs {
        Some(words) => Verbs::read(setup, &key("verbs"), words)?,
        None => Verbs::These(vec![Verb::Send]),
    };
    if let Verbs::These(listed) = &verbs
        && let Some(verb) = listed.iter().find(|verb| !may_be_limited(**verb))
    {
        return Err(setup.error(&key("verbs"), &format!("{verb} is never limited")));
    }
    if params.parcels.is_none() && params.bytes.is_none() {
        return Err(setup.error(&key("parcels"), "a limit has parcels or bytes, or both, a second"));
    }
    let bucket = |rate_key: &str, per_second, burst_key: &str, burst| {
        make_bucket(setup, (&key(rate_key), per_second), (&key(burst_key), burst))
    };
    let rate = Rate {
        parcels: bucket("parcels", params.parcels, "burst", params.burst)?,
        bytes: bucket("bytes", params.bytes, "bytes-burst", params.bytes_burst)?,
    };
    let who = WhoParams {
        users: params.users,
        groups: params.groups,
        min_level: params.min_level,
    };
    let name = params.name.unwrap_or_else(|| format!("limit {}", index + 1));
    Ok(QuotaLimit {
        name: format!("{}/{name}", setup.label).into(),
        who: Who::read(setup, &place, who)?,
        verbs,
        counts: RateCounts::new(rate, PEERS),
    })
}

/// A bucket from two keys; without a burst it holds one second's refill.
fn make_bucket(
    setup: &Setup<'_>,
    (rate_key, rate): (&str, Option<u64>),
    (burst_key, burst): (&str, Option<u64>),
) -> Result<Bucket, WireError> {
    let check = |key: &str, number: u64| match (1..=HIGHEST).contains(&number) {
        true => Ok(number),
        false => Err(setup.error(key, &format!("a rate must be a number from 1 to {HIGHEST}"))),
    };
    match (rate, burst) {
        (None, None) => Ok(Bucket::UNLIMITED),
        (None, Some(_)) => Err(setup.error(burst_key, "a burst needs a rate")),
        (Some(rate), burst) => Ok(Bucket {
            per_second: check(rate_key, rate)?,
            burst: check(burst_key, burst.unwrap_or(rate))?,
        }),
    }
}

/// Giving up, stopping a device and releasing it again are never limited.
fn may_be_limited(verb: Verb) -> bool {
    !verb.gives_up() && !matches!(verb, Verb::Stop | Verb::Unstop)
}

impl Manager for Quota {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        let limit = self.limits.iter_mut().find(|limit| limit.covers(question));
        let Some(limit) = limit.filter(|_| may_be_limited(question.verb)) else {
            return Verdict::allow_always().by(&self.label);
        };
        if question.verb == Verb::Send {
            let rate = limit.counts.rate();
            return Verdict::allow_always().at_rate(rate).by(&limit.name);
        }
        // The same request, after its answers: it was counted before.
        if question.repeated {
            return Verdict::allow().by(&limit.name);
        }
        match limit
            .counts
            .take(&question.peer.name, question.size, question.now)
        {
            Ok(()) => Verdict::allow().by(&limit.name),
            Err(over) => limit.refuse(question, over),
        }
    }
}

impl QuotaLimit {
    fn covers(&self, question: &Question<'_>) -> bool {
        self.verbs.covers(question.verb) && self.who.fits(question.peer)
    }

    fn refuse(&self, question: &Question<'_>, over: Over) -> Verdict {
        let Question {
            peer, verb, context, ..
        } = question;
        let (text, earliest) = match over {
            Over::Until(time) => {
                let much = words(&self.counts.rate());
                (
                    format!("{} may {verb} {context} no more than {much}", peer.name),
                    Some(time),
                )
            }
            Over::Never => {
                let most = self.counts.rate().bytes.burst;
                (
                    format!(
                        "{} may {verb} {context} with {most} bytes at once at most",
                        peer.name
                    ),
                    None,
                )
            }
            Over::Crowded(time) => {
                let text =
                    format!("more than {PEERS} peers {verb} at once here, which is all that can be counted");
                (text, Some(time))
            }
        };
        Verdict::deny(Code::OVER_QUOTA, &*self.name, text)
            .earliest(earliest)
            .by(&self.name)
    }
}

fn words(rate: &Rate) -> String {
    let parts = [(rate.parcels, "times"), (rate.bytes, "bytes")];
    let limited = parts.iter().filter(|(bucket, _)| *bucket != Bucket::UNLIMITED);
    let parts: Vec<String> = limited
        .map(|(bucket, unit)| format!("{} {unit} a second", bucket.per_second))
        .collect();
    parts.join(" and ")
}
