//! One task of an agent: whose it is, what is said of it, and whether it is still wanted.

use std::time::Duration;

use mom_client::{Channel, Client, Event, Events, Map, Token, Value, WireError};
use mom_drive::Holding;
use tokio::sync::watch;
use tokio::time::{Instant, timeout, timeout_at};

use crate::OFFERED;

/// How long an offer that nobody asked for takes to be declined.
const DECLINED: Duration = Duration::from_secs(2);

/// A task that a peer has asked for.
#[derive(Debug, Clone)]
pub struct Hired<T> {
    /// Whose it is.
    pub peer: String,
    /// What is to be done.
    pub task: T,
    /// This agent.
    pub client: Client,
    /// Its channel.
    pub channel: Channel,
    /// The id of the message that asked for it.
    pub(crate) id: Option<u64>,
    /// Since when it is at it.
    pub(crate) since: Instant,
    /// Why it is to end, once it is.
    pub(crate) cancelled: watch::Receiver<Option<String>>,
}

/// How a task ended: `done`, `failed`, `cancelled` or `lost`, in words, with what the trade says beside that.
#[derive(Debug, Clone)]
pub struct Ended {
    /// The state.
    pub state: &'static str,
    /// In words.
    pub text: String,
    /// What else.
    pub more: Map,
}

impl Ended {
    /// One of which there is no more to say.
    #[must_use]
    pub fn new(state: &'static str, text: impl Into<String>) -> Ended {
        Ended {
            state,
            text: text.into(),
            more: Map::new(),
        }
    }
}

impl<T> Hired<T> {
    /// Waits until the task is to end, and says why.
    pub async fn ends(&self) -> String {
        match self.cancelled.clone().wait_for(Option::is_some).await {
            Ok(why) => why.clone().unwrap_or_default(),
            Err(_) => "the agent ends".to_owned(),
        }
    }

    /// Why it is to end, if it is.
    #[must_use]
    pub fn cancelled(&self) -> Option<String> {
        self.cancelled.borrow().clone()
    }

    /// The content of a message about it.
    #[must_use]
    pub fn report(&self, state: &str) -> Map {
        Map::new().with("by", self.peer.as_str()).with("state", state)
    }

    /// Tells all how far it is; `content` begins with [`report`](Self::report).
    pub async fn tell(&self, content: Map) {
        say(&self.channel, "progress", content, None).await;
    }

    /// Says how it ended.
    pub(crate) async fn tell_end(&self, ended: Ended) {
        tracing::info!(
            peer = self.peer,
            state = ended.state,
            text = ended.text,
            "the task has ended"
        );
        let mut content = self.report(ended.state).with("text", ended.text);
        for (key, value) in ended.more.iter() {
            content.set(key, value.clone());
        }
        self.tell(content).await;
    }

    /// Says to the peer that its task is accepted.
    pub(crate) async fn accept(&self) {
        let content = self.report("accepted").with("text", "offer me the token");
        let content = content.with("agent", self.client.name());
        say(&self.channel, "progress", content, Some((&self.peer, self.id))).await;
    }

    /// The token, once the peer of the task offers it.
    pub(crate) async fn offered(&self, token: &Token, mut offers: Events) -> Result<Holding, Ended> {
        let (me, until) = (self.client.name(), Instant::now() + OFFERED);
        let failed = |text: String| Ended::new("failed", text);
        loop {
            let Ok(event) = timeout_at(until, offers.next()).await else {
                let text = format!(
                    "{} did not offer the token within {} s",
                    self.peer,
                    OFFERED.as_secs()
                );
                return Err(failed(text));
            };
            match event {
                Some(Event::Offer { by, to, .. }) if to == me && by == self.peer => {
                    let accepted = Holding::accept(token.clone()).await;
                    return accepted.map_err(|error| failed(error.to_string()));
                }
                Some(Event::Offer { by, to, .. }) if to == me => {
                    tracing::info!(by, "an offer without a task is declined");
                    if let Ok(Err(error)) = timeout(DECLINED, token.decline()).await {
                        tracing::warn!(%error, "an offer was not declined");
                    }
                }
                Some(_) => {}
                None => return Err(failed("the connection to the hub is closed".to_owned())),
            }
        }
    }
}

/// Refuses what a peer asked for.
pub(crate) async fn refuse(channel: &Channel, peer: &str, id: Option<u64>, name: &str, error: &WireError) {
    let content: Map = error.to_map().with("by", peer);
    say(channel, name, content, Some((peer, id))).await;
}

/// Says something to all, or to one peer as the answer to its message.
async fn say(channel: &Channel, name: &str, content: Map, to: Option<(&str, Option<u64>)>) {
    let mut message = channel.message(name).content(Value::from(content)).no_echo();
    if let Some((peer, id)) = to {
        message = message.to([peer]);
        if let Some(id) = id {
            message = message.reference(id);
        }
    }
    // Who asked hears of the end by the token's return, too.
    if let Err(error) = message.send().await {
        tracing::warn!(%error, name, "a message was not sent");
    }
}
