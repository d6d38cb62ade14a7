//! The arm as a peer: joins its channel, obeys what it hears there, and keeps out of the zones that are closed to it.

use std::convert::Infallible;
use std::future::{Future, pending};
use std::pin::{Pin, pin};
use std::time::Duration;

use mom_client::{Boxed, Card, Channel, Client, ClientError, Code, Consult, Event, LinkState, WireError};
use mom_device::{
    DevicePeer, DeviceTime, Happening, Machine as _, card, come_back, ensure_above, ensure_guarded,
    instant_of, is_missing, sleep_or_wait, time_since,
};
use tokio::time::Instant;

use crate::blocks::Block;
use crate::controller::{LinkFault, Simulated};
use crate::machine::ArmMachine;
use crate::zone_keeper::ZoneKeeper;
use crate::zone_watch::{ZoneEvent, ZoneWatch};
use crate::zones::{Mount, Zones};

/// The channel of the arm.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmOptions {
    /// The channel of its commands and states; its session is joined first. Where it is missing the arm makes it, if it may.
    pub channel: String,
    /// The token that guards a channel that the arm makes; none: `token`, beside the channel.
    pub token: Option<String>,
    /// The manager of that token, if it is made; none: that of the session.
    pub manager: Option<String>,
    /// When it is put out of its channel, or that goes, it stands until it may be there again, instead of ending.
    pub comes_back: bool,
    /// How old a command may be when it begins, whatever its sender says; none: as old as it likes.
    pub max_age: Option<Duration>,
    /// A fault of the simulated link between the program and the controller (M53), to try what happens then.
    pub link_fault: Option<LinkFault>,
    /// The session whose tokens are zones that the arm shares with other machines (M40); none: it has the table for itself.
    pub zones: Option<String>,
    /// Where the arm's table is in the frame of the zones.
    pub mount: Mount,
    /// How many times as fast as real time the simulated arm's time passes: 1 to 100.
    pub pace: u32,
}

impl Default for ArmOptions {
    /// The lab's: `/robot/arm`.
    fn default() -> Self {
        Self {
            channel: "/robot/arm".to_owned(),
            token: None,
            manager: None,
            comes_back: true,
            max_age: None,
            link_fault: None,
            zones: None,
            mount: Mount::default(),
            pace: 1,
        }
    }
}

impl ArmOptions {
    /// The controller of the lab's simulated arm, on its table.
    #[must_use]
    pub fn controller(&self) -> Simulated {
        let controller = Simulated::new(0, Block::lab());
        match self.link_fault {
            Some(fault) => controller.failing(fault),
            None => controller,
        }
    }

    /// Joins its channel as its device, and the zones.
    async fn enter(&self, client: &Client, card: &Card) -> Result<Entered, ClientError> {
        let channel = self.enter_channel(client, card).await?;
        let zones = match &self.zones {
            Some(session) => Some(ZoneWatch::join(client, session).await?),
            None => None,
        };
        Ok((channel, zones))
    }

    /// Joins its channel as its device, after the arm has made what is missing of its contexts.
    async fn enter_channel(&self, client: &Client, card: &Card) -> Result<Channel, ClientError> {
        match client.channel_with_card(&self.channel, card).await {
            Err(error) if is_missing(&error) => {}
            entered => return entered,
        }
        let beside = || {
            let session = self.channel.rsplit_once('/').map_or("", |(session, _)| session);
            format!("{session}/token")
        };
        let token = self.token.clone().unwrap_or_else(beside);
        ensure_above(client, &token).await?;
        ensure_above(client, &self.channel).await?;
        ensure_guarded(client, &self.channel, &token, self.manager.as_deref()).await?;
        client.channel_with_card(&self.channel, card).await
    }

    /// Lets the arm come to its rest while it has no channel.
    async fn rest(&self, arm: &mut ArmMachine, begin: Instant) -> Infallible {
        let pace = DeviceTime::from(self.pace.clamp(1, 100));
        loop {
            let wake = arm.next_wake().map(|due| due.saturating_add(pace - 1) / pace);
            sleep_or_wait(wake.map(|due| instant_of(begin, due))).await;
            arm.advance(time_since(begin).saturating_mul(pace));
        }
    }
}

