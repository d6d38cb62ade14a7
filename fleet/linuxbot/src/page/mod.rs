//! The robot's own web server, beside its control (W21): a page, its state as JSON, and what it sees (W22).
//!
//! It cannot slow the control: it asks for a [`Glance`](crate::Glance) at most twenty times a second, draws on tokio's
//! blocking threads at most five times a second, and has few connections, each for one short request.

#[cfg(test)]
mod tests;
mod text;

use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use http::header::{
    ALLOW, AUTHORIZATION, CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, WWW_AUTHENTICATE,
    X_CONTENT_TYPE_OPTIONS,
};
use http::{HeaderMap, HeaderValue, Method, Request, Response, StatusCode};
use http_body_util::Full;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use mom_wheels::Floor;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::{JoinSet, spawn_blocking};
use tokio::time::{sleep, timeout};

use text::{html, json};

use crate::{Access, Eye, Login, Observed, Observer};

/// Connections at once of those who may look, and of those who are told that they may not; more are closed.
const MOST: usize = 16;
const MOST_REFUSED: usize = 4;
/// For the head of a request, and for all of a connection.
const HEAD: Duration = Duration::from_secs(5);
const WHOLE: Duration = Duration::from_secs(15);
/// Bytes of a request's head, and its lines.
const MOST_BYTES: usize = 8192;
const MOST_LINES: usize = 64;
/// After an error of the listener, such as too many open files.
const PAUSE: Duration = Duration::from_millis(500);

type Answer = Response<Full<Bytes>>;

/// What a robot shows of itself over HTTP, and to whom.
#[derive(Debug)]
pub struct Page {
    /// The number of the robot.
    pub unit: u32,
    /// Who may look: those who may drive (W23).
    pub access: Access,
    /// What they have to know; none: nothing.
    pub login: Option<Login>,
    /// How the robot is.
    pub observer: Observer,
    /// What it sees, if it has a camera.
    pub eye: Option<Arc<Eye>>,
}

/// Serves the page until it is dropped. An error of the listener ends nothing: the robot drives without its page as well.
pub async fn serve_page(listener: TcpListener, page: Page) {
    let (page, places) = (Arc::new(page), Arc::new(Semaphore::new(MOST)));
    let refusals = Arc::new(Semaphore::new(MOST_REFUSED));
    let mut connections = JoinSet::new();
    loop {
        let (stream, from) = tokio::select! {
            accepted = listener.accept() => match accepted {
                Ok(accepted) => accepted,
                Err(error) => {
                    tracing::debug!(%error, "a connection to the page could not be accepted");
                    sleep(PAUSE).await;
                    continue;
                }
            },
            Some(_) = connections.join_next() => continue,
        };
        let admitted = page.access.admits(from.ip());
        // Those who may not look take no place of those who may.
        let places = if admitted { &places } else { &refusals };
        match Arc::clone(places).try_acquire_owned() {
            Ok(place) => {
                let page = admitted.then(|| Arc::clone(&page));
                connections.spawn(connect(stream, from, page, place));
            }
            Err(_) => tracing::debug!(%from, "closed: too many clients read the page"),
        }
    }
}

