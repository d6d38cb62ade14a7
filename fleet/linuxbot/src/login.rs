//! Who may look at a robot's own page: anyone who knows its user and password (W21).

use std::fmt;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use http::HeaderMap;
use http::header::AUTHORIZATION;

/// A user and a password, as the first line of a file has them: `USER:PASSWORD`.
///
/// ```
/// use mom_linuxbot::Login;
///
/// assert!(Login::parse("alice:secret\n").is_ok());
/// assert_eq!(Login::parse("alice").unwrap_err(), "its first line must be USER:PASSWORD");
/// ```
#[derive(Clone, PartialEq, Eq)]
pub struct Login(Vec<u8>);

/// The password is told to nobody.
impl fmt::Debug for Login {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Login")
    }
}

impl Login {
    /// Reads the first line of a text.
    ///
    /// # Errors
    ///
    /// What is wrong with it, in words, and without the password.
    pub fn parse(text: &str) -> Result<Self, &'static str> {
        let line = text.lines().next().unwrap_or_default();
        match line.split_once(':') {
            Some((user, password)) if !user.is_empty() && !password.is_empty() => {
                Ok(Self(line.as_bytes().to_vec()))
            }
            _ => Err("its first line must be USER:PASSWORD"),
        }
    }

    /// Whether a request has this user and password (Basic). It takes as long wherever they differ.
    #[must_use]
    pub fn admits(&self, headers: &HeaderMap) -> bool {
        let said = headers.get(AUTHORIZATION).and_then(|value| value.to_str().ok());
        let said = said.and_then(|value| value.split_once(' '));
        let Some((_, said)) = said.filter(|(scheme, _)| scheme.eq_ignore_ascii_case("basic")) else {
            return false;
        };
        let said = STANDARD.decode(said.trim()).unwrap_or_default();
        let differs = said
            .iter()
            .zip(&self.0)
            .fold(0, |differs, (said, own)| differs | (said ^ own));
        differs == 0 && said.len() == self.0.len()
    }
}
