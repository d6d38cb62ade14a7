//! Instants on the wire: µs since the Unix epoch, UTC. And time that only rises, which is not on the wire.

use std::fmt;

use time::{Date, Month, OffsetDateTime, UtcOffset};

/// Monotonic time in µs since a start, mostly the hub's; or a duration.
pub type Micros = u64;

/// An instant in µs since 1970-01-01T00:00:00Z, without leap seconds.
///
/// Its text form is `2026-11-21T10:00:00.000123Z`: years 0000–9999, always `Z`, one to six fraction digits
/// or none when read, six when written.
///
/// ```
/// use mom_proto::Time;
/// let time: Time = "2026-11-21T10:00:00.000123Z".parse().unwrap();
/// assert_eq!(time.micros(), 1_795_255_200_000_123);
/// assert_eq!(time.to_string(), "2026-11-21T10:00:00.000123Z");
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Time(i64);

/// Text that is not an instant of the form `2026-11-21T10:00:00.000123Z`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a time is written like 2026-11-21T10:00:00.000123Z, in UTC")]
pub struct BadTime;

impl Time {
    /// The earliest instant with a text form: 0000-01-01T00:00:00Z.
    pub const MIN: Time = Time(-62_167_219_200_000_000);
    /// The last instant with a text form: 9999-12-31T23:59:59.999999Z.
    pub const MAX: Time = Time(253_402_300_799_999_999);

    /// The instant this many µs after the epoch, if it has a text form.
    pub fn from_micros(micros: i64) -> Option<Time> {
        let time = Time(micros);
        (Time::MIN <= time && time <= Time::MAX).then_some(time)
    }

    /// µs since the epoch.
    pub fn micros(self) -> i64 {
        self.0
    }

    /// Writes the text form into `out`: 27 bytes.
    pub fn write(self, out: &mut Vec<u8>) {
        // Not by nanoseconds: they are an i128, whose divisions take most of the time.
        let (seconds, micros) = (self.0.div_euclid(1_000_000), self.0.rem_euclid(1_000_000));
        let date_time = OffsetDateTime::from_unix_timestamp(seconds).unwrap_or(OffsetDateTime::UNIX_EPOCH);
        let (date, clock) = (date_time.date(), date_time.time());
        let year = u32::try_from(date.year()).unwrap_or_default();
        for (digits, number, separator) in [
            (4, year, b'-'),
            (2, u8::from(date.month()).into(), b'-'),
            (2, date.day().into(), b'T'),
            (2, clock.hour().into(), b':'),
            (2, clock.minute().into(), b':'),
            (2, clock.second().into(), b'.'),
            (6, u32::try_from(micros).unwrap_or_default(), b'Z'),
        ] {
            push_padded(out, number, digits);
            out.push(separator);
        }
    }
}

impl fmt::Display for Time {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut out = Vec::with_capacity(27);
        self.write(&mut out);
        formatter.write_str(std::str::from_utf8(&out).unwrap_or_default())
    }
}

impl std::str::FromStr for Time {
    type Err = BadTime;

    fn from_str(text: &str) -> Result<Time, BadTime> {
        let bytes = text.as_bytes();
        let separators = [(4, b'-'), (7, b'-'), (10, b'T'), (13, b':'), (16, b':')];
        if bytes.len() < 20 || separators.iter().any(|&(at, byte)| bytes[at] != byte) {
            return Err(BadTime);
        }
        let fraction = match &bytes[19..] {
            [b'Z'] => 0,
            [b'.', digits @ .., b'Z'] if (1..=6).contains(&digits.len()) => {
                number(digits)? * 10_u32.pow(6 - u32::try_from(digits.len()).map_err(|_| BadTime)?)
            }
            _ => return Err(BadTime),
        };
        let part = |from: usize, to: usize| number(&bytes[from..to]);
        let small = |from, to| part(from, to).and_then(|n| u8::try_from(n).map_err(|_| BadTime));
        let month = Month::try_from(small(5, 7)?).map_err(|_| BadTime)?;
        let year = i32::try_from(part(0, 4)?).map_err(|_| BadTime)?;
        let date = Date::from_calendar_date(year, month, small(8, 10)?).map_err(|_| BadTime)?;
        let clock = time::Time::from_hms_micro(small(11, 13)?, small(14, 16)?, small(17, 19)?, fraction)
            .map_err(|_| BadTime)?;
        let seconds = OffsetDateTime::new_in_offset(date, clock, UtcOffset::UTC).unix_timestamp();
        Time::from_micros(seconds * 1_000_000 + i64::from(fraction)).ok_or(BadTime)
    }
}

fn number(digits: &[u8]) -> Result<u32, BadTime> {
    digits.iter().try_fold(0, |sum, byte| match byte {
        b'0'..=b'9' => Ok(sum * 10 + u32::from(byte - b'0')),
        _ => Err(BadTime),
    })
}

fn push_padded(out: &mut Vec<u8>, number: u32, digits: usize) {
    let start = out.len();
    out.resize(start + digits, b'0');
    let mut rest = number;
    for slot in out[start..].iter_mut().rev() {
        *slot = b'0' + u8::try_from(rest % 10).unwrap_or_default();
        rest /= 10;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(text: &str, micros: Option<i64>) {
        assert_eq!(text.parse::<Time>().ok().map(Time::micros), micros, "{text}");
    }

    #[test]
    fn reads_only_its_own_form() {
        check("1970-01-01T00:00:00Z", Some(0));
        check("1970-01-01T00:00:00.5Z", Some(500_000));
        check("1969-12-31T23:59:59.999999Z", Some(-1));
        check("0000-01-01T00:00:00Z", Some(Time::MIN.micros()));
        check("9999-12-31T23:59:59.999999Z", Some(Time::MAX.micros()));
        check("2024-02-29T00:00:00Z", Some(1_709_164_800_000_000));
        for bad in [
            "",
            "2023-02-29T00:00:00Z",
            "2026-11-21 10:00:00Z",
            "2026-11-21T10:00:00",
            "2026-11-21T10:00:00+01:00",
            "2026-11-21T10:00:00.1234567Z",
            "2026-11-21T10:00:00.Z",
            "2026-11-21T24:00:00Z",
            "2026-11-21T10:00:60Z",
            "+026-11-21T10:00:00Z",
            "２026-11-21T10:00:00Z",
        ] {
            check(bad, None);
        }
    }

    #[test]
    fn what_is_written_is_read_back() {
        for micros in [
            0,
            -1,
            1,
            1_795_255_200_000_123,
            Time::MIN.micros(),
            Time::MAX.micros(),
        ] {
            let time = Time::from_micros(micros).unwrap();
            check(&time.to_string(), Some(micros));
        }
        assert_eq!(Time::from_micros(Time::MAX.micros() + 1), None);
    }
}
