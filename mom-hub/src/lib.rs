//! Decides: the context tree of MOM as a deterministic state machine (design §4).
//!
//! [`Hub::handle`] takes the time and an [`Input`] and appends [`Effect`]s; [`Hub::deadline`] says when the
//! hub wants to be called without one. There is no IO, no clock, no randomness: the same inputs give the same
//! effects, so a log of inputs replays exactly.
//!
//! Its rooms lie on one another, and each uses only those after it: `hub` (the way in), `verbs` (one per file),
//! `contexts` (make, join, leave, delete), `stops` (who is stopped), `ownership` (tokens in the tree), `asking`
//! (managers, peers and chairs), `world` (what the hub knows, and its effects), `messages` (admission, routes, rates),
//! `tree` (contexts and peers as data), `token` (one token by itself), then `heard`, `content`, `values` and `peer_id`.
//! `cargo xtask tidy` holds that.
//!
//! Functions that append effects are named `push_*`, those that carry out a verb `on`; `check` asserts what always
//! holds, and what contradicts it in a release is a `fault` for the audit log.
//!
//! ```
//! use mom_hub::{Effect, Hub, Input, PeerId, Settings, User};
//! use mom_managers::Registry;
//! use mom_proto::Map;
//!
//! let mut hub = Hub::new(Settings::default(), Registry::builtin(), &"open".into(), &[]).unwrap();
//! let mut effects = Vec::new();
//! let alice = User { name: "alice".into(), level: 1, groups: vec![], details: Map::new() };
//! hub.handle(0, Input::Login { peer: PeerId(1), user: alice, nickname: None, id: Some(1) }, &mut effects);
//! assert!(matches!(&effects[..], [Effect::Reply { to: PeerId(1), .. }, Effect::Audit(_)]));
//! hub.check();
//! ```

mod asking;
mod content;
mod contexts;
mod heard;
mod hub;
mod messages;
mod ownership;
mod peer_id;
mod stops;
mod token;
mod tree;
mod values;
mod verbs;
mod world;

pub use contexts::make::SetupError;
pub use hub::Hub;
pub use hub::input::{Configuration, Input};
pub use hub::judge::{Case, ContextOutline, Judgement};
pub use messages::admit::{Admission, Alike, Ingress, Receivers, admit, admit_with, receivers};
pub use messages::rate::{Budget, Usage};
pub use messages::route::{Guard, GuardOwner, Route};
pub use peer_id::PeerId;
pub use token::record::{Holder, Record, Ticket};
pub use tree::clock::PeerClock;
pub use tree::context::Presence;
pub use tree::keep::{Keep, KeepArgs};
pub use tree::latch::{Latch, Stop, StopRecord};
pub use tree::member::{Member, StandingVerdict};
pub use tree::peers::User;
pub use tree::spec::ContextSpec;
pub use tree::stop_row::StopRow;
pub use world::audit::Audit;
pub use world::effect::Effect;
pub use world::inquiry::{About, Explain, Inquiry};
pub use world::settings::Settings;
