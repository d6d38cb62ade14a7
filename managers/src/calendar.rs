//! Spans of wall time: from one instant to another, or by the clock on days of the week. All in UTC.

use mom_proto::nearest::nearest;
use mom_proto::{Time, WireError};

use crate::Setup;

const MINUTE: i64 = 60_000_000;
const DAY: i64 = 24 * 60 * MINUTE;

/// The words of the days, and their order from the epoch's first Monday on.
const WEEK: [&str; 7] = ["mon", "tue", "wed", "thu", "fri", "sat", "sun"];
/// 1970-01-01 was a Thursday.
const EPOCH_DAY: i64 = 3;

const FORMS: &str = "a time of the day such as 09:00, or an instant such as 2026-11-23T09:00:00Z";

/// Instants in µs since the epoch; the end is exclusive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Span {
    /// Once.
    Once { from: i64, to: i64 },
    /// On each marked day, from an offset after midnight, for at most a day.
    Daily { from: i64, length: i64, days: [bool; 7] },
}

impl Span {
    /// Reads the keys `from`, `to` and `days` below `key`.
    pub(crate) fn read(
        setup: &Setup<'_>,
        key: &str,
        from: &str,
        to: &str,
        days: Option<&[String]>,
    ) -> Result<Span, WireError> {
        let at = |name: &str| format!("{key}/{name}");
        let bad = |name: &str, text: &str| setup.error(&at(name), &format!("{name} is {text}"));
        if let Some(begin) = clock(from) {
            let end = clock(to).ok_or_else(|| bad("to", "a time of the day, as from is"))?;
            if begin == DAY {
                return Err(bad("from", "a time before 24:00"));
            }
            if begin == end {
                return Err(bad("to", "another time than from; a whole day is 00:00 to 24:00"));
            }
            let length = if end > begin {
                end - begin
            } else {
                end + DAY - begin
            };
            let days = days_of(setup, &at("days"), days)?;
            return Ok(Span::Daily {
                from: begin,
                length,
                days,
            });
        }
        let instant = |text: &str| text.parse::<Time>().ok().map(Time::micros);
        let begin = instant(from).ok_or_else(|| bad("from", FORMS))?;
        let end = instant(to).ok_or_else(|| bad("to", "an instant, as from is"))?;
        if end <= begin {
            return Err(bad("to", "not later than from"));
        }
        match days {
            Some(_) => Err(bad("days", "for times of the day; these are instants")),
            None => Ok(Span::Once { from: begin, to: end }),
        }
    }

    /// The end of the span that contains this instant.
    pub(crate) fn end(&self, at: i64) -> Option<i64> {
        match *self {
            Span::Once { from, to } => (from <= at && at < to).then_some(to),
            Span::Daily { length, .. } => {
                let today = at.div_euclid(DAY);
                let begun = [today - 1, today]
                    .into_iter()
                    .filter_map(|day| self.begin_on(day));
                begun
                    .map(|begin| (begin, begin + length))
                    .find(|&(begin, end)| begin <= at && at < end)
                    .map(|(_, end)| end)
            }
        }
    }

    /// The next time after this instant at which the span begins.
    pub(crate) fn next_begin(&self, at: i64) -> Option<i64> {
        match *self {
            Span::Once { from, .. } => (from > at).then_some(from),
            Span::Daily { .. } => {
                let today = at.div_euclid(DAY);
                // Today's begin may be past, and the next marked day a week away.
                (today..=today + 7)
                    .filter_map(|day| self.begin_on(day))
                    .find(|begin| *begin > at)
            }
        }
    }

    fn begin_on(&self, day: i64) -> Option<i64> {
        match *self {
            Span::Once { .. } => None,
            Span::Daily { from, days, .. } => {
                let of_week = usize::try_from((day + EPOCH_DAY).rem_euclid(7)).unwrap_or_default();
                days[of_week].then_some(day * DAY + from)
            }
        }
    }
}

/// An instant as text, without a zero fraction.
pub(crate) fn words(micros: i64) -> String {
    match Time::from_micros(micros) {
        Some(time) => time.to_string().replace(".000000Z", "Z"),
        None => "the end of time".to_owned(),
    }
}

/// µs from midnight to a time such as `09:00`; `24:00` is the next midnight.
fn clock(text: &str) -> Option<i64> {
    let number = |digits: &[u8]| match digits {
        [tens @ b'0'..=b'9', ones @ b'0'..=b'9'] => {
            Some(i64::from(tens - b'0') * 10 + i64::from(ones - b'0'))
        }
        _ => None,
    };
    let bytes = text.as_bytes();
    let (hours, minutes) = match bytes {
        [hours @ .., b':', tens, ones] => (number(hours)?, number(&[*tens, *ones])?),
        _ => return None,
    };
    let valid = hours < 24 && minutes < 60 || hours == 24 && minutes == 0;
    valid.then_some((hours * 60 + minutes) * MINUTE)
}

fn days_of(setup: &Setup<'_>, key: &str, words: Option<&[String]>) -> Result<[bool; 7], WireError> {
    let Some(words) = words else {
        return Ok([true; 7]);
    };
    if words.is_empty() {
        return Err(setup.error(key, "days is empty; leave it out for every day"));
    }
    let mut days = [false; 7];
    for word in words {
        let Some(day) = WEEK.iter().position(|known| known == word) else {
            let text = format!("there is no day {word:?}; days are {}", WEEK.join(", "));
            return Err(setup.error(key, &text).nearest_opt(nearest(word, WEEK)));
        };
        days[day] = true;
    }
    Ok(days)
}
