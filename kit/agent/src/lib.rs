//! What agents do alike that others hire: an agent waits in a channel of its own, is asked for a task there, takes the token that the peer
//! lends it for that, works, and gives it back. A [`Trade`] says what it can do.
//!
//! In its channel:
//!
//! | message | by | content |
//! |---|---|---|
//! | the trade's verb | anybody | the task |
//! | `cancel` | whose task it is | |
//! | `progress` | the agent | `by`: whose task it is; `state`: `accepted` (to the peer that asked, with `agent`, to whom the token is to be
//! given), `working`, `ending`, and at last `done`, `failed`, `cancelled` or `lost`; `text`; and what the trade says beside it |
//! | `…-refused`, `cancel-refused` | the agent | code, name and text |
//!
//! [`Hire`] is the other side: it asks an agent, lends it the token, follows it, and takes the token back.
//!
//! It takes an offer of the token from the peer of an accepted task only, within [`OFFERED`] of the acceptance. The task ends when its peer
//! cancels it, leaves or has lost its connection for 5 s, when the token is lost, when what was lent is used up, and when the program ends.

mod hire;
mod hired;
mod life;

use std::future::Future;
use std::time::Duration;

use mom_client::{Token, Value, WireError};
use mom_drive::Holding;

pub use hire::Hire;
pub use hired::{Ended, Hired};
pub use life::run;

/// How long an accepted task waits for the token.
pub const OFFERED: Duration = Duration::from_secs(15);

/// What an agent can be hired for.
pub trait Trade: Send + Sync + 'static {
    /// What is asked for.
    type Task: Clone + Send + Sync + 'static;
    /// What it joins for that before anything is lent.
    type Tools: Send;

    /// The message by which a task is asked for.
    const VERB: &'static str;

    /// Reads a task.
    ///
    /// # Errors
    /// What is wrong with it, as `bad-content`.
    fn read(&self, content: &Value) -> Result<Self::Task, WireError>;

    /// A task in words that follow "alice has had it": `calibrate x`.
    fn words(task: &Self::Task) -> String;

    /// Joins what the task needs, and finds out whether it can be done; also the token that has to be lent.
    ///
    /// # Errors
    /// Why it cannot be done now.
    fn meet(
        &self,
        hired: &Hired<Self::Task>,
    ) -> impl Future<Output = Result<(Self::Tools, Token), WireError>> + Send;

    /// Works under the token, gives it back, and says how that ended.
    fn work(
        &self,
        hired: &Hired<Self::Task>,
        tools: Self::Tools,
        holding: Holding,
    ) -> impl Future<Output = Ended> + Send;
}
