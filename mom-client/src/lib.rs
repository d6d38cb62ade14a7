//! Asks: the client crate of MOM.
//!
//! A [`Client`] is one peer: it connects to a hub, logs in, joins contexts and exchanges parcels there. Its proxies
//! are a [`Session`] (a directory of contexts), a [`Channel`] (where messages are exchanged) and a [`Token`]
//! (exclusive control of a device). A [`TokenGuard`] holds a token, renews its lease and gives it to another peer; an
//! [`InhibitGuard`] keeps everybody from it; a [`FenceGate`] lets a device refuse messages of earlier owners, and a
//! [`StateGate`] commands for an earlier state of it. [`Consults`] are the hub's questions to peers that manage
//! contexts. A [`HubClock`] knows the hub's time and the [`Age`] of arriving parcels, and a [`Predictor`] compensates
//! it. After a lost link the client reconnects and joins its contexts again, but does not grab tokens again, because
//! another peer may drive by then.
//!
//! ```no_run
//! # async fn example() -> Result<(), mom_client::ClientError> {
//! use mom_client::{Client, Event};
//!
//! let client = Client::builder("bin://127.0.0.1:7666").user("alice").password("alice").connect().await?;
//! let chat = client.channel("/chat").await?;
//! let mut events = chat.events();
//! chat.send("chat", "good morning").await?;
//! while let Some(event) = events.next().await {
//!     if let Event::Message(parcel) = event {
//!         println!("{:?}: {:?}", parcel.sender, parcel.value());
//!     }
//! }
//! # Ok(())
//! # }
//! ```

mod answers;
mod arrivals;
mod ask_owner;
mod builder;
mod channel;
mod client;
mod clock;
mod consults;
mod doors;
mod driver;
mod error;
mod events;
mod gate;
mod give;
mod grab;
mod guard;
mod guards;
mod handover;
mod holding;
mod ids;
mod info;
mod inhibit;
mod installation;
mod key;
mod latch;
mod link;
mod login;
mod membership;
mod message;
mod outbox;
mod owning;
mod pending;
mod predict;
mod probe;
mod proof;
mod reconnect;
mod refusal;
mod report;
mod sending;
mod session;
mod shared;
mod state_gate;
mod stats;
mod stops;
mod subscribe;
mod survive;
mod token;
mod token_info;
mod trace;
mod waits;
mod wanted;

pub use ask_owner::AskOwner;
pub use builder::Builder;
pub use channel::Channel;
pub use client::Client;
pub use clock::{Age, HubClock};
pub use consults::{Consult, Consults};
pub use error::{ClientError, ErrorKind};
pub use events::Event;
pub use gate::{FenceGate, GuardState, Stale};
pub use give::{Give, Given, Lapsed};
pub use grab::{Grab, Place};
pub use guard::{Lost, TokenGuard};
pub use guards::Loan;
pub use holding::After;
pub use info::{ContextInfo, Member};
pub use inhibit::InhibitGuard;
pub use key::Key;
pub use latch::{Held, Latch, Reaction, StopState};
pub use message::{Message, Receipt};
pub use mom_net::{Address, DEFAULT_PORT, Identity, NetError, Trust};
pub use mom_proto::{
    ClockOffset, Code, Content, ContextKind, Delivery, Family, Fence, Fingerprint, HISTORY, HUB, Map,
    MessageRate, Parcel, Path, TRACE, Thinning, Time, TraceParent, Value, WireError, event, from_value,
    to_value, visible,
};
pub use predict::{Model, Prediction, Predictor};
pub use probe::Probe;
pub use proof::{Proof, TokenSource};
pub use reconnect::{LinkState, Reconnect};
pub use refusal::{Refusal, ordinal, plain_duration};
pub use report::{Report, report};
pub use session::Session;
pub use state_gate::{BASED_ON, StateGate};
pub use stats::{AgeStats, ChannelStats, ConnectedPeer, Counts, MemoryStats, PeerStats, Stats};
pub use stops::{DeviceAnswer, Rest, Standing, StopReport, Stopping, ToldChannel};
pub use subscribe::Events;
pub use token::Token;
pub use token_info::{Asking, Delegated, Offered, Reserved, TokenInfo, Waiting};
