//! The hub's end of tunnels.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use bytes::{Bytes, BytesMut};
use http::header::{ALLOW, CACHE_CONTROL, CONTENT_TYPE};
use http::{Method, Request, Response, StatusCode};
use http_body_util::{BodyExt as _, Limited};
use hyper::body::Body;
use mom_proto::codec::Form;
use mom_proto::{Code, Limits, Parcel, WireError};
use parking_lot::Mutex;
use sha2::{Digest as _, Sha256};
use tokio::sync::Notify;
use tokio::time::{Instant, timeout, timeout_at};

use super::pipe::{Misplaced, Pipe};
use super::{END, ID, LONGEST, MOST_UP, SENT, TAKEN, TunnelBody};
use crate::{NetError, SecretId};

/// Brought down by one answer that has an end.
const MOST_DOWN: usize = 64 * 1024;

/// What a peer hears last it gets within this time.
const FAREWELL: Duration = Duration::from_secs(3);

/// All tunnels of a hub.
#[derive(Debug, Default)]
pub struct Tunnels {
    open: Mutex<HashMap<SecretId, Arc<Tunnel>>>,
    /// By the ids before their logins, as long as nobody has used the new ones.
    former: Mutex<HashMap<SecretId, Arc<Tunnel>>>,
}

/// One tunnel.
#[derive(Debug)]
pub struct Tunnel {
    pipe: Arc<Pipe>,
    id: Mutex<SecretId>,
    /// What has brought its login, once its id is another than before.
    renewed: Mutex<Option<LoginPost>>,
    /// Nobody could read along when it was opened, so nobody may when it is used.
    private: bool,
    /// Whose it is, in the numbers of the hub; 0 before that is known.
    peer: AtomicU64,
    /// The request that brings bytes down at the moment: one that is newer takes its place.
    turn: AtomicU64,
    turned: Notify,
}

/// The request that has brought a login. Its answer has the new id: if that is lost, only who sends the very same bytes again, with their
/// proof of who it is, gets it again.
#[derive(Debug)]
struct LoginPost {
    /// The id before. None: the new one was used, or another client has come with the old one.
    id: Option<SecretId>,
    at: u64,
    digest: [u8; 32],
}

impl LoginPost {
    fn new(id: SecretId, at: u64, body: &[u8]) -> LoginPost {
        LoginPost {
            id: Some(id),
            at,
            digest: Sha256::digest(body).into(),
        }
    }

    fn is(&self, at: u64, body: &[u8]) -> bool {
        self.at == at && self.digest == <[u8; 32]>::from(Sha256::digest(body))
    }
}

/// What is said by a request, behind the `?`.
#[derive(Debug, Default)]
struct Said {
    /// Where the bytes begin.
    at: u64,
    /// So many have come down.
    ack: Option<u64>,
    /// The answer waits so long for bytes, and has an end.
    wait: Option<Duration>,
    /// Nothing more comes up.
    end: bool,
}

impl Tunnels {
    /// Opens a tunnel, for requests only that nobody can read along if it is `private`; none where the system has no randomness.
    pub fn open(&self, private: bool) -> Option<Arc<Tunnel>> {
        let id = SecretId::random()?;
        let tunnel = Arc::new(Tunnel {
            pipe: Arc::default(),
            id: Mutex::new(id),
            renewed: Mutex::new(None),
            private,
            peer: AtomicU64::new(0),
            turn: AtomicU64::new(0),
            turned: Notify::new(),
        });
        self.open.lock().insert(id, Arc::clone(&tunnel));
        Some(tunnel)
    }

    /// The tunnel that a path names, behind `/tunnel/`.
    pub fn find(&self, id: &str) -> Option<Arc<Tunnel>> {
        let tunnel = self.open.lock().get(&id.parse().ok()?).cloned()?;
        // Its id is known, if it is a new one.
        self.forget_former(&tunnel);
        Some(tunnel)
    }

    /// Waits a moment until the peer has heard all that was said, and forgets the tunnel.
    pub async fn close(&self, tunnel: &Tunnel) {
        tunnel.pipe.finish();
        // A client that does not come for it does without.
        let _ = timeout(FAREWELL, tunnel.pipe.drained()).await;
        // Requests that are under way have it still: none takes bytes once it cannot be found.
        tunnel.pipe.break_off("the tunnel is closed");
        self.forget(tunnel);
        tunnel.pipe.empty();
    }

