//! The bytes of a challenge, which a key signs to authenticate.

/// The prefix of the signed bytes at login, so that signatures made for other purposes are invalid here.
pub const LOGIN_CONTEXT: &str = "mom-login-1";

/// Bytes of a challenge's nonce.
pub const NONCE_BYTES: usize = 32;

/// The bytes that the key of a user signs: `mom-login-1`, the hub's name, the user's name and the nonce, with a
/// zero byte between each.
///
/// The hub's name makes a signature for one hub useless at another. No name can hold a zero
/// byte, so no two challenges have the same bytes.
///
/// ```
/// use mom_proto::login_challenge;
/// assert_eq!(login_challenge("mom", "arm", b"nonce"), b"mom-login-1\0mom\0arm\0nonce");
/// ```
pub fn login_challenge(hub: &str, user: &str, nonce: &[u8]) -> Vec<u8> {
    [LOGIN_CONTEXT.as_bytes(), hub.as_bytes(), user.as_bytes(), nonce].join(&0)
}
