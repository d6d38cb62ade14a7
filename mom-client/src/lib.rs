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

mod contexts;
mod control;
mod device;
mod error;
mod link;
mod peer;
mod refusal;
mod said;
mod wire;
mod words;

pub use contexts::builder::Builder;
pub use contexts::channel::Channel;
pub use contexts::client::Client;
pub use contexts::consults::{Consult, Consults};
pub use contexts::events::Events;
pub use contexts::message::{Message, Receipt};
pub use contexts::session::Session;
pub use contexts::stops::{DeviceAnswer, Rest, Standing, StopReport, Stopping, ToldChannel};
pub use control::ask_owner::AskOwner;
pub use control::give::{Give, Given, Lapsed};
pub use control::grab::Grab;
pub use control::guard::TokenGuard;
pub use control::holding::After;
pub use control::inhibit::InhibitGuard;
pub use control::token::Token;
pub use device::gate::{FenceGate, GuardState, Stale};
pub use device::latch::{Held, Latch, Reaction};
pub use device::predict::{Model, Prediction, Predictor};
pub use device::state_gate::{BASED_ON, StateGate};
pub use error::{ClientError, ErrorKind};
pub use link::probe::Probe;
pub use link::reconnect::Reconnect;
pub use link::report::{Report, report};
pub use mom_net::{Address, Identity, NetError, Trust};
pub use mom_proto::{
    CARD_VERSION, Card, CardArg, CardField, CardType, CardVerb, ClockOffset, Code, Content, ContextKind,
    Delivery, Family, FieldType, Fingerprint, HISTORY, HUB, Map, MessageRate, OnLoss, Parcel, Path, Thinning,
    Time, TraceParent, Value, WireError, event, from_value, to_value, visible,
};
pub use peer::link_state::LinkState;
pub use peer::shared::Boxed;
pub use refusal::{Refusal, ordinal, plain_duration};
pub use said::events::Event;
pub use said::info::{ContextInfo, Member};
pub use said::ownership::{Loan, Lost, Place};
pub use said::stats::{AgeStats, ChannelStats, ConnectedPeer, Counts, MemoryStats, PeerStats, Stats};
pub use said::stop_state::StopState;
pub use said::token_info::{Asking, Delegated, Offered, Reserved, TokenInfo, Waiting};
pub use wire::clock::{Age, HubClock};
pub use wire::key::Key;
pub use wire::proof::{Proof, TokenSource};
