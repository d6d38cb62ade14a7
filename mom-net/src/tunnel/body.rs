//! What a tunnel answers a request with.

use std::convert::Infallible;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use bytes::Bytes;
use hyper::body::{Body, Frame, SizeHint};
use tokio::time::Instant;

use super::server::Tunnel;

/// Sent at once.
const PIECE: usize = 16 * 1024;

/// All of it, or what comes as it comes.
#[derive(Debug)]
pub struct TunnelBody(Kind);

#[derive(Debug)]
enum Kind {
    Whole(Option<Bytes>),
    Stream(Streaming),
}

struct Streaming {
    tunnel: Arc<Tunnel>,
    turn: u64,
    at: u64,
    until: Instant,
    next: Option<Next>,
}

type Next = Pin<Box<dyn Future<Output = Option<Bytes>> + Send>>;

impl std::fmt::Debug for Streaming {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("Streaming")
            .field("at", &self.at)
            .finish_non_exhaustive()
    }
}

impl TunnelBody {
    /// These bytes.
    pub fn whole(bytes: impl Into<Bytes>) -> TunnelBody {
        TunnelBody(Kind::Whole(Some(bytes.into()).filter(|bytes| !bytes.is_empty())))
    }

    /// What the tunnel brings from this place on, until then or until another request takes its turn.
    pub(super) fn stream(tunnel: Arc<Tunnel>, turn: u64, at: u64, until: Instant) -> TunnelBody {
        TunnelBody(Kind::Stream(Streaming {
            tunnel,
            turn,
            at,
            until,
            next: None,
        }))
    }
}

impl Default for TunnelBody {
    fn default() -> TunnelBody {
        TunnelBody(Kind::Whole(None))
    }
}

impl Body for TunnelBody {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        let bytes = match &mut self.0 {
            Kind::Whole(bytes) => bytes.take(),
            Kind::Stream(streaming) => {
                let Streaming {
                    tunnel,
                    turn,
                    at,
                    until,
                    next,
                } = streaming;
                let begin = || -> Next {
                    let (tunnel, turn, at, until) = (Arc::clone(tunnel), *turn, *at, *until);
                    Box::pin(async move { tunnel.down(turn, at, PIECE, until).await })
                };
                let bytes = ready!(next.get_or_insert_with(begin).as_mut().poll(context));
                *next = None;
                *at += bytes.as_ref().map_or(0, |bytes| bytes.len() as u64);
                bytes
            }
        };
        Poll::Ready(bytes.map(|bytes| Ok(Frame::data(bytes))))
    }

    fn is_end_stream(&self) -> bool {
        matches!(self.0, Kind::Whole(None))
    }

    fn size_hint(&self) -> SizeHint {
        match &self.0 {
            Kind::Whole(bytes) => SizeHint::with_exact(bytes.as_ref().map_or(0, |bytes| bytes.len() as u64)),
            Kind::Stream(_) => SizeHint::new(),
        }
    }
}
