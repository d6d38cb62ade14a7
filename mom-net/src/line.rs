//! A connection inside one process that carries bytes as a network does: with a delay and a rate, until it stalls or is cut.
//!
//! For simulations: all above it is what a socket has above it, and its time is that of the runtime, which may be virtual.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use bytes::{Bytes, BytesMut};
use mom_proto::Limits;
use mom_proto::codec::{Decoder, Form};
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until};

use crate::tcp::{client_decoder, first_bytes, speaking};
use crate::tunnel::{Misplaced, Pipe, WINDOW};
use crate::{NetError, Privacy, Transceiver, socket};

/// Bytes that are taken at a time, as segments are.
const SEGMENT: usize = 1448;

/// How a line carries, in each direction: to the hub, and from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineShape {
    /// From one end to the other.
    pub delay: [Duration; 2],
    /// Bytes per second; none = all at once.
    pub rate: [Option<u64>; 2],
    /// Nothing comes out of it, and neither end is told.
    pub stalls: [bool; 2],
    /// It is broken for good, and both ends hear so.
    pub is_cut: bool,
}

impl LineShape {
    /// A line with this delay in each direction.
    pub fn with_delay(delay: Duration) -> LineShape {
        LineShape {
            delay: [delay; 2],
            rate: [None; 2],
            stalls: [false; 2],
            is_cut: false,
        }
    }
}

/// A connection of bytes in this form; the end of the peer, and that of the hub. It goes by what the shape says at the time; where its
/// sender is gone, it goes on as it was. Called on a runtime, which carries the bytes.
///
/// # Errors
/// None that is known: the first bytes always have room.
pub fn line(
    form: Form,
    limits: &Limits,
    shape: watch::Receiver<LineShape>,
) -> Result<(Transceiver, Transceiver), NetError> {
    let (near, far) = (Arc::new(Pipe::default()), Arc::new(Pipe::default()));
    let end = |pipe: &Arc<Pipe>, decoder: Decoder| -> Result<Transceiver, NetError> {
        let halves = socket::tunnel(Arc::clone(pipe));
        let peer = speaking(halves, Privacy::Local, form, decoder, BytesMut::new());
        peer.writer.try_write(&mut first_bytes(form))?;
        Ok(peer)
    };
    let ends = (
        end(&near, client_decoder(form, limits))?,
        end(&far, Decoder::new(form, limits))?,
    );
    tokio::spawn(carry(Arc::clone(&near), Arc::clone(&far), shape.clone(), 0));
    tokio::spawn(carry(far, near, shape, 1));
    Ok(ends)
}

/// Carries one direction to its end.
async fn carry(from: Arc<Pipe>, to: Arc<Pipe>, mut shape: watch::Receiver<LineShape>, way: usize) {
    let mut under_way: VecDeque<(Instant, Option<Bytes>)> = VecDeque::new();
    let (mut taken, mut brought, mut free, mut is_shaped) = (0_u64, 0_u64, Instant::now(), true);
    let mut has_ended = false;
    loop {
        let now = *shape.borrow_and_update();
        if now.is_cut {
            from.break_off("the line is cut");
            return to.break_off("the line is cut");
        }
        let due = under_way
            .front()
            .map(|(due, _)| *due)
            .filter(|_| !now.stalls[way]);
        let room = usize::try_from(taken - brought).unwrap_or(usize::MAX) < WINDOW;
        tokio::select! {
            biased;
            changed = shape.changed(), if is_shaped => is_shaped = changed.is_ok(),
            () = until(due) => match under_way.pop_front() {
                Some((_, Some(bytes))) => {
                    if !bring(&to, brought, &bytes).await {
                        return from.break_off("nobody reads any more");
                    }
                    brought += bytes.len() as u64;
                    from.acknowledge(brought);
                }
                _ => return to.took_all(),
            },
            bytes = from.bytes_from(taken, SEGMENT), if !has_ended && room => {
                let length = bytes.as_ref().map_or(0, |bytes| bytes.len() as u64);
                let time = now.rate[way].map_or(Duration::ZERO, |rate| {
                    Duration::from_micros(length.saturating_mul(1_000_000) / rate.max(1))
                });
                free = free.max(Instant::now()) + time;
                // Bytes keep their order where the delay becomes less.
                let after = under_way.back().map_or(free, |(due, _)| *due);
                has_ended = bytes.is_none();
                taken += length;
                under_way.push_back(((free + now.delay[way]).max(after), bytes));
            }
        }
    }
}

