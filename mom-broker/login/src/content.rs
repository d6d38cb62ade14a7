//! The content of a login. Its errors quote nothing, because it may be a secret in the wrong field.

use mom_proto::nearest::nearest;
use mom_proto::{
    Code, Compression, Map, Parcel, ReadCount, SECRET_BYTES, Value, ValueKind, WireError, check_name,
};

/// A login request.
#[derive(Debug)]
pub(super) struct LoginRequest {
    pub(super) proof: ClaimedProof,
    /// The requested nickname.
    pub(super) nickname: Option<String>,
    pub(super) wishes: Wishes,
}

/// The proof that it claims to have.
pub(super) enum ClaimedProof {
    Password { name: String, password: String },
    Key { name: String },
    Certificate { name: String },
    Token(String),
    Guest,
}

impl std::fmt::Debug for ClaimedProof {
    // Without the secrets.
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(match self {
            ClaimedProof::Password { .. } => "Password",
            ClaimedProof::Key { .. } => "Key",
            ClaimedProof::Certificate { .. } => "Certificate",
            ClaimedProof::Token(_) => "Token",
            ClaimedProof::Guest => "Guest",
        })
    }
}

/// What a login asks for beside the proof of who it is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Wishes {
    /// That its connection may be lost and come back.
    pub link: Option<LinkWish>,
    /// How often both sides say that they are there, ms.
    pub heartbeat: Option<u64>,
    /// How its connection may be compressed, what it would rather have first.
    pub compress: Vec<Compression>,
}

/// A link that is asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkWish {
    /// For how long the peer may be away, ms.
    pub grace: Option<u64>,
}

/// The answer to it.
#[derive(Clone)]
pub struct ResumeAnswer {
    pub(crate) proof: Vec<u8>,
    /// What the peer has read of the hub.
    pub read: ReadCount,
}

impl std::fmt::Debug for ResumeAnswer {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("ResumeAnswer")
            .field("read", &self.read)
            .finish_non_exhaustive()
    }
}

const KEYS: [&str; 10] = [
    "name",
    "password",
    "key",
    "certificate",
    "token",
    "guest",
    "nickname",
    "link",
    "heartbeat",
    "compress",
];

/// The shortest time between signs of life that a peer may ask for, ms.
const SHORTEST_BEAT: u64 = 100;

impl LoginRequest {
    /// Reads the content of `login login`.
    pub(super) fn read(parcel: &Parcel) -> Result<LoginRequest, WireError> {
        let mut map = map_of(
            parcel,
            "a login needs content {name, password}, {name, key}, {name, certificate}, {token} or {guest}",
        )?;
        let name = take_text(&mut map, "name")?;
        let password = take_text(&mut map, "password")?;
        let key = take_true(&mut map, "key")?;
        let certificate = take_true(&mut map, "certificate")?;
        let token = take_text(&mut map, "token")?;
        let guest = take_true(&mut map, "guest")?;
        let nickname = take_text(&mut map, "nickname")?;
        let wishes = Wishes {
            link: take_link(&mut map)?,
            heartbeat: take_count(&mut map, "heartbeat")?,
            compress: take_ways(&mut map)?,
        };
        check_rest(&map, &KEYS)?;
        if wishes.heartbeat.is_some_and(|beat| beat < SHORTEST_BEAT) {
            let text = format!("it is in ms, and {SHORTEST_BEAT} at least");
            return Err(wrong("heartbeat", &text));
        }
        if let Some(nickname) = &nickname {
            check_name(nickname).map_err(|error| error.slot("content/nickname"))?;
        }
        let proofs = [password.is_some(), key, certificate, token.is_some(), guest];
        if proofs.iter().filter(|claimed| **claimed).count() > 1 {
            let text = "content: one of password, key, certificate, token and guest, not several";
            return Err(WireError::new(Code::BAD_CONTENT, text).slot("content"));
        }
        let proof = match (name, password, token) {
            (Some(name), Some(password), None) => ClaimedProof::Password { name, password },
            (Some(name), None, None) if key => ClaimedProof::Key { name },
            (Some(name), None, None) if certificate => ClaimedProof::Certificate { name },
            (None, None, Some(token)) => ClaimedProof::Token(token),
            (None, None, None) if guest => ClaimedProof::Guest,
            (Some(_), None, None) if !guest => {
                let text = "it is missing; to log in with a key or a certificate, send key = true or certificate = true instead";
                return Err(wrong("password", text));
            }
            (Some(_), ..) => return Err(wrong("name", "a token or a guest names no user")),
            (None, ..) => return Err(wrong("name", "it is missing")),
        };
        Ok(LoginRequest {
            proof,
            nickname,
            wishes,
        })
    }
}

