//! Peers that come through requests of HTTP.

use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;

use http::header::ALLOW;
use http::{HeaderValue, Method, Request, Response, StatusCode};
use hyper::body::Incoming;
use mom_hub::PeerId;
use mom_net::Tunnel;
use mom_proto::Code;
use tokio::time::Instant;

use super::HttpConnection;
use super::answers::{Body, refuse};
use crate::connection::{Remote, Seated, Serving, login_time, too_late};

/// The time that a body has to come, if a login has not less.
const BODY: std::time::Duration = std::time::Duration::from_secs(10);

impl HttpConnection {
    /// Opens a tunnel, which is a connection like any other: it takes a place, and waits for a login.
    pub(super) fn open_tunnel(self: Arc<HttpConnection>, request: &Request<Incoming>) -> Response<Body> {
        if request.method() != Method::POST {
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
        let remote = self.remote_of(request.headers());
        let near = |from: IpAddr| from.to_canonical().is_loopback() && !remote.relayed;
        if !self.is_secured(remote) && !remote.from.is_some_and(near) {
            let text = "a tunnel without TLS is allowed over loopback only, because others could hijack it; use https://";
            return refuse(StatusCode::FORBIDDEN, Code::INSECURE.word(), text);
        }
        let from = remote.from.unwrap_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED));
        let seated = match self.services.seat(&self.web.doors, from) {
            Ok(seated) => seated,
            Err(error) => return self.refuse_full(from, &error),
        };
        let Some(tunnel) = self.web.tunnels.open(self.is_secured(remote)) else {
            return refuse(
                StatusCode::INTERNAL_SERVER_ERROR,
                "internal",
                "the system's random number generator failed",
            );
        };
        let answer = tunnel.opened();
        tokio::spawn(self.serve_tunnel(tunnel, remote, seated));
        answer
    }

    async fn serve_tunnel(
        self: Arc<HttpConnection>,
        tunnel: Arc<Tunnel>,
        remote: Remote,
        (seat, told): Seated,
    ) {
        let services = self.services.fresh();
        let (web, privacy) = (Arc::clone(&self.web), self.privacy);
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
                let mut serving = Serving::begin(services, transceiver, remote, Some(seat), login_by);
                tunnel.set_peer(serving.peer().0);
                serving.run().await;
            }
            Err(error) => tracing::debug!(from = ?remote.from, %error, "refused"),
        }
        web.tunnels.close(&tunnel).await;
    }

    /// Carries a request of one who knows the tunnel.
    pub(super) async fn use_tunnel(&self, id: &str, request: Request<Incoming>) -> Response<Body> {
        let body_by = Instant::now() + BODY.min(login_time(&self.services.limits));
        let Some(tunnel) = self.web.tunnels.find(id) else {
            let again = match self.web.tunnels.find_former(id) {
                Some(tunnel)
                    if !tunnel.is_private() || self.is_secured(self.remote_of(request.headers())) =>
                {
                    self.web.tunnels.answer_again(&tunnel, request, body_by).await
                }
                _ => None,
            };
            let unknown = || {
                let text = "there is no such tunnel; open one with POST /tunnel";
                refuse(StatusCode::NOT_FOUND, "unknown-tunnel", text)
            };
            return again.unwrap_or_else(unknown);
        };
        if tunnel.is_private() && !self.is_secured(self.remote_of(request.headers())) {
            let text = "this tunnel was opened over TLS, and is used over TLS only";
            return refuse(StatusCode::FORBIDDEN, Code::INSECURE.word(), text);
        }
        if let Err(error) = self.count_as_user_of(&tunnel) {
            return refuse(StatusCode::SERVICE_UNAVAILABLE, error.code.word(), &error.text);
        }
        self.web
            .tunnels
            .answer(&tunnel, request, &self.services.limits, body_by)
            .await
    }

    /// A connection that brings what a user says is not a stranger's.
    fn count_as_user_of(&self, tunnel: &Tunnel) -> Result<(), mom_proto::WireError> {
        let Some(peer) = tunnel.peer().filter(|_| tunnel.is_trusted()) else {
            return Ok(());
        };
        let user = self.services.board.tap.audit.user(PeerId(peer));
        user.map_or(Ok(()), |user| self.count_as(&user))
    }
}
