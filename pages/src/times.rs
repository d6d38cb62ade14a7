//! Times on a command line.

use std::ops::RangeInclusive;
use std::time::Duration;

/// `250ms`, `0.5s`, `2m` (or `2min`), `1h`; a number without a unit is refused, because nobody knows which one was meant.
///
/// # Errors
/// What a time looks like.
pub fn duration(text: &str) -> Result<Duration, String> {
    let end = text
        .find(|c: char| !c.is_ascii_digit() && c != '.')
        .unwrap_or(text.len());
    let (number, unit) = text.split_at(end);
    let factor = match unit {
        "ms" => 1e-3,
        "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err("a time must be a number with ms, s, m or h: 250ms, 5s, 2m".to_owned()),
    };
    let number: f64 = number
        .parse()
        .map_err(|_| "a time must begin with a number: 5s".to_owned())?;
    let time = Duration::try_from_secs_f64(number * factor).ok();
    // Milliseconds go over the wire.
    time.filter(|time| u64::try_from(time.as_millis()).is_ok())
        .ok_or_else(|| "this time is too long".to_owned())
}

/// The same within bounds, as clap takes it for the values of an option.
pub fn duration_within(
    bounds: RangeInclusive<Duration>,
) -> impl Fn(&str) -> Result<Duration, String> + Clone + Send + Sync + 'static {
    move |text| {
        let time = duration(text)?;
        match bounds.contains(&time) {
            true => Ok(time),
            false => Err(format!(
                "it must be a time from {} to {}",
                shown(*bounds.start()),
                shown(*bounds.end())
            )),
        }
    }
}

/// In its largest unit without a fraction.
fn shown(time: Duration) -> String {
    let millis = time.as_millis();
    let units = [(3_600_000, "h"), (60_000, "m"), (1000, "s")];
    match units
        .iter()
        .find(|(unit, _)| millis > 0 && millis.is_multiple_of(*unit))
    {
        Some((unit, name)) => format!("{}{name}", millis / unit),
        None => format!("{millis}ms"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_has_a_unit() {
        for (text, millis) in [
            ("250ms", 250),
            ("0ms", 0),
            ("5s", 5000),
            ("0.5s", 500),
            ("2m", 120_000),
            ("2min", 120_000),
            ("1h", 3_600_000),
        ] {
            assert_eq!(duration(text), Ok(Duration::from_millis(millis)), "{text}");
        }
        for (text, words) in [
            ("", "a number with"),
            ("5", "a number with"),
            ("5 s", "a number with"),
            ("5d", "a number with"),
            ("-5s", "a number with"),
            ("1e3s", "a number with"),
            ("infs", "a number with"),
            ("s", "begin with a number"),
            (".s", "begin with a number"),
            ("1.2.3s", "begin with a number"),
            ("99999999999999999999s", "too long"),
            ("9999999999999999999h", "too long"),
        ] {
            let error = duration(text).expect_err(text);
            assert!(error.contains(words), "{text}: {error}");
        }
    }

    #[test]
    fn what_is_out_of_bounds_is_told_with_them() {
        let read = duration_within(Duration::from_millis(1)..=Duration::from_secs(3600));
        assert_eq!(read("1h"), Ok(Duration::from_secs(3600)));
        for text in ["0s", "61m"] {
            assert_eq!(
                read(text),
                Err("it must be a time from 1ms to 1h".to_owned()),
                "{text}"
            );
        }
        let read = duration_within(Duration::ZERO..=Duration::from_secs(90));
        assert_eq!(read("2m"), Err("it must be a time from 0ms to 90s".to_owned()));
    }
}
