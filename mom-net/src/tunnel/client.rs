//! A client's end of a tunnel: some requests bring bytes up, others bring them down.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use bytes::{Bytes, BytesMut};
use http::header::{CACHE_CONTROL, CONTENT_TYPE, HOST, HeaderMap, PROXY_AUTHORIZATION};
use http::uri::PathAndQuery;
use http::{HeaderName, HeaderValue, Method, Request, Response, StatusCode};
use http_body_util::{BodyExt as _, Full};
use hyper::body::Incoming;
use hyper::client::conn::http1;
use mom_proto::codec::Form;
use parking_lot::Mutex;
use tokio::sync::Notify;
use tokio::time::{Instant, sleep, timeout};

use super::pipe::{Misplaced, Pipe, WINDOW};
use super::{END, ID, LONGEST, MOST_UP, SENT, TAKEN};
use crate::carrier::Carrier;
use crate::dial::Dialer;
use crate::{Address, ClientTls, Door, HttpStream, NetError, Privacy, http as http_door};

/// Brought up by one request before login: the hub takes one parcel.
const MOST_BEFORE_LOGIN: usize = 16 * 1024;

/// An answer that the hub lets last takes so much longer at most.
const PATIENCE: Duration = Duration::from_secs(10);

/// Bytes that were sent and are not here after so long are held back by an intermediary that buffers the whole answer.
const HELD_BACK: Duration = Duration::from_secs(1);

/// Requests that fail are made again after these times; then the tunnel is broken.
const AGAIN: [Duration; 4] = [
    Duration::from_millis(50),
    Duration::from_millis(250),
    Duration::from_secs(1),
    Duration::from_secs(3),
];

/// Opens a tunnel to a hub; gives what goes through it, and who could read along.
pub(crate) async fn connect(dialer: Dialer) -> Result<(Arc<Pipe>, Privacy), NetError> {
    let dialer = Arc::new(dialer);
    let streams = dialer.address.door != (Door::Tunnel { polled: true });
    let mut up = Requests::new(&dialer);
    let carrier = dialer.dial().await?;
    let privacy = carrier.privacy();
    up.take(carrier).await?;
    let answer = timeout(PATIENCE, up.ask(Method::POST, "/tunnel", Bytes::new())).await;
    let (head, said) = answer.map_err(|_| io::Error::from(io::ErrorKind::TimedOut))??;
    let id = read_id(&head.headers).filter(|_| head.status == StatusCode::CREATED);
    let id = id.ok_or_else(|| dialer.named(http_door::refusal(head.status, &said)))?;
    let tunnel = Arc::new(Tunnel {
        pipe: Arc::default(),
        id: Mutex::new(id),
        renewed: Notify::new(),
        acknowledge: Notify::new(),
        acknowledged: AtomicU64::new(0),
        expected: AtomicU64::new(0),
        expects: Notify::new(),
    });
    let pipe = Arc::clone(&tunnel.pipe);
    let down = Requests::new(&dialer);
    tokio::spawn(async move {
        tokio::select! {
            // It ends first where the hub closes.
            () = tunnel.bring_down(down, streams) => {}
            () = tunnel.bring_up(up) => {}
        }
        tunnel.pipe.break_off("the tunnel is closed");
    });
    Ok((pipe, privacy))
}

/// Posts a document of JSON to a hub by plain HTTP, through the proxy of the environment if it names one; gives what is answered.
///
/// # Errors
/// A link that cannot be had, or nothing like an answer in time.
pub async fn post(
    host: &str,
    port: u16,
    path: &str,
    document: impl Into<Bytes>,
) -> Result<(StatusCode, Bytes), NetError> {
    let request = Request::post(path)
        .header(CONTENT_TYPE, "application/json")
        .body(document.into())
        .map_err(io::Error::other)?;
    let answer = ask_once(&http_address(host, port, false), None, request).await?;
    Ok((answer.status(), answer.into_body()))
}

