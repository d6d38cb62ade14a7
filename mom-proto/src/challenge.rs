//! The bytes of a challenge, which a key signs to authenticate, and of the one that a link's secret answers.

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

/// The prefix of what is proven at a resume.
pub const LINK_CONTEXT: &str = "mom-link-1";

/// Bytes of a link's secret, and of a proof by it.
pub const SECRET_BYTES: usize = 32;

/// The bytes of which a link's secret makes an HMAC-SHA-256: `mom-link-1`, the hub's name, the link's id and the nonce, with a zero
/// byte between each.
///
/// ```
/// use mom_proto::link_challenge;
/// assert_eq!(link_challenge("mom", "07", b"nonce"), b"mom-link-1\0mom\007\0nonce");
/// ```
pub fn link_challenge(hub: &str, link: &str, nonce: &[u8]) -> Vec<u8> {
    [LINK_CONTEXT.as_bytes(), hub.as_bytes(), link.as_bytes(), nonce].join(&0)
}