/// Its channel, and the zones if it keeps out of some.
type Entered = (Channel, Option<ZoneWatch>);

/// Runs the lab's simulated arm until `shutdown` is done, as [`run_arm`] does.
///
/// A lost link halts the arm; the client connects again by itself, and the arm goes on with the next command. [`ArmOptions::comes_back`]
/// says what becomes of an arm that is put out of its channel.
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
pub fn run(
    client: Client,
    options: ArmOptions,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Boxed<'static, Result<(), ClientError>> {
    let arm = ArmMachine::new(Box::new(options.controller()));
    run_arm(client, options, arm, shutdown)
}

/// Runs an arm, with whatever controller it has, until `shutdown` is done. Then it halts, reports that, and logs out. Its time begins at 0.
///
/// Where its contexts are missing, it makes them if it may: the session, the token beside its channel, and the channel, which that guards.
///
/// # Errors
///
/// As [`run`].
pub fn run_arm(
    client: Client,
    options: ArmOptions,
    arm: ArmMachine,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Boxed<'static, Result<(), ClientError>> {
    Box::pin(run_arm_until(client, options, arm, Box::pin(shutdown)))
}

async fn run_arm_until(
    client: Client,
    options: ArmOptions,
    arm: ArmMachine,
    shutdown: Boxed<'static, ()>,
) -> Result<(), ClientError> {
    let begin = Instant::now();
    let ended = live(
        &client,
        &options,
        arm.at_pace(options.pace),
        begin,
        pin!(shutdown),
    )
    .await;
    client.close().await;
    ended
}

async fn live(
    client: &Client,
    options: &ArmOptions,
    mut arm: ArmMachine,
    begin: Instant,
    mut shutdown: Pin<&mut impl Future<Output = ()>>,
) -> Result<(), ClientError> {
    let card = card(&arm);
    let mut entered = options.enter(client, &card).await?;
    loop {
        let (left, ended) = obey(client, entered, options, arm, begin, shutdown.as_mut()).await;
        arm = left;
        match ended {
            Err(error) if options.comes_back && !matches!(error, ClientError::Closed(_)) => {
                let channel = &options.channel;
                tracing::warn!(%error, channel, "the arm stands until it may be in its channel again");
            }
            ended => return ended,
        }
        entered = tokio::select! {
            () = &mut shutdown => return Ok(()),
            entered = come_back(|| options.enter(client, &card)) => entered?,
            never = options.rest(&mut arm, begin) => match never {},
        };
    }
}

/// Has the arm obey in its channel, until it hears nothing more there, or `shutdown` is done. Whatever ends it, the arm is halted.
async fn obey(
    client: &Client,
    (channel, mut zones): Entered,
    options: &ArmOptions,
    arm: ArmMachine,
    begin: Instant,
    mut shutdown: Pin<&mut impl Future<Output = ()>>,
) -> (ArmMachine, Result<(), ClientError>) {
    let mut keeper = zones
        .is_some()
        .then(|| ZoneKeeper::new(Zones::new(options.mount)));
    let mut peer = DevicePeer::start(client, &channel, arm, begin).at_pace(options.pace.clamp(1, 100));
    if let Some(max_age) = options.max_age {
        peer = peer.with_max_age(max_age);
    }
    if let Some(keeper) = &mut keeper {
        keeper.learn(peer.gate());
        close(&mut peer, keeper);
    }
    tracing::info!(peer = client.name(), channel = %channel.path(), "the arm is ready");
    let result = loop {
        tokio::select! {
            () = &mut shutdown => break Ok(()),
            event = zone_event(&mut zones) => {
                let Some(event) = event else { break Err(ended(client, peer.put_out())) };
                hear_zone(&mut peer, keeper.as_mut(), &event);
            }
            happening = peer.wait() => {
                let Some(happening) = happening else { break Err(ended(client, peer.put_out())) };
                if matches!(happening, Happening::Event(_)) && !hear_zones(&mut peer, keeper.as_mut(), &mut zones).await {
                    break Err(ended(client, peer.put_out()));
                }
                hear(&mut peer, keeper.as_mut(), &happening);
            },
        }
    };
    let why = match &result {
        Ok(()) => "its program ends".to_owned(),
        Err(_) => peer.why_gone(),
    };
    (peer.leave(&why).await, result)
}

