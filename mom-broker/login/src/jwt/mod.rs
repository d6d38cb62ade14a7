//! Tokens of an issuer whom the configuration trusts (JWT, RFC 7519; threat 14).

mod config;

use jsonwebtoken::errors::ErrorKind;
use jsonwebtoken::{Algorithm, AlgorithmFamily, DecodingKey, Validation, crypto, decode, decode_header};
use mom_proto::{Code, Time, WireError, check_name};
use serde::Deserialize;

pub use config::{JwtConfig, JwtUsers, KeyFile};

use crate::SettingError;

/// Least bytes of a shared secret and of an RSA modulus (RFC 7518, 3.2 and 3.3).
const SECRET: usize = 32;
const MODULUS: usize = 256;
/// Bytes of an Ed25519 key, the only curve that is accepted.
const ED25519: usize = 32;
/// Groups that a token may name.
const GROUPS: usize = 64;

const KNOWN: &str = "EdDSA, ES256, ES384, RS256, RS384, RS512, PS256, PS384, PS512, HS256, HS384 and HS512";

/// Checks tokens by one configuration.
#[derive(Debug)]
pub struct Verifier {
    pub(super) config: JwtConfig,
    key: DecodingKey,
    validation: Validation,
}

/// The claims of a token about its bearer.
#[derive(Debug, PartialEq)]
pub(super) struct Proven {
    pub(super) name: String,
    /// Level and groups, if they come from the claims and not from the users file.
    pub(super) claims: Option<(i32, Vec<String>)>,
    /// When the bearer must authenticate again.
    pub(super) until: Time,
}

#[derive(Deserialize)]
struct Claims {
    // Missing required claims are reported by name below.
    #[serde(default)]
    sub: Option<String>,
    #[serde(default)]
    exp: Option<Seconds>,
    #[serde(default)]
    nbf: Option<Seconds>,
    #[serde(default)]
    level: Option<i64>,
    #[serde(default)]
    groups: Option<Vec<String>>,
}

/// Seconds since the epoch, whole or not (RFC 7519, 2: NumericDate).
#[derive(Clone, Copy, Deserialize)]
#[serde(untagged)]
enum Seconds {
    Whole(i64),
    Parts(f64),
}

impl Seconds {
    fn micros(self) -> i64 {
        match self {
            Seconds::Whole(seconds) => seconds.saturating_mul(1_000_000),
            // Saturates; a value that is not a number counts as long ago.
            Seconds::Parts(seconds) => (seconds * 1e6) as i64,
        }
    }
}

impl Verifier {
    /// Makes one.
    ///
    /// # Errors
    /// What is wrong, at which key of the configuration.
    pub fn new(config: &JwtConfig) -> Result<Verifier, SettingError> {
        let wrong = |key: &'static str| move |text: String| SettingError::new(&[key], text);
        let algorithms = algorithms(&config.algorithms).map_err(wrong("algorithms"))?;
        for (key, text) in [("issuer", &config.issuer), ("audience", &config.audience)] {
            if text.is_empty() {
                return Err(wrong(key)(format!("{key} is empty; a token must name it")));
            }
        }
        let key = read_key(algorithms[0].family(), config.key.text()).map_err(wrong("key"))?;
        for algorithm in &algorithms {
            // Only checks that the key fits the algorithm and curve.
            crypto::verify("", b"", &key, *algorithm)
                .map_err(|_| wrong("key")(format!("this is not a key for {algorithm:?}")))?;
        }
        let mut validation = Validation::new(algorithms[0]);
        validation.algorithms = algorithms;
        validation.set_issuer(&[&config.issuer]);
        validation.set_audience(&[&config.audience]);
        validation.set_required_spec_claims(&["exp", "iss", "aud", "sub"]);
        // Times are checked here, by the broker's clock.
        validation.validate_exp = false;
        validation.validate_nbf = false;
        Ok(Verifier {
            config: config.clone(),
            key,
            validation,
        })
    }

