//! HTTP proxies for tests: one of the tests' own that can be as awkward as some are, and those that people run.

mod daemon;

use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _, copy_bidirectional};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinHandle;

pub use daemon::{Daemon, Kind};

/// The most that a request's head may have.
const HEAD: usize = 64 * 1024;

/// What a proxy is like.
#[derive(Clone, Copy, Debug, Default)]
pub struct Manners {
    /// It answers in HTTP/1.0.
    pub old: bool,
    /// It closes after each answer.
    pub closes: bool,
    /// It passes no connections on.
    pub refuses_connect: bool,
    /// It takes everything to this hub, whichever is named.
    pub to: Option<SocketAddr>,
}

/// A proxy that takes whole requests and gives whole answers on: it waits for the end of each. It does not say that it is there.
/// With a hub of its own (`to`) it may also stand in that hub's place.
#[derive(Debug)]
pub struct BufferingProxy {
    address: SocketAddr,
    known: Arc<Known>,
    accepting: JoinHandle<()>,
}

/// What its connections share.
#[derive(Debug, Default)]
struct Known {
    asked: Mutex<Vec<String>>,
    /// Each n-th request or answer is lost; 0 for none.
    loses: AtomicUsize,
}

impl Known {
    /// Notes a request; whether it is lost, and whether its answer is.
    fn note(&self, line: &str) -> (bool, bool) {
        let mut asked = self.asked.lock().expect("nobody panics with it");
        asked.push(line.to_owned());
        let each = self.loses.load(Ordering::Relaxed);
        let lost = each > 0 && asked.len().is_multiple_of(each);
        let request = (asked.len() / each.max(1)).is_multiple_of(2);
        (lost && request, lost && !request)
    }
}

impl BufferingProxy {
    /// Starts one on a free port of loopback.
    ///
    /// # Panics
    /// If there is none.
    pub async fn start(manners: Manners) -> BufferingProxy {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("it is bound");
        let known = Arc::<Known>::default();
        let shared = Arc::clone(&known);
        let accepting = tokio::spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                let known = Arc::clone(&shared);
                // However a connection ends, both ends see it.
                tokio::spawn(async move { drop(serve(stream, manners, &known).await) });
            }
        });
        BufferingProxy {
            address,
            known,
            accepting,
        }
    }

    /// As it stands in `HTTP_PROXY`.
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The first lines of all requests so far.
    ///
    /// # Panics
    /// Never.
    pub fn asked(&self) -> Vec<String> {
        self.known.asked.lock().expect("nobody panics with it").clone()
    }

    /// Loses each n-th request from now on, or, in turn, its answer, and the connection with it.
    pub fn lose_each(&self, count: usize) {
        self.known.loses.store(count, Ordering::Relaxed);
    }
}

impl Drop for BufferingProxy {
    fn drop(&mut self) {
        self.accepting.abort();
    }
}

/// Serves one connection of a client.
async fn serve(mut client: TcpStream, manners: Manners, known: &Known) -> io::Result<()> {
    let mut read = Vec::new();
    loop {
        let Some(head) = take_head(&mut client, &mut read).await? else {
            return Ok(());
        };
        let (line, fields) = head.split_once("\r\n").ok_or(ErrorKind::InvalidData)?;
        let (request_lost, answer_lost) = known.note(line);
        let mut words = line.split(' ');
        let (Some(method), Some(target)) = (words.next(), words.next()) else {
            return Err(ErrorKind::InvalidData.into());
        };
        if method == "CONNECT" {
            return pass(client, target, manners, &read).await;
        }
        let size = field(fields, "content-length").and_then(|size| size.parse().ok());
        let size: usize = size.unwrap_or_default();
        while read.len() < size {
            if client.read_buf(&mut read).await? == 0 {
                return Err(ErrorKind::UnexpectedEof.into());
            }
        }
        let body: Vec<u8> = read.drain(..size).collect();
        if request_lost {
            return Ok(());
        }
        let (head, body) = ask(method, target, fields, &body, manners).await?;
        if answer_lost {
            return Ok(());
        }
        let version = if manners.old { "HTTP/1.0" } else { "HTTP/1.1" };
        let stays = if manners.closes { "close" } else { "keep-alive" };
        let (status, fields) = head.split_once("\r\n").unwrap_or((&head, ""));
        let status = status.split_once(' ').map_or("", |(_, status)| status);
        let kept = fields.split("\r\n").filter(|line| {
            let name = line.split(':').next().unwrap_or_default().to_ascii_lowercase();
            !line.is_empty() && !["connection", "content-length"].contains(&&*name)
        });
        let kept: String = kept.map(|line| format!("{line}\r\n")).collect();
        let size = body.len();
        let head =
            format!("{version} {status}\r\n{kept}Content-Length: {size}\r\nConnection: {stays}\r\n\r\n");
        client.write_all(&[head.as_bytes(), &body].concat()).await?;
        if manners.closes {
            return client.shutdown().await;
        }
    }
}

