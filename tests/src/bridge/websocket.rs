//! Frames of a WebSocket around whatever bytes.

use std::io;
use std::net::SocketAddr;

use bytes::{Buf as _, BytesMut};
use mom_proto::codec::Form;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};

use crate::asking::{Asking, upgrade};

const LAST: u8 = 0x80;
const CONTINUATION: u8 = 0;
const TEXT: u8 = 1;
const BINARY: u8 = 2;
const CLOSE: u8 = 8;

pub(super) async fn carry(near: TcpStream, hub: SocketAddr, form: Form) -> io::Result<()> {
    let (protocol, text) = match form {
        Form::Json => ("mom.json.v1", true),
        _ => ("mom.bin.v1", false),
    };
    let mut asking = Asking::connect(hub).await;
    let lines = upgrade(protocol);
    let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
    let answer = asking.ask("GET /mom", &lines, b"").await;
    if answer.status != 101 {
        return Err(io::Error::other(format!("{answer:?}")));
    }
    let (hub, arrived) = asking.into_parts();
    let (from_hub, to_hub) = hub.into_split();
    let (from_near, to_near) = near.into_split();
    tokio::try_join!(up(from_near, to_hub, text), down(from_hub, arrived, to_near)).map(|_| ())
}

async fn up(mut near: OwnedReadHalf, mut hub: OwnedWriteHalf, text: bool) -> io::Result<()> {
    let mut bytes = vec![0; 16 * 1024];
    let mut in_message = false;
    loop {
        let count = near.read(&mut bytes).await?;
        if count == 0 {
            hub.write_all(&frame(LAST | CLOSE, &[])).await?;
            return hub.shutdown().await;
        }
        if !text {
            hub.write_all(&frame(LAST | BINARY, &bytes[..count])).await?;
            continue;
        }
        // A line is a message; one that is not whole yet begins it.
        for piece in bytes[..count].split_inclusive(|byte| *byte == b'\n') {
            let (line, last) = match piece.strip_suffix(b"\n") {
                Some(line) => (line, LAST),
                None => (piece, 0),
            };
            let kind = if in_message { CONTINUATION } else { TEXT };
            in_message = last == 0;
            hub.write_all(&frame(kind | last, line)).await?;
        }
    }
}

/// A frame of a client, whose mask changes nothing.
fn frame(first: u8, payload: &[u8]) -> Vec<u8> {
    let size = u16::try_from(payload.len()).expect("a small frame").to_be_bytes();
    [&[first, 0x80 | 126][..], &size, &[0; 4], payload].concat()
}

async fn down(mut hub: OwnedReadHalf, mut arrived: BytesMut, mut near: OwnedWriteHalf) -> io::Result<()> {
    loop {
        while let Some((first, payload)) = take(&mut arrived) {
            match first & 0x0f {
                CLOSE => return near.shutdown().await,
                _ => near.write_all(&payload).await?,
            }
        }
        if hub.read_buf(&mut arrived).await? == 0 {
            return near.shutdown().await;
        }
    }
}

/// The next frame of a hub, once it is here.
pub(crate) fn take(arrived: &mut BytesMut) -> Option<(u8, BytesMut)> {
    let (first, second) = (*arrived.first()?, *arrived.get(1)?);
    let digits = match second {
        126 => 2,
        127 => 8,
        _ => 0,
    };
    let size = arrived.get(2..2 + digits)?;
    let size = match digits {
        0 => usize::from(second),
        _ => size.iter().fold(0, |size, byte| size << 8 | usize::from(*byte)),
    };
    if arrived.len() < 2 + digits + size {
        return None;
    }
    arrived.advance(2 + digits);
    Some((first, arrived.split_to(size)))
}
