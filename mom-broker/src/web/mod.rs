//! What HTTP asks of a hub: to become a WebSocket, a tunnel, its health and figures, what a user may see of it, and the console.

mod answers;
mod api;
mod console;
mod forwarded;
mod image;
mod metrics;
mod origins;
mod reports;
mod tunnels;
mod visitors;

use std::convert::Infallible;
use std::future::{pending, poll_fn};
use std::net::{IpAddr, SocketAddr};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use http::header::{
    CONNECTION, CONTENT_ENCODING, CONTENT_LENGTH, HOST, HeaderMap, ORIGIN, TRANSFER_ENCODING,
};
use http::{HeaderValue, Method, Request, Response, StatusCode, Version};
use hyper::body::{Body as _, Incoming};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::TokioTimer;
use mom_config::{Network, WebConfig};
use mom_login::KeyFile;
use mom_net::{HttpStream, Privacy, Protocol, Takes, Transceiver, Tunnels, WebSocketUpgrade};
use mom_proto::{Path, WireError};
use parking_lot::{Mutex, RwLock};
use tokio::sync::oneshot;
use tokio::time::{Instant, sleep_until};

use crate::connection::{AdmissionLimiter, Remote, Seat, Seated, Services, login_time, login_timeout};

use answers::{Body, allow, allow_all, refuse};
use console::Files;
use origins::Origins;
use reports::Reports;
use visitors::Visitors;

/// The head of a request in bytes, and its lines.
const HEAD: usize = 16 * 1024;
const LINES: usize = 64;

/// How long a connection may wait for its next request.
const IDLE: Duration = Duration::from_secs(60);

/// All that is asked by HTTP.
#[derive(Debug)]
pub(crate) struct Web {
    doors: Arc<AdmissionLimiter>,
    tunnels: Arc<Tunnels>,
    rules: RwLock<Arc<Rules>>,
    visitors: Arc<Visitors>,
    reports: Reports,
    console: &'static Files,
    begun: Instant,
}

/// What the configuration says.
#[derive(Debug)]
struct Rules {
    origins: Origins,
    forwarded_by: Vec<Network>,
    metrics_token: Option<KeyFile>,
    log: Option<Path>,
    console: bool,
}

/// One connection that asks by HTTP.
pub(crate) struct Visit {
    pub(crate) services: Services,
    pub(crate) remote: Remote,
    /// The address that it has come to.
    pub(crate) local: SocketAddr,
    pub(crate) takes: Takes,
    pub(crate) seated: Seated,
    /// When it is not a stranger any more, or goes.
    pub(crate) login_by: Instant,
}

/// What the requests of one connection share.
struct HttpConnection {
    web: Arc<Web>,
    services: Services,
    remote: Remote,
    local: SocketAddr,
    takes: Takes,
    privacy: Privacy,
    seat: Mutex<Option<Seat>>,
    upgrade: Mutex<Option<Upgrade>>,
    /// A whole head has come.
    asked: AtomicBool,
}

/// What a connection becomes after its last request.
struct Upgrade {
    websocket: WebSocketUpgrade,
    remote: Remote,
}

impl Web {
    pub(crate) fn new(doors: Arc<AdmissionLimiter>, config: &WebConfig) -> Web {
        Web {
            doors,
            tunnels: Arc::default(),
            rules: RwLock::new(Arc::new(Rules::new(config))),
            visitors: Arc::default(),
            reports: Reports::default(),
            console: Files::embedded(),
            begun: Instant::now(),
        }
    }

    /// Goes by another configuration from now on.
    pub(crate) fn replace(&self, config: &WebConfig) {
        *self.rules.write() = Arc::new(Rules::new(config));
    }

    /// Which build of the console is served; none if none was built in, or it is switched off.
    pub(crate) fn console(&self) -> Option<&str> {
        self.console.build().filter(|_| self.rules().console)
    }

    fn rules(&self) -> Arc<Rules> {
        Arc::clone(&self.rules.read())
    }