/// Sends a request to the server that its URL names, which is not a hub, over a connection of its own and through the proxy of the
/// environment if it names one; gives the whole answer. `https` needs to know whom to trust.
///
/// # Errors
/// A URL without a host, a link that cannot be had, or nothing like an answer in time.
pub async fn ask(tls: Option<&ClientTls>, request: Request<Bytes>) -> Result<Response<Bytes>, NetError> {
    let url = request.uri();
    let host = url.host().ok_or_else(|| {
        let text = format!("{url} has no host: write http://HOST:PORT or https://HOST:PORT");
        io::Error::new(io::ErrorKind::InvalidInput, text)
    })?;
    let host = host.trim_start_matches('[').trim_end_matches(']');
    let secure = url.scheme_str() == Some("https");
    let port = url.port_u16().unwrap_or(if secure { 443 } else { 80 });
    ask_once(&http_address(host, port, secure), tls, request).await
}

fn ask_once<'a>(
    address: &'a Address,
    tls: Option<&'a ClientTls>,
    request: Request<Bytes>,
) -> Pin<Box<dyn Future<Output = Result<Response<Bytes>, NetError>> + Send + 'a>> {
    // Boxed, so that the client of HTTP is compiled here, and not in each crate that asks.
    Box::pin(ask_over_a_link(address, tls, request))
}

async fn ask_over_a_link(
    address: &Address,
    tls: Option<&ClientTls>,
    request: Request<Bytes>,
) -> Result<Response<Bytes>, NetError> {
    let mut requests = Requests::new(&Arc::new(Dialer::to(address, tls)?));
    let answer = timeout(PATIENCE, async {
        whole(requests.send(request.map(Full::new)).await?).await
    });
    let (head, body) = answer
        .await
        .map_err(|_| io::Error::from(io::ErrorKind::TimedOut))??;
    Ok(Response::from_parts(head, body))
}

/// A server of HTTP, as an address.
fn http_address(host: &str, port: u16, tls: bool) -> Address {
    Address {
        form: Form::Binary,
        door: Door::Tunnel { polled: true },
        tls,
        host: host.to_owned(),
        port,
        path: None,
        pin: None,
        any: false,
        port_named: true,
    }
}

#[derive(Debug)]
struct Tunnel {
    pipe: Arc<Pipe>,
    id: Mutex<String>,
    /// The id is another.
    renewed: Notify,
    /// It is time to say how much has come down.
    acknowledge: Notify,
    acknowledged: AtomicU64,
    /// What the hub says that it has sent.
    expected: AtomicU64,
    expects: Notify,
}

impl Tunnel {
    /// Brings up what is written, until all of it is there.
    async fn bring_up(&self, mut requests: Requests) {
        let mut most = MOST_BEFORE_LOGIN;
        loop {
            let at = self.pipe.kept_from();
            let bytes = tokio::select! {
                bytes = self.pipe.bytes_from(at, most) => bytes,
                () = self.acknowledge.notified() => Some(Bytes::new()),
            };
            let end = bytes.is_none();
            let said = if end { "&end=1" } else { "" };
            let request = |here: u64, id: &str| format!("/tunnel/{id}?at={at}&ack={here}{said}");
            let Some((status, headers)) = self
                .post(&mut requests, &request, bytes.unwrap_or_default())
                .await
            else {
                return;
            };
            let taken = number(&headers, &TAKEN);
            if let Some(id) = read_id(&headers) {
                *self.id.lock() = id;
                self.renewed.notify_waiters();
                most = MOST_UP;
            }
            if let Some(sent) = number(&headers, &SENT) {
                self.expected.fetch_max(sent, Ordering::AcqRel);
                self.expects.notify_waiters();
            }
            match (status, taken) {
                (StatusCode::OK | StatusCode::CONFLICT, Some(taken))
                    if self.pipe.acknowledge(taken) && taken >= at => {}
                (StatusCode::SERVICE_UNAVAILABLE, _) => sleep(AGAIN[0]).await,
                _ => {
                    return self
                        .pipe
                        .break_off(&format!("the hub answers {status} through the tunnel"));
                }
            }
            if end && status == StatusCode::OK {
                // What it says last still comes down.
                std::future::pending::<()>().await;
            }
        }
    }

