//! What HTTP asks of a hub: to become a WebSocket, a tunnel, its health and figures, and what a user may see of it.

mod answers;
mod origins;
mod tunnels;

use std::convert::Infallible;
use std::future::poll_fn;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use http::header::{CONNECTION, HOST, ORIGIN, TRANSFER_ENCODING};
use http::{HeaderValue, Method, Request, Response, StatusCode};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::TokioTimer;
use mom_net::{HttpStream, Privacy, Transceiver, Tunnels, WebSocketUpgrade};
use mom_proto::WireError;
use parking_lot::Mutex;
use tokio::sync::oneshot;

use crate::connection::{Doors, Seat, Services};

use answers::{Body, allow, refuse};
use origins::Origins;

/// The head of a request in bytes, and its lines.
const HEAD: usize = 16 * 1024;
const LINES: usize = 64;

/// How long a connection may wait for its next request.
const IDLE: Duration = Duration::from_secs(60);

/// All that is asked by HTTP.
#[derive(Debug)]
pub(crate) struct Web {
    doors: Arc<Doors>,
    tunnels: Arc<Tunnels>,
    origins: Origins,
}

/// One connection that asks by HTTP.
pub(crate) struct Visit {
    pub(crate) services: Services,
    pub(crate) from: SocketAddr,
    /// The port that it has come to.
    pub(crate) port: u16,
    /// Told if it has to go.
    pub(crate) told: oneshot::Receiver<WireError>,
    pub(crate) seat: Seat,
}

/// What the requests of one connection share.
struct HttpConnection {
    web: Arc<Web>,
    services: Services,
    from: SocketAddr,
    port: u16,
    privacy: Privacy,
    seat: Mutex<Option<Seat>>,
    upgrade: Mutex<Option<WebSocketUpgrade>>,
}

impl Web {
    pub(crate) fn new(doors: Arc<Doors>, origins: &[String]) -> Web {
        Web {
            doors,
            tunnels: Arc::default(),
            origins: Origins::new(origins),
        }
    }

    /// Answers the requests of a connection; gives it back with its seat if it has become a peer's.
    pub(crate) async fn serve(
        self: &Arc<Web>,
        stream: HttpStream,
        visit: Visit,
    ) -> Option<(Transceiver, Seat)> {
        let Visit {
            services,
            from,
            port,
            told,
            seat,
        } = visit;
        let limits = Arc::clone(&services.limits);
        let shared = Arc::new(HttpConnection {
            web: Arc::clone(self),
            services,
            from,
            port,
            privacy: stream.privacy(),
            seat: Mutex::new(Some(seat)),
            upgrade: Mutex::default(),
        });
        let asked = Arc::clone(&shared);
        let service = service_fn(move |request| {
            let asked = Arc::clone(&asked);
            Box::pin(async move { Ok::<_, Infallible>(asked.answer(request).await) })
        });
        let mut connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(IDLE.min(Duration::from_millis(limits.login_time)))
            .max_buf_size(HEAD)
            .max_headers(LINES)
            .serve_connection(stream, service);
        let served = tokio::select! {
            served = poll_fn(|context| connection.poll_without_shutdown(context)) => served,
            Ok(_) = told => return None,
        };
        if let Err(error) = served {
            tracing::debug!(%from, %error, "HTTP ended");
        }
        let parts = connection.into_parts();
        let upgrade = shared.upgrade.lock().take();
        let Some(upgrade) = upgrade else {
            parts.io.close().await;
            return None;
        };
        let limits = limits.before_login();
        let begun = upgrade.start(parts.io, &parts.read_buf, &limits).await;
        let seat = shared.seat.lock().take();
        begun.ok().zip(seat)
    }
}

impl HttpConnection {
    async fn answer(self: Arc<HttpConnection>, request: Request<Incoming>) -> Response<Body> {
        let (origin, head) = (
            request.headers().get(ORIGIN).cloned(),
            request.method() == Method::HEAD,
        );
        let allowed = match &origin {
            Some(origin) => self.web.origins.allow(origin, self.port),
            None => true,
        };
        let mut answer = match self.check(&request, allowed) {
            Some(refusal) => refusal,
            None => self.route(request).await,
        };
        if allowed && let Some(origin) = origin {
            allow(answer.headers_mut(), origin);
        }
        if head {
            *answer.body_mut() = Body::default();
        }
        answer
    }

    /// Refuses what no request may have.
    fn check(&self, request: &Request<Incoming>, allowed: bool) -> Option<Response<Body>> {
        let headers = request.headers();
        if headers.contains_key(TRANSFER_ENCODING) {
            // Two lengths may be read differently by a proxy and by us; one needs no second.
            let mut answer = refuse(
                StatusCode::LENGTH_REQUIRED,
                "bad-frame",
                "send the body with Content-Length, without Transfer-Encoding",
            );
            answer
                .headers_mut()
                .insert(CONNECTION, HeaderValue::from_static("close"));
            return Some(answer);
        }
        if headers.get_all(HOST).into_iter().count() > 1 {
            return Some(refuse(
                StatusCode::BAD_REQUEST,
                "bad-frame",
                "a request has one Host",
            ));
        }
        if !allowed {
            let text = "pages of this origin may not use the hub; its owner can add it to [web] origins";
            return Some(refuse(StatusCode::FORBIDDEN, "not-permitted", text));
        }
        None
    }

    async fn route(self: Arc<HttpConnection>, request: Request<Incoming>) -> Response<Body> {
        if WebSocketUpgrade::is_asked(request.headers()) {
            return self.upgrade(&request);
        }
        let path = request.uri().path().to_owned();
        match (request.method(), path.as_str()) {
            (&Method::OPTIONS, _) => answers::options(),
            (_, "/tunnel") => self.open_tunnel(request.method()),
            (_, path) if path.starts_with("/tunnel/") => {
                self.use_tunnel(&path["/tunnel/".len()..], request).await
            }
            (&Method::GET | &Method::HEAD, "/" | "/mom") => answers::text(StatusCode::OK, HERE),
            _ => refuse(
                StatusCode::NOT_FOUND,
                "unknown-path",
                "there is nothing of this name at this hub",
            ),
        }
    }

    fn upgrade(&self, request: &Request<Incoming>) -> Response<Body> {
        if request.uri().path() != "/mom" {
            return refuse(StatusCode::NOT_FOUND, "unknown-path", "the WebSocket is at /mom");
        }
        match WebSocketUpgrade::of(request) {
            Ok(upgrade) => {
                let answer = upgrade.response();
                *self.upgrade.lock() = Some(upgrade);
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

/// What a person reads who opens the hub in a browser.
const HERE: &str = "This is a MOM hub.\n\nPeers connect to this port: ws://HOST:PORT/mom (WebSocket), http://HOST:PORT (tunnel), tcp:// (XML), bin:// (binary).\n";
