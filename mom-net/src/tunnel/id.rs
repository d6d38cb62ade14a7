//! What a tunnel is known by: whoever knows it speaks through it.

use std::fmt;
use std::str::FromStr;

/// 128 random bits.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Id(u128);

impl Id {
    /// A new one; none where the system has no randomness.
    pub(super) fn random() -> Option<Id> {
        let mut bits = [0; 16];
        getrandom::fill(&mut bits).ok()?;
        Some(Id(u128::from_be_bytes(bits)))
    }
}

impl fmt::Display for Id {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{:032x}", self.0)
    }
}

/// Logs must not hold it.
impl fmt::Debug for Id {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Id(…)")
    }
}

impl FromStr for Id {
    type Err = ();

    fn from_str(text: &str) -> Result<Id, ()> {
        let digits = text.len() == 32
            && text
                .bytes()
                .all(|digit| matches!(digit, b'0'..=b'9' | b'a'..=b'f'));
        let number = digits.then(|| u128::from_str_radix(text, 16).ok()).flatten();
        number.map(Id).ok_or(())
    }
}
