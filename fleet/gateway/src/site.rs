//! Where the robots of a gateway are at the hub: their paths, and the contexts of one.

use std::sync::Arc;
use std::time::Duration;

use mom_brs::Table;
use mom_brs::file::EXTENDED;
use mom_client::{Channel, Client, ClientError, Path};
use mom_device::{COMMAND, card};
use mom_wheeled::{ensure_session, enter};
use tokio::time::timeout;

use crate::Unit;

/// Robots of one connection. Each of them has its peer join a session, a token and a channel, and a peer joins 1024 contexts, unless
/// the hub's file says otherwise.
pub(crate) const ROBOTS_PER_CONNECTION: usize = 256;
/// So long a hub may take to let a robot leave.
const LEAVING: Duration = Duration::from_secs(1);

/// How many connections to the hub so many robots need.
#[must_use]
pub fn connections(robots: usize) -> usize {
    robots.div_ceil(ROBOTS_PER_CONNECTION).max(1)
}

/// What a gateway makes of its robots at the hub.
#[derive(Debug, Clone)]
pub struct GatewayOptions {
    /// The session of the fleet: robot 7 is `/fleet/7`, with a channel `robot` and a token `token`; the token of a group is
    /// `/fleet/GROUP/token`.
    pub session: String,
    /// One token for all robots of this gateway, which are driven together; none: each group and each robot of none has its own.
    /// A token guards 256 channels at most.
    pub together: Option<String>,
    /// The manager of tokens that are made, by its name in the hub's configuration; none: that of the session.
    pub manager: Option<String>,
    /// The commands that the robots know.
    pub table: &'static Table,
}

impl Default for GatewayOptions {
    /// `/fleet`, a token for each robot with the manager of the session, and all commands of ours.
    fn default() -> Self {
        Self {
            session: "/fleet".to_owned(),
            together: None,
            manager: None,
            table: &EXTENDED,
        }
    }
}

impl GatewayOptions {
    /// The channel of a robot's commands and states.
    #[must_use]
    pub fn channel(&self, unit: u32) -> String {
        format!("{}/{unit}/robot", self.session)
    }

    /// The token of a robot: that of all, that of its group, or its own.
    #[must_use]
    pub fn token(&self, unit: u32, group: Option<&str>) -> String {
        match (&self.together, group) {
            (Some(token), _) => token.clone(),
            (None, Some(group)) => format!("{}/{group}/token", self.session),
            (None, None) => format!("{}/{unit}/token", self.session),
        }
    }

    /// The channel in which people see and edit the fleet's file, where the hub has it.
    #[must_use]
    pub fn file(&self) -> String {
        format!("{}/file", self.session)
    }

    /// The channel in which every robot's newest state is.
    #[must_use]
    pub fn status(&self) -> String {
        format!("{}/status", self.session)
    }
}

/// Where a robot is at the hub.
#[derive(Debug, Clone)]
pub(crate) struct RobotSite {
    pub(crate) client: Client,
    pub(crate) options: Arc<GatewayOptions>,
    pub(crate) unit: u32,
    pub(crate) group: Option<String>,
}

impl RobotSite {
    /// Makes what is missing of the robot's contexts, and joins its channel as its device.
    pub(crate) async fn enter(&self) -> Result<Channel, ClientError> {
        let RobotSite {
            client,
            options,
            unit,
            group,
        } = self;
        ensure_session(client, &options.session).await?;
        if let Some(group) = group {
            ensure_session(client, &format!("{}/{group}", options.session)).await?;
        }
        let path = format!("{}/{unit}", options.session);
        let token = options.token(*unit, group.as_deref());
        let card = card(&Unit::new(*unit, options.table));
        let enter = || enter(client, &path, &token, options.manager.as_deref(), &card);
        let channel = enter().await?;
        if is_guarded(&channel, &token) {
            return Ok(channel);
        }
        // It was made when the robot was in another group: the owner of that token would drive it.
        client
            .delete(channel.path().as_str())
            .await
            .map_err(|error| unguarded(&channel, &token, error))?;
        let channel = enter().await?;
        match is_guarded(&channel, &token) {
            true => Ok(channel),
            false => Err(unguarded(
                &channel,
                &token,
                ClientError::Connection("another peer has made it".to_owned()),
            )),
        }
    }

    /// Leaves the robot's contexts; a hub that does not answer is not waited for long.
    pub(crate) async fn leave(&self) {
        let path = format!("{}/{}", self.options.session, self.unit);
        let leaving = async { self.client.session(&path).await?.leave().await };
        match timeout(LEAVING, leaving).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::warn!(unit = self.unit, %error, "the robot's contexts were not left"),
            Err(_) => tracing::warn!(unit = self.unit, "the robot's contexts were not left in time"),
        }
    }

    /// By whom, and why, the robot is stopped; the hub keeps that by the path of its channel, so another path is not stopped.
    pub(crate) async fn stopped(&self) -> Result<Option<String>, ClientError> {
        let channel = self.options.channel(self.unit);
        // A channel that is gone for a moment keeps its stop, so that it is not known then.
        let asked = timeout(LEAVING, self.client.stops(&channel)).await;
        let late = || ClientError::Connection("it does not answer".to_owned());
        match asked.map_err(|_| late()).flatten() {
            Ok(state) if state.stopped || !state.only.is_empty() => {
                let by = state.by.unwrap_or_else(|| "a peer".to_owned());
                let reason = state
                    .reason
                    .map(|reason| format!(" ({reason})"))
                    .unwrap_or_default();
                Ok(Some(format!("unit {} is stopped by {by}{reason}", self.unit)))
            }
            Ok(_) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// The channel of all states; none if the session's path is none.
    pub(crate) fn status(&self) -> Option<Path> {
        Path::parse(&self.options.status()).ok()
    }
}

/// Whether nobody commands in this channel but who holds that token.
fn is_guarded(channel: &Channel, token: &str) -> bool {
    let guards = |name: &String| matches!(name.as_str(), COMMAND | "*");
    channel
        .guard()
        .is_some_and(|guard| guard.token.as_str() == token && guard.names.iter().any(guards))
}

/// What is wrong with a channel that another token guards, or none, and cannot be made anew.
fn unguarded(channel: &Channel, token: &str, why: ClientError) -> ClientError {
    let guard = channel
        .guard()
        .map_or("nothing".to_owned(), |guard| guard.token.to_string());
    let text = format!(
        "the commands of {} are guarded by {guard}, and by the fleet's file they are by {token}; it cannot be made anew: ",
        channel.path()
    );
    match why {
        ClientError::Refused(mut error) => {
            error.text = format!("{text}{}", error.text);
            ClientError::Refused(error)
        }
        other => ClientError::Connection(format!("{text}{other}")),
    }
}
