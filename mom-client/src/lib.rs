//! Asks: the client crate of MOM.
//!
//! A [`Client`] is one peer: it connects to a hub, logs in, joins contexts and exchanges parcels there. Its
//! proxies are a [`Session`] (a directory of contexts), a [`Channel`] (where messages are exchanged) and a
//! [`Token`] (exclusive control of a device). A [`TokenGuard`] holds a token and renews its lease; a
//! [`FenceGate`] lets a device refuse what an earlier owner sent. A lost link is made anew and everything
//! joined is joined again; tokens are not, as somebody else may drive by then.
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
mod builder;
mod channel;
mod client;
mod driver;
mod error;
mod events;
mod gate;
mod guard;
mod guards;
mod info;
mod key;
mod link;
mod login;
mod membership;
mod message;
mod outbox;
mod pending;
mod places;
mod proof;
mod reconnect;
mod session;
mod shared;
mod subscribe;
mod token;

pub use builder::Builder;
pub use channel::Channel;
pub use client::Client;
pub use error::{ClientError, ErrorKind};
pub use events::Event;
pub use gate::{FenceGate, GuardState, Stale};
pub use guard::{Lost, TokenGuard};
pub use info::{ContextInfo, Member};
pub use key::Key;
pub use message::{Message, Receipt};
pub use mom_net::Address;
pub use mom_proto::{
    Code, Content, ContextKind, Delivery, Family, Map, Parcel, Path, Time, Value, WireError, event,
    from_value, to_value,
};
pub use proof::Proof;
pub use reconnect::{Link, Reconnect};
pub use session::Session;
pub use subscribe::Events;
pub use token::Token;
