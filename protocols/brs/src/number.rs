//! Numbers as `%05d` writes them: five characters, the sign among them (W5).

/// The lowest number that five characters hold.
pub const LOWEST: i32 = -9_999;
/// The highest number that five characters hold.
pub const HIGHEST: i32 = 99_999;

/// Bytes of a code.
pub(crate) const CODE: usize = 2;
/// Bytes of a parameter with the space before it.
pub(crate) const GROUP: usize = 6;

/// A parameter as it is written: a space and a number, cut to what five characters hold.
pub(crate) fn group(value: i32) -> [u8; GROUP] {
    let value = value.clamp(LOWEST, HIGHEST);
    let mut bytes = *b" 00000";
    let mut rest = value.unsigned_abs();
    for byte in bytes.iter_mut().rev() {
        if rest == 0 {
            break;
        }
        *byte = digit(rest % 10);
        rest /= 10;
    }
    if let (true, [_, sign, ..]) = (value < 0, &mut bytes) {
        *sign = b'-';
    }
    bytes
}

/// The last digit of a number, as a character.
pub(crate) fn digit(number: u32) -> u8 {
    b'0' + (number % 10) as u8
}

/// Whether the bytes, no more than six, are a parameter with the space before it, or may become one.
pub(crate) fn begins_group(bytes: &[u8]) -> bool {
    match bytes {
        [] | [b' '] => true,
        [b' ', first, rest @ ..] => {
            (first.is_ascii_digit() || *first == b'-') && rest.iter().all(u8::is_ascii_digit)
        }
        _ => false,
    }
}

/// The number of a whole parameter, of which `begins_group` is true. `-0000` is 0.
pub(crate) fn value(group: &[u8; GROUP]) -> i32 {
    let [_space, first, ..] = group;
    let number = group
        .iter()
        .filter(|byte| byte.is_ascii_digit())
        .fold(0, |number, byte| number * 10 + i32::from(byte - b'0'));
    if *first == b'-' { -number } else { number }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_five_characters_with_the_sign_among_them() {
        for (number, text) in [
            (0, " 00000"),
            (7, " 00007"),
            (-7, " -0007"),
            (-50, " -0050"),
            (LOWEST, " -9999"),
            (HIGHEST, " 99999"),
            (i32::MIN, " -9999"),
            (i32::MAX, " 99999"),
        ] {
            assert_eq!(group(number), text.as_bytes(), "{number}");
        }
    }

    #[test]
    fn every_number_is_read_as_it_was_written() {
        for number in LOWEST..=HIGHEST {
            let written = group(number);
            assert!(begins_group(&written), "{number}");
            assert_eq!(value(&written), number);
        }
    }

    #[test]
    fn a_beginning_of_a_parameter_is_known_at_each_byte() {
        for good in ["", " ", " -", " -0", " 1", " 12345", " -0000"] {
            assert!(begins_group(good.as_bytes()), "{good:?}");
        }
        for bad in ["1", "-", "  ", " +", " 1-", " --", " 1 ", " 1x", "\u{2013}"] {
            assert!(!begins_group(bad.as_bytes()), "{bad:?}");
        }
        assert_eq!(value(b" -0000"), 0);
    }
}
