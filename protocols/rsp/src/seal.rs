//! What the key of both ends is used for: codes on the handshake, and sealed packets.

use crate::layout::TAG;
use crate::{Dropped, Header, Key};

/// The keys of both directions of a session.
#[derive(Clone)]
pub(crate) struct Keys {
    pub(crate) down: Key,
    pub(crate) up: Key,
    /// Without the feature there are none, and the compiler leaves out what would be done with them.
    #[cfg(not(feature = "cipher"))]
    #[expect(dead_code, reason = "it cannot be made")]
    none: core::convert::Infallible,
}

/// Bytes of a nonce of the handshake.
pub(crate) const NONCE: usize = 16;

#[cfg(feature = "cipher")]
mod with {
    use chacha20poly1305::{AeadInPlace, ChaCha20Poly1305, KeyInit};
    use hkdf::Hkdf;
    use hmac::{Hmac, Mac};
    use sha2::Sha256;

    use super::*;

    impl Keys {
        pub(crate) fn derive(
            key: &Key,
            hello: &[u8; NONCE],
            welcome: &[u8; NONCE],
            session: [u8; 6],
        ) -> Option<Keys> {
            let mut salt = [0; 2 * NONCE];
            let (first, second) = salt.split_at_mut(NONCE);
            first.copy_from_slice(hello);
            second.copy_from_slice(welcome);
            let all = Hkdf::<Sha256>::new(Some(&salt), key);
            let mut keys = Keys {
                down: [0; 32],
                up: [0; 32],
            };
            all.expand_multi_info(&[b"mom rsp down", &session], &mut keys.down)
                .ok()?;
            all.expand_multi_info(&[b"mom rsp up", &session], &mut keys.up)
                .ok()?;
            Some(keys)
        }
    }

    fn nonce(counter: u64) -> [u8; 12] {
        let [a, b, c, d, e, f, g, h] = counter.to_be_bytes();
        [0, 0, 0, 0, a, b, c, d, e, f, g, h]
    }

    pub(crate) fn seal(key: &Key, counter: u64, header: &[u8], body: &mut [u8]) -> Option<[u8; TAG]> {
        let cipher = ChaCha20Poly1305::new(key.into());
        let tag = cipher.encrypt_in_place_detached(&nonce(counter).into(), header, body);
        tag.ok().map(Into::into)
    }

    pub(crate) fn open<'p>(
        key: &Key,
        counter: u64,
        header: &[u8],
        sealed: &'p mut [u8],
    ) -> Result<&'p mut [u8], Dropped> {
        let (body, tag) = sealed.split_last_chunk_mut::<TAG>().ok_or(Dropped::Short)?;
        let cipher = ChaCha20Poly1305::new(key.into());
        let opened = cipher.decrypt_in_place_detached(&nonce(counter).into(), header, body, (&*tag).into());
        opened.map(|()| body).map_err(|_| Dropped::Sealed)
    }

    /// HMAC-SHA256, cut to 16 bytes.
    pub(crate) fn code(key: &Key, bytes: &[u8]) -> Option<[u8; TAG]> {
        let mut mac = <Hmac<Sha256> as Mac>::new_from_slice(key).ok()?;
        mac.update(bytes);
        mac.finalize().into_bytes().first_chunk::<TAG>().copied()
    }

    /// Whether the code is right, in a time that does not depend on where it is wrong.
    pub(crate) fn is_code(key: &Key, bytes: &[u8], code: &[u8; TAG]) -> bool {
        <Hmac<Sha256> as Mac>::new_from_slice(key).is_ok_and(|mut mac| {
            mac.update(bytes);
            mac.verify_truncated_left(code).is_ok()
        })
    }
}

/// Without the feature there is no end that has a key, so nothing of this is reached.
#[cfg(not(feature = "cipher"))]
mod with {
    use super::*;

    impl Keys {
        pub(crate) fn derive(_: &Key, _: &[u8; NONCE], _: &[u8; NONCE], _: [u8; 6]) -> Option<Keys> {
            None
        }
    }

    pub(crate) fn seal(_: &Key, _: u64, _: &[u8], _: &mut [u8]) -> Option<[u8; TAG]> {
        None
    }

    pub(crate) fn open<'p>(_: &Key, _: u64, _: &[u8], _: &'p mut [u8]) -> Result<&'p mut [u8], Dropped> {
        Err(Dropped::Encryption)
    }

    pub(crate) fn code(_: &Key, _: &[u8]) -> Option<[u8; TAG]> {
        None
    }

    pub(crate) fn is_code(_: &Key, _: &[u8], _: &[u8; TAG]) -> bool {
        false
    }
}

pub(crate) use with::{code, is_code, open, seal};

/// Ends a packet of the handshake, whose bytes before the code are in `packet[..len]`: with a key the code follows.
pub(crate) fn sign(key: Option<&Key>, packet: &mut [u8], len: usize) -> Option<usize> {
    let Some(key) = key else {
        return Some(len);
    };
    let code = code(key, packet.get(..len)?)?;
    packet.get_mut(len..len + TAG)?.copy_from_slice(&code);
    Some(len + TAG)
}

/// What stands between the header and the code of a packet of the handshake.
pub(crate) fn checked<'p>(key: Option<&Key>, header: &Header, packet: &'p [u8]) -> Result<&'p [u8], Dropped> {
    if header.encryption != u8::from(key.is_some()) {
        return Err(Dropped::Encryption);
    }
    let signed = match key {
        None => packet,
        Some(key) => {
            let (signed, mac) = packet.split_last_chunk::<TAG>().ok_or(Dropped::Short)?;
            is_code(key, signed, mac)
                .then_some(signed)
                .ok_or(Dropped::Sealed)?
        }
    };
    signed.get(Header::LEN..).ok_or(Dropped::Short)
}
