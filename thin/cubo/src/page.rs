//! The robot's own page: what its body looks like, whatever anybody says of it.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use http::header::{ALLOW, CACHE_CONTROL, CONTENT_TYPE};
use http::{HeaderValue, Method, Request, Response, StatusCode};
use http_body_util::Full;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use serde_json::{Value, json};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};

use crate::{CuboHandle, Glance};

/// Connections at once; more are closed.
const MOST: usize = 16;
/// For all of a connection, which is one short request.
const WHOLE: Duration = Duration::from_secs(5);
/// Bytes of a request's head.
const MOST_BYTES: usize = 8192;
/// After an error of the listener, such as too many open files.
const PAUSE: Duration = Duration::from_millis(500);

const PAGE: &str = "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta http-equiv=\"refresh\" content=\"1\">\n\
    <title>CUBO</title>\n</head>\n<body>\n<h1>CUBO</h1>\n<pre>";

type Answer = Response<Full<Bytes>>;

/// Serves the page until it is dropped, to all who can reach it: `/`, and `/status.json`. An error of the listener ends nothing.
pub async fn serve_page(listener: TcpListener, robot: CuboHandle) {
    let places = Arc::new(Semaphore::new(MOST));
    let mut connections = JoinSet::new();
    loop {
        let stream = tokio::select! {
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) => stream,
                Err(error) => {
                    tracing::debug!(%error, "a connection to the page could not be accepted");
                    sleep(PAUSE).await;
                    continue;
                }
            },
            Some(_) = connections.join_next() => continue,
        };
        match Arc::clone(&places).try_acquire_owned() {
            Ok(place) => drop(connections.spawn(connect(stream, robot.clone(), place))),
            Err(_) => tracing::debug!("closed: too many clients read the page"),
        }
    }
}

/// One connection, and one request on it.
async fn connect(stream: TcpStream, robot: CuboHandle, _place: OwnedSemaphorePermit) {
    let service = service_fn(|request: Request<hyper::body::Incoming>| {
        let answered = answer(&robot, request.method(), request.uri().path());
        async move { Ok::<_, Infallible>(answered) }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .max_buf_size(MOST_BYTES)
        .keep_alive(false)
        .serve_connection(TokioIo::new(stream), service);
    if !matches!(timeout(WHOLE, connection).await, Ok(Ok(()))) {
        tracing::debug!("a connection to the page ended early");
    }
}

fn answer(robot: &CuboHandle, method: &Method, path: &str) -> Answer {
    if ![Method::GET, Method::HEAD].contains(method) {
        let mut refused = words(
            StatusCode::METHOD_NOT_ALLOWED,
            "this page is read-only: it accepts GET and HEAD\n",
        );
        let allowed = HeaderValue::from_static("GET, HEAD");
        refused.headers_mut().insert(ALLOW, allowed);
        return refused;
    }
    let state = || status(&robot.glance(), robot.is_up()).to_string();
    match path {
        "/" => found(
            "text/html; charset=utf-8",
            format!("{PAGE}{}</pre>\n</body>\n</html>\n", state()),
        ),
        "/status.json" => found("application/json", state()),
        _ => words(StatusCode::NOT_FOUND, "a robot has / and /status.json\n"),
    }
}

/// `{x, y, heading, turns, left-arm, right-arm, head-tilt, lips, gesture, sounds, linked}`: mm, degrees, percent, and the number of the
/// gesture that is played.
fn status(glance: &Glance, linked: bool) -> Value {
    let posture = &glance.posture;
    json!({
        "x": glance.pose.x,
        "y": glance.pose.y,
        "heading": glance.pose.heading,
        "turns": glance.turns,
        "left-arm": posture.left_arm.0,
        "right-arm": posture.right_arm.0,
        "head-tilt": posture.head_tilt.0,
        "lips": glance.lips.0,
        "gesture": glance.gesture,
        "sounds": glance.sounds,
        "linked": linked,
    })
}

fn words(status: StatusCode, text: &str) -> Answer {
    let mut answer = found("text/plain; charset=utf-8", text.to_owned());
    *answer.status_mut() = status;
    answer
}

fn found(media_type: &'static str, body: String) -> Answer {
    let mut answer = Response::new(Full::new(body.into()));
    for (name, value) in [(CONTENT_TYPE, media_type), (CACHE_CONTROL, "no-store")] {
        answer.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    answer
}
