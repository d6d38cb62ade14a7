//! A connection to a hub before any login: how far one gets, and how long that takes (M59, M60).

use std::io;
use std::sync::Arc;
use std::time::{Duration, Instant};

use mom_net::{Address, ClientTls, NetError, Transceiver, Trust};
use mom_proto::codec::Frame;
use mom_proto::{ClockOffset, Family, Limits, Parcel, WireError};

use crate::HubClock;
use crate::wire::clock::system;

/// A connection that does not log in. The hub closes it when its time for a login is over, after 10 s by default.
///
/// ```no_run
/// # async fn example() -> Result<(), mom_client::NetError> {
/// use mom_client::Probe;
/// let mut probe = Probe::connect(&"bin://127.0.0.1".parse()?, None).await?;
/// println!("a ping of 1000 bytes takes {:?}", probe.ping(1000).await?);
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Probe {
    transceiver: Transceiver,
    clock: HubClock,
    pings: u64,
}

impl Probe {
    /// Connects, with TLS if the address says so. The hub has then said nothing yet, and may be none.
    ///
    /// # Errors
    /// `Io` for a link that cannot be had, or a hub that is not to be trusted.
    pub async fn connect(address: &Address, trust: Option<Trust>) -> Result<Probe, NetError> {
        let trust = trust.or(address.pin.map(Trust::Pinned)).unwrap_or_default();
        let tls = address.tls.then(|| ClientTls::new(&trust, None)).transpose();
        let tls = tls.map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))?;
        Ok(Probe {
            transceiver: mom_net::connect(address, &Limits::default(), tls.as_ref()).await?,
            clock: HubClock::new(Arc::new(system)),
            pings: 0,
        })
    }

    /// Sends a `time ping` with so many bytes of padding, and gives how long it takes until the short `time pong` is
    /// back. Before login a hub takes 16 KiB.
    ///
    /// # Errors
    /// `Wire` for an error that the hub tells; `Io` for a link that ended, and as `InvalidData` for bytes that no hub says.
    pub async fn ping(&mut self, padding: usize) -> Result<Duration, NetError> {
        self.pings += 1;
        let content = self.clock.ask(self.pings);
        let content = match padding {
            0 => content,
            _ => content.with("padding", "x".repeat(padding)),
        };
        let ping = Parcel::new(Family::Time, "ping").id(self.pings).content(content);
        let start = Instant::now();
        // A hub that refuses may close before it has read everything; its error is more useful than the write error.
        let sent = self.transceiver.writer.send(ping).await;
        loop {
            match self.transceiver.reader.next().await.map_err(no_parcel)? {
                Some(Frame::Parcel(pong))
                    if pong.reference == Some(self.pings) && pong.family == Family::Time =>
                {
                    let took = start.elapsed();
                    self.clock.answered(&pong);
                    return Ok(took);
                }
                Some(Frame::Parcel(parcel)) if parcel.family == Family::Error => {
                    return Err(WireError::from_parcel(&parcel).into());
                }
                Some(Frame::Parcel(_)) => {}
                Some(Frame::Malformed { error, .. }) => return Err(no_parcel(error.into())),
                None => {
                    sent?;
                    return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into());
                }
            }
        }
    }

    /// How far the hub's clock is ahead of this system's, by the pings; none before the first.
    pub fn offset(&self) -> Option<ClockOffset> {
        self.clock.offset()
    }
}

/// Bytes that cannot be read are not an error that the other side has told.
fn no_parcel(error: NetError) -> NetError {
    match error {
        NetError::Wire(error) => io::Error::new(io::ErrorKind::InvalidData, error.text).into(),
        other => other,
    }
}