    fn forget(&self, tunnel: &Tunnel) {
        self.open.lock().remove(&*tunnel.id.lock());
        // Last, because a request under way could renew its id until now.
        self.forget_former(tunnel);
    }

    /// From now on the id before the login is that of nobody.
    fn forget_former(&self, tunnel: &Tunnel) {
        let former = tunnel.renewed.lock().as_mut().and_then(|post| post.id.take());
        if let Some(former) = former {
            self.former.lock().remove(&former);
        }
    }

    /// Gives a tunnel whose peer has logged in another id: the first one is useless to others who have seen it.
    fn renew(&self, tunnel: &Arc<Tunnel>, at: u64, body: &[u8]) -> Option<SecretId> {
        let mut renewed = tunnel.renewed.lock();
        if renewed.is_some() || !tunnel.pipe.is_trusted() {
            return None;
        }
        let new = SecretId::random()?;
        let mut open = self.open.lock();
        let mut id = tunnel.id.lock();
        // One that has ended while this request was under way does not come back.
        open.remove(&*id)?;
        self.former.lock().insert(*id, Arc::clone(tunnel));
        *renewed = Some(LoginPost::new(*id, at, body));
        *id = new;
        open.insert(new, Arc::clone(tunnel));
        Some(new)
    }

    /// The tunnel whose login has come by this id, of which nobody has used the new one.
    pub fn find_former(&self, id: &str) -> Option<Arc<Tunnel>> {
        self.former.lock().get(&id.parse().ok()?).cloned()
    }

    /// Answers the request that has brought a login once more: where its answer was lost, nobody knows the new id. None
    /// for any other request; a request with other bytes ends that.
    pub async fn answer_again<B>(
        &self,
        tunnel: &Tunnel,
        request: Request<B>,
        body_by: Instant,
    ) -> Option<Response<TunnelBody>>
    where
        B: Body<Data = Bytes>,
        B::Error: Into<Box<dyn std::error::Error + Send + Sync>>,
    {
        // A client that waits for bytes comes by the old id until the new one is known.
        if *request.method() != Method::POST {
            return None;
        }
        let said = Said::read(request.uri().query().unwrap_or_default())?;
        let body = timeout_at(body_by, Limited::new(request.into_body(), MOST_UP).collect()).await;
        let body = body.ok()?.ok()?.to_bytes();
        let Some(id) = tunnel.login_again(said.at, &body) else {
            self.forget_former(tunnel);
            return None;
        };
        let (taken, sent) = (tunnel.pipe.arrived_to(), tunnel.pipe.written_to());
        let mut answer = count(StatusCode::OK, &[(TAKEN, taken), (SENT, sent)]);
        answer.headers_mut().insert(ID, id.to_string().parse().ok()?);
        Some(answer)
    }

    /// Answers a request about a tunnel. A body has to be here by `body_by`, and before login it is no larger than a parcel
    /// may be.
    pub async fn answer<B>(
        &self,
        tunnel: &Arc<Tunnel>,
        request: Request<B>,
        limits: &Limits,
        body_by: Instant,
    ) -> Response<TunnelBody>
    where
        B: Body<Data = Bytes>,
        B::Error: Into<Box<dyn std::error::Error + Send + Sync>>,
    {
        let Some(said) = Said::read(request.uri().query().unwrap_or_default()) else {
            return refusal(
                StatusCode::BAD_REQUEST,
                "the query of a tunnel is at=, ack=, wait= and end=, with numbers",
            );
        };
        if let Some(ack) = said.ack
            && !tunnel.pipe.acknowledge(ack)
        {
            return refusal(StatusCode::BAD_REQUEST, "more is acknowledged than was sent");
        }
        match *request.method() {
            Method::POST => {
                let most = match tunnel.pipe.is_trusted() {
                    true => MOST_UP,
                    false => MOST_UP.min(limits.before_login),
                };
                // What is announced is not waited for.
                if request.body().size_hint().lower() > most as u64 {
                    return too_large();
                }
                let body = timeout_at(body_by, Limited::new(request.into_body(), most).collect());
                match body.await {
                    Ok(Ok(body)) => self.up(tunnel, &said, &body.to_bytes()).await,
                    Ok(Err(error)) if error.is::<http_body_util::LengthLimitError>() => too_large(),
                    Ok(Err(_)) => refusal(StatusCode::BAD_REQUEST, "the body ended early"),
                    Err(_) => refusal(StatusCode::REQUEST_TIMEOUT, "the body did not arrive in time"),
                }
            }
            Method::GET => tunnel.answer_down(&said).await,
            _ => {
                let mut answer = refusal(StatusCode::METHOD_NOT_ALLOWED, "a tunnel accepts GET and POST");
                answer
                    .headers_mut()
                    .insert(ALLOW, http::HeaderValue::from_static("GET, POST"));
                answer
            }
        }
    }

