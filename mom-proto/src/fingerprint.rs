//! What a certificate is known by.

use std::fmt;
use std::str::FromStr;

/// The SHA-256 of a certificate, written `sha256:` and 64 hexadecimal digits. With colons between the bytes, as
/// `openssl x509 -fingerprint -sha256` prints it, it is read as well.
///
/// ```
/// use mom_proto::Fingerprint;
/// let text = format!("sha256:{}", "0a".repeat(32));
/// assert_eq!(text.parse::<Fingerprint>().unwrap().to_string(), text);
/// let as_openssl = vec!["0A"; 32].join(":");
/// assert_eq!(as_openssl.parse::<Fingerprint>().unwrap().to_string(), text);
/// assert!("sha256:0a".parse::<Fingerprint>().is_err());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Fingerprint([u8; 32]);

/// Text that is not a fingerprint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a fingerprint must be sha256: and 64 hexadecimal digits; colons between them are allowed")]
pub struct BadFingerprint;

impl Fingerprint {
    /// Of these bytes.
    pub fn new(bytes: [u8; 32]) -> Fingerprint {
        Fingerprint(bytes)
    }
}

impl fmt::Display for Fingerprint {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("sha256:")?;
        self.0.iter().try_for_each(|byte| write!(formatter, "{byte:02x}"))
    }
}

impl FromStr for Fingerprint {
    type Err = BadFingerprint;

    fn from_str(text: &str) -> Result<Fingerprint, BadFingerprint> {
        let digits = text.strip_prefix("sha256:").unwrap_or(text);
        let mut bytes = [0; 32];
        let mut digits = digits.bytes().filter(|digit| *digit != b':');
        let mut digit = || {
            let digit = digits.next().and_then(|digit| char::from(digit).to_digit(16));
            digit.and_then(|digit| u8::try_from(digit).ok())
        };
        for byte in &mut bytes {
            *byte = digit()
                .zip(digit())
                .map(|(high, low)| high * 16 + low)
                .ok_or(BadFingerprint)?;
        }
        match digits.next() {
            None => Ok(Fingerprint(bytes)),
            Some(_) => Err(BadFingerprint),
        }
    }
}
