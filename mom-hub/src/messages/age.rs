//! The age of a message at ingress, by the hub's clock (M6, design §7).

use std::time::Duration;

use mom_proto::{Code, Micros, Parcel, Time, WireError, event};

use crate::PeerClock;

/// When a clock is likely to be measured.
const MEASURED: Duration = Duration::from_millis(200);

/// An age and how wrong it may be, both in µs.
pub(crate) type Aged = (i64, u64);

/// The age of a message at `wall`; none if its sender's clock is not known, or it does not say when it was created.
pub(crate) fn age_of(parcel: &Parcel, wall: Time, clock: Option<&PeerClock>) -> Option<Aged> {
    Some(aged(parcel.timestamp?, wall, clock?))
}

/// The age at `wall` of a message created at `timestamp` by that clock.
pub(crate) fn aged(timestamp: Time, wall: Time, clock: &PeerClock) -> Aged {
    let created = clock.offset.own(timestamp);
    (wall.micros().saturating_sub(created), clock.offset.error)
}

/// Whether an age lies further in the future than the clock may be wrong.
pub(crate) fn is_ahead((age, error): Aged, clock: &PeerClock) -> bool {
    i128::from(age) + i128::from(error) + i128::from(clock.future) < 0
}

/// Whether an age is not above `most` µs even with its error. An unknown age is not.
pub(crate) fn is_within(age: Option<Aged>, most: Micros) -> bool {
    age.is_some_and(|(age, error)| {
        let oldest = i128::from(age) + i128::from(error);
        oldest <= i128::from(most)
    })
}

/// Checks that a message is neither of the future nor expired, and gives its age. A stop is always taken: a device must
/// halt also if a clock is wrong.
///
/// # Errors
/// `bad-slot` for a timestamp too far ahead, `expired`.
pub(crate) fn check_age(
    parcel: &Parcel,
    wall: Time,
    clock: Option<&PeerClock>,
) -> Result<Option<Aged>, WireError> {
    let age = age_of(parcel, wall, clock);
    let (Some((micros, error)), Some(clock)) = (age, clock) else {
        return Ok(None);
    };
    if &*parcel.name == event::STOP {
        return Ok(age);
    }
    if is_ahead((micros, error), clock) {
        let text = format!(
            "its timestamp is {} ms in the future by its sender's measured clock, ± {} ms",
            micros.unsigned_abs() / 1000,
            error.div_ceil(1000)
        );
        return Err(WireError::new(Code::BAD_SLOT, text).slot("timestamp"));
    }
    check_life(parcel, micros)?;
    Ok(age)
}

/// Whether a message of this age was said before this moment, for certain.
pub(crate) fn is_before((age, error): Aged, moment: Time, wall: Time) -> bool {
    let since = i128::from(wall.micros()) - i128::from(moment.micros());
    i128::from(age) - i128::from(error) > since
}

/// Checks that a message of this age in µs has not expired.
///
/// # Errors
/// `expired`.
pub(crate) fn check_life(parcel: &Parcel, age: impl Into<i128>) -> Result<(), WireError> {
    let (age, life) = (
        age.into(),
        parcel.expires.map(|expires| i128::from(expires) * 1000),
    );
    if life.is_none_or(|life| age < life) {
        return Ok(());
    }
    let text = format!(
        "it expired: valid for {} ms, {} ms old",
        parcel.expires.unwrap_or_default(),
        age / 1000
    );
    Err(WireError::new(Code::EXPIRED, text).slot("expires"))
}

/// Why a message that a token guards does not pass that expires, and of which nobody knows how old it is: counted from
/// its arrival, a command that has waited for a minute in a network would move the device.
#[cold]
pub(crate) fn unknown_age(parcel: &Parcel) -> WireError {
    match parcel.timestamp {
        None => {
            let text = "an expiry is relative to the timestamp, and the message has none";
            WireError::new(Code::BAD_SLOT, text).slot("timestamp")
        }
        Some(_) => {
            let text = "its age is unknown: the hub has not measured its sender's clock yet; answer the hub's pings, then send it again";
            WireError::new(Code::TRY_LATER, text)
                .slot("expires")
                .retry_after(MEASURED)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_proto::{ClockOffset, Family, Value};

    const NOON: i64 = 43_200_000_000;

    /// A message of a peer whose clock is an hour ahead, ± 2 ms, created so many µs before the hub has it.
    fn check(name: &str, old: i64, expires: Option<u64>) -> Result<Option<Aged>, WireError> {
        let hour = 3_600_000_000;
        let clock = PeerClock {
            offset: ClockOffset {
                micros: hour,
                error: 2_000,
            },
            future: 1_000_000,
        };
        let mut parcel = Parcel::new(Family::Message, name);
        parcel.timestamp = Time::from_micros(NOON - old + hour);
        parcel.expires = expires;
        check_age(&parcel, Time::from_micros(NOON).unwrap(), Some(&clock))
    }

    fn slot_of(error: &WireError) -> Option<&str> {
        error.get("slot").and_then(Value::as_str)
    }

    #[test]
    fn ages_count_by_the_hubs_clock() {
        for old in [-1_002_000, -1, 0, 1, 500_000, 86_400_000_000] {
            assert_eq!(check("state", old, None), Ok(Some((old, 2_000))), "{old}");
        }
        let error = check("state", -1_002_001, None).unwrap_err();
        assert_eq!(
            (&error.code, slot_of(&error)),
            (&Code::BAD_SLOT, Some("timestamp"))
        );
        assert!(error.text.contains("1002 ms in the future"), "{}", error.text);
    }

    #[test]
    fn what_is_over_is_refused() {
        assert_eq!(check("state", 499_999, Some(500)), Ok(Some((499_999, 2_000))));
        let error = check("state", 500_000, Some(500)).unwrap_err();
        assert_eq!((&error.code, slot_of(&error)), (&Code::EXPIRED, Some("expires")));
        assert_eq!(
            check("unstop", 500_000, Some(500)).unwrap_err().code,
            Code::EXPIRED
        );
    }

    #[test]
    fn what_has_waited_is_that_much_older() {
        let mut parcel = Parcel::new(Family::Message, "state");
        assert_eq!(check_life(&parcel, 700_000_u64), Ok(()));
        parcel.expires = Some(700);
        assert_eq!(check_life(&parcel, 699_999_u64), Ok(()));
        assert_eq!(check_life(&parcel, 700_000_u64).unwrap_err().code, Code::EXPIRED);
    }

    #[test]
    fn a_stop_is_taken_whatever_its_stamps() {
        for old in [-86_400_000_000, 86_400_000_000] {
            assert_eq!(check("stop", old, Some(1)), Ok(Some((old, 2_000))));
        }
    }

    #[test]
    fn nothing_is_said_of_what_is_not_known() {
        let mut parcel = Parcel::new(Family::Message, "state");
        parcel.timestamp = Some(Time::MAX);
        parcel.expires = Some(0);
        assert_eq!(check_age(&parcel, Time::default(), None), Ok(None));
        assert!(!is_within(None, Micros::MAX));
        assert!(is_within(Some((1, 2)), 3) && !is_within(Some((2, 2)), 3));
        assert!(is_within(Some((i64::MIN, 0)), 0) && !is_within(Some((i64::MAX, u64::MAX)), Micros::MAX));
    }
}
