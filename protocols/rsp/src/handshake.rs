//! What is said before there is a session.

use crate::seal::NONCE;
use crate::{Dropped, PERIODS};

/// What begins a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Hello {
    pub(crate) nonce: [u8; NONCE],
    pub(crate) hash: [u8; 32],
    pub(crate) period: u16,
    pub(crate) paper: bool,
}

/// A robot's answer that gives a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Welcome {
    pub(crate) nonce: [u8; NONCE],
    pub(crate) echo: [u8; NONCE],
    pub(crate) hash: [u8; 32],
    /// All buffers of memory events, free or not.
    pub(crate) buffers: u8,
}

/// The most bytes of a refusal.
pub(crate) const REFUSAL: usize = 1200;

pub(crate) const MODEL: u8 = 1;
pub(crate) const BUSY: u8 = 2;
pub(crate) const VERSION: u8 = 3;

impl Hello {
    #[cfg(feature = "middle")]
    pub(crate) const LEN: usize = NONCE + 32 + 3;

    #[cfg(feature = "middle")]
    pub(crate) fn encode(&self) -> [u8; Hello::LEN] {
        let mut bytes = [0; Hello::LEN];
        let mut rest = &mut bytes[..];
        put(&mut rest, &self.nonce);
        put(&mut rest, &self.hash);
        put(&mut rest, &self.period.to_be_bytes());
        put(&mut rest, &[u8::from(self.paper)]);
        bytes
    }

    pub(crate) fn parse(mut payload: &[u8]) -> Result<Hello, Dropped> {
        let hello = Hello {
            nonce: take(&mut payload)?,
            hash: take(&mut payload)?,
            period: u16::from_be_bytes(take(&mut payload)?),
            paper: match take(&mut payload)? {
                [0] => false,
                [1] => true,
                _ => return Err(Dropped::Payload),
            },
        };
        let fits = payload.is_empty() && PERIODS.contains(&hello.period);
        fits.then_some(hello).ok_or(Dropped::Payload)
    }
}

impl Welcome {
    pub(crate) const LEN: usize = 2 * NONCE + 32 + 1;

    pub(crate) fn encode(&self) -> [u8; Welcome::LEN] {
        let mut bytes = [0; Welcome::LEN];
        let mut rest = &mut bytes[..];
        put(&mut rest, &self.nonce);
        put(&mut rest, &self.echo);
        put(&mut rest, &self.hash);
        put(&mut rest, &[self.buffers]);
        bytes
    }

    #[cfg(feature = "middle")]
    pub(crate) fn parse(mut payload: &[u8]) -> Result<Welcome, Dropped> {
        let welcome = Welcome {
            nonce: take(&mut payload)?,
            echo: take(&mut payload)?,
            hash: take(&mut payload)?,
            buffers: take::<1>(&mut payload)?[0],
        };
        payload.is_empty().then_some(welcome).ok_or(Dropped::Payload)
    }
}

/// Takes so many bytes from the front.
pub(crate) fn take<const N: usize>(payload: &mut &[u8]) -> Result<[u8; N], Dropped> {
    let (&taken, rest) = payload.split_first_chunk().ok_or(Dropped::Payload)?;
    *payload = rest;
    Ok(taken)
}

/// Puts bytes at the front, if they fit.
pub(crate) fn put(rest: &mut &mut [u8], bytes: &[u8]) -> bool {
    match core::mem::take(rest).split_at_mut_checked(bytes.len()) {
        Some((to, after)) => {
            to.copy_from_slice(bytes);
            *rest = after;
            true
        }
        None => false,
    }
}
