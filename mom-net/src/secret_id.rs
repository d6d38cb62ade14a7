//! An identifier that only its owner knows: knowing it is the proof of ownership.

use std::fmt;
use std::str::FromStr;

/// 128 random bits, 32 hexadecimal digits as text.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct SecretId(u128);

impl SecretId {
    /// A new one; none where the system has no randomness.
    pub fn random() -> Option<SecretId> {
        let mut bits = [0; 16];
        getrandom::fill(&mut bits).ok()?;
        Some(SecretId(u128::from_be_bytes(bits)))
    }
}

impl fmt::Display for SecretId {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{:032x}", self.0)
    }
}

/// Logs must not hold it.
impl fmt::Debug for SecretId {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("SecretId(…)")
    }
}

impl FromStr for SecretId {
    /// What is wrong with it is nobody's business.
    type Err = ();

    fn from_str(text: &str) -> Result<SecretId, ()> {
        let digits = text.len() == 32
            && text
                .bytes()
                .all(|digit| matches!(digit, b'0'..=b'9' | b'a'..=b'f'));
        let number = digits.then(|| u128::from_str_radix(text, 16).ok()).flatten();
        number.map(SecretId).ok_or(())
    }
}
