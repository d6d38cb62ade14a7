//! The lines of an MCP client: one JSON-RPC message each, from the standard input and to the standard output.
//!
//! The SDK's own transport passes over what it cannot read; here every such line is answered, and only so many calls are
//! under way at once.

use std::collections::HashSet;
use std::io::{self, BufRead, BufReader, Write};
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use parking_lot::Mutex;
use rmcp::RoleServer;
use rmcp::model::{ClientNotification, JsonRpcMessage, RequestId};
use rmcp::service::{RxJsonRpcMessage, TxJsonRpcMessage};
use rmcp::transport::Transport;
use serde_json::{Value as Json, json};
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::timeout;

use crate::id_of::IdFinder;

/// The longest line; a script may have 64 KiB, and each of its characters may be written as six.
pub(crate) const LONGEST: usize = 512 * 1024;
/// So many calls may be under way.
pub(crate) const AT_ONCE: usize = 16;
/// Lines that wait for their turn, in each direction.
const WAITING: usize = 16;
/// So long the last answers may take to be read.
const FLUSH: Duration = Duration::from_secs(1);

/// JSON-RPC: it is not JSON.
const NOT_JSON: i64 = -32700;
/// JSON-RPC: it is not a request.
const NO_REQUEST: i64 = -32600;
/// Of this server: too much at once.
const BUSY: i64 = -32000;

/// A line that came.
#[derive(Debug, PartialEq)]
enum ClientLine {
    Whole(Vec<u8>),
    /// Its bytes are gone, but for the id of a call.
    TooLong(Json),
}

/// The transport of a server on the standard streams.
pub(crate) struct Stdio {
    lines: mpsc::Receiver<ClientLine>,
    out: mpsc::Sender<String>,
    under_way: Arc<Mutex<HashSet<RequestId>>>,
    /// An answer to what did not reach the server, which waits to be written.
    refusal: Option<String>,
    /// Told when the client has closed its end.
    gone: watch::Sender<bool>,
}

/// Done when all answers are written.
pub(crate) struct Written(oneshot::Receiver<()>);

impl Written {
    /// Waits for it, though not for a client that reads nothing.
    pub(crate) async fn wait(self) {
        // Where nobody reads, nothing is lost.
        let _ = timeout(FLUSH, self.0).await;
    }
}

/// Opens the standard streams; also what is true once the client is gone. Threads read and write them, as reading them
/// cannot be cancelled.
pub(crate) fn open() -> (Stdio, watch::Sender<bool>, Written) {
    let (heard, lines) = mpsc::channel(WAITING);
    let (out, said) = mpsc::channel(WAITING);
    let (done, written) = oneshot::channel();
    thread::spawn(move || read(BufReader::new(io::stdin()), &heard));
    thread::spawn(move || {
        write(io::stdout(), said);
        // Whether anybody waits is not this thread's business.
        let _ = done.send(());
    });
    let gone = watch::Sender::new(false);
    let stdio = Stdio {
        lines,
        out,
        under_way: Arc::default(),
        refusal: None,
        gone: gone.clone(),
    };
    (stdio, gone, Written(written))
}

/// Hands over each line, until the end.
fn read(mut input: impl BufRead, heard: &mpsc::Sender<ClientLine>) {
    let (mut line, mut too_long): (Vec<u8>, Option<IdFinder>) = (Vec::new(), None);
    loop {
        let buffer = match input.fill_buf() {
            Ok([]) | Err(_) => return,
            Ok(buffer) => buffer,
        };
        let end = buffer.iter().position(|byte| *byte == b'\n');
        let piece = &buffer[..end.unwrap_or(buffer.len())];
        if too_long.is_none() && line.len() + piece.len() > LONGEST {
            let mut finder = IdFinder::default();
            finder.feed(&std::mem::take(&mut line));
            too_long = Some(finder);
        }
        match &mut too_long {
            Some(finder) => finder.feed(piece),
            None => line.extend_from_slice(piece),
        }
        let taken = end.map_or(buffer.len(), |end| end + 1);
        input.consume(taken);
        if end.is_some() {
            let whole = std::mem::take(&mut line);
            let next = match too_long.take() {
                Some(finder) => ClientLine::TooLong(finder.id()),
                None => ClientLine::Whole(whole),
            };
            if heard.blocking_send(next).is_err() {
                return;
            }
        }
    }
}

fn write(mut output: impl Write, mut said: mpsc::Receiver<String>) {
    while let Some(line) = said.blocking_recv() {
        if writeln!(output, "{line}").and_then(|()| output.flush()).is_err() {
            return;
        }
    }
}

impl Stdio {
    /// Answers what does not reach the server.
    fn refuse(&mut self, id: &Json, code: i64, text: &str) {
        let answer = json!({"jsonrpc": "2.0", "id": id, "error": {"code": code, "message": text}});
        self.refusal = Some(answer.to_string());
    }

    /// Reads a line; what is for the server.
    fn take(&mut self, line: &[u8]) -> Option<RxJsonRpcMessage<RoleServer>> {
        match parse(line) {
            Ok(JsonRpcMessage::Request(request)) => match self.admit(&request.id) {
                Ok(()) => return Some(JsonRpcMessage::Request(request)),
                Err((code, text)) => self.refuse(&request.id.into_json_value(), code, &text),
            },
            Ok(JsonRpcMessage::Notification(notification)) => {
                if let ClientNotification::CancelledNotification(cancelled) = &notification.notification
                    && let Some(id) = &cancelled.params.request_id
                {
                    // It is not answered any more.
                    self.under_way.lock().remove(id);
                }
                return Some(JsonRpcMessage::Notification(notification));
            }
            // This server asks nothing.
            Ok(JsonRpcMessage::Response(_) | JsonRpcMessage::Error(_)) => {}
            Err(None) => tracing::debug!("a notification that cannot be read"),
            Err(Some((id, code, text))) => self.refuse(&id, code, &text),
        }
        None
    }

