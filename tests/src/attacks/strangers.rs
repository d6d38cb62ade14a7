//! What strangers send who have not logged in.

use std::net::SocketAddr;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::time::timeout;

use crate::asking::{Asking, request, upgrade};
use crate::bridge::websocket::take;
use crate::raw::PATIENCE;

/// WebSocket frames of nothing, with a mask of zeros: a ping, and an empty binary message.
pub(super) const NOTHING: [[u8; 6]; 2] = [[0x89, 0x80, 0, 0, 0, 0], [0x82, 0x80, 0, 0, 0, 0]];

/// Sends such a frame again and again until the hub closes; gives the status with which it does.
pub(super) async fn flood(address: SocketAddr, frame: [u8; 6]) -> u16 {
    let mut asking = Asking::connect(address).await;
    let lines = upgrade("mom.bin.v1");
    let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
    let answer = asking.ask("GET /mom", &lines, b"").await;
    assert_eq!(answer.status, 101, "{answer:?}");
    let (stream, said) = asking.into_parts();
    let (mut reads, mut writes) = stream.into_split();
    let frames = frame.repeat(10_000);
    let flooding = tokio::spawn(async move { while writes.write_all(&frames).await.is_ok() {} });
    let mut heard = said;
    while let Ok(Ok(1..)) = timeout(PATIENCE, reads.read_buf(&mut heard)).await {}
    flooding.abort();
    // Behind answers to pings, and what the hub says itself: a close with its status.
    loop {
        if let (0x88, status) = take(&mut heard).expect("it says why") {
            return u16::from_be_bytes([status[0], status[1]]);
        }
    }
}

/// Asks so often on one connection without waiting for answers; gives the status of each that comes.
pub(super) async fn ask_much(address: SocketAddr, times: usize) -> Vec<u16> {
    let mut asking = Asking::connect(address).await;
    asking
        .send(request("GET /nothing", &["Host: hub"], b"").repeat(times))
        .await;
    let mut statuses = Vec::new();
    while statuses.len() < times
        && let Some(answer) = asking.answer().await
    {
        statuses.push(answer.status);
    }
    statuses
}
