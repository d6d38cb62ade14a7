//! Carries: the transceivers of MOM (M2, M14, M17, M18).
//!
//! A [`Transceiver`] is a connection in two halves, the same type at both ends: a [`Reader`] that gives
//! frames and a [`Writer`] that takes parcels. It comes from [`connect`], [`accept`], which tells the wire
//! forms apart by their first bytes, or [`pair`], which joins two ends inside one process without encoding; [`line()`] does so as a network
//! would, for simulations.
//!
//! ```
//! # tokio::runtime::Builder::new_current_thread().build().unwrap().block_on(async {
//! use mom_proto::codec::Frame;
//! use mom_proto::{Family, Parcel};
//!
//! let (mut here, mut there) = mom_net::pair();
//! here.writer.send(Parcel::new(Family::Time, "ping")).await.unwrap();
//! let Some(Frame::Parcel(parcel)) = there.reader.next().await.unwrap() else { panic!("a parcel") };
//! assert_eq!(parcel.name(), "ping");
//! # });
//! ```

mod address;
mod carrier;
mod compressed;
mod dial;
mod error;
mod flow;
mod http;
mod line;
mod link;
mod local;
mod options;
mod outgoing;
mod part;
mod proxy;
mod queue;
mod reader;
mod secret_id;
mod socket;
mod spare;
mod takes;
mod tcp;
mod tls;
mod transceiver;
mod tunnel;
mod turn;
mod websocket;
mod writer;

pub use address::{Address, Door};
pub use compressed::COMPRESSION_MEMORY;
pub use error::NetError;
pub use flow::{Allowance, Flow, Pause};
pub use http::HttpStream;
pub use line::{LineShape, line};
pub use link::{Privacy, TcpState};
pub use local::pair;
pub use outgoing::Outgoing;
pub use part::Part;
pub use proxy::proxied;
pub use queue::{
    BadCount, DropPolicy, DropReason, Item, Lane, Ledger, Piece, Rest, Rewound, SendQueue, Taken, write_batch,
};
pub use reader::Reader;
pub use secret_id::SecretId;
pub use takes::{Protocol, Takes, TlsUse};
pub use tcp::{Accepted, accept, connect, refuse};
pub use tls::{ClientTls, Identity, SelfSigned, ServerTls, TlsError, Trust};
pub use transceiver::Transceiver;
pub use tunnel::{Tunnel, TunnelBody, Tunnels, ask, post};
pub use websocket::{UpgradeRefused, WebSocketUpgrade};
pub use writer::{GATHER, Progress, Writer};