    async fn post(
        &self,
        requests: &mut Requests,
        target: &impl Fn(u64, &str) -> String,
        bytes: Bytes,
    ) -> Option<(StatusCode, HeaderMap)> {
        let mut failures = AGAIN.iter();
        loop {
            let (here, id) = (self.pipe.arrived_to(), self.id.lock().clone());
            let path = target(here, &id);
            let asked = requests.ask(Method::POST, &path, bytes.clone());
            match timeout(LONGEST + PATIENCE, asked).await {
                Ok(Ok((head, _))) if !is_gateway(head.status) => {
                    self.acknowledged.fetch_max(here, Ordering::AcqRel);
                    return Some((head.status, head.headers));
                }
                failed => {
                    requests.sender = None;
                    let Some(pause) = failures.next() else {
                        self.pipe.break_off(&why(failed));
                        return None;
                    };
                    sleep(*pause).await;
                }
            }
        }
    }

    /// Brings down what the hub says, as a stream or, where an intermediary holds that back, by asking again and again.
    async fn bring_down(&self, mut requests: Requests, mut streams: bool) {
        let mut failures = AGAIN.iter();
        loop {
            let (at, id) = (self.pipe.arrived_to(), self.id.lock().clone());
            let wait = match streams {
                true => String::new(),
                false => format!("&wait={}", LONGEST.as_millis()),
            };
            let target = format!("/tunnel/{id}?at={at}{wait}");
            self.acknowledged.fetch_max(at, Ordering::AcqRel);
            let read = async {
                let answer = requests.open(Method::GET, &target, Bytes::new()).await?;
                self.read_down(answer, at, &id).await
            };
            let read = tokio::select! {
                read = timeout(LONGEST + PATIENCE, read) => read,
                () = self.held_back(), if streams => Ok(Ok(Read::HeldBack)),
            };
            match read {
                Ok(Ok(Read::Some)) => failures = AGAIN.iter(),
                Ok(Ok(Read::HeldBack)) => {
                    tracing::debug!("the tunnel polls: an intermediary buffers the stream");
                    (streams, requests.sender) = (false, None);
                }
                Ok(Ok(Read::End)) => return self.pipe.took_all(),
                failed => {
                    requests.sender = None;
                    let Some(pause) = failures.next() else {
                        let failed = failed.map(|read| read.map(drop));
                        return self.pipe.break_off(&why(failed));
                    };
                    sleep(*pause).await;
                }
            }
        }
    }

    async fn read_down(&self, answer: Response<Incoming>, mut at: u64, id: &str) -> io::Result<Read> {
        match answer.status() {
            StatusCode::OK if answer.headers().contains_key(END) => return Ok(Read::End),
            StatusCode::OK => {}
            // Its id may just have been renewed.
            StatusCode::NOT_FOUND => {
                let renewed = timeout(PATIENCE, self.is_renewed(id)).await;
                return Ok(if renewed.is_ok() { Read::Some } else { Read::End });
            }
            status => return Err(io::Error::other(format!("the hub answers {status}"))),
        }
        let mut body = answer.into_body();
        while let Some(frame) = body.frame().await {
            let Ok(bytes) = frame.map_err(io::Error::other)?.into_data() else {
                continue;
            };
            while let Err(Misplaced::Full(_)) = self.pipe.take_in(at, &bytes) {
                self.pipe.settle().await;
            }
            at += bytes.len() as u64;
            let known = self.acknowledged.load(Ordering::Acquire);
            if at.saturating_sub(known) >= WINDOW as u64 / 4 {
                self.acknowledge.notify_one();
            }
        }
        Ok(Read::Some)
    }

    async fn is_renewed(&self, old: &str) {
        loop {
            let mut renewed = std::pin::pin!(self.renewed.notified());
            renewed.as_mut().enable();
            if *self.id.lock() != old {
                return;
            }
            renewed.await;
        }
    }

    /// Waits until bytes are missing that the hub has sent a while ago.
    async fn held_back(&self) {
        loop {
            let mut expects = std::pin::pin!(self.expects.notified());
            expects.as_mut().enable();
            let expected = self.expected.load(Ordering::Acquire);
            if self.pipe.arrived_to() >= expected {
                expects.await;
                continue;
            }
            let until = Instant::now() + HELD_BACK;
            tokio::time::sleep_until(until).await;
            if self.pipe.arrived_to() < expected && !self.pipe.is_full() {
                return;
            }
        }
    }
}

/// What has come of asking for more.
enum Read {
    Some,
    HeldBack,
    End,
}

