//! The agent: hears in its channel what it is to do, takes the robot's token from the peer that asked, works, and gives it back
//! ([`mom_agent`]).
//!
//! Its verb, in `/servo`, is `align`, with `first`, `second`: names of blocks; `side`: `right`, `left`, `front` or `back`; `gap`: mm. What
//! it tells beside the state is in [`report`].
//!
//! Of the arm's state it uses the pose (spin and tilt at the beginning, which no image shows, and how far the workspace goes), whether
//! the jaws hold anything, and whether it is stopped; never where the arm says that blocks are.

mod drive;
mod job;
pub mod report;
mod watch;

use std::future::Future;

use mom_client::{Boxed, Client, ClientError};

pub use mom_agent::OFFERED;

/// The channels and the token of the agent.
#[derive(Debug, Clone, PartialEq)]
pub struct ServoOptions {
    /// Its own channel.
    pub channel: String,
    /// The robot's.
    pub robot: String,
    /// The token that guards the robot.
    pub token: String,
    /// Those of the cameras; they stand still.
    pub cameras: Vec<String>,
}

impl Default for ServoOptions {
    /// The lab's.
    fn default() -> ServoOptions {
        ServoOptions {
            channel: "/servo".to_owned(),
            robot: "/robot/arm".to_owned(),
            token: "/robot/token".to_owned(),
            cameras: ["/camera/x", "/camera/y", "/camera/top"]
                .map(str::to_owned)
                .to_vec(),
        }
    }
}

/// Runs the agent until `shutdown` is done; a task under way is cancelled, and the token returned.
///
/// # Errors
///
/// [`ClientError`] if its channel cannot be joined, or the connection is closed for good.
pub fn run(
    client: Client,
    options: ServoOptions,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Boxed<'static, Result<(), ClientError>> {
    let shutdown: Boxed<'static, ()> = Box::pin(shutdown);
    Box::pin(async move {
        let channel = options.channel.clone();
        mom_agent::run(client, &channel, job::Aligner(options), shutdown).await
    })
}
