//! Questions to the model.

use mom_client::{Client, Map, Time};
use mom_drive::{DeviceChannel, VerbFailure};
use mom_program::work::wall;

use crate::Objects;
use crate::server::QUERY;

/// The model's channel.
pub(super) struct ModelChannel {
    client: Client,
    pub(super) channel: DeviceChannel,
}

impl ModelChannel {
    pub(super) async fn join(client: &Client, path: &str) -> Result<ModelChannel, VerbFailure> {
        Ok(ModelChannel {
            client: client.clone(),
            channel: DeviceChannel::join(client, path).await?,
        })
    }

    /// All objects, and the number of the newest change among them.
    pub(super) async fn all(&self) -> Result<(Objects, i64), VerbFailure> {
        let what = format!("ask {} for its objects", self.channel.path());
        let answer = self.channel.ask(QUERY, Map::new(), &what).await?;
        let seq = answer.get("seq").and_then(mom_client::Value::as_int);
        Ok((Objects::of(&answer), seq.unwrap_or_default()))
    }

    /// The hub's time.
    pub(super) fn now(&self) -> Time {
        wall(&self.client)
    }
}
