//! HTTP/1.1 as a carrier: how it is told from other first bytes, and a connection that hyper reads and writes.

mod stream;

use std::future::poll_fn;
use std::io;

use bytes::{Bytes, BytesMut};
use http::Request;
use http::response;
use http_body_util::Empty;
use hyper::client::conn::http1;

use crate::carrier::Carrier;

pub use stream::HttpStream;

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

/// Asks for something that makes of the connection another than one for requests, and gives what was answered, the connection and
/// what has arrived behind the answer.
pub(crate) async fn switch(
    carrier: Carrier,
    request: Request<Empty<Bytes>>,
) -> io::Result<(response::Parts, Carrier, BytesMut)> {
    let stream = HttpStream::new(carrier, BytesMut::new());
    let (mut sender, mut connection) = http1::handshake(stream).await.map_err(io::Error::other)?;
    let mut over = false;
    let response = {
        let mut asked = std::pin::pin!(sender.send_request(request));
        poll_fn(|context| {
            // It ends when the other side switches, perhaps before the answer is looked at.
            if !over {
                over = connection.poll_without_shutdown(context).is_ready();
            }
            asked.as_mut().poll(context)
        })
        .await
        .map_err(io::Error::other)?
    };
    let (head, body) = response.into_parts();
    drop((body, sender));
    if !over {
        poll_fn(|context| connection.poll_without_shutdown(context))
            .await
            .map_err(io::Error::other)?;
    }
    let parts = connection.into_parts();
    let (carrier, _) = parts.io.into_carrier();
    Ok((head, carrier, BytesMut::from(&parts.read_buf[..])))
}
