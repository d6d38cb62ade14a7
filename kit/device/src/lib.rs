//! What every device at a hub does alike, however it is built.
//!
//! A device is a peer that obeys the owner of the token which guards its channel: it carries out scripts one after the other,
//! tells how far each has come, halts when its owner changes or its link is lost, and stops for anybody.
//! A [`Machine`] says what the device itself can do; [`CommandQueue`] carries commands out as a pure function of time, [`DeviceServer`]
//! decides how they are answered, and [`DevicePeer`] connects it to the hub.

mod back;
mod call;
mod carded;
mod clock;
mod command;
mod contexts;
mod declared;
mod error;
mod estop;
mod fresh;
mod machine;
mod obey;
mod outlet;
mod pull;
mod queue;
mod reading;
mod refusal;
mod rest;
mod run;
mod script;
mod server;
mod words;

pub use back::{come_back, stay};
pub use call::Call;
pub use carded::{Carded, check_by_card};
pub use clock::{instant_of, sleep_or_wait, time_since};
pub use command::{Command, Order, Progress, QueueEvent, State};
pub use contexts::{ensure, ensure_above, ensure_guarded, ensure_session, is_missing};
pub use declared::{Declared, Device};
pub use error::{DeviceError, ErrorName};
pub use machine::{Machine, STATE_PERIOD, card};
pub use obey::obey;
pub use outlet::{Outlet, Sending, sender};
pub use queue::{CommandQueue, MAX_WAITING};
pub use rest::{AtRest, LOOK_AT_REST, REST, Rest, Sample};
pub use run::{DevicePeer, Happening};
pub use script::{Attachments, MAX_ATTACHED, MAX_BYTES, MAX_STATEMENTS, MAX_WAIT, Script, Statement};
pub use server::{COMMAND, DeviceServer, STATE, STATUS};
pub use words::{Word, Words};

/// The time of a device, in µs since its program began.
pub type DeviceTime = i64;