/// Reads the content of `login answer`.
pub(super) fn read_signature(parcel: &Parcel) -> Result<[u8; 64], WireError> {
    let mut map = map_of(parcel, "an answer needs content {signature}")?;
    let signature = take(&mut map, "signature");
    check_rest(&map, &["signature"])?;
    let signature = signature.ok_or_else(|| wrong("signature", "it is missing"))?;
    signature
        .as_binary()
        .and_then(|bytes| <[u8; 64]>::try_from(&bytes[..]).ok())
        .ok_or_else(|| wrong("signature", "64 bytes, binary, are wanted"))
}

/// Reads the content of `login resume`: the id of a link, of so many bytes at most.
pub(super) fn read_link(parcel: &Parcel, longest: usize) -> Result<String, WireError> {
    let mut map = map_of(parcel, "a resume needs content {link}")?;
    let link = take_text(&mut map, "link")?;
    check_rest(&map, &["link"])?;
    let link = link.ok_or_else(|| wrong("link", "it is missing"))?;
    match link.len() <= longest {
        true => Ok(link),
        false => Err(wrong("link", "that is not an id of a link")),
    }
}

/// Reads the content of the answer to a resume's challenge.
pub(super) fn read_proof(parcel: &Parcel) -> Result<ResumeAnswer, WireError> {
    let mut map = map_of(parcel, "an answer to a resume needs content {proof, read}")?;
    let proof = take(&mut map, "proof");
    let read = take_count(&mut map, "read")?;
    let checksum = take_count(&mut map, "checksum")?;
    check_rest(&map, &["proof", "read", "checksum"])?;
    let proof = proof.ok_or_else(|| wrong("proof", "it is missing"))?;
    let proof = proof
        .as_binary()
        .filter(|proof| proof.len() == SECRET_BYTES)
        .ok_or_else(|| wrong("proof", "32 bytes, binary, are wanted"))?;
    Ok(ResumeAnswer {
        proof: proof.to_vec(),
        read: ReadCount {
            parcels: read.ok_or_else(|| wrong("read", "it is missing"))?,
            checksum: checksum
                .map(|checksum| u32::try_from(checksum).map_err(|_| wrong("checksum", "it has 32 bits")))
                .transpose()?,
        },
    })
}

fn map_of(parcel: &Parcel, wanted: &str) -> Result<Map, WireError> {
    let missing = || WireError::new(Code::BAD_CONTENT, wanted).slot("content");
    match parcel.content.as_ref().ok_or_else(missing)?.to_value()? {
        Value::Map(map) => Ok(map),
        Value::Null => Err(missing()),
        other => {
            let text = format!("content: {} stands where a map is wanted", other.kind().word());
            Err(WireError::new(Code::BAD_CONTENT, text).slot("content"))
        }
    }
}

/// A member; null counts as absent.
fn take(map: &mut Map, key: &str) -> Option<Value> {
    map.remove(key).filter(|value| value.kind() != ValueKind::Null)
}

fn take_text(map: &mut Map, key: &str) -> Result<Option<String>, WireError> {
    match take(map, key) {
        None => Ok(None),
        Some(Value::String(text)) => Ok(Some(text)),
        Some(other) => Err(wrong_kind(key, &other, "a string")),
    }
}

fn take_count(map: &mut Map, key: &str) -> Result<Option<u64>, WireError> {
    match take(map, key) {
        None => Ok(None),
        Some(Value::Int(count)) => u64::try_from(count)
            .map(Some)
            .map_err(|_| wrong(key, "it is not negative")),
        Some(other) => Err(wrong_kind(key, &other, "an int")),
    }
}

