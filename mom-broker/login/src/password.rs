//! Passwords and their hashes.

use argon2::password_hash::PasswordHasher;
use argon2::password_hash::phc::{Output, PasswordHash};
use argon2::{Algorithm, Argon2, Block, Params, Version};
use mom_proto::{Code, WireError};

use crate::LoginLink;

/// The argon2id hash of a password with a new salt, for the users file.
///
/// # Errors
/// The message of the hash function: no randomness, or a password that it does not accept.
pub fn hash(password: &str) -> Result<String, String> {
    Argon2::default()
        .hash_password(password.as_bytes())
        .map(|hash| hash.to_string())
        .map_err(|error| error.to_string())
}

/// Whether text is a hash that logins can be checked against.
pub(crate) fn is_hash(text: &str) -> bool {
    PasswordHash::new(text).is_ok_and(|hash| hash.algorithm.as_str() == "argon2id")
}

/// A hash that no password has and that costs as much to check as the costliest of these; as much as a new one if there are none.
pub(super) fn decoy<'a>(hashes: impl Iterator<Item = &'a str>) -> String {
    let costs = hashes
        .filter_map(|hash| Params::try_from(&PasswordHash::new(hash).ok()?.params).ok())
        .max_by_key(|params| u64::from(params.m_cost()) * u64::from(params.t_cost()));
    let (memory, passes, lanes) = costs.map_or(
        (
            Params::DEFAULT_M_COST,
            Params::DEFAULT_T_COST,
            Params::DEFAULT_P_COST,
        ),
        |params| (params.m_cost(), params.t_cost(), params.p_cost()),
    );
    // Base64 of 16 and of 32 bytes, all zero: who finds a password with this output has still no user.
    let (salt, output) = ("A".repeat(22), "A".repeat(43));
    format!("$argon2id$v=19$m={memory},t={passes},p={lanes}${salt}${output}")
}

/// Refuses a secret that others could have read on its way.
pub(super) fn check_private(link: &LoginLink, what: &str) -> Result<(), WireError> {
    if link.is_private() {
        return Ok(());
    }
    let text = format!(
        "a {what} is taken only over TLS or loopback: others could read it on the way; connect to bins:// or tcps://, or log in with a key"
    );
    Err(WireError::new(Code::INSECURE, text))
}

/// Whether a password belongs to a hash. The memory is the caller's, to be used again.
pub(super) fn matches(password: &str, hash: &str, memory: &mut Vec<Block>) -> bool {
    try_match(password, hash, memory).unwrap_or(false)
}

fn try_match(password: &str, hash: &str, memory: &mut Vec<Block>) -> Option<bool> {
    let hash = PasswordHash::new(hash).ok()?;
    let (salt, expected) = (hash.salt.as_ref()?, hash.hash.as_ref()?);
    let algorithm = Algorithm::try_from(hash.algorithm.as_str()).ok()?;
    let version = match hash.version {
        Some(version) => Version::try_from(version).ok()?,
        None => Version::default(),
    };
    let params = Params::try_from(&hash.params).ok()?;
    let blocks = params.block_count();
    if memory.len() < blocks {
        memory.resize(blocks, Block::default());
    }
    let mut output = [0; Output::MAX_LENGTH];
    let output = output.get_mut(..expected.len())?;
    let argon2 = Argon2::new(algorithm, version, params);
    argon2
        .hash_password_into_with_memory(password.as_bytes(), salt.as_ref(), output, &mut memory[..blocks])
        .ok()?;
    // It compares in constant time.
    Some(Output::new(output).ok()? == *expected)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_are_taken_over_tls_and_loopback_only() {
        for (from, taken) in [
            (None, true),
            (Some("127.0.0.1"), true),
            (Some("127.9.8.7"), true),
            (Some("::1"), true),
            (Some("::ffff:127.0.0.1"), true),
            (Some("192.0.2.1"), false),
            (Some("::ffff:192.0.2.1"), false),
            (Some("2001:db8::1"), false),
            (Some("0.0.0.0"), false),
        ] {
            let from = from.map(|from| from.parse().expect("an address"));
            let link = LoginLink {
                from,
                ..LoginLink::default()
            };
            let private = LoginLink {
                private: true,
                ..link
            };
            assert!(check_private(&private, "password").is_ok(), "{from:?}");
            let relayed = LoginLink {
                relayed: true,
                ..link
            };
            assert_eq!(
                check_private(&relayed, "password").is_ok(),
                from.is_none(),
                "{from:?}"
            );
            match check_private(&link, "password") {
                Ok(()) => assert!(taken, "{from:?}"),
                Err(error) => assert!(!taken && error.code == Code::INSECURE, "{from:?}"),
            }
        }
    }

    #[test]
    fn an_unknown_user_costs_as_much_as_the_costliest() {
        let cheap = "$argon2id$v=19$m=256,t=1,p=1$c29tZXNhbHQ$CTFhFdXPJO1aFaMaO6Mm5c8y7cJHAph8ArZWb2GRPPc";
        let costly = "$argon2id$v=19$m=1024,t=3,p=1$c29tZXNhbHQ$CTFhFdXPJO1aFaMaO6Mm5c8y7cJHAph8ArZWb2GRPPc";
        let mut memory = Vec::new();
        for (hashes, costs) in [
            (vec![cheap, costly, "damaged"], "$m=1024,t=3,p=1$"),
            (vec![cheap], "$m=256,t=1,p=1$"),
            (vec![], "$m=19456,t=2,p=1$"),
        ] {
            let decoy = decoy(hashes.into_iter());
            assert!(is_hash(&decoy) && decoy.contains(costs), "{decoy}");
            // It is hashed to the end, not refused for its form, which would take no time.
            assert_eq!(try_match("secret", &decoy, &mut memory), Some(false), "{decoy}");
        }
    }

    #[test]
    fn a_hash_knows_its_password() {
        let hash = hash("secret").expect("a hash");
        let mut memory = Vec::new();
        let mut matches = |password, hash: &str| matches(password, hash, &mut memory);
        assert!(matches("secret", &hash) && !matches("Secret", &hash) && !matches("", &hash));
        assert!(!matches("", "") && !matches("secret", "secret"));
        assert!(
            matches("secret", &hash),
            "whatever the memory was used for before"
        );
        // A vector of the reference implementation, with other costs.
        let other = "$argon2id$v=19$m=65536,t=2,p=1$c29tZXNhbHQ$CTFhFdXPJO1aFaMaO6Mm5c8y7cJHAph8ArZWb2GRPPc";
        assert!(matches("password", other) && !matches("passwort", other) && matches("secret", &hash));
    }
}