/// One connection, and one request on it.
async fn connect(stream: TcpStream, from: SocketAddr, page: Option<Arc<Page>>, _place: OwnedSemaphorePermit) {
    let service = service_fn(|request: Request<hyper::body::Incoming>| {
        let page = page.clone();
        async move {
            Ok::<_, Infallible>(match page {
                Some(page) => match page.asks_for_login(request.headers()).await {
                    Some(asked) => asked,
                    None => page.answer(request.method(), request.uri().path()).await,
                },
                None => refused(from),
            })
        }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD)
        .max_buf_size(MOST_BYTES)
        .max_headers(MOST_LINES)
        .keep_alive(false)
        .serve_connection(TokioIo::new(stream), service);
    let ended = timeout(WHOLE, connection).await.map_err(io::Error::from);
    if let Err(error) = ended.and_then(|ended| ended.map_err(io::Error::other)) {
        tracing::debug!(%from, %error, "a connection to the page ended");
    }
}

impl Page {
    /// The page of a simulated robot on this floor, and what its control takes.
    #[must_use]
    pub fn of(unit: u32, access: Access, floor: Floor) -> (Self, Observed) {
        let (observer, observed) = Observed::pair();
        let page = Self {
            unit,
            access,
            login: None,
            observer,
            eye: Some(Arc::new(Eye::new(floor))),
        };
        (page, observed)
    }

    /// The same for those alone who know this.
    #[must_use]
    pub fn with_login(mut self, login: Option<Login>) -> Self {
        self.login = login;
        self
    }

    /// What is answered to who has not logged in, before anything is shown. A wrong password is answered later, so that few are tried.
    async fn asks_for_login(&self, headers: &HeaderMap) -> Option<Answer> {
        let login = self.login.as_ref()?;
        if login.admits(headers) {
            return None;
        }
        if headers.contains_key(AUTHORIZATION) {
            sleep(PAUSE).await;
        }
        let text = "this page requires a login; the file given to mom-linuxbot --web-login has the user and password\n";
        let mut answer = words(StatusCode::UNAUTHORIZED, text);
        let realm = format!("Basic realm=\"robot {}\", charset=\"UTF-8\"", self.unit);
        if let Ok(realm) = HeaderValue::try_from(realm) {
            answer.headers_mut().insert(WWW_AUTHENTICATE, realm);
        }
        Some(answer)
    }

    /// What is answered to a request of this method for this path.
    async fn answer(&self, method: &Method, path: &str) -> Answer {
        if !matches!(path, "/" | "/status.json" | "/camera.jpg") {
            return words(
                StatusCode::NOT_FOUND,
                "a robot has /, /status.json and /camera.jpg\n",
            );
        }
        if ![Method::GET, Method::HEAD].contains(method) {
            let text = "this page is read-only: it accepts GET and HEAD\n";
            let mut answer = words(StatusCode::METHOD_NOT_ALLOWED, text);
            answer
                .headers_mut()
                .insert(ALLOW, HeaderValue::from_static("GET, HEAD"));
            return answer;
        }
        let Some(glance) = self.observer.look().await else {
            let text = "the sensors of this robot cannot be read\n";
            return words(StatusCode::SERVICE_UNAVAILABLE, text);
        };
        match path {
            "/" => {
                let text = html(self.unit, &glance, self.eye.is_some());
                found("text/html; charset=utf-8", text.into())
            }
            "/status.json" => found("application/json", json(self.unit, &glance).to_string().into()),
            _ => {
                let (Some(eye), Some(pose)) = (self.eye.clone(), glance.pose) else {
                    return words(StatusCode::NOT_FOUND, "this robot has no camera\n");
                };
                let drawn = spawn_blocking(move || eye.picture(pose)).await;
                match drawn.ok().flatten() {
                    Some(picture) => found("image/jpeg", picture),
                    None => words(StatusCode::SERVICE_UNAVAILABLE, "there is no picture now\n"),
                }
            }
        }
    }
}

fn refused(from: SocketAddr) -> Answer {
    let from = from.ip().to_canonical();
    let text =
        format!("{from} is not allowed to drive this robot or read its page; see mom-linuxbot --allow\n");
    words(StatusCode::FORBIDDEN, text)
}

fn words(status: StatusCode, text: impl Into<Bytes>) -> Answer {
    let mut answer = found("text/plain; charset=utf-8", text.into());
    *answer.status_mut() = status;
    answer
}

fn found(media_type: &'static str, body: Bytes) -> Answer {
    let mut answer = Response::new(Full::new(body));
    let headers = [
        (CONTENT_TYPE, media_type),
        (CACHE_CONTROL, "no-store"),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (
            CONTENT_SECURITY_POLICY,
            "default-src 'none'; img-src 'self'; style-src 'unsafe-inline'; frame-ancestors 'none'",
        ),
    ];
    for (name, value) in headers {
        answer.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    answer
}
