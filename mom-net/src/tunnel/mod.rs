//! A connection through requests of HTTP, for networks that let nothing else pass (M19): `POST` brings bytes up, `GET` brings
//! them down, and both say where in the stream they begin, so that nothing is lost or read twice whatever proxies do.
//!
//! docs/PROTOCOL.md has the requests. Whatever form the peers speak goes through unchanged.

mod body;
mod client;
mod pipe;
mod server;

pub use body::TunnelBody;
pub(crate) use client::connect;
pub use client::{ask, post};
pub(crate) use pipe::{Misplaced, Pipe, WINDOW};
pub use server::{Tunnel, Tunnels};

use http::HeaderName;
use std::time::Duration;

/// The id of the tunnel, where it is new.
pub(crate) const ID: HeaderName = HeaderName::from_static("mom-tunnel");
/// How many bytes have come up in all.
pub(crate) const TAKEN: HeaderName = HeaderName::from_static("mom-taken");
/// How many bytes were sent down in all.
pub(crate) const SENT: HeaderName = HeaderName::from_static("mom-sent");

/// Nothing more comes down.
pub(crate) const END: HeaderName = HeaderName::from_static("mom-end");

/// How long an answer may last: proxies cut those that are longer, often at 30 or 60 s.
pub(crate) const LONGEST: Duration = Duration::from_secs(20);

/// Brought up by one request of a peer that has logged in.
pub(crate) const MOST_UP: usize = 128 * 1024;
