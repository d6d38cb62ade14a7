//! The parts of an answer as text.

use mom_hub::Judgement;
use mom_managers::{Bucket, Standing};
use mom_proto::{Micros, Path, Time, Verb};

/// The wall time at a time of the hub.
pub(super) fn later(anchor: Time, at: Micros) -> Option<Time> {
    Time::from_micros(anchor.micros().checked_add(i64::try_from(at).ok()?)?)
}

pub(super) fn stands(standing: Standing) -> String {
    let Standing::Stands {
        until, rate, max_age, ..
    } = standing
    else {
        return "asked anew each time".to_owned();
    };
    let mut words = match until {
        Some(until) => format!("for {} s", until.div_ceil(1_000_000)),
        None => "until something changes".to_owned(),
    };
    if let Some(most) = max_age {
        words.push_str(&format!(", for messages of at most {} ms", most / 1000));
    }
    let bucket = |bucket: Bucket, of: &str| {
        let some = bucket.per_second != u64::MAX;
        some.then(|| {
            format!(
                ", at most {} {of} per second and {} at once",
                bucket.per_second, bucket.burst
            )
        })
    };
    if let Some(rate) = rate {
        words.extend(bucket(rate.parcels, "parcels"));
        words.extend(bucket(rate.bytes, "bytes"));
    }
    words
}

/// The hub's conditions for any peer before the manager decides.
pub(super) fn needs(context: &Path, verb: Verb, judgement: &Judgement) -> Vec<String> {
    let above = context.parent().map(|above| format!("membership of {above}"));
    let mut needs = match verb {
        Verb::Create | Verb::Join | Verb::Grab | Verb::Inhibit | Verb::Request => above.into_iter().collect(),
        Verb::Send | Verb::Stop | Verb::Unstop | Verb::Invite => vec![format!("membership of {context}")],
        Verb::Renew | Verb::Give => vec![format!("ownership of {context}")],
        Verb::Accept => vec![format!(
            "an offer of {context}, or its ownership and a peer's request"
        )],
        _ => Vec::new(),
    };
    needs.extend(
        judgement
            .guard
            .as_ref()
            .map(|token| format!("ownership of {token}")),
    );
    needs
}