/// Takes in what has happened. Who commands is known before his command, and who does no more after the end of what he had begun.
fn hear(peer: &mut DevicePeer<ArmMachine>, keeper: Option<&mut ZoneKeeper>, happening: &Happening) {
    let Happening::Event(event) = happening else {
        return peer.take(happening);
    };
    log(event);
    let Some(keeper) = keeper else {
        return peer.take(happening);
    };
    if matches!(event, Event::Message(_)) {
        keeper.observe(event, peer.gate());
        close(peer, keeper);
        peer.take(happening);
    } else {
        peer.take(happening);
        keeper.observe(event, peer.gate());
        close(peer, keeper);
    }
}

fn close(peer: &mut DevicePeer<ArmMachine>, keeper: &ZoneKeeper) {
    let closed = keeper.closed();
    if *peer.machine().closed() != closed {
        peer.note(|arm| arm.close(closed));
    }
}

/// Hears what the hub told of zones before: who grabs a zone may use it at once. `false` if they are gone.
async fn hear_zones(
    peer: &mut DevicePeer<ArmMachine>,
    mut keeper: Option<&mut ZoneKeeper>,
    zones: &mut Option<ZoneWatch>,
) -> bool {
    while let Some(event) = ready(zone_event(zones)).await {
        let Some(event) = event else { return false };
        hear_zone(peer, keeper.as_deref_mut(), &event);
    }
    true
}

/// Waits for news of the zones, if there are any.
async fn zone_event(zones: &mut Option<ZoneWatch>) -> Option<ZoneEvent> {
    match zones {
        Some(zones) => zones.next().await,
        None => pending().await,
    }
}

/// What a future gives at once, if it does.
async fn ready<T>(future: impl Future<Output = T>) -> Option<T> {
    tokio::select! {
        biased;
        value = future => Some(value),
        () = std::future::ready(()) => None,
    }
}

fn hear_zone(peer: &mut DevicePeer<ArmMachine>, keeper: Option<&mut ZoneKeeper>, event: &ZoneEvent) {
    let Some(keeper) = keeper else { return };
    match event {
        ZoneEvent::News(news) => keeper.hear(news),
        ZoneEvent::Question(consult) => {
            // Where the arm is now.
            peer.take(&Happening::Due);
            let state = peer.state();
            let is_busy = state.executing.is_some() || state.waiting > 0;
            let answer = keeper.grant(
                &consult.context,
                &consult.peer,
                peer.gate(),
                peer.machine(),
                is_busy,
            );
            tokio::spawn(answer_question(consult.clone(), answer));
        }
    }
    close(peer, keeper);
}

async fn answer_question(consult: Consult, answer: Result<(), String>) {
    let answered = match answer {
        Ok(()) => consult.allow().await,
        Err(why) => consult.deny(&why).await,
    };
    if let Err(error) = answered {
        tracing::warn!(%error, "an answer about a zone did not arrive");
    }
}

fn log(event: &Event) {
    match event {
        Event::Refused(error, reference) => tracing::warn!(%error, reference, "the hub refused a message"),
        Event::Lagged(count) => tracing::error!(count, "events were lost; the arm stops"),
        Event::LinkDown => tracing::warn!("the link is lost; the arm halts"),
        Event::Rejoined => tracing::info!("joined again"),
        Event::Resumed => tracing::info!("the link goes on; the arm is at rest"),
        event => tracing::debug!(?event),
    }
}

/// Why there are no more events.
fn ended(client: &Client, put_out: Option<&str>) -> ClientError {
    match &*client.state().borrow() {
        LinkState::Closed(error) => ClientError::Closed(error.clone()),
        _ => WireError::new(
            Code::UNKNOWN_PATH,
            match put_out {
                Some(why) => format!("the arm was put out of its channel: {why}"),
                None => "the hub deleted the arm's channel, or its zones".to_owned(),
            },
        )
        .into(),
    }
}
