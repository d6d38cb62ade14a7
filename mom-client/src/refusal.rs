//! Refusals, typed and as text for operators (M29).

use std::fmt;
use std::time::Duration;

use mom_proto::{Code, Value, WireError};

/// The details of a refusal; what does not apply is absent.
///
/// Its `Display` is one line for people: `bob (level 1) holds it for 2 min 3 s more; you would be 2nd in the queue`.
///
/// ```
/// use std::time::Duration;
/// use mom_client::{ClientError, Code, WireError};
/// let held = WireError::new(Code::HELD, "/t is held").owner("bob", 1).retry_after(Duration::from_secs(123));
/// let error = ClientError::Refused(held.detail("place", 2));
/// let refusal = error.refusal().unwrap();
/// assert_eq!((refusal.owner, refusal.owner_level), (Some("bob"), Some(1)));
/// assert_eq!(
///     refusal.to_string(),
///     "bob (level 1) holds it for 2 min 3 s more; you would be 2nd in the queue"
/// );
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Refusal<'a> {
    /// What kind of refusal.
    pub code: &'a Code,
    /// The hub's own words.
    pub text: &'a str,
    /// The rule that decided, by its name in the configuration.
    pub rule: Option<&'a str>,
    /// The peer that owns the token.
    pub owner: Option<&'a str>,
    /// The level with which it is owned.
    pub owner_level: Option<i64>,
    /// The level of the peer that was refused.
    pub level: Option<i64>,
    /// When to try again, from the refusal on: for `held` the remainder of the lease.
    pub retry_after: Option<Duration>,
    /// The place in the queue that the peer has or would have, 1 for the next.
    pub place: Option<u64>,
    /// The expected time until its grant, if nobody before it renews.
    pub expected: Option<Duration>,
    /// The peers that hold the token together.
    pub holders: Vec<&'a str>,
    /// The receivers without capacity for a message, in a channel where senders wait.
    pub slow: Vec<&'a str>,
}

impl<'a> Refusal<'a> {
    /// The refusal in an error of the hub.
    pub fn of(error: &'a WireError) -> Refusal<'a> {
        let string = |key| error.get(key).and_then(Value::as_str);
        let int = |key| error.get(key).and_then(Value::as_int);
        let number = |key| int(key).and_then(|number| u64::try_from(number).ok());
        let strings = |key| {
            let list = error.get(key).and_then(Value::as_list).unwrap_or_default();
            list.iter().filter_map(Value::as_str).collect()
        };
        Refusal {
            code: &error.code,
            text: &error.text,
            rule: string("rule"),
            owner: string("owner"),
            owner_level: int("owner-level"),
            level: int("level"),
            retry_after: error.retry_in(),
            place: number("place"),
            expected: number("expected").map(Duration::from_millis),
            holders: strings("holders"),
            slow: strings("slow"),
        }
    }

    /// The owner, and the remaining time; empty if the refusal names nobody.
    fn held(&self) -> Option<String> {
        if let Some((last, others)) = self.holders.split_last() {
            return Some(match others {
                [] => format!("{last} has inhibited it, so nobody may own it"),
                others => format!(
                    "{} and {last} have inhibited it, so nobody may own it",
                    others.join(", ")
                ),
            });
        }
        let owner = self.owner?;
        let owner = match self.owner_level {
            Some(level) => format!("{owner} (level {level})"),
            None => owner.to_owned(),
        };
        Some(match self.retry_after {
            Some(left) if left.is_zero() => format!("{owner} holds it, although its lease has expired"),
            Some(left) => format!("{owner} holds it for {} more", plain_duration(left)),
            None => format!("{owner} holds it without a time limit"),
        })
    }

    /// The place in the queue: the one it would have had, or the one at which its wait ended.
    fn queue(&self) -> Option<String> {
        let place = ordinal(self.place?);
        let soon = match self.expected {
            Some(expected) if !expected.is_zero() => {
                format!(", with your turn expected in {}", plain_duration(expected))
            }
            _ => String::new(),
        };
        Some(match *self.code == Code::TIMED_OUT {
            true => format!("you were {place} in the queue"),
            false => format!("you would be {place} in the queue{soon}"),
        })
    }
}

impl fmt::Display for Refusal<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let held = [Code::HELD, Code::TIMED_OUT].contains(self.code);
        if let Some(words) = self.held().filter(|_| held) {
            if *self.code == Code::TIMED_OUT {
                formatter.write_str("waited in vain: ")?;
            }
            formatter.write_str(&words)?;
            return match self.queue() {
                Some(queue) => write!(formatter, "; {queue}"),
                None => Ok(()),
            };
        }
        match self.text.is_empty() {
            true => formatter.write_str(self.code.word())?,
            false => formatter.write_str(self.text)?,
        }
        match self.retry_after {
            Some(wait) if !wait.is_zero() => write!(formatter, "; try again in {}", plain_duration(wait)),
            _ => Ok(()),
        }
    }
}

