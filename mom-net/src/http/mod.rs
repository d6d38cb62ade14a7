//! HTTP/1.1 as a carrier: how it is told from other first bytes, and a connection that hyper reads and writes.

mod stream;

use std::error::Error as _;
use std::future::poll_fn;
use std::io;
use std::pin::pin;
use std::task::{Context, Poll};

use bytes::{Bytes, BytesMut};
use http::{HeaderMap, Request, StatusCode};
use http_body_util::{BodyExt as _, Empty, Limited};
use hyper::client::conn::http1;
use mom_proto::{Code, WireError};
use serde::Deserialize;

use crate::carrier::Carrier;

pub use stream::HttpStream;

/// How much is read of an answer that grants nothing, and how much of it is shown if it is not a hub's.
const MOST_SAID: usize = 4096;
const SHOWN: usize = 100;

/// The methods of requests that a hub answers, if only to say that it takes others.
const METHODS: [&[u8]; 8] = [
    b"GET ",
    b"POST ",
    b"HEAD ",
    b"OPTIONS ",
    b"PUT ",
    b"DELETE ",
    b"PATCH ",
    b"TRACE ",
];

/// Whether first bytes begin HTTP: sure, or none if there are too few to tell.
pub(crate) fn sniff(first: &[u8]) -> Option<bool> {
    if METHODS.iter().any(|method| first.starts_with(method)) {
        return Some(true);
    }
    match METHODS.iter().any(|method| method.starts_with(first)) {
        true => None,
        false => Some(false),
    }
}

/// What has become of the network, where that is why a request has failed.
pub(crate) fn into_io(error: hyper::Error) -> io::Error {
    let kind = error
        .source()
        .and_then(|source| source.downcast_ref::<io::Error>());
    let kind = match kind {
        Some(source) => source.kind(),
        None if error.is_parse() => {
            let text = "what answers is not a hub: it does not speak HTTP";
            return io::Error::new(io::ErrorKind::InvalidData, text);
        }
        None if error.is_closed() || error.is_canceled() || error.is_incomplete_message() => {
            io::ErrorKind::UnexpectedEof
        }
        None => io::ErrorKind::Other,
    };
    io::Error::new(kind, error)
}

/// Why an answer is not what a hub gives: its own words, or those of another server.
pub(crate) fn refusal(status: StatusCode, said: &[u8]) -> io::Error {
    #[derive(Deserialize)]
    struct Refusal {
        code: String,
        text: String,
    }
    match serde_json::from_slice(said) {
        Ok(Refusal { code, text }) => io::Error::other(WireError::new(Code::from_wire(0, &code), text)),
        Err(_) => {
            let said: String = String::from_utf8_lossy(said).chars().take(SHOWN).collect();
            let text = format!("what answers is not a hub: {status} {}", said.trim());
            io::Error::new(io::ErrorKind::InvalidData, text)
        }
    }
}

/// Asks for something that makes of the connection another than one for requests, which is answered with this status; gives the
/// answer, the connection and what has arrived behind the answer. What another answer means is for `refused` to say.
pub(crate) async fn switch(
    carrier: Carrier,
    request: Request<Empty<Bytes>>,
    granted: StatusCode,
    refused: impl FnOnce(StatusCode, &[u8]) -> io::Error,
) -> io::Result<(HeaderMap, Carrier, BytesMut)> {
    let stream = HttpStream::new(carrier, BytesMut::new());
    let (mut sender, mut connection) = http1::handshake(stream).await.map_err(into_io)?;
    let mut over = false;
    // It ends when the other side switches, perhaps before the answer is looked at.
    let mut drive = |context: &mut Context<'_>| {
        if !over {
            over = connection.poll_without_shutdown(context).is_ready();
        }
        over
    };
    let mut asked = pin!(sender.send_request(request));
    let response = poll_fn(|context| {
        drive(context);
        asked.as_mut().poll(context)
    });
    let (head, body) = response.await.map_err(into_io)?.into_parts();
    if head.status != granted {
        let mut said = pin!(Limited::new(body, MOST_SAID).collect());
        let said = poll_fn(|context| {
            drive(context);
            said.as_mut().poll(context)
        });
        let said = said.await.map(|said| said.to_bytes()).unwrap_or_default();
        return Err(refused(head.status, &said));
    }
    drop(body);
    poll_fn(|context| {
        if drive(context) {
            Poll::Ready(())
        } else {
            Poll::Pending
        }
    })
    .await;
    let parts = connection.into_parts();
    let (carrier, _) = parts.io.into_carrier();
    Ok((head.headers, carrier, BytesMut::from(&parts.read_buf[..])))
}
