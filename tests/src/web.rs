//! A client of HTTP that says just what a test wants said.

use std::net::SocketAddr;
use std::time::Duration;

use serde_json::Value as Json;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::time::timeout;

/// What was answered.
#[derive(Debug)]
pub struct Answer {
    /// The status.
    pub status: u16,
    /// The header lines.
    pub head: String,
    /// The body.
    pub body: Vec<u8>,
}

impl Answer {
    /// The value of a header.
    pub fn header(&self, name: &str) -> Option<&str> {
        let mut lines = self.head.lines().filter_map(|line| line.split_once(':'));
        let (_, value) = lines.find(|(key, _)| key.eq_ignore_ascii_case(name))?;
        Some(value.trim())
    }

    /// The body as JSON.
    ///
    /// # Panics
    /// If it is none.
    pub fn json(&self) -> Json {
        serde_json::from_slice(&self.body).unwrap_or_else(|error| panic!("{error}: {}", self.text()))
    }

    /// The body as text.
    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }
}

/// Asks by a connection of its own: `GET /path`, header lines without line ends, a body.
///
/// # Panics
/// If nothing like an answer comes.
pub async fn ask(hub: SocketAddr, request: &str, headers: &[&str], body: &[u8]) -> Answer {
    let mut lines = vec![format!("{request} HTTP/1.1"), format!("Host: {hub}")];
    lines.extend(headers.iter().map(|line| (*line).to_owned()));
    lines.push("Connection: close".to_owned());
    if !body.is_empty() {
        lines.push(format!("Content-Length: {}", body.len()));
    }
    let head = format!("{}\r\n\r\n", lines.join("\r\n"));
    say(hub, &[head.as_bytes(), body].concat()).await
}

/// Sends these bytes, and reads the answer to its end.
///
/// # Panics
/// If nothing like an answer comes.
pub async fn say(hub: SocketAddr, bytes: &[u8]) -> Answer {
    let mut stream = TcpStream::connect(hub).await.expect("the hub listens");
    stream.write_all(bytes).await.expect("the hub reads");
    let mut said = Vec::new();
    let read = timeout(Duration::from_secs(60), stream.read_to_end(&mut said)).await;
    read.expect("it answers in time").expect("it answers");
    let text = String::from_utf8_lossy(&said);
    let end = said.windows(4).position(|four| four == b"\r\n\r\n");
    let end = end.unwrap_or_else(|| panic!("no answer of HTTP: {text}"));
    let head = String::from_utf8_lossy(&said[..end]).into_owned();
    let status = head.split(' ').nth(1).and_then(|status| status.parse().ok());
    Answer {
        status: status.unwrap_or_else(|| panic!("no status: {head}")),
        head,
        body: said[end + 4..].to_vec(),
    }
}

/// A connection that stays for more than one request.
#[derive(Debug)]
pub struct Connection {
    hub: SocketAddr,
    stream: TcpStream,
}

impl Connection {
    /// Connects.
    ///
    /// # Panics
    /// If nobody listens.
    pub async fn open(hub: SocketAddr) -> Connection {
        let stream = TcpStream::connect(hub).await.expect("the hub listens");
        Connection { hub, stream }
    }

    /// Asks, and reads just the answer.
    ///
    /// # Panics
    /// If nothing like an answer comes.
    pub async fn ask(&mut self, request: &str, headers: &[&str], body: &[u8]) -> Answer {
        let mut lines = vec![format!("{request} HTTP/1.1"), format!("Host: {}", self.hub)];
        lines.extend(headers.iter().map(|line| (*line).to_owned()));
        lines.push(format!("Content-Length: {}", body.len()));
        let head = format!("{}\r\n\r\n", lines.join("\r\n"));
        let bytes = [head.as_bytes(), body].concat();
        self.stream.write_all(&bytes).await.expect("the hub reads");
        let read = timeout(Duration::from_secs(60), self.read());
        read.await.expect("it answers in time")
    }

    async fn read(&mut self) -> Answer {
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            head.push(self.stream.read_u8().await.expect("a whole head"));
        }
        let mut answer = Answer {
            status: 0,
            head: String::from_utf8_lossy(&head).into_owned(),
            body: Vec::new(),
        };
        let status = answer
            .head
            .split(' ')
            .nth(1)
            .and_then(|status| status.parse().ok());
        answer.status = status.expect("a status");
        let length = answer
            .header("content-length")
            .and_then(|length| length.parse().ok());
        answer.body = vec![0; length.expect("an answer with a length")];
        self.stream
            .read_exact(&mut answer.body)
            .await
            .expect("a whole body");
        answer
    }
}
