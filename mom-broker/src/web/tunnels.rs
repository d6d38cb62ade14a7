//! Peers that come through requests of HTTP.

use std::sync::Arc;

use http::header::ALLOW;
use http::{HeaderValue, Method, Request, Response, StatusCode};
use hyper::body::Incoming;
use mom_hub::PeerId;
use mom_net::{Privacy, Tunnel};
use tokio::sync::oneshot;
use tokio::time::Instant;

use super::HttpConnection;
use super::answers::{Body, refuse};
use crate::connection::{Seat, Serving, login_time, too_late};

/// The time that a body has to come.
const BODY: std::time::Duration = std::time::Duration::from_secs(10);

impl HttpConnection {
    /// Opens a tunnel, which is a connection like any other: it takes a place, and waits for a login.
    pub(super) fn open_tunnel(self: Arc<HttpConnection>, method: &Method) -> Response<Body> {
        if method != Method::POST {
            let mut answer = refuse(
                StatusCode::METHOD_NOT_ALLOWED,
                "unknown-verb",
                "POST opens a tunnel",
            );
            answer
                .headers_mut()
                .insert(ALLOW, HeaderValue::from_static("POST"));
            return answer;
        }
        if self.privacy == Privacy::Plain && !self.from.ip().is_loopback() {
            let text = "a tunnel without TLS is for loopback: others could take it over; use https://";
            return refuse(StatusCode::FORBIDDEN, "insecure-link", text);
        }
        let (seat, told, evicted) = match self.web.doors.enter(self.from.ip()) {
            Ok(entered) => entered,
            Err(error) => return refuse(StatusCode::SERVICE_UNAVAILABLE, error.code.word(), &error.text),
        };
        if let Some(evicted) = evicted {
            let board = &self.services.board;
            evicted.tell(|outbox, error| board.close(outbox, Some(error)));
        }
        let Some(tunnel) = self.web.tunnels.open() else {
            return refuse(
                StatusCode::INTERNAL_SERVER_ERROR,
                "internal",
                "this machine has no randomness",
            );
        };
        let answer = tunnel.opened();
        tokio::spawn(self.serve_tunnel(tunnel, seat, told));
        answer
    }

    async fn serve_tunnel(
        self: Arc<HttpConnection>,
        tunnel: Arc<Tunnel>,
        seat: Seat,
        told: oneshot::Receiver<mom_proto::WireError>,
    ) {
        let services = self.services.fresh();
        let (web, from, privacy) = (Arc::clone(&self.web), self.from, self.privacy);
        // The connection that has opened it may end long before it does.
        drop(self);
        let limits = services.limits.before_login();
        let login_by = Instant::now() + login_time(&services.limits);
        let greeted = {
            let answer = |error: &mom_proto::WireError| services.answer(error);
            let too_late = too_late(&services.limits, login_by, told);
            tunnel.greet(privacy, &limits, too_late, answer).await
        };
        match greeted {
            Ok(transceiver) => {
                let mut serving =
                    Serving::begin(services, transceiver, Some(from.ip()), Some(seat), login_by);
                tunnel.set_peer(serving.peer().0);
                serving.run().await;
            }
            Err(error) => tracing::debug!(%from, %error, "refused"),
        }
        web.tunnels.close(&tunnel).await;
    }

    /// Carries a request of one who knows the tunnel.
    pub(super) async fn use_tunnel(&self, id: &str, request: Request<Incoming>) -> Response<Body> {
        let Some(tunnel) = self.web.tunnels.find(id) else {
            return refuse(
                StatusCode::NOT_FOUND,
                "unknown-tunnel",
                "there is no such tunnel; open one with POST /tunnel",
            );
        };
        if let Err(error) = self.count_as_user_of(&tunnel) {
            return refuse(StatusCode::SERVICE_UNAVAILABLE, error.code.word(), &error.text);
        }
        let body_by = Instant::now() + BODY;
        self.web
            .tunnels
            .answer(&tunnel, request, &self.services.limits, body_by)
            .await
    }

    /// A connection that brings what a user says is no stranger's.
    fn count_as_user_of(&self, tunnel: &Tunnel) -> Result<(), mom_proto::WireError> {
        let Some(peer) = tunnel.peer().filter(|_| tunnel.is_trusted()) else {
            return Ok(());
        };
        let user = self.services.board.tap.audit.user(PeerId(peer));
        match (user, &mut *self.seat.lock()) {
            (Some(user), Some(seat)) => seat.log_in(&user),
            _ => Ok(()),
        }
    }
}
