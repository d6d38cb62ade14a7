//! Passwords and their hashes.

use argon2::password_hash::PasswordHasher;
use argon2::password_hash::phc::{Output, PasswordHash};
use argon2::{Algorithm, Argon2, Block, Params, Version};
use mom_proto::{Code, WireError};
use sha2::{Digest as _, Sha256};

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

/// The costliest hash that a login is checked against: KiB of memory times passes, some 0.3 s of a core; and its lanes. Anyone can ask for
/// a login, so what one costs is bounded here, whoever wrote the users file.
const MOST_WORK: u64 = 256 * 1024;
const MOST_LANES: u32 = 16;

/// What is wrong with text as a hash that logins can be checked against, if anything.
pub(crate) fn fault(text: &str) -> Option<String> {
    let hash = PasswordHash::new(text)
        .ok()
        .filter(|hash| hash.algorithm.as_str() == "argon2id");
    let Some(hash) = hash else {
        return Some("no argon2id hash".to_owned());
    };
    let Ok(params) = Params::try_from(&hash.params) else {
        return Some("an argon2id hash with costs that argon2 does not have (m, t and p)".to_owned());
    };
    let is_known = hash
        .version
        .is_none_or(|version| Version::try_from(version).is_ok());
    if hash.salt.is_none() || hash.hash.is_none() || !is_known {
        return Some(
            "an argon2id hash that is not whole: version 16 or 19, costs, salt and output".to_owned(),
        );
    }
    let work = u64::from(params.m_cost()) * u64::from(params.t_cost());
    (work > MOST_WORK || params.p_cost() > MOST_LANES).then(|| {
        format!(
            "too costly: each login would take m={} KiB times t={} passes in p={} lanes; m times t is at most {MOST_WORK}, p at most {MOST_LANES}",
            params.m_cost(),
            params.t_cost(),
            params.p_cost(),
        )
    })
}

/// What the passwords of unknown users are checked against, so that the time does not reveal which users exist.
#[derive(Debug)]
pub(super) struct Decoys {
    /// Where the file has hashes of several costs, an unknown name has those of a user whom this chooses by the name: it costs the same
    /// each time, and as often as a known name's as much. It is as secret as the hashes.
    secret: [u8; 32],
    /// One for each user with a password.
    hashes: Vec<String>,
}

impl Decoys {
    /// For a file with these hashes.
    pub(super) fn new<'a>(hashes: impl Iterator<Item = &'a str>) -> Decoys {
        let mut secret = Sha256::new();
        let decoys = hashes.map(|hash| -> Option<String> {
            secret.update(hash);
            let params = Params::try_from(&PasswordHash::new(hash).ok()?.params).ok()?;
            Some(decoy(&params))
        });
        let mut hashes: Vec<String> = decoys.flatten().collect();
        if hashes.is_empty() {
            hashes.push(decoy(&Params::DEFAULT));
        }
        Decoys {
            secret: secret.finalize().into(),
            hashes,
        }
    }

    /// The hash that this unknown user seems to have.
    pub(super) fn of(&self, name: &str) -> &str {
        let chosen = Sha256::new_with_prefix(self.secret).chain_update(name).finalize();
        let chosen = chosen
            .iter()
            .take(8)
            .fold(0_u64, |sum, byte| sum << 8 | u64::from(*byte));
        let chosen = chosen % self.hashes.len() as u64;
        usize::try_from(chosen).map_or("", |chosen| &self.hashes[chosen])
    }
}

/// A hash that no password has and that costs this much to check.
fn decoy(params: &Params) -> String {
    // Base64 of 16 and of 32 bytes, all zero: who finds a password with this output has still no user.
    let (salt, output) = ("A".repeat(22), "A".repeat(43));
    let (memory, passes, lanes) = (params.m_cost(), params.t_cost(), params.p_cost());
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

    const CHEAP: &str =
        "$argon2id$v=19$m=256,t=1,p=1$c29tZXNhbHQ$CTFhFdXPJO1aFaMaO6Mm5c8y7cJHAph8ArZWb2GRPPc";

    /// Threat 15: where hashes differ in their costs, the costs of unknown names differ alike.
    #[test]
    fn unknown_users_cost_what_known_ones_do() {
        let costly = CHEAP.replace("m=256,t=1", "m=1024,t=3");
        let mut memory = Vec::new();
        for (hashes, costs) in [
            (
                vec![CHEAP, CHEAP, "damaged", &costly],
                vec!["$m=256,t=1,p=1$", "$m=1024,t=3,p=1$"],
            ),
            (vec![CHEAP], vec!["$m=256,t=1,p=1$"]),
            (vec![], vec!["$m=19456,t=2,p=1$"]),
        ] {
            let decoys = Decoys::new(hashes.into_iter());
            // It is hashed to the end, not refused for its form, which would take no time.
            assert_eq!(try_match("secret", decoys.of("zoe"), &mut memory), Some(false));
            let mut counts = vec![0; costs.len()];
            for number in 0..300 {
                let name = format!("user-{number}");
                assert_eq!(decoys.of(&name), decoys.of(&name));
                let kind = costs.iter().position(|costs| decoys.of(&name).contains(costs));
                counts[kind.expect("one of the costs")] += 1;
            }
            // Two of three users have the cheap one.
            let expected = 300 * (4 - costs.len()) / 3;
            assert!((expected - 40..=expected + 40).contains(&counts[0]), "{counts:?}");
        }
        let other = Decoys::new([CHEAP, &costly.replace('c', "d")].into_iter());
        let these = Decoys::new([CHEAP, costly.as_str()].into_iter());
        let differ = (0..100).filter(|number| {
            let name = number.to_string();
            these.of(&name) != other.of(&name)
        });
        assert!(
            differ.count() > 20,
            "who knows the users does not know the choice"
        );
    }

    /// Threat 16: what a login costs is bounded, whatever is in the file.
    #[test]
    fn hashes_that_nobody_can_log_in_with_or_that_cost_too_much_are_refused() {
        let with = |costs: &str| CHEAP.replace("m=256,t=1,p=1", costs);
        for costs in [
            "m=256,t=1,p=1",
            "m=19456,t=2,p=1",
            "m=65536,t=4,p=4",
            "m=262144,t=1,p=16",
        ] {
            assert_eq!(fault(&with(costs)), None, "{costs}");
        }
        for (hash, words) in [
            (with("m=262145,t=1,p=1"), "too costly"),
            (with("m=2097152,t=1,p=4"), "m=2097152 KiB times t=1 passes"),
            (with("m=65536,t=4294967295,p=1"), "too costly"),
            (with("m=4294967295,t=4294967295,p=1"), "too costly"),
            (with("m=1024,t=1,p=17"), "p at most 16"),
            (with("m=256,t=1,p=0"), "costs that argon2 does not have"),
            (with("m=256,t=0,p=1"), "costs that argon2 does not have"),
            (with("m=7,t=1,p=1"), "costs that argon2 does not have"),
            (with("m=32,t=1,p=5"), "costs that argon2 does not have"),
            (CHEAP.replace("v=19", "v=18"), "not whole"),
            (
                CHEAP.rsplit_once('$').expect("an output").0.to_owned(),
                "not whole",
            ),
            (CHEAP.replace("argon2id", "argon2i"), "no argon2id hash"),
            (String::new(), "no argon2id hash"),
        ] {
            let said = fault(&hash).unwrap_or_default();
            assert!(said.contains(words), "{hash}: {said}");
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