/// `0.4 s`, `1.1 s`, `42 s`, `2 min 58 s`, `1 h 5 min`; rounded up, so that waiting this long is always enough.
pub fn plain_duration(duration: Duration) -> String {
    let tenths = duration.as_millis().div_ceil(100);
    if tenths <= 100 {
        return match tenths % 10 {
            0 => format!("{} s", tenths / 10),
            tenth => format!("{}.{tenth} s", tenths / 10),
        };
    }
    let seconds = duration
        .as_secs()
        .saturating_add(u64::from(duration.subsec_nanos() > 0));
    match (seconds / 3600, seconds / 60 % 60, seconds % 60) {
        (0, 0, seconds) => format!("{seconds} s"),
        (0, minutes, 0) => format!("{minutes} min"),
        (0, minutes, seconds) => format!("{minutes} min {seconds} s"),
        (hours, 0, _) => format!("{hours} h"),
        (hours, minutes, _) => format!("{hours} h {minutes} min"),
    }
}

/// `1st`, `2nd`, `3rd`, `4th`, `11th`.
pub fn ordinal(number: u64) -> String {
    let ending = match (number % 100, number % 10) {
        (11..=13, _) => "th",
        (_, 1) => "st",
        (_, 2) => "nd",
        (_, 3) => "rd",
        _ => "th",
    };
    format!("{number}{ending}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(error: &WireError, words: &str) {
        assert_eq!(Refusal::of(error).to_string(), words);
    }

    #[test]
    fn a_held_token_in_words() {
        let held = || WireError::new(Code::HELD, "/t is held").owner("bob", 1);
        let seconds = Duration::from_secs;
        check(&held(), "bob (level 1) holds it without a time limit");
        check(
            &held().retry_after(seconds(123)).detail("place", 2),
            "bob (level 1) holds it for 2 min 3 s more; you would be 2nd in the queue",
        );
        check(
            &held()
                .retry_after(seconds(3))
                .detail("place", 3)
                .detail("expected", 9000),
            "bob (level 1) holds it for 3 s more; you would be 3rd in the queue, with your turn expected in 9 s",
        );
        check(
            &held().retry_after(Duration::ZERO),
            "bob (level 1) holds it, although its lease has expired",
        );
        let mut late = held().retry_after(seconds(3)).detail("place", 1);
        late.code = Code::TIMED_OUT;
        check(
            &late,
            "waited in vain: bob (level 1) holds it for 3 s more; you were 1st in the queue",
        );
        let together = |names: &[&str]| {
            let names: Vec<Value> = names.iter().map(|name| (*name).into()).collect();
            WireError::new(Code::HELD, "several").detail("holders", names)
        };
        check(&together(&["bob"]), "bob has inhibited it, so nobody may own it");
        check(
            &together(&["ally", "bob", "dan"]),
            "ally, bob and dan have inhibited it, so nobody may own it",
        );
    }

    #[test]
    fn what_nobody_holds_is_in_the_hub_s_words() {
        let restart = WireError::new(Code::HELD, "kept for who owned it before the restart");
        check(
            &restart.rule("restart").retry_after(Duration::from_millis(29_200)),
            "kept for who owned it before the restart; try again in 30 s",
        );
        check(
            &WireError::new(Code::DECLINED, "not now").owner("bob", 1),
            "not now",
        );
        check(&WireError::new(Code::NO_OFFER, ""), "no-offer");
    }

    #[test]
    fn durations_are_rounded_up() {
        for (millis, words) in [
            (0, "0 s"),
            (1, "0.1 s"),
            (999, "1 s"),
            (1001, "1.1 s"),
            (1100, "1.1 s"),
            (9_901, "10 s"),
            (10_001, "11 s"),
            (59_000, "59 s"),
            (59_001, "1 min"),
            (178_000, "2 min 58 s"),
            (180_000, "3 min"),
            (3_600_000, "1 h"),
            (3_900_000, "1 h 5 min"),
        ] {
            assert_eq!(plain_duration(Duration::from_millis(millis)), words);
        }
    }

    #[test]
    fn ordinals() {
        let words: Vec<String> = [1, 2, 3, 4, 11, 12, 13, 21, 22, 111, 112, 1003]
            .map(ordinal)
            .into();
        let expected = "1st 2nd 3rd 4th 11th 12th 13th 21st 22nd 111th 112th 1003rd";
        assert_eq!(words.join(" "), expected);
    }
}