    /// Takes bytes up.
    async fn up(&self, tunnel: &Arc<Tunnel>, said: &Said, body: &[u8]) -> Response<TunnelBody> {
        match tunnel.pipe.take_in(said.at, body) {
            Ok(_) => {}
            Err(Misplaced::Gap(taken)) => return count(StatusCode::CONFLICT, &[(TAKEN, taken)]),
            Err(Misplaced::Full(taken)) => return count(StatusCode::SERVICE_UNAVAILABLE, &[(TAKEN, taken)]),
            Err(Misplaced::Over) => return refusal(StatusCode::GONE, "the tunnel has ended"),
        }
        if said.end {
            tunnel.pipe.took_all();
        }
        // Who logs in hears of the new id in the answer. Later nobody waits: what is acknowledged beside the bytes must go on
        // while the hub waits with these.
        if !tunnel.pipe.is_trusted() {
            let _ = timeout(LONGEST, tunnel.pipe.settle()).await;
        }
        let (taken, sent) = (tunnel.pipe.arrived_to(), tunnel.pipe.written_to());
        let mut answer = count(StatusCode::OK, &[(TAKEN, taken), (SENT, sent)]);
        // Sent twice, it may find that the other one has brought the new id to nobody.
        let id = self.renew(tunnel, said.at, body);
        if let Some(id) = id.or_else(|| tunnel.login_again(said.at, body))
            && let Ok(id) = id.to_string().parse()
        {
            answer.headers_mut().insert(ID, id);
        }
        answer
    }
}

impl Tunnel {
    /// The answer to the request that opened it.
    pub fn opened(&self) -> Response<TunnelBody> {
        let id = self.id.lock().to_string();
        let mut answer = count(StatusCode::CREATED, &[]);
        if let Ok(id) = id.parse() {
            answer.headers_mut().insert(ID, id);
        }
        *answer.body_mut() = TunnelBody::whole(id);
        answer
    }

    /// What both of its ends share.
    pub(crate) fn pipe(&self) -> &Arc<Pipe> {
        &self.pipe
    }

    /// Waits for a peer's first bytes, which begin this form; gives all that have come.
    pub(crate) async fn first_words(
        &self,
        too_late: impl Future<Output = WireError>,
        answer: impl FnOnce(&WireError) -> Parcel,
    ) -> Result<(Form, BytesMut), NetError> {
        let mut first = BytesMut::new();
        let told = tokio::select! {
            told = self.first_form(&mut first) => told,
            error = too_late => Err(error.into()),
        };
        if let Err(NetError::Wire(error)) = &told
            && let Ok(encoded) = Form::Xml.encode(&answer(error))
        {
            self.pipe.try_write(&[std::io::IoSlice::new(&encoded.head)])?;
        }
        Ok((told?, first))
    }

    async fn first_form(&self, first: &mut BytesMut) -> Result<Form, NetError> {
        loop {
            if let Some(form) = Form::sniff(first)? {
                return Ok(form);
            }
            if std::future::poll_fn(|context| self.pipe.poll_read(first, context)).await? == 0 {
                return Err(std::io::Error::from(std::io::ErrorKind::UnexpectedEof).into());
            }
        }
    }

    /// Its new id, for who brings the bytes of its login again, as long as nobody has used that.
    fn login_again(&self, at: u64, body: &[u8]) -> Option<SecretId> {
        let renewed = self.renewed.lock();
        let post = renewed.as_ref()?;
        (post.id.is_some() && post.is(at, body)).then(|| *self.id.lock())
    }

