//! Arithmetic on numbers of the wire: whole ones wrap in their type, of an f32 the value here is its bits.

use crate::Number;

/// The number of these bytes.
pub(crate) fn load(number: Number, bytes: &[u8]) -> i64 {
    let mut value = 0_u32;
    for &byte in bytes {
        value = value << 8 | u32::from(byte);
    }
    wrap(number, i64::from(value))
}

/// Writes the number.
pub(crate) fn store(mut value: i64, bytes: &mut [u8]) {
    for byte in bytes.iter_mut().rev() {
        *byte = value as u8;
        value >>= 8;
    }
}

/// The number of the type that has the same low bits.
pub(crate) fn wrap(number: Number, value: i64) -> i64 {
    match number {
        Number::U8 => i64::from(value as u8),
        Number::I8 => i64::from(value as i8),
        Number::U16 => i64::from(value as u16),
        Number::I16 => i64::from(value as i16),
        Number::U32 | Number::F32 => i64::from(value as u32),
        Number::I32 => i64::from(value as i32),
    }
}

pub(crate) fn float(value: i64) -> f32 {
    f32::from_bits(value as u32)
}

pub(crate) fn bits(value: f32) -> i64 {
    i64::from(value.to_bits())
}

/// The nearest number that the type has.
pub(crate) fn saturate(number: Number, value: i64) -> i64 {
    let bits = number.size() as u32 * 8;
    let (low, high) = match number {
        Number::U8 | Number::U16 | Number::U32 | Number::F32 => (0, (1 << bits) - 1),
        Number::I8 | Number::I16 | Number::I32 => (-1 << (bits - 1), (1 << (bits - 1)) - 1),
    };
    value.max(low).min(high)
}

/// At most so far from 0.
fn within(value: i64, limit: f32) -> i64 {
    let limit = limit as i64;
    value.max(-limit).min(limit)
}

/// `total` + `step`.
pub(crate) fn add(number: Number, total: i64, step: i64) -> i64 {
    match number {
        Number::F32 => bits(float(total) + float(step)),
        _ => wrap(number, total + step),
    }
}

/// Whether what has been added to `base` to make `total` and `step` more are together within the type.
#[cfg(feature = "middle")]
pub(crate) fn fits(number: Number, base: i64, total: i64, step: i64) -> bool {
    match number {
        Number::F32 => (float(total) + float(step)).is_finite(),
        _ => {
            let sum = wrap(number, total - base) + step;
            saturate(number, sum) == sum
        }
    }
}

/// The total `new` was heard after `heard`, of which `given` was given: the new `given`. What it lacks of the total stays to be given, at
/// most as much as the type holds.
pub(crate) fn hear(number: Number, heard: i64, given: i64, new: i64) -> i64 {
    if number == Number::F32 {
        return given;
    }
    let waits = wrap(number, heard - given) + wrap(number, new - heard);
    wrap(number, new - saturate(number, waits))
}

/// The next step towards the total, and what is given then.
pub(crate) fn give(number: Number, heard: i64, given: i64, limit: Option<f32>) -> (i64, i64) {
    if number != Number::F32 {
        let all = wrap(number, heard - given);
        let part = limit.map_or(all, |limit| within(all, limit));
        return (part, wrap(number, given + part));
    }
    let all = float(heard) - float(given);
    match limit {
        Some(limit) if all.abs() > limit => {
            let part = limit.copysign(all);
            (bits(part), bits(float(given) + part))
        }
        // The whole way ends exactly at the total, whatever was rounded on it.
        _ => (bits(all), heard),
    }
}

/// `now` moved towards `goal` by at most `limit`.
pub(crate) fn approach(number: Number, now: i64, goal: i64, limit: Option<f32>) -> i64 {
    let Some(limit) = limit else {
        return goal;
    };
    if number != Number::F32 {
        return now + within(goal - now, limit);
    }
    let all = float(goal) - float(now);
    if all.abs() > limit {
        bits(float(now) + limit.copysign(all))
    } else {
        goal
    }
}

/// The point between `from` and `to` that lies at `part`, 0 to 1, of the way.
pub(crate) fn between(number: Number, from: i64, to: i64, part: f32) -> i64 {
    if part >= 1.0 {
        to
    } else if number == Number::F32 {
        bits(float(from) * (1.0 - part) + float(to) * part)
    } else {
        from + ((to - from) as f32 * part) as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_and_written_in_their_type() {
        let cases: [(Number, &[u8], i64); 5] = [
            (Number::U8, &[0xFE], 254),
            (Number::I8, &[0xFE], -2),
            (Number::I16, &[0xFF, 0xFE], -2),
            (Number::U32, &[0xFF, 0, 0, 1], 0xFF00_0001),
            (Number::I32, &[0xFF, 0xFF, 0xFF, 0xFE], -2),
        ];
        for (number, bytes, value) in cases {
            assert_eq!(load(number, bytes), value);
            let mut written = [0; 4];
            store(value, &mut written[..bytes.len()]);
            assert_eq!(&written[..bytes.len()], bytes);
        }
    }

    #[test]
    fn totals_that_wrap_give_their_difference() {
        let given = hear(Number::I16, 0x7FF0, 0x7FF0, -0x7FF0);
        let (step, given) = give(Number::I16, -0x7FF0, given, Some(20.9));
        assert_eq!(step, 20);
        let (step, given) = give(Number::I16, -0x7FF0, given, None);
        assert_eq!((step, given), (12, -0x7FF0));
        assert_eq!(give(Number::I16, -0x7FF0, given, None).0, 0);
    }

    #[test]
    fn more_than_the_type_holds_is_held_at_its_end_and_not_turned_round() {
        let given = hear(Number::I8, 0, 0, 100);
        let given = hear(Number::I8, 100, given, -56);
        assert_eq!(give(Number::I8, -56, given, None).0, 127);
    }

    #[test]
    fn a_limit_holds_in_both_directions_and_ends_at_the_goal() {
        let goal = bits(-1.0);
        let now = approach(Number::F32, bits(0.0), goal, Some(0.75));
        assert_eq!(float(now), -0.75);
        assert_eq!(approach(Number::F32, now, goal, Some(0.75)), goal);
        assert_eq!(
            approach(Number::U8, 250, 5, Some(100.0)),
            150,
            "unsigned numbers do not wrap on their way"
        );
        let (step, given) = give(Number::F32, bits(2.0), bits(0.0), Some(0.5));
        assert_eq!((float(step), float(given)), (0.5, 0.5));
    }

    #[test]
    fn a_point_between_ends_exactly() {
        assert_eq!(
            between(Number::I32, 1, i64::from(i32::MAX), 1.0),
            i64::from(i32::MAX)
        );
        assert_eq!(between(Number::I32, -100, 100, 0.25), -50);
    }
}