fn take_link(map: &mut Map) -> Result<Option<LinkWish>, WireError> {
    match take(map, "link") {
        None | Some(Value::Bool(false)) => Ok(None),
        Some(Value::Bool(true)) => Ok(Some(LinkWish::default())),
        Some(Value::Map(mut link)) => {
            let grace = take_count(&mut link, "grace")?;
            check_rest(&link, &["grace"])?;
            Ok(Some(LinkWish { grace }))
        }
        Some(other) => Err(wrong_kind("link", &other, "a boolean or a map")),
    }
}

/// Ways that are not known are as if they were not there.
fn take_ways(map: &mut Map) -> Result<Vec<Compression>, WireError> {
    let ways = match take(map, "compress") {
        None => return Ok(Vec::new()),
        Some(Value::List(ways)) => ways,
        Some(other) => return Err(wrong_kind("compress", &other, "a list of strings")),
    };
    let words: Option<Vec<&str>> = ways.iter().map(Value::as_str).collect();
    match words {
        Some(words) => {
            let mut known: Vec<Compression> = words.into_iter().filter_map(Compression::of).collect();
            known.truncate(Compression::ALL.len());
            Ok(known)
        }
        None => Err(wrong_kind("compress", &Value::List(ways), "a list of strings")),
    }
}

fn take_true(map: &mut Map, key: &str) -> Result<bool, WireError> {
    match take(map, key) {
        None => Ok(false),
        Some(Value::Bool(flag)) => Ok(flag),
        Some(other) => Err(wrong_kind(key, &other, "a boolean")),
    }
}

fn check_rest(map: &Map, known: &[&str]) -> Result<(), WireError> {
    let Some(key) = map.keys().next() else {
        return Ok(());
    };
    let error = wrong(key, &format!("it is not known; known are {}", known.join(", ")));
    Err(error.nearest_opt(nearest(key, known.iter().copied())))
}

fn wrong_kind(key: &str, given: &Value, wanted: &str) -> WireError {
    wrong(
        key,
        &format!("{} stands where {wanted} is wanted", given.kind().word()),
    )
}

fn wrong(key: &str, text: &str) -> WireError {
    // Keys come from outside, so errors quote only a readable part of them.
    let key: String = key.chars().take(64).collect();
    let slot = format!("content/{key}");
    WireError::new(Code::BAD_CONTENT, format!("{slot}: {text}")).slot(&slot)
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_proto::Family;

    fn read(map: Map) -> Result<LoginRequest, WireError> {
        LoginRequest::read(&Parcel::new(Family::Login, "login").content(map))
    }

    #[test]
    fn what_is_no_login_is_refused_at_its_place() {
        let name = || Map::new().with("name", "alice");
        for (map, slot) in [
            (Map::new(), "content/name"),
            (name(), "content/password"),
            (name().with("key", false), "content/password"),
            (Map::new().with("password", "hunter2"), "content/name"),
            (Map::new().with("key", true), "content/name"),
            (name().with("password", 42_424_242), "content/password"),
            (name().with("key", "hunter2"), "content/key"),
            (name().with("token", "hunter2"), "content/name"),
            (name().with("guest", true), "content/name"),
            (name().with("password", "hunter2").with("key", true), "content"),
            (Map::new().with("token", "hunter2").with("guest", true), "content"),
            (
                name().with("password", "hunter2").with("nick", "x"),
                "content/nick",
            ),
            (
                name().with("password", "hunter2").with("nickname", "hub"),
                "content/nickname",
            ),
        ] {
            let error = read(map.clone()).expect_err("no login");
            assert_eq!(
                error.get("slot").and_then(Value::as_str),
                Some(slot),
                "{map:?}: {error}"
            );
            let told = error.to_string();
            assert!(!told.contains("hunter2") && !told.contains("4242"), "{told}");
        }
        let password =
            read(name().with("password", "hunter2").with("nickname", Value::Null)).expect("a login");
        assert!(!format!("{password:?}").contains("hunter2"));
    }

    #[test]
    fn a_signature_is_64_bytes() {
        let answer = |value: Value| {
            let content = Map::new().with("signature", value);
            read_signature(&Parcel::new(Family::Login, "answer").content(content))
        };
        assert_eq!(answer(Value::Binary(vec![7; 64].into())), Ok([7; 64]));
        for value in [Value::Binary(vec![7; 63].into()), Value::from("7"), Value::Null] {
            let error = answer(value).expect_err("no signature");
            assert_eq!(error.code, Code::BAD_CONTENT);
        }
    }
}
