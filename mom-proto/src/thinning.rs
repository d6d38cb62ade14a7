//! Thinning: the options of `context join`.

use std::fmt;
use std::str::FromStr;

use crate::{Code, Map, Value, WireError};

const SECOND: u64 = 1_000_000;

/// How many of the others' messages a member of a channel gets.
///
/// ```
/// use mom_proto::Thinning;
///
/// let thinning = Thinning { rate: Some("5/s".parse().unwrap()), ..Thinning::default() };
/// assert!(thinning.thins());
/// assert_eq!(thinning.interval(), 200_000);
/// assert!(!Thinning::default().thins());
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Thinning {
    /// Only the newest waiting message of each sender and name.
    pub newest: bool,
    /// The most messages of each sender and name, always the newest; none = unlimited.
    pub rate: Option<MessageRate>,
}

impl Thinning {
    /// Whether any messages may be left out.
    pub fn thins(&self) -> bool {
        self.newest || self.rate.is_some()
    }

    /// The least time between two of the same sender and name, µs; 0 without a rate.
    pub fn interval(&self) -> u64 {
        self.rate.map_or(0, MessageRate::interval)
    }

    /// Adds `newest` and `rate` to a map, as far as they are set.
    pub fn describe(&self, map: &mut Map) {
        if self.newest {
            map.set("newest", true);
        }
        if let Some(rate) = self.rate {
            map.set("rate", rate.to_string());
        }
    }
}

/// How many messages in a second or a minute: `5/s`, `12/min`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageRate {
    count: u64,
    /// µs.
    period: u64,
}

impl MessageRate {
    /// The most in a period. The hub's timer has a resolution of 1 ms, so a higher rate would be no limit.
    pub const MOST: u64 = 1000;

    /// So many per second.
    ///
    /// # Errors
    /// `bad-content` for a number that is not from 1 to [`MessageRate::MOST`].
    pub fn per_second(count: u64) -> Result<MessageRate, WireError> {
        MessageRate::of(count, SECOND).ok_or_else(|| wrong(&count))
    }

    /// From content: an int is a number per second, a string is parsed.
    ///
    /// # Errors
    /// `bad-content`.
    pub fn from_value(value: &Value) -> Result<MessageRate, WireError> {
        match value {
            Value::Int(count) => u64::try_from(*count)
                .ok()
                .and_then(|count| MessageRate::of(count, SECOND))
                .ok_or_else(|| wrong(count)),
            Value::String(text) => text.parse(),
            _ => Err(wrong(&value.kind().word())),
        }
    }

    /// The least time between two, µs.
    pub fn interval(self) -> u64 {
        self.period.div_ceil(self.count)
    }

    fn of(count: u64, period: u64) -> Option<MessageRate> {
        (1..=MessageRate::MOST)
            .contains(&count)
            .then_some(MessageRate { count, period })
    }
}

impl FromStr for MessageRate {
    type Err = WireError;

    fn from_str(text: &str) -> Result<MessageRate, WireError> {
        let (count, unit) = text.split_once('/').unwrap_or((text, "s"));
        let period = match unit {
            "s" => SECOND,
            "min" => 60 * SECOND,
            _ => return Err(wrong(&format_args!("{text:?}"))),
        };
        // A sign or a blank is not a digit.
        let digits = count.bytes().all(|byte| byte.is_ascii_digit());
        let count = count.parse().ok().filter(|_| digits);
        count
            .and_then(|count| MessageRate::of(count, period))
            .ok_or_else(|| wrong(&format_args!("{text:?}")))
    }
}

impl fmt::Display for MessageRate {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = if self.period == SECOND { "s" } else { "min" };
        write!(formatter, "{}/{unit}", self.count)
    }
}

fn wrong(found: &dyn fmt::Display) -> WireError {
    let text = format!(
        "a rate must be a number from 1 to {} of messages per second, or a text as \"5/s\" or \"12/min\", not {found}",
        MessageRate::MOST
    );
    WireError::new(Code::BAD_CONTENT, text).slot("content/rate")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_read_and_shown() {
        for (value, shown, interval) in [
            (Value::from(5), "5/s", 200_000),
            (Value::from("5/s"), "5/s", 200_000),
            (Value::from("7"), "7/s", 142_858),
            (Value::from("12/min"), "12/min", 5_000_000),
            (Value::from(1000), "1000/s", 1000),
        ] {
            let rate = MessageRate::from_value(&value).unwrap();
            assert_eq!((rate.to_string().as_str(), rate.interval()), (shown, interval));
            assert_eq!(rate.to_string().parse::<MessageRate>().unwrap(), rate);
        }
    }

    #[test]
    fn what_is_no_rate_is_refused_with_its_place() {
        for value in [
            Value::from(0),
            Value::from(-1),
            Value::from(1001),
            Value::from("0/s"),
            Value::from("+5/s"),
            Value::from("5 /s"),
            Value::from("5/h"),
            Value::from("/s"),
            Value::from(""),
            Value::from("99999999999999999999/s"),
            Value::from(true),
            Value::Double(1.5),
        ] {
            let error = MessageRate::from_value(&value).unwrap_err();
            assert_eq!(error.code, Code::BAD_CONTENT, "{value:?}");
            assert_eq!(error.get("slot").and_then(Value::as_str), Some("content/rate"));
        }
    }

    #[test]
    fn what_is_not_set_is_not_told() {
        let mut map = Map::new();
        Thinning::default().describe(&mut map);
        assert!(map.is_empty());
        let thinning = Thinning {
            newest: true,
            rate: MessageRate::per_second(2).ok(),
        };
        thinning.describe(&mut map);
        assert_eq!(map, Map::new().with("newest", true).with("rate", "2/s"));
    }
}
