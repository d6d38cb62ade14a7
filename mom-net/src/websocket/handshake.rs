//! How a connection that speaks HTTP becomes a WebSocket (RFC 6455, 4), seen from both ends.

use std::io;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use bytes::{Bytes, BytesMut};
use http::header::{
    CONNECTION, HOST, HeaderMap, HeaderName, SEC_WEBSOCKET_ACCEPT, SEC_WEBSOCKET_KEY, SEC_WEBSOCKET_PROTOCOL,
    SEC_WEBSOCKET_VERSION, UPGRADE,
};
use http::{HeaderValue, Method, Request, Response, StatusCode};
use http_body_util::Empty;
use mom_proto::codec::Form;
use sha1::{Digest as _, Sha1};

use super::WebSocket;
use super::frame::Rules;
use crate::carrier::Carrier;
use crate::{Address, HttpStream, http as http_door};

/// What the key of a client is answered with: RFC 6455, 1.3.
const MAGIC: &str = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11";

/// The subprotocols, in the order of the hub's preference.
const PROTOCOLS: [(&str, Form); 2] = [("mom.json.v1", Form::Json), ("mom.bin.v1", Form::Binary)];

/// A request to become a WebSocket that can be granted.
#[derive(Debug)]
pub struct WebSocketUpgrade {
    form: Form,
    accept: String,
}

/// A request to become one that cannot be granted, and what to answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UpgradeRefused {
    /// The status of the answer.
    pub status: StatusCode,
    /// What is wrong, and what to do.
    pub text: &'static str,
}

fn refused(text: &'static str) -> UpgradeRefused {
    UpgradeRefused {
        status: StatusCode::BAD_REQUEST,
        text,
    }
}

/// Whether a header that is a list of words has this one.
fn has_word(headers: &HeaderMap, name: &HeaderName, word: &str) -> bool {
    words(headers, name).any(|other| other.eq_ignore_ascii_case(word))
}

fn words<'a>(headers: &'a HeaderMap, name: &HeaderName) -> impl Iterator<Item = &'a str> {
    let values = headers
        .get_all(name)
        .into_iter()
        .filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).map(str::trim)
}

fn accept_of(key: &[u8]) -> String {
    STANDARD.encode(Sha1::new().chain_update(key).chain_update(MAGIC).finalize())
}

impl WebSocketUpgrade {
    /// Whether a request asks for a WebSocket.
    pub fn is_asked(headers: &HeaderMap) -> bool {
        has_word(headers, &UPGRADE, "websocket")
    }

    /// Reads the request. The first subprotocol of the client's that the hub has is taken.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn of<B>(request: &Request<B>) -> Result<WebSocketUpgrade, UpgradeRefused> {
        let headers = request.headers();
        if request.method() != Method::GET || !has_word(headers, &CONNECTION, "upgrade") {
            return Err(refused("a WebSocket begins with GET and Connection: Upgrade"));
        }
        if headers.get(SEC_WEBSOCKET_VERSION).map(HeaderValue::as_bytes) != Some(b"13") {
            return Err(UpgradeRefused {
                status: StatusCode::UPGRADE_REQUIRED,
                text: "this hub speaks version 13 of WebSocket: send Sec-WebSocket-Version: 13",
            });
        }
        let key = headers.get(SEC_WEBSOCKET_KEY).map(HeaderValue::as_bytes);
        let decoded = key.and_then(|key| STANDARD.decode(key).ok());
        let (Some(key), Some(16)) = (key, decoded.map(|key| key.len())) else {
            return Err(refused("Sec-WebSocket-Key is 16 bytes in base64"));
        };
        let known = |word: &str| PROTOCOLS.iter().find(|(name, _)| *name == word);
        let (_, form) = words(headers, &SEC_WEBSOCKET_PROTOCOL)
            .find_map(known)
            .ok_or_else(|| {
                refused("ask for a subprotocol of this hub: Sec-WebSocket-Protocol: mom.json.v1 (text) or mom.bin.v1 (binary)")
            })?;
        Ok(WebSocketUpgrade {
            form: *form,
            accept: accept_of(key),
        })
    }

    /// The form that will be spoken.
    pub fn form(&self) -> Form {
        self.form
    }

    /// The WebSocket that the connection is once the answer is written. `read` = what has arrived behind the request.
    pub(crate) fn granted(&self, stream: HttpStream, read: &[u8]) -> io::Result<WebSocket> {
        let rules = Rules {
            text: !self.form.is_binary(),
            client: false,
        };
        let (carrier, mut first) = stream.into_carrier();
        // What hyper has read came before what it has not.
        let mut arrived = BytesMut::from(read);
        arrived.unsplit(first.split());
        carrier.prepare()?;
        Ok(WebSocket::new(carrier, rules, arrived))
    }

    /// The answer that grants it.
    ///
    /// # Panics
    /// Never: the headers are well-formed.
    pub fn response<B: Default>(&self) -> Response<B> {
        Response::builder()
            .status(StatusCode::SWITCHING_PROTOCOLS)
            .header(CONNECTION, "Upgrade")
            .header(UPGRADE, "websocket")
            .header(SEC_WEBSOCKET_ACCEPT, &self.accept)
            .header(SEC_WEBSOCKET_PROTOCOL, protocol_of(self.form))
            .body(B::default())
            .expect("these headers are well-formed")
    }
}

fn protocol_of(form: Form) -> &'static str {
    let named = PROTOCOLS.iter().find(|(_, other)| *other == form);
    named.map_or("mom.bin.v1", |(name, _)| name)
}

/// Asks a hub for a WebSocket.
pub(crate) async fn connect(carrier: Carrier, address: &Address) -> io::Result<WebSocket> {
    let form = address.form;
    let mut key = [0; 16];
    getrandom::fill(&mut key).map_err(|error| io::Error::other(error.to_string()))?;
    let key = STANDARD.encode(key);
    let request = Request::get("/mom")
        .header(HOST, address.authority())
        .header(CONNECTION, "Upgrade")
        .header(UPGRADE, "websocket")
        .header(SEC_WEBSOCKET_VERSION, "13")
        .header(SEC_WEBSOCKET_KEY, &key)
        .header(SEC_WEBSOCKET_PROTOCOL, protocol_of(form))
        .body(Empty::<Bytes>::new())
        .map_err(io::Error::other)?;
    let granted = StatusCode::SWITCHING_PROTOCOLS;
    let (headers, carrier, arrived) =
        http_door::switch(carrier, request, granted, http_door::refusal).await?;
    let accept = headers.get(SEC_WEBSOCKET_ACCEPT);
    let protocol = headers.get(SEC_WEBSOCKET_PROTOCOL);
    if accept.map(HeaderValue::as_bytes) != Some(accept_of(key.as_bytes()).as_bytes())
        || protocol.map(HeaderValue::as_bytes) != Some(protocol_of(form).as_bytes())
    {
        let text = "what answers is not a hub: its WebSocket is another";
        return Err(io::Error::new(io::ErrorKind::InvalidData, text));
    }
    let rules = Rules {
        text: !form.is_binary(),
        client: true,
    };
    carrier.prepare()?;
    Ok(WebSocket::new(carrier, rules, arrived))
}