    /// Brings bytes down.
    async fn answer_down(self: &Arc<Tunnel>, said: &Said) -> Response<TunnelBody> {
        if !self.pipe.acknowledge(said.at) {
            return refusal(StatusCode::BAD_REQUEST, "so much was not sent yet");
        }
        if self.pipe.kept_from() > said.at {
            return refusal(
                StatusCode::GONE,
                "these bytes were acknowledged, and are kept no longer",
            );
        }
        if self.pipe.is_finished() && said.at == self.pipe.written_to() {
            return count(StatusCode::OK, &[(END, said.at)]);
        }
        let turn = self.turn.fetch_add(1, Ordering::AcqRel) + 1;
        self.turned.notify_waiters();
        let mut answer = count(StatusCode::OK, &[]);
        *answer.body_mut() = match said.wait {
            None => TunnelBody::stream(Arc::clone(self), turn, said.at, Instant::now() + LONGEST),
            Some(wait) => {
                let until = Instant::now() + wait.min(LONGEST);
                let bytes = self.down(turn, said.at, MOST_DOWN, until).await;
                TunnelBody::whole(bytes.unwrap_or_default())
            }
        };
        // Proxies that read along: nginx is told so by a header of its own.
        let headers = answer.headers_mut();
        headers.insert("x-accel-buffering", http::HeaderValue::from_static("no"));
        headers.insert(
            CONTENT_TYPE,
            http::HeaderValue::from_static("application/octet-stream"),
        );
        answer
    }

    /// Bytes from this place on, as soon as there are some; none when it is too late, or not one's turn.
    pub(super) async fn down(&self, turn: u64, at: u64, most: usize, until: Instant) -> Option<Bytes> {
        let turned = async {
            loop {
                let mut turned = std::pin::pin!(self.turned.notified());
                turned.as_mut().enable();
                if self.turn.load(Ordering::Acquire) != turn {
                    return;
                }
                turned.await;
            }
        };
        tokio::select! {
            biased;
            () = turned => None,
            bytes = self.pipe.bytes_from(at, most) => bytes,
            () = tokio::time::sleep_until(until) => None,
        }
    }

    /// Notes whose it is.
    pub fn set_peer(&self, peer: u64) {
        self.peer.store(peer, Ordering::Release);
    }

    /// Whose it is, if that is known.
    pub fn peer(&self) -> Option<u64> {
        Some(self.peer.load(Ordering::Acquire)).filter(|peer| *peer > 0)
    }

    /// Whether only requests may use it that nobody can read along.
    pub fn is_private(&self) -> bool {
        self.private
    }

    /// Whether its peer has logged in.
    pub fn is_trusted(&self) -> bool {
        self.pipe.is_trusted()
    }
}

impl Said {
    fn read(query: &str) -> Option<Said> {
        let mut said = Said::default();
        for part in query.split('&').filter(|part| !part.is_empty()) {
            let (key, value) = part.split_once('=')?;
            let number: u64 = value.parse().ok()?;
            match key {
                "at" => said.at = number,
                "ack" => said.ack = Some(number),
                "wait" => said.wait = Some(Duration::from_millis(number)),
                "end" => said.end = number == 1,
                _ => return None,
            }
        }
        Some(said)
    }
}

fn count(status: StatusCode, counts: &[(http::HeaderName, u64)]) -> Response<TunnelBody> {
    let mut answer = Response::new(TunnelBody::default());
    *answer.status_mut() = status;
    let headers = answer.headers_mut();
    headers.insert(CACHE_CONTROL, http::HeaderValue::from_static("no-store"));
    for (name, number) in counts {
        headers.insert(name, http::HeaderValue::from(*number));
    }
    answer
}

fn too_large() -> Response<TunnelBody> {
    let text = "a request may carry at most 128 KiB, and before login one parcel";
    refusal(StatusCode::PAYLOAD_TOO_LARGE, text)
}

/// Says what is wrong in the words of the protocol, as the hub's other answers of HTTP do.
fn refusal(status: StatusCode, text: &'static str) -> Response<TunnelBody> {
    let code = match status {
        StatusCode::PAYLOAD_TOO_LARGE => Code::TOO_LARGE,
        StatusCode::REQUEST_TIMEOUT => Code::TOO_LATE,
        StatusCode::METHOD_NOT_ALLOWED => Code::UNKNOWN_VERB,
        _ => Code::BAD_FRAME,
    };
    let mut answer = count(status, &[]);
    let said = serde_json::json!({ "code": code.word(), "text": text });
    *answer.body_mut() = TunnelBody::whole(format!("{said}\n"));
    let json = http::HeaderValue::from_static("application/json");
    answer.headers_mut().insert(CONTENT_TYPE, json);
    answer
}
