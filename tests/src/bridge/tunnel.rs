//! Requests of HTTP around whatever bytes.

use std::io;
use std::net::SocketAddr;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::sync::Mutex;

use crate::asking::{Answer, Asking};

/// Brought up at once: less than a stranger may, and less than a peer may.
const MOST_BEFORE_LOGIN: usize = 8 * 1024;
const MOST_UP: usize = 120 * 1024;

struct Tunnel {
    hub: SocketAddr,
    /// Another one from the login on; held while a request goes up whose answer may say so.
    id: Mutex<String>,
}

pub(super) async fn carry(near: TcpStream, hub: SocketAddr) -> io::Result<()> {
    let mut asking = Asking::connect(hub).await;
    let answer = asking.ask("POST /tunnel", &["Host: 127.0.0.1"], b"").await;
    let id = answer
        .header("mom-tunnel")
        .ok_or_else(|| io::Error::other(format!("{answer:?}")))?;
    let id = Mutex::new(id.to_owned());
    let tunnel = Tunnel { hub, id };
    let (from_near, to_near) = near.into_split();
    tokio::select! {
        // A side that has finished sending may still receive.
        Err(error) = tunnel.up(from_near) => Err(error),
        ended = tunnel.down(to_near) => ended,
    }
}

impl Tunnel {
    async fn up(&self, mut near: OwnedReadHalf) -> io::Result<()> {
        let mut asking = Asking::connect(self.hub).await;
        let mut larger = false;
        let (mut bytes, mut at) = (vec![0; MOST_BEFORE_LOGIN], 0);
        loop {
            let count = near.read(&mut bytes).await?;
            let end = if count == 0 { "&end=1" } else { "" };
            loop {
                let mut id = self.id.lock().await;
                let first = format!("POST /tunnel/{id}?at={at}{end}");
                let answer = again(&mut asking, self.hub, &first, &bytes[..count]).await;
                if let Some(new) = answer.header("mom-tunnel") {
                    *id = new.to_owned();
                    larger = true;
                }
                match answer.status {
                    200 => break,
                    // It has more than it has read: the same again.
                    503 => {}
                    // What it has still to say is for the other direction.
                    _ => return Ok(()),
                }
            }
            at += count;
            if count == 0 {
                return Ok(());
            }
            if larger {
                bytes.resize(MOST_UP, 0);
            }
        }
    }

    async fn down(&self, mut near: OwnedWriteHalf) -> io::Result<()> {
        let mut asking = Asking::connect(self.hub).await;
        let (mut at, mut id) = (0, self.id.lock().await.clone());
        loop {
            let first = format!("GET /tunnel/{id}?at={at}&wait=5000");
            let answer = again(&mut asking, self.hub, &first, b"").await;
            if answer.status == 404 {
                let now = self.id.lock().await.clone();
                if now != id {
                    id = now;
                    continue;
                }
            }
            if answer.status != 200 || answer.header("mom-end").is_some() {
                return near.shutdown().await;
            }
            near.write_all(&answer.body).await?;
            at += answer.body.len();
        }
    }
}

/// Asks, over a new connection if the hub has closed this one, as it may at any time.
async fn again(asking: &mut Asking, hub: SocketAddr, first: &str, body: &[u8]) -> Answer {
    loop {
        asking
            .send(crate::asking::request(first, &["Host: 127.0.0.1"], body))
            .await;
        match asking.answer().await {
            Some(answer) => return answer,
            None => *asking = Asking::connect(hub).await,
        }
    }
}
