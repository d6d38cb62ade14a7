//! Which issuer is trusted: the table `[login.jwt]`.

use std::fmt;

use serde::{Deserialize, Deserializer};

/// The issuer of accepted tokens (JWT, RFC 7519).
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct JwtConfig {
    /// The one issuer, as the claim `iss` has it.
    pub issuer: String,
    /// This hub, as the claim `aud` has it.
    pub audience: String,
    /// The accepted algorithms, such as `EdDSA`; all use the same key.
    pub algorithms: Vec<String>,
    /// The issuer's public key, or the secret shared with it.
    pub key: KeyFile,
    /// How far the issuer's clock may be off, in ms.
    #[serde(default)]
    pub leeway: u64,
    /// The source of the user's level and groups.
    #[serde(default)]
    pub users: JwtUsers,
    /// The highest level that a claim gives.
    #[serde(default)]
    pub max_level: i32,
}

/// The source of level and groups for logins with a token.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum JwtUsers {
    /// From the users file; the claim `sub` names the user there.
    #[default]
    File,
    /// From the claims `level` and `groups`; `sub` need not be in a file.
    FromClaims,
}

/// The key against which tokens are checked; in a configuration file the name of its file.
#[derive(Clone, PartialEq, Eq, Default)]
pub struct KeyFile {
    file: String,
    text: String,
}

impl KeyFile {
    /// A public key as PEM, or a shared secret.
    pub fn from_text(text: impl Into<String>) -> KeyFile {
        KeyFile {
            file: String::new(),
            text: text.into(),
        }
    }

    /// The text, without the line end that editors put after a secret.
    pub fn text(&self) -> &str {
        self.text.trim_end_matches(['\r', '\n'])
    }

    /// Reads the file that the configuration names.
    ///
    /// # Errors
    /// As `read`, which gives a file's text.
    pub fn read<E>(&mut self, read: impl FnOnce(&str) -> Result<String, E>) -> Result<(), E> {
        self.text = read(&self.file)?;
        Ok(())
    }
}

impl fmt::Debug for KeyFile {
    // It may be a secret.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "KeyFile({:?})", self.file)
    }
}

impl<'de> Deserialize<'de> for KeyFile {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<KeyFile, D::Error> {
        let file = String::deserialize(deserializer)?;
        Ok(KeyFile {
            file,
            text: String::new(),
        })
    }
}