    /// Who bears this token.
    ///
    /// # Errors
    /// `bad-login`; with the reason only if the issuer signed it.
    pub(super) fn verify(&self, token: &str, now: Time) -> Result<Proven, WireError> {
        let refused = |text: &str| WireError::new(Code::BAD_LOGIN, text);
        let untrusted = || refused("this is not a token of the issuer that this hub trusts");
        // Critical extensions (RFC 7515, 4.1.11) are not supported.
        let header = decode_header(token).map_err(|_| untrusted())?;
        if header.crit.is_some() {
            return Err(untrusted());
        }
        let claims: Claims = decode(token, &self.key, &self.validation)
            .map_err(|error| match error.kind() {
                ErrorKind::InvalidAudience => refused("the token is for another audience than this hub"),
                ErrorKind::InvalidIssuer => refused("the token is of another issuer"),
                ErrorKind::MissingRequiredClaim(claim) => {
                    refused(&format!("the token has no proper {claim}"))
                }
                _ => untrusted(),
            })?
            .claims;
        let leeway = i64::try_from(self.config.leeway).unwrap_or(i64::MAX);
        let leeway = leeway.saturating_mul(1000);
        let (Some(sub), Some(exp)) = (&claims.sub, claims.exp) else {
            return Err(untrusted());
        };
        let until = exp.micros().saturating_add(leeway);
        if now.micros() >= until {
            return Err(refused("the token has expired"));
        }
        if claims
            .nbf
            .is_some_and(|nbf| now.micros().saturating_add(leeway) < nbf.micros())
        {
            return Err(refused("the token is not valid yet"));
        }
        check_name(sub).map_err(|_| refused("the token's sub is not a name of a user"))?;
        let rights = match self.config.users {
            JwtUsers::File => None,
            JwtUsers::FromClaims => Some(
                self.rights(&claims)
                    .ok_or_else(|| refused("the token's groups are no names, or too many"))?,
            ),
        };
        Ok(Proven {
            name: sub.clone(),
            claims: rights,
            until: Time::from_micros(until).unwrap_or(Time::MAX),
        })
    }

    fn rights(&self, claims: &Claims) -> Option<(i32, Vec<String>)> {
        let level = claims
            .level
            .unwrap_or_default()
            .min(i64::from(self.config.max_level));
        let level = i32::try_from(level).unwrap_or(i32::MIN);
        let groups = claims.groups.clone().unwrap_or_default();
        let fine = groups.len() <= GROUPS && groups.iter().all(|group| check_name(group).is_ok());
        fine.then_some((level, groups))
    }
}

fn algorithms(words: &[String]) -> Result<Vec<Algorithm>, String> {
    let mut algorithms = Vec::new();
    for word in words {
        let algorithm = word.parse::<Algorithm>().map_err(|_| {
            if word.eq_ignore_ascii_case("none") {
                "none is not a signature: anybody could make such a token".to_owned()
            } else {
                format!("{word:?} is not an algorithm; known are {KNOWN}")
            }
        })?;
        algorithms.push(algorithm);
    }
    match algorithms.first() {
        None => Err(format!("at least one of {KNOWN}")),
        // A public key used as a shared secret would be a secret that everybody knows.
        Some(first) if algorithms.iter().any(|other| other.family() != first.family()) => {
            Err("these are algorithms for different kinds of key; there is one key".to_owned())
        }
        Some(_) => Ok(algorithms),
    }
}

fn read_key(family: AlgorithmFamily, text: &str) -> Result<DecodingKey, String> {
    let is_pem = text.contains("-----BEGIN");
    if family == AlgorithmFamily::Hmac {
        if is_pem {
            return Err(
                "this is a key in PEM, not a secret; a public key must not be used as one".to_owned(),
            );
        }
        if text.len() < SECRET {
            return Err(format!("a shared secret has at least {SECRET} bytes"));
        }
        return Ok(DecodingKey::from_secret(text.as_bytes()));
    }
    if text.contains("PRIVATE KEY-----") {
        return Err("this is a private key; the hub needs the issuer's public one only".to_owned());
    }
    if !text.contains("PUBLIC KEY-----") {
        return Err("a public key in PEM is wanted: -----BEGIN PUBLIC KEY-----".to_owned());
    }
    let (kind, key) = match family {
        AlgorithmFamily::Ed => ("Ed25519", DecodingKey::from_ed_pem(text.as_bytes())),
        AlgorithmFamily::Ec => ("ECDSA", DecodingKey::from_ec_pem(text.as_bytes())),
        _ => ("RSA", DecodingKey::from_rsa_pem(text.as_bytes())),
    };
    let key = key.map_err(|_| format!("this is not a public key of {kind}, which the algorithms require"))?;
    let bytes = key.try_get_as_bytes().unwrap_or_default();
    if family == AlgorithmFamily::Ed && bytes.len() != ED25519 {
        return Err("for EdDSA only keys of Ed25519 are accepted".to_owned());
    }
    if family == AlgorithmFamily::Rsa {
        let parts = (crypto::rust_crypto::DEFAULT_PROVIDER
            .key_utils
            .rsa_pub_components_from_public_key)(bytes);
        let (modulus, _) = parts.map_err(|_| "this is not a public key of RSA".to_owned())?;
        if modulus.len() < MODULUS {
            return Err(format!("a key of RSA has at least {} bits", MODULUS * 8));
        }
    }
    Ok(key)
}

#[cfg(test)]
mod tests;
