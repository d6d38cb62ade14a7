//! Being a device in a channel, from the beginning of a program to its end.

use std::future::Future;
use std::pin::{Pin, pin};

use mom_client::{Boxed, Card, Channel, Client, ClientError};
use tokio::time::Instant;

use crate::{
    Declared, Device, DevicePeer, Machine as _, card, come_back, ensure_above, ensure_guarded, instant_of,
    is_missing, sleep_or_wait, time_since,
};

/// Has a device obey in this channel, until `end` is done. Whatever ends it, the device is halted.
///
/// Where the channel is missing, it is made, guarded by the token beside it, `token`, as far as the device may. When the device is put out
/// of the channel, or that goes, it stands until it may be there again.
///
/// ```no_run
/// use mom_client::{CardArg, CardVerb, Client, ClientError, Map};
/// use mom_device::{Call, Device, DeviceError, obey};
///
/// # struct Motors;
/// # impl Motors {
/// #     fn lift_to(&mut self, _: f64) {}
/// #     fn is_there(&self) -> bool { true }
/// #     fn brake(&mut self) {}
/// #     fn height(&self) -> f64 { 0.0 }
/// # }
/// struct Lift(Motors);
///
/// impl Device for Lift {
///     const NAME: &str = "the lift";
///
///     fn verbs() -> Vec<CardVerb> {
///         let height = CardArg::number("height", "mm").within(0.0..=500.0);
///         vec![CardVerb::motion("lift", "Lifts the table to a height").args([height])]
///     }
///     fn begin(&mut self, call: &Call) -> Result<(), DeviceError> {
///         self.0.lift_to(call.number("height")?);
///         Ok(())
///     }
///     fn is_done(&mut self) -> Result<bool, DeviceError> {
///         Ok(self.0.is_there())
///     }
///     fn halt(&mut self) {
///         self.0.brake();
///     }
///     fn position(&self) -> Map {
///         Map::new().with("height", self.0.height())
///     }
/// }
///
/// # async fn example() -> Result<(), ClientError> {
/// let client = Client::builder("bin://127.0.0.1:7666").user("lift").password("secret").connect().await?;
/// let interrupted = async { drop(tokio::signal::ctrl_c().await) };
/// obey(&client, "/lift/robot", Lift(Motors), interrupted).await?;
/// # Ok(())
/// # }
/// ```
///
/// # Errors
///
/// A channel that cannot be made or joined at the beginning, or a connection that is closed for good.
pub fn obey<'a, D: Device + 'a>(
    client: &'a Client,
    channel: &'a str,
    device: D,
    end: impl Future<Output = ()> + Send + 'a,
) -> Boxed<'a, Result<(), ClientError>> {
    Box::pin(obey_until(client, channel, Declared::new(device), Box::pin(end)))
}

async fn obey_until<D: Device>(
    client: &Client,
    path: &str,
    mut device: Declared<D>,
    mut end: Boxed<'_, ()>,
) -> Result<(), ClientError> {
    let begin = Instant::now();
    let card = card(&device);
    let mut channel = enter(client, path, &card).await?;
    loop {
        let mut peer = DevicePeer::start(client, &channel, device, begin);
        tracing::info!(peer = client.name(), channel = path, "{} is ready", D::NAME);
        let is_over = loop {
            tokio::select! {
                biased;
                () = &mut end => break true,
                more = peer.step() => if !more { break false },
            }
        };
        if is_over {
            peer.leave("its program ends").await;
            return Ok(());
        }
        let why = peer.why_gone();
        device = peer.leave(&why).await;
        drop(channel);
        tracing::warn!(
            channel = path,
            why,
            "{} stands until it may be in its channel again",
            D::NAME
        );
        channel = match stand(client, path, &card, &mut device, begin, &mut end).await? {
            Some(back) => back,
            None => return Ok(()),
        };
    }
}

/// Has it stand until it is in its channel again; none where its program ends meanwhile.
async fn stand<D: Device>(
    client: &Client,
    path: &str,
    card: &Card,
    device: &mut Declared<D>,
    begin: Instant,
    end: &mut Pin<Box<dyn Future<Output = ()> + Send + '_>>,
) -> Result<Option<Channel>, ClientError> {
    let mut back = pin!(come_back(|| enter(client, path, card)));
    loop {
        let wake = device.next_wake().map(|due| instant_of(begin, due));
        tokio::select! {
            biased;
            () = &mut *end => return Ok(None),
            entered = &mut back => return entered.map(Some),
            () = sleep_or_wait(wake) => device.advance(time_since(begin)),
        }
    }
}

/// Joins a channel as its device, after what is missing of it was made.
async fn enter(client: &Client, path: &str, card: &Card) -> Result<Channel, ClientError> {
    match client.channel_with_card(path, card).await {
        Err(error) if is_missing(&error) => {}
        entered => return entered,
    }
    let session = path.rsplit_once('/').map_or("", |(session, _)| session);
    ensure_above(client, path).await?;
    ensure_guarded(client, path, &format!("{session}/token"), None).await?;
    client.channel_with_card(path, card).await
}