    /// Answers the requests of a connection; gives it back, whose it is, and its seat, if it has become a peer's.
    pub(crate) async fn serve(
        self: &Arc<Web>,
        stream: HttpStream,
        visit: Visit,
    ) -> Option<(Transceiver, Remote, Seat)> {
        let Visit {
            services,
            remote,
            local,
            takes,
            seated: (seat, told),
            login_by,
        } = visit;
        let limits = Arc::clone(&services.limits);
        let shared = Arc::new(HttpConnection {
            web: Arc::clone(self),
            services,
            remote,
            local,
            takes,
            privacy: stream.privacy(),
            seat: Mutex::new(Some(seat)),
            upgrade: Mutex::default(),
            asked: AtomicBool::new(false),
        });
        let asked = Arc::clone(&shared);
        let service = service_fn(move |request| {
            let asked = Arc::clone(&asked);
            Box::pin(async move { Ok::<_, Infallible>(asked.answer(request).await) })
        });
        let mut connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(IDLE.min(login_time(&limits)))
            .max_buf_size(HEAD)
            .max_headers(LINES)
            .serve_connection(stream, service);
        let (mut evicted, mut login_by) = (pin!(evicted(told)), pin!(sleep_until(login_by)));
        let mut leaving = false;
        let refused = loop {
            tokio::select! {
                served = poll_fn(|context| connection.poll_without_shutdown(context)) => break match served {
                    Err(error) if error.is_timeout() => {
                        Some((StatusCode::REQUEST_TIMEOUT, login_timeout(limits.login_time)))
                    }
                    Err(error) => {
                        tracing::debug!(from = ?remote.from, %error, "HTTP ended");
                        None
                    }
                    Ok(()) => None,
                },
                error = &mut evicted => break Some((StatusCode::SERVICE_UNAVAILABLE, error)),
                () = &mut login_by, if !leaving => {
                    leaving = true;
                    // A client that asks on without end has a place for a while, and comes again for another.
                    if shared.seat.lock().as_ref().is_some_and(Seat::is_stranger) {
                        std::pin::Pin::new(&mut connection).graceful_shutdown();
                    }
                }
            }
        };
        let parts = connection.into_parts();
        let upgrade = shared.upgrade.lock().take();
        let Some(upgrade) = upgrade.filter(|_| refused.is_none()) else {
            shared.part(parts.io, refused).await;
            return None;
        };
        let limits = limits.before_login();
        let Upgrade { websocket, remote } = upgrade;
        let begun = websocket.start(parts.io, &parts.read_buf, &limits).await;
        let seat = shared.seat.lock().take()?;
        Some((begun.ok()?, remote, seat))
    }
}

impl Rules {
    fn new(config: &WebConfig) -> Rules {
        Rules {
            origins: Origins::new(&config.origins),
            forwarded_by: config.forwarded_by.clone(),
            metrics_token: config.metrics_token.clone(),
            console: config.console,
            log: config.log.as_deref().and_then(|path| Path::parse(path).ok()),
        }
    }
}

/// Waits until a connection has to go for others.
async fn evicted(told: oneshot::Receiver<WireError>) -> WireError {
    match told.await {
        Ok(error) => error,
        Err(_) => pending().await,
    }
}

impl HttpConnection {
    /// Ends the connection. One that has asked nothing yet hears why; later nobody knows where in an answer it is.
    async fn part(&self, stream: HttpStream, refused: Option<(StatusCode, WireError)>) {
        match refused {
            None => stream.close(&[]).await,
            Some((status, error)) if !self.asked.load(Ordering::Relaxed) => {
                let code = error.code.word();
                if self.services.is_first("closed", self.remote.from, Some(code)) {
                    tracing::info!(from = ?self.remote.from, code, "closed");
                }
                stream.close(&answers::raw(status, &error)).await;
            }
            // At once: nothing is under way, or its descriptor is another connection's.
            Some(_) => {}
        }
    }

    async fn answer(self: Arc<HttpConnection>, request: Request<Incoming>) -> Response<Body> {
        self.asked.store(true, Ordering::Relaxed);
        let (origin, head) = (
            request.headers().get(ORIGIN).cloned(),
            request.method() == Method::HEAD,
        );
        let allowed = match &origin {
            Some(origin) => self.web.rules().origins.allow(origin, self.local),
            None => true,
        };
        let public = !allowed && self.is_public(&request);
        let foreign = origin.as_ref().filter(|_| !allowed && !public);
        let mut answer = match self.check(&request, foreign) {
            Some(refusal) => refusal,
            None => self.route(request).await,
        };
        if allowed && let Some(origin) = origin {
            allow(answer.headers_mut(), origin);
        } else if public {
            allow_all(answer.headers_mut());
        }
        if head {
            if let Some(length) = answer.body().size_hint().exact().filter(|length| *length > 0) {
                answer.headers_mut().insert(CONTENT_LENGTH, length.into());
            }
            *answer.body_mut() = Body::default();
        }
        answer
    }

    /// Whether anybody may have what is asked for.
    fn is_public(&self, request: &Request<Incoming>) -> bool {
        !WebSocketUpgrade::is_asked(request.headers())
            && self.web.rules().console
            && console::is_read(self.web.console, request.method(), request.uri().path())
    }

    /// Refuses what no request may have.
    fn check(&self, request: &Request<Incoming>, foreign: Option<&HeaderValue>) -> Option<Response<Body>> {
        let headers = request.headers();
        let fault = if headers.contains_key(TRANSFER_ENCODING) {
            // Two lengths may be read differently by a proxy and by us; one needs no second.
            let text = "send the body with Content-Length, without Transfer-Encoding";
            Some((StatusCode::LENGTH_REQUIRED, text))
        } else if !hosts(request.version()).contains(&headers.get_all(HOST).into_iter().count()) {
            Some((
                StatusCode::BAD_REQUEST,
                "a request must have exactly one Host header",
            ))
        } else if headers.contains_key(CONTENT_ENCODING) {
            let text = "send the body as it is, without Content-Encoding";
            Some((StatusCode::UNSUPPORTED_MEDIA_TYPE, text))
        } else {
            None
        };
        if let Some((status, text)) = fault {
            let mut answer = refuse(status, "bad-frame", text);
            let close = HeaderValue::from_static("close");
            answer.headers_mut().insert(CONNECTION, close);
            return Some(answer);
        }
        let foreign = foreign.map(Origins::refusal)?;
        Some(refuse(StatusCode::FORBIDDEN, "denied", &foreign))
    }

