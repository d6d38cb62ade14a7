//! Keys, and an issuer of tokens, for logins from outside.

use base64::Engine;
use base64::engine::general_purpose::{STANDARD, URL_SAFE_NO_PAD};
use ed25519_dalek::pkcs8::spki::der::pem::LineEnding;
use ed25519_dalek::pkcs8::{EncodePrivateKey, EncodePublicKey};
use ed25519_dalek::{Signer, SigningKey};
use jsonwebtoken::{Algorithm, EncodingKey, Header, encode};
use mom_broker::{JwtConfig, JwtUsers, KeyFile, UserEntry};
use mom_proto::{Family, Map, Parcel, Value, WireError, login_challenge};
use serde_json::{Value as Json, json};

use crate::raw::Raw;

/// Who signs the tokens of these tests, and for whom.
pub const ISSUER: &str = "https://id.example.org";
/// The audience.
pub const AUDIENCE: &str = "mom";

/// A key of a device; the same number is the same key.
#[derive(Debug)]
pub struct DeviceKey(SigningKey);

impl DeviceKey {
    /// One of 256.
    pub fn number(number: u8) -> DeviceKey {
        DeviceKey(SigningKey::from_bytes(&[number; 32]))
    }

    /// Its line in the users file.
    pub fn public(&self) -> String {
        let bytes = self.0.verifying_key().to_bytes();
        format!("ed25519 {}", STANDARD.encode(bytes))
    }

    /// The private key in PEM.
    ///
    /// # Panics
    /// Never.
    pub fn pem(&self) -> String {
        let pem = self.0.to_pkcs8_pem(LineEnding::LF);
        pem.expect("a key has a form in PEM").to_string()
    }

    /// The answer to a challenge, as this user.
    ///
    /// # Panics
    /// If it is none.
    pub fn answer(&self, challenge: &Value, user: &str) -> Parcel {
        let hub = challenge.get("hub").and_then(Value::as_str).expect("a hub");
        self.answer_as(challenge, hub, user)
    }

    /// The same, for a hub of another name.
    ///
    /// # Panics
    /// If it is none.
    pub fn answer_as(&self, challenge: &Value, hub: &str, user: &str) -> Parcel {
        let nonce = challenge.get("nonce").and_then(Value::as_binary);
        let signed = login_challenge(hub, user, nonce.expect("a nonce"));
        let signature = self.0.sign(&signed).to_bytes().to_vec();
        let signature = Value::Binary(signature.into());
        Parcel::new(Family::Login, "answer").content(Map::new().with("signature", signature))
    }
}

/// Asks for a challenge.
///
/// # Errors
/// What the broker answers instead.
pub async fn challenge(raw: &mut Raw, user: &str) -> Result<Value, WireError> {
    let content = Map::new().with("name", user).with("key", true);
    log_in(raw, content).await
}

/// Says `login login`.
///
/// # Errors
/// Why it was refused.
pub async fn log_in(raw: &mut Raw, content: Map) -> Result<Value, WireError> {
    let login = Parcel::new(Family::Login, "login").content(content);
    raw.ask(login).await.map(|reply| reply.value())
}

/// Gives this user's password, which is its name, a hash as costly as `mom-broker passwd` makes it: those of the lab's file cost little.
///
/// # Panics
/// If there is no such user.
pub fn make_costly(users: &mut [UserEntry], name: &str) {
    let user = users.iter_mut().find(|user| user.name == name);
    let hash = mom_broker::hash(name).expect("it can be hashed");
    user.expect("a user of the lab").password = Some(hash);
}

/// Proves a password.
///
/// # Errors
/// Why it was refused.
pub async fn password(raw: &mut Raw, user: &str, password: &str) -> Result<Value, WireError> {
    log_in(raw, Map::new().with("name", user).with("password", password)).await
}

/// Shows a token.
///
/// # Errors
/// Why it was refused.
pub async fn token(raw: &mut Raw, token: &str) -> Result<Value, WireError> {
    log_in(raw, Map::new().with("token", token)).await
}

/// An issuer that signs tokens.
#[derive(Debug)]
pub struct Issuer(SigningKey);

impl Issuer {
    /// One of 256.
    pub fn number(number: u8) -> Issuer {
        Issuer(SigningKey::from_bytes(&[number; 32]))
    }

    /// The public key in PEM.
    ///
    /// # Panics
    /// Never.
    pub fn public_pem(&self) -> String {
        let pem = self.0.verifying_key().to_public_key_pem(LineEnding::LF);
        pem.expect("a key has a form in PEM")
    }

    /// The 32 bytes of the public key.
    pub fn public_bytes(&self) -> [u8; 32] {
        self.0.verifying_key().to_bytes()
    }

    /// The configuration of a hub that trusts it.
    pub fn config(&self) -> JwtConfig {
        JwtConfig {
            issuer: ISSUER.to_owned(),
            audience: AUDIENCE.to_owned(),
            algorithms: vec!["EdDSA".to_owned()],
            key: KeyFile::from_text(self.public_pem()),
            leeway: 0,
            users: JwtUsers::File,
            max_level: 0,
        }
    }

    /// A token with these claims.
    ///
    /// # Panics
    /// Never.
    pub fn sign(&self, claims: &Json) -> String {
        let pem = self.0.to_pkcs8_pem(LineEnding::LF).expect("a key");
        let key = EncodingKey::from_ed_pem(pem.as_bytes()).expect("the same key");
        encode(&Header::new(Algorithm::EdDSA), claims, &key).expect("claims are JSON")
    }

    /// A token with any header, properly signed.
    pub fn sign_with_header(&self, header: &Json, claims: &Json) -> String {
        let message = unsigned(header, claims);
        let signature = self.0.sign(message.as_bytes()).to_bytes();
        format!("{message}.{}", URL_SAFE_NO_PAD.encode(signature))
    }
}

/// The claims of a token for this user, until a time in seconds.
pub fn claims(user: &str, exp: i64) -> Json {
    json!({"iss": ISSUER, "aud": AUDIENCE, "sub": user, "exp": exp})
}

/// Claims with one of them changed, or taken out by null.
pub fn with(mut claims: Json, key: &str, value: Json) -> Json {
    match (value, &mut claims) {
        (Json::Null, Json::Object(map)) => drop(map.remove(key)),
        (value, claims) => claims[key] = value,
    }
    claims
}

/// Header and claims of a token, without a signature.
pub fn unsigned(header: &Json, claims: &Json) -> String {
    let part = |json: &Json| URL_SAFE_NO_PAD.encode(json.to_string());
    format!("{}.{}", part(header), part(claims))
}