/// Whether a proxy says that it did not get through.
fn is_gateway(status: StatusCode) -> bool {
    matches!(status, StatusCode::BAD_GATEWAY | StatusCode::GATEWAY_TIMEOUT)
}

fn why<T>(failed: Result<io::Result<T>, tokio::time::error::Elapsed>) -> String {
    match failed {
        Ok(Err(error)) => format!("the tunnel broke off: {error}"),
        Ok(Ok(_)) => "the tunnel broke off: a proxy cannot reach the hub".to_owned(),
        Err(_) => "the tunnel broke off: no answer came".to_owned(),
    }
}

fn number(headers: &HeaderMap, name: &HeaderName) -> Option<u64> {
    headers.get(name)?.to_str().ok()?.parse().ok()
}

fn read_id(headers: &HeaderMap) -> Option<String> {
    let id = headers.get(ID)?.to_str().ok()?;
    let digits = id.len() == 32 && id.bytes().all(|digit| digit.is_ascii_hexdigit());
    digits.then(|| id.to_owned())
}

/// Requests one after the other, over one connection as long as it lasts.
struct Requests {
    dialer: Arc<Dialer>,
    sender: Option<http1::SendRequest<Full<Bytes>>>,
}

impl Requests {
    fn new(dialer: &Arc<Dialer>) -> Requests {
        Requests {
            dialer: Arc::clone(dialer),
            sender: None,
        }
    }

    async fn take(&mut self, carrier: Carrier) -> Result<(), NetError> {
        carrier.prepare()?;
        let stream = HttpStream::new(carrier, BytesMut::new());
        let (sender, connection) = http1::handshake(stream).await.map_err(http_door::into_io)?;
        // Ends with the sender; errors are told to the caller.
        tokio::spawn(async move { drop(connection.await) });
        self.sender = Some(sender);
        Ok(())
    }

    /// Asks, and waits for the head of the answer.
    async fn open(&mut self, method: Method, path: &str, body: Bytes) -> io::Result<Response<Incoming>> {
        let mut request = Request::builder().method(method).uri(path);
        if !body.is_empty() {
            request = request.header(CONTENT_TYPE, "application/octet-stream");
        }
        let request = request.body(Full::new(body)).map_err(io::Error::other)?;
        self.send(request).await
    }

    /// Sends a request, whose headers are completed, and waits for the head of the answer.
    async fn send(&mut self, mut request: Request<Full<Bytes>>) -> io::Result<Response<Incoming>> {
        let usable = match &mut self.sender {
            Some(sender) => sender.ready().await.is_ok(),
            None => false,
        };
        if !usable {
            let carrier = self.dialer.dial().await.map_err(into_io)?;
            self.take(carrier).await.map_err(into_io)?;
        }
        let path = request.uri().path_and_query().map_or("/", PathAndQuery::as_str);
        let (target, authorization) = self.dialer.target(path);
        *request.uri_mut() = target.parse().map_err(io::Error::other)?;
        let host = self.dialer.address.authority();
        let host = HeaderValue::from_str(&host).map_err(io::Error::other)?;
        let headers = request.headers_mut();
        headers.insert(HOST, host);
        headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
        if let Some(authorization) = authorization {
            headers.insert(PROXY_AUTHORIZATION, authorization);
        }
        let sender = self.sender.as_mut().ok_or(io::ErrorKind::NotConnected)?;
        sender.send_request(request).await.map_err(http_door::into_io)
    }

    /// Asks, and waits for all of the answer.
    async fn ask(
        &mut self,
        method: Method,
        path: &str,
        body: Bytes,
    ) -> io::Result<(http::response::Parts, Bytes)> {
        whole(self.open(method, path, body).await?).await
    }
}

/// Waits for the rest of an answer.
async fn whole(answer: Response<Incoming>) -> io::Result<(http::response::Parts, Bytes)> {
    let (head, body) = answer.into_parts();
    let body = http_body_util::Limited::new(body, MOST_UP).collect().await;
    Ok((head, body.map_err(io::Error::other)?.to_bytes()))
}

fn into_io(error: NetError) -> io::Error {
    match error {
        NetError::Io(error) => error,
        other => io::Error::other(other),
    }
}