    async fn route(self: Arc<HttpConnection>, request: Request<Incoming>) -> Response<Body> {
        if WebSocketUpgrade::is_asked(request.headers()) {
            return self.upgrade(&request);
        }
        let path = request.uri().path().to_owned();
        let tunnel = path.strip_prefix("/tunnel");
        let protocol = match tunnel {
            Some(_) => Protocol::Tunnel,
            None => Protocol::Http,
        };
        if let Some(refusal) = self.check_taken(protocol) {
            return refusal;
        }
        match (request.method(), path.as_str(), tunnel) {
            (&Method::OPTIONS, ..) => answers::options(),
            (.., Some("")) => self.open_tunnel(&request),
            (.., Some(id)) if id.starts_with('/') => self.use_tunnel(&id[1..], request).await,
            (_, path, _) if path.starts_with("/api/") => self.api(request).await,
            (.., "/log", _) => self.take_report(request).await,
            (&Method::GET | &Method::HEAD, "/healthz", _) => answers::text(StatusCode::OK, "ok\n"),
            (&Method::GET | &Method::HEAD, "/readyz", _) => self.readiness(),
            (&Method::GET | &Method::HEAD, "/metrics", _) => self.metrics(&request).await,
            (method, path, _) => self.show(method, path, request.headers()),
        }
    }

    /// Shows the console, or says what is here.
    fn show(&self, method: &Method, path: &str, headers: &HeaderMap) -> Response<Body> {
        let shown = match self.web.rules().console {
            true => console::answer(self.web.console, method, path, headers),
            false => None,
        };
        shown.unwrap_or_else(|| match (method, path) {
            (&Method::GET | &Method::HEAD, "/" | "/mom") => answers::text(StatusCode::OK, HERE),
            _ => refuse(
                StatusCode::NOT_FOUND,
                "unknown-path",
                "there is nothing of this name at this hub",
            ),
        })
    }

    /// Whose a request is.
    fn remote_of(&self, headers: &HeaderMap) -> Remote {
        forwarded::remote(self.remote, headers, &self.web.rules().forwarded_by)
    }

    /// Counts the connection as one of a user: what brings a user's requests is not a stranger's.
    fn count_as(&self, user: &str) -> Result<(), WireError> {
        let mut seat = self.seat.lock();
        seat.as_mut().map_or(Ok(()), |seat| seat.log_in(user))
    }

    /// Whether nobody between can read along.
    fn is_secured(&self, remote: Remote) -> bool {
        remote.secured || matches!(self.privacy, Privacy::Tls { .. })
    }

    /// Refuses what the listener does not take.
    fn check_taken(&self, protocol: Protocol) -> Option<Response<Body>> {
        let error = self.takes.check(protocol).err()?;
        Some(refuse(StatusCode::FORBIDDEN, error.code.word(), &error.text))
    }

    /// Tells one for whom there is no place.
    fn refuse_full(&self, from: IpAddr, error: &WireError) -> Response<Body> {
        self.services.note_full(from);
        refuse(StatusCode::SERVICE_UNAVAILABLE, error.code.word(), &error.text)
    }

    fn upgrade(&self, request: &Request<Incoming>) -> Response<Body> {
        if request.uri().path() != "/mom" {
            return refuse(StatusCode::NOT_FOUND, "unknown-path", "the WebSocket is at /mom");
        }
        if let Some(refusal) = self.check_taken(Protocol::Websocket) {
            return refusal;
        }
        match WebSocketUpgrade::of(request) {
            Ok(websocket) => {
                let remote = self.remote_of(request.headers());
                if let Some(from) = remote.from
                    && Some(from) != self.remote.from
                {
                    // It counts where it comes from, and no more as the proxy's.
                    match self.services.seat(&self.web.doors, from) {
                        Ok((seat, _)) => *self.seat.lock() = Some(seat),
                        Err(error) => return self.refuse_full(from, &error),
                    }
                }
                let answer = websocket.response();
                *self.upgrade.lock() = Some(Upgrade { websocket, remote });
                answer
            }
            Err(refused) => {
                let mut answer = refuse(refused.status, "bad-frame", refused.text);
                let version = HeaderValue::from_static("13");
                answer.headers_mut().insert("sec-websocket-version", version);
                answer
            }
        }
    }
}

/// So many `Host` fields a request may have: RFC 9112, 3.2.
fn hosts(version: Version) -> std::ops::RangeInclusive<usize> {
    if version == Version::HTTP_10 { 0..=1 } else { 1..=1 }
}

/// What a person reads who asks the hub by a program such as curl.
const HERE: &str = "This is a MOM hub.\n\nPeers connect to this port: ws://HOST:PORT/mom (WebSocket), http://HOST:PORT (tunnel), tcp:// (XML), bin:// (binary).\n";