    /// Notes a call; the reason if there is no place for it.
    fn admit(&self, id: &RequestId) -> Result<(), (i64, String)> {
        let mut under_way = self.under_way.lock();
        if under_way.contains(id) {
            return Err((NO_REQUEST, format!("the id {id} is that of a call under way")));
        }
        if under_way.len() >= AT_ONCE {
            let text = format!("{AT_ONCE} calls are under way, as many as may be; wait for an answer");
            return Err((BUSY, text));
        }
        under_way.insert(id.clone());
        Ok(())
    }
}

/// Reads a line; for one that is none, the id to answer, or none where no answer is due, the code and the reason.
fn parse(line: &[u8]) -> Result<RxJsonRpcMessage<RoleServer>, Option<(Json, i64, String)>> {
    let error = match serde_json::from_slice(line) {
        Ok(message) => return Ok(message),
        Err(error) => error,
    };
    let json: Json = match serde_json::from_slice(line) {
        Ok(json) => json,
        Err(error) => return Err(Some((Json::Null, NOT_JSON, format!("this is not JSON: {error}")))),
    };
    let id = json.get("id").filter(|id| id.is_string() || id.is_i64());
    match id {
        // JSON-RPC: nobody answers a notification.
        None if json.get("method").is_some_and(Json::is_string) && json.get("id").is_none() => Err(None),
        id => Err(Some((
            id.cloned().unwrap_or_default(),
            NO_REQUEST,
            format!("this is not a request of MCP: {error}"),
        ))),
    }
}

impl Transport<RoleServer> for Stdio {
    type Error = io::Error;

    fn send(
        &mut self,
        item: TxJsonRpcMessage<RoleServer>,
    ) -> impl Future<Output = io::Result<()>> + Send + 'static {
        let (out, under_way) = (self.out.clone(), Arc::clone(&self.under_way));
        async move {
            let id = match &item {
                JsonRpcMessage::Response(response) => Some(&response.id),
                JsonRpcMessage::Error(error) => error.id.as_ref(),
                _ => None,
            };
            let line = serde_json::to_string(&item)?;
            let sent = out.send(line).await;
            // Only now, so that calls of a client that reads nothing count.
            if let Some(id) = id {
                under_way.lock().remove(id);
            }
            sent.map_err(|_| io::Error::from(io::ErrorKind::BrokenPipe))
        }
    }

    // It is dropped whenever the server has something else to do, so that nothing may be in its hands while it waits.
    async fn receive(&mut self) -> Option<RxJsonRpcMessage<RoleServer>> {
        loop {
            if self.refusal.is_some() {
                let place = self.out.reserve().await.ok()?;
                if let Some(refusal) = self.refusal.take() {
                    place.send(refusal);
                }
            }
            let Some(line) = self.lines.recv().await else {
                self.gone.send_replace(true);
                return None;
            };
            match line {
                ClientLine::Whole(line) if line.iter().all(u8::is_ascii_whitespace) => {}
                ClientLine::Whole(line) => {
                    if let Some(message) = self.take(&line) {
                        return Some(message);
                    }
                }
                ClientLine::TooLong(id) => {
                    let text = format!("a line of more than {LONGEST} bytes; nothing of it was read");
                    self.refuse(&id, NO_REQUEST, &text);
                }
            }
        }
    }

    async fn close(&mut self) -> io::Result<()> {
        self.lines.close();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(input: &[u8]) -> Vec<ClientLine> {
        let (heard, mut lines) = mpsc::channel(WAITING);
        read(input, &heard);
        drop(heard);
        std::iter::from_fn(|| lines.blocking_recv()).collect()
    }

    #[test]
    fn a_line_has_an_end_and_a_limit() {
        let long = vec![b'a'; LONGEST + 1];
        let whole = |text: &[u8]| ClientLine::Whole(text.to_vec());
        for (input, expected) in [
            (&b"one\ntwo\n"[..], vec![whole(b"one"), whole(b"two")]),
            (b"no end", vec![]),
            (b"\n", vec![whole(b"")]),
            (
                &[&long[..], b"\nnext\n"].concat(),
                vec![ClientLine::TooLong(Json::Null), whole(b"next")],
            ),
            (&[&long[1..], b"\n"].concat(), vec![whole(&long[1..])]),
            (&long, vec![]),
        ] {
            assert!(lines(input) == expected, "{} bytes", input.len());
        }
    }

    #[test]
    fn what_is_no_request_is_told() {
        for (line, expected) in [
            ("nonsense", Some((Json::Null, NOT_JSON))),
            ("{", Some((Json::Null, NOT_JSON))),
            ("[]", Some((Json::Null, NO_REQUEST))),
            ("7", Some((Json::Null, NO_REQUEST))),
            (r#"{"id":7}"#, Some((json!(7), NO_REQUEST))),
            (r#"{"id":"a","method":8}"#, Some((json!("a"), NO_REQUEST))),
            (r#"{"id":[],"method":"ping"}"#, Some((Json::Null, NO_REQUEST))),
            (r#"{"method":"notifications/cancelled","params":7}"#, None),
        ] {
            let told = parse(line.as_bytes()).expect_err(line);
            assert_eq!(told.map(|(id, code, _)| (id, code)), expected, "{line}");
        }
        let deep = "[".repeat(100_000);
        assert!(matches!(
            parse(deep.as_bytes()),
            Err(Some((Json::Null, NOT_JSON, _)))
        ));
        assert!(parse(br#"{"jsonrpc":"2.0","id":1,"method":"ping"}"#).is_ok());
    }
}
