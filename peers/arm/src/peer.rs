//! The arm as a peer: joins its channel and carries between it and the [`RobotServer`].

use std::future::{Future, pending};
use std::pin::{Pin, pin};
use std::time::Duration;

use mom_client::{Client, ClientError, Parcel};
use tokio::time::{Instant, sleep_until, timeout};

use crate::arm::Arm;
use crate::motion::Micros;
use crate::outbox::Outbox;
use crate::server::RobotServer;

/// How long the last statuses may take to leave when the program ends.
const FAREWELL: Duration = Duration::from_secs(1);

/// Where the arm is heard.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ArmOptions {
    /// The channel of its commands and states; its session is joined first.
    pub channel: String,
}

impl Default for ArmOptions {
    /// The lab's: `/robot/arm`.
    fn default() -> Self {
        Self {
            channel: "/robot/arm".to_owned(),
        }
    }
}

/// A parcel on its way into the client's queue.
type Sending = Pin<Box<dyn Future<Output = Result<(), ClientError>> + Send>>;

/// Runs an arm until `shutdown` is done. Then it halts, says so, and logs out.
///
/// A lost link halts the arm; the client connects again by itself, and the arm goes on with the next command.
///
/// ```no_run
/// use mom_arm::{ArmOptions, peer};
/// use mom_client::Client;
///
/// # async fn example() -> Result<(), mom_client::ClientError> {
/// let client = Client::builder("bin://127.0.0.1:7666").user("arm").password("arm").connect().await?;
/// peer::run(client, ArmOptions::default(), std::future::pending()).await?;
/// # Ok(())
/// # }
/// ```
///
/// # Errors
///
/// [`ClientError`] if the channel cannot be joined or the connection is closed for good.
pub async fn run(
    client: Client,
    options: ArmOptions,
    shutdown: impl Future<Output = ()>,
) -> Result<(), ClientError> {
    let channel = client.channel(&options.channel).await?;
    let (mut events, gate) = (channel.events(), channel.gate());
    let begin = Instant::now();
    let mut server = RobotServer::new(Arm::new(0), channel.path().clone());
    let mut link = Link::new(client.clone());
    let mut out = Vec::new();
    let mut shutdown = pin!(shutdown);
    server.report(&mut out);
    tracing::info!(peer = client.name(), channel = %channel.path(), "the arm is ready");
    loop {
        link.push(&mut out);
        let wake = server.next_wake().map(|due| begin + duration(due));
        tokio::select! {
            () = &mut shutdown => break,
            event = events.next() => match event {
                Some(event) => {
                    tracing::debug!(?event);
                    server.handle(&event, |parcel| gate.check(parcel), micros(begin), &mut out);
                }
                None => return Err(ClientError::Closed(None)),
            },
            () = sleep_or_wait(wake) => server.advance(micros(begin), &mut out),
            () = link.work() => {}
        }
    }
    server.halt("its program ends", micros(begin), &mut out);
    link.push(&mut out);
    if timeout(FAREWELL, link.flush()).await.is_err() {
        tracing::warn!("the last messages did not leave in time");
    }
    client.close().await;
    Ok(())
}

/// The way out: sends one parcel after the other, so that a slow link holds up neither motion nor halts.
struct Link {
    client: Client,
    outbox: Outbox,
    sending: Option<Sending>,
}

impl Link {
    fn new(client: Client) -> Self {
        Self {
            client,
            outbox: Outbox::default(),
            sending: None,
        }
    }

    fn push(&mut self, out: &mut Vec<Parcel>) {
        out.drain(..).for_each(|parcel| self.outbox.push(parcel));
        let dropped = self.outbox.take_dropped();
        if dropped > 0 {
            tracing::warn!(dropped, "the link is too slow; messages were dropped");
        }
    }

    /// Sends one parcel; never ends while there is none. May be dropped at any time, nothing is lost.
    async fn work(&mut self) {
        let sending = match &mut self.sending {
            Some(sending) => sending,
            None => match self.outbox.pop() {
                Some(parcel) => self.sending.insert(send(self.client.clone(), parcel)),
                None => return pending().await,
            },
        };
        if let Err(error) = sending.await {
            tracing::warn!(%error, "a message was not sent");
        }
        self.sending = None;
    }

    async fn flush(&mut self) {
        while self.sending.is_some() || !self.outbox.is_empty() {
            self.work().await;
        }
    }
}

fn send(client: Client, parcel: Parcel) -> Sending {
    Box::pin(async move { client.send(parcel).await })
}

async fn sleep_or_wait(wake: Option<Instant>) {
    match wake {
        Some(wake) => sleep_until(wake).await,
        None => pending().await,
    }
}

fn micros(begin: Instant) -> Micros {
    Micros::try_from(begin.elapsed().as_micros()).unwrap_or(Micros::MAX)
}

fn duration(micros: Micros) -> Duration {
    Duration::from_micros(u64::try_from(micros).unwrap_or(0))
}