/// Whether the other end has taken them.
async fn bring(to: &Pipe, at: u64, bytes: &[u8]) -> bool {
    loop {
        match to.take_in(at, bytes) {
            Ok(_) => return true,
            Err(Misplaced::Full(_)) => to.settle().await,
            Err(Misplaced::Gap(_) | Misplaced::Over) => return false,
        }
    }
}

async fn until(due: Option<Instant>) {
    match due {
        Some(due) => sleep_until(due).await,
        None => std::future::pending().await,
    }
}

#[cfg(test)]
mod tests {
    use mom_proto::codec::Frame;
    use mom_proto::{Family, Parcel};

    use super::*;

    fn shaped(delay: u64) -> (watch::Sender<LineShape>, Transceiver, Transceiver) {
        let (sender, shape) = watch::channel(LineShape::with_delay(Duration::from_millis(delay)));
        let (near, far) = line(Form::Binary, &Limits::default(), shape).unwrap();
        (sender, near, far)
    }

    async fn name(peer: &mut Transceiver) -> Option<String> {
        match peer.reader.next().await {
            Ok(Some(Frame::Parcel(parcel))) => Some(parcel.name().to_owned()),
            Ok(None) => None,
            other => panic!("{other:?}"),
        }
    }

    #[tokio::test(start_paused = true)]
    async fn what_is_said_comes_after_the_delay_and_in_order() {
        let (_shape, mut near, mut far) = shaped(30);
        let begin = Instant::now();
        near.writer.send(Parcel::new(Family::Time, "ping")).await.unwrap();
        near.writer.send(Parcel::new(Family::Time, "pong")).await.unwrap();
        assert_eq!(name(&mut far).await.as_deref(), Some("ping"));
        assert_eq!(begin.elapsed(), Duration::from_millis(30));
        assert_eq!(name(&mut far).await.as_deref(), Some("pong"));
        far.writer.send(Parcel::new(Family::Time, "back")).await.unwrap();
        assert_eq!(name(&mut near).await.as_deref(), Some("back"));
        assert_eq!(begin.elapsed(), Duration::from_millis(60));
        drop(near);
        assert_eq!(name(&mut far).await, None, "an end is an end");
    }

    #[tokio::test(start_paused = true)]
    async fn a_line_has_a_rate() {
        let (shape, mut near, mut far) = shaped(0);
        shape.send_modify(|shape| shape.rate[0] = Some(10_000));
        let begin = Instant::now();
        let text = "x".repeat(20_000);
        near.writer
            .send(Parcel::new(Family::Message, "image").content(text))
            .await
            .unwrap();
        assert_eq!(name(&mut far).await.as_deref(), Some("image"));
        let took = begin.elapsed();
        assert!(
            took > Duration::from_millis(1990) && took < Duration::from_millis(2200),
            "{took:?}"
        );
    }

    #[tokio::test(start_paused = true)]
    async fn a_line_that_stalls_says_nothing_and_one_that_is_cut_says_so() {
        let (shape, mut near, mut far) = shaped(5);
        shape.send_modify(|shape| shape.stalls[0] = true);
        near.writer.send(Parcel::new(Family::Time, "ping")).await.unwrap();
        let waited = tokio::time::timeout(Duration::from_secs(3600), far.reader.next()).await;
        assert!(waited.is_err(), "{waited:?}");
        shape.send_modify(|shape| shape.stalls[0] = false);
        assert_eq!(name(&mut far).await.as_deref(), Some("ping"));
        shape.send_modify(|shape| shape.is_cut = true);
        assert!(far.reader.next().await.is_err());
        let mut ended = near;
        assert!(ended.reader.next().await.is_err());
    }
}