/// The next head, without the empty line after it; none at the end.
async fn take_head(stream: &mut TcpStream, read: &mut Vec<u8>) -> io::Result<Option<String>> {
    loop {
        if let Some(end) = read.windows(4).position(|four| four == b"\r\n\r\n") {
            let head: Vec<u8> = read.drain(..end + 4).collect();
            let head = String::from_utf8_lossy(&head[..end]).into_owned();
            return Ok(Some(format!("{head}\r\n")));
        }
        if read.len() > HEAD || stream.read_buf(read).await? == 0 {
            return Ok(None);
        }
    }
}

fn field<'a>(fields: &'a str, wanted: &str) -> Option<&'a str> {
    let mut fields = fields.split("\r\n").filter_map(|line| line.split_once(':'));
    let found = fields.find(|(name, _)| name.eq_ignore_ascii_case(wanted));
    found.map(|(_, value)| value.trim())
}

/// Asks the hub, and waits for the end of its answer: its head and its body.
async fn ask(
    method: &str,
    target: &str,
    fields: &str,
    body: &[u8],
    manners: Manners,
) -> io::Result<(String, Vec<u8>)> {
    let rest = target.strip_prefix("http://").unwrap_or(target);
    let at = rest.find('/').unwrap_or(rest.len());
    let (authority, path) = rest.split_at(at);
    let mut hub = reach(authority, manners).await?;
    let kept = fields
        .split("\r\n")
        .filter(|line| !line.is_empty() && !line.to_ascii_lowercase().starts_with("connection:"));
    let kept: String = kept.map(|line| format!("{line}\r\n")).collect();
    // In this version the end of an answer is that of the connection.
    let head = format!("{method} {path} HTTP/1.0\r\n{kept}\r\n");
    hub.write_all(&[head.as_bytes(), body].concat()).await?;
    let mut read = Vec::new();
    let head = take_head(&mut hub, &mut read).await?;
    hub.read_to_end(&mut read).await?;
    Ok((head.ok_or(ErrorKind::UnexpectedEof)?, read))
}

/// Connects to a hub.
async fn reach(named: &str, manners: Manners) -> io::Result<TcpStream> {
    match manners.to {
        Some(hub) => TcpStream::connect(hub).await,
        None => TcpStream::connect(named).await,
    }
}

/// Passes a connection on.
async fn pass(mut client: TcpStream, target: &str, manners: Manners, read: &[u8]) -> io::Result<()> {
    let version = if manners.old { "HTTP/1.0" } else { "HTTP/1.1" };
    if manners.refuses_connect {
        let answer = format!("{version} 403 Forbidden\r\nContent-Length: 7\r\n\r\nnot so\n");
        client.write_all(answer.as_bytes()).await?;
        return client.shutdown().await;
    }
    let mut hub = reach(target, manners).await?;
    let granted = format!("{version} 200 Connection established\r\n\r\n");
    client.write_all(granted.as_bytes()).await?;
    hub.write_all(read).await?;
    copy_bidirectional(&mut client, &mut hub).await.map(drop)
}
