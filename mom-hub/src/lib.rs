//! Decides: the context tree of MOM as a deterministic state machine (design §4).
//!
//! [`Hub::handle`] takes the time and an [`Input`] and appends [`Effect`]s; [`Hub::deadline`] says when the
//! hub wants to be called without one. There is no IO, no clock, no randomness: the same inputs give the same
//! effects, so a log of inputs replays exactly.
//!
//! Methods are named by kind: `handle_*` take an input in, `on_*` carry out one verb, `push_*` append
//! effects, `check` asserts what always holds.
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

mod admit;
mod age;
mod args;
mod audit;
mod check;
mod configure;
mod consult;
mod context;
mod create;
mod describe;
mod durable;
mod effect;
mod events;
mod facts;
mod handover;
mod hub;
mod input;
mod judge;
mod keep;
mod member;
mod membership;
mod ownership;
mod peers;
mod pending;
mod rate;
mod record;
mod route;
mod settings;
mod token;
mod tree;
mod verbs;
mod waiting;

pub use admit::{Admission, Alike, Ingress, Receivers, admit, admit_with, receivers};
pub use age::PeerClock;
pub use args::ContextSpec;
pub use audit::Audit;
pub use context::Presence;
pub use create::SetupError;
pub use effect::Effect;
pub use hub::Hub;
pub use input::{Configuration, Input, User};
pub use judge::{Case, Judgement, Place};
pub use keep::{Keep, KeepArgs};
pub use member::{Member, PeerId, StandingVerdict};
pub use rate::{Budget, Usage};
pub use record::{Holder, Record, Ticket};
pub use route::{Guard, GuardOwner, Route};
pub use settings::Settings;
