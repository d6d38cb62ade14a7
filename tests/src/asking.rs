//! A connection that asks by HTTP with whatever bytes it is told to, and reads what comes back.

use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use bytes::BytesMut;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio::time::timeout;

use crate::raw::PATIENCE;

/// A raw connection for requests.
#[derive(Debug)]
pub struct Asking {
    stream: TcpStream,
    input: BytesMut,
}

/// What a request was answered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// The number of the first line.
    pub status: u16,
    /// The header lines, each in lower case up to its colon.
    pub headers: Vec<(String, String)>,
    /// As much as its `Content-Length` says.
    pub body: Vec<u8>,
}

impl Answer {
    /// The value of a header.
    pub fn header(&self, name: &str) -> Option<&str> {
        let found = self.headers.iter().find(|(key, _)| key == name);
        found.map(|(_, value)| value.as_str())
    }

    /// The code of the protocol in a refusal.
    pub fn code(&self) -> Option<String> {
        let said: serde_json::Value = serde_json::from_slice(&self.body).ok()?;
        said["code"].as_str().map(str::to_owned)
    }
}

impl Asking {
    /// Connects.
    ///
    /// # Panics
    /// If the broker cannot be reached.
    pub async fn connect(address: SocketAddr) -> Asking {
        Asking::connect_from(IpAddr::from([127, 0, 0, 1]), address).await
    }

    /// Connects from another address of this machine.
    ///
    /// # Panics
    /// If the broker cannot be reached from there.
    pub async fn connect_from(from: IpAddr, address: SocketAddr) -> Asking {
        let socket = TcpSocket::new_v4().expect("a socket");
        // Little waits here for one who does not read.
        socket.set_recv_buffer_size(16 * 1024).expect("a socket option");
        socket.bind((from, 0).into()).expect("an address of loopback");
        let stream = socket.connect(address).await.expect("the broker listens");
        stream.set_nodelay(true).expect("a socket option");
        let input = BytesMut::new();
        Asking { stream, input }
    }

    /// Writes bytes. A broker that has closed already does not matter: what it said is read later.
    ///
    /// # Panics
    /// If the broker neither takes them nor closes.
    pub async fn send(&mut self, bytes: impl AsRef<[u8]>) {
        let sent = timeout(PATIENCE, self.stream.write_all(bytes.as_ref())).await;
        let _ = sent.expect("the broker reads or closes");
    }

    /// The connection, once it takes no more requests, and what has come on it.
    pub fn into_parts(self) -> (TcpStream, BytesMut) {
        (self.stream, self.input)
    }

    /// Asks with these lines and this body, and gives the answer.
    ///
    /// # Panics
    /// If there is none.
    pub async fn ask(&mut self, first: &str, lines: &[&str], body: &[u8]) -> Answer {
        self.send(request(first, lines, body)).await;
        let answer = self.answer().await;
        answer.unwrap_or_else(|| panic!("{first} was not answered"))
    }

    /// The next answer; none at the end of the connection.
    ///
    /// # Panics
    /// If neither comes, or what comes is not an answer.
    pub async fn answer(&mut self) -> Option<Answer> {
        let heard = timeout(PATIENCE, self.try_answer()).await;
        heard.expect("the broker answers or closes")
    }

    async fn try_answer(&mut self) -> Option<Answer> {
        let end = loop {
            let end = self.input.windows(4).position(|four| four == b"\r\n\r\n");
            match end {
                Some(end) => break end + 4,
                None if !self.read().await => {
                    assert!(self.input.is_empty(), "half an answer: {:?}", self.input);
                    return None;
                }
                None => {}
            }
        };
        let head = self.input.split_to(end).to_vec();
        let head = String::from_utf8(head).expect("a head is text");
        let mut lines = head.lines();
        let first = lines.next().unwrap_or_default();
        let status = first.strip_prefix("HTTP/1.").and_then(|rest| rest.get(2..5));
        let status = status.and_then(|status| status.parse().ok());
        let headers: Vec<(String, String)> = lines
            .filter_map(|line| line.split_once(": "))
            .map(|(key, value)| (key.to_ascii_lowercase(), value.to_owned()))
            .collect();
        let mut answer = Answer {
            status: status.unwrap_or_else(|| panic!("no status in {first:?}")),
            headers,
            body: Vec::new(),
        };
        let length = answer
            .header("content-length")
            .and_then(|length| length.parse().ok());
        let length = length.unwrap_or_default();
        while self.input.len() < length {
            assert!(self.read().await, "the body is cut short: {answer:?}");
        }
        answer.body = self.input.split_to(length).to_vec();
        Some(answer)
    }

    async fn read(&mut self) -> bool {
        self.input.reserve(4096);
        // A reset is an end like any other.
        matches!(self.stream.read_buf(&mut self.input).await, Ok(read) if read > 0)
    }

    /// Whether something comes within this time, or the end.
    pub async fn hears_within(&mut self, time: Duration) -> bool {
        !self.input.is_empty() || timeout(time, self.read()).await.is_ok()
    }

    /// Bytes that come; none at the end.
    ///
    /// # Panics
    /// If neither does.
    pub async fn bytes(&mut self) -> Vec<u8> {
        if self.input.is_empty() {
            timeout(PATIENCE, self.read()).await.expect("bytes or an end");
        }
        self.input.split().to_vec()
    }

    /// Checks that nothing more comes, and the connection ends.
    ///
    /// # Panics
    /// If not.
    pub async fn check_closed(&mut self) {
        assert_eq!(self.answer().await, None, "nothing more");
    }
}

/// The bytes of a request with these lines and this body, whose length is said if it has any.
pub fn request(first: &str, lines: &[&str], body: &[u8]) -> Vec<u8> {
    let mut head = format!("{first} HTTP/1.1\r\n");
    for line in lines {
        head.push_str(&format!("{line}\r\n"));
    }
    if !body.is_empty() || first.starts_with("POST") {
        head.push_str(&format!("Content-Length: {}\r\n", body.len()));
    }
    [head.as_bytes(), b"\r\n", body].concat()
}

/// The lines of a request for a WebSocket of this subprotocol.
pub fn upgrade(protocol: &str) -> Vec<String> {
    [
        "Host: 127.0.0.1",
        "Connection: Upgrade",
        "Upgrade: websocket",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        &format!("Sec-WebSocket-Protocol: {protocol}"),
    ]
    .map(str::to_owned)
    .to_vec()
}
