//! The client: one peer at a hub.

use std::sync::Arc;
use std::time::Duration;

use mom_net::Transceiver;
use mom_proto::codec::Form;
use mom_proto::{Card, ContextKind, Family, Map, Parcel, Path, Thinning, Value, to_value};
use tokio::sync::watch;
use tokio::time::timeout;
use tracing::Instrument as _;

use crate::peer::shared::{Shared, verb};
use crate::peer::wanted::Terms;
use crate::wire::proof::{Credentials, is_challenge};
use crate::wire::trace;
use crate::wire::welcome::Welcome;
use crate::words::{map_of, millis};
use crate::{
    Builder, Channel, ClientError, Consults, ContextInfo, Events, HubClock, LinkState, Member, Proof,
    Session, Stats,
};

/// How long a logout may take.
const CLOSE: Duration = Duration::from_secs(1);

/// A peer that is logged in at a hub. Cheap to clone; all clones are the same peer.
///
/// When the last of the clones and of the proxies made from them is dropped, the client logs out.
///
/// ```no_run
/// # async fn example() -> Result<(), mom_client::ClientError> {
/// use mom_client::Client;
/// let client = Client::builder("bin://127.0.0.1").user("alice").password("alice").connect().await?;
/// for context in client.list("/").await? {
///     println!("{} {}", context.kind, context.path);
/// }
/// client.close().await;
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Client {
    pub(crate) handle: Arc<Handle>,
}

/// Held by everything that needs the connection; dropping the last one ends it.
#[derive(Debug)]
pub(crate) struct Handle {
    pub(crate) shared: Arc<Shared>,
}

impl Drop for Handle {
    fn drop(&mut self) {
        self.shared.end();
    }
}

impl Client {
    pub(crate) fn of(handle: Arc<Handle>) -> Client {
        Client { handle }
    }

    fn shared(&self) -> &Arc<Shared> {
        &self.handle.shared
    }

    /// A client of the hub at an address: `tcp://host:port` speaks XML, `bin://` and `mom://` binary. A path
    /// in the address is not joined by itself.
    pub fn builder(address: impl AsRef<str>) -> Builder {
        Builder::remote(address.as_ref())
    }

    /// A client of a hub in this process; `connect` gives one more connection to it.
    pub fn builder_local(connect: impl Fn() -> Transceiver + Send + Sync + 'static) -> Builder {
        Builder::local(connect, None)
    }

    /// A client of a hub in this process by lines that carry bytes in this form ([`mom_net::line()`]), for simulations.
    pub fn builder_line(form: Form, connect: impl Fn() -> Transceiver + Send + Sync + 'static) -> Builder {
        Builder::local(connect, Some(form))
    }

    /// The peer's name at the hub. It may be another one after a reconnect.
    pub fn name(&self) -> String {
        self.shared().lock().me.peer.clone()
    }

    /// The user.
    pub fn user(&self) -> String {
        self.shared().lock().me.user.clone()
    }

    /// The user's level; higher goes first (M29).
    pub fn level(&self) -> i32 {
        self.shared().lock().me.level
    }

    /// The hub's login reply: peer, user, level, groups, protocol, limits, time.
    pub fn welcome(&self) -> Map {
        self.shared().lock().me.content.clone()
    }

    /// Authenticates again, for example before a token expires; this proof is also used for later reconnects. Level
    /// and groups are refreshed. With a token of another user this becomes another peer:
    /// [`Event::LinkDown`](crate::Event::LinkDown) and all other consequences of a lost link follow.
    ///
    /// # Errors
    /// `Refused` with `bad-login` and other refusals of the hub, `Local` with `insecure` for a password or token that others could
    /// read on the way; then nothing changes.
    pub async fn authenticate_again(&self, proof: Proof) -> Result<(), ClientError> {
        let shared = self.shared();
        let known = shared.credentials.lock().clone();
        let credentials = Credentials { proof, ..known };
        let mut reply = self.request(credentials.login().await?).await?;
        if is_challenge(&reply) {
            reply = self.request(credentials.answer(&reply)?).await?;
        }
        let welcome = Welcome::read(map_of(&reply))?;
        *shared.credentials.lock() = credentials;
        shared.renew_login(welcome);
        Ok(())
    }

    /// Sends a request, with a new id and, unless it has one, a timestamp, and waits for the reply.
    ///
    /// A message is answered by the hub only if its `receipt` is true; see
    /// [`Message::send_acknowledged`](crate::Message::send_acknowledged).
    ///
    /// # Errors
    /// [`ClientError`], any.
    pub async fn request(&self, parcel: Parcel) -> Result<Parcel, ClientError> {
        let span = trace::sending(&parcel);
        let answer = self.shared().request(parcel).instrument(span.clone()).await;
        trace::sent(&span, &answer);
        answer
    }

    /// Sends a message; waits only for capacity in this client's own queue of 4 MiB. It gets a new id unless it has
    /// one. A refusal comes as [`Event::Refused`](crate::Event::Refused).
    ///
    /// # Errors
    /// `Local` for what cannot be encoded or is too large for the hub, `Connection` while the link is down,
    /// `Closed`.
    pub async fn send(&self, parcel: Parcel) -> Result<(), ClientError> {
        let span = trace::sending(&parcel);
        let sent = self.shared().post(parcel, None).instrument(span.clone()).await;
        trace::sent(&span, &sent);
        sent
    }

    /// Looks up a path (M32).
    ///
    /// # Errors
    /// `Refused` with `unknown-path` and the nearest one, or `denied`.
    pub async fn lookup(&self, path: &str) -> Result<ContextInfo, ClientError> {
        ContextInfo::from_reply(&self.ask(Family::Context, "lookup", path, None).await?)
    }

    /// The contexts in a session, as far as this peer may look them up.
    ///
    /// # Errors
    /// `Refused` with `unknown-path`, `wrong-kind` or `denied`.
    pub async fn list(&self, path: &str) -> Result<Vec<ContextInfo>, ClientError> {
        self.pages("list", path, |page| ContextInfo::list(page, "children"))
            .await
    }

    /// Details of one context (M33).
    ///
    /// # Errors
    /// `Refused` with `unknown-path` or `denied`.
    pub async fn info(&self, path: &str) -> Result<Map, ClientError> {
        Ok(map_of(&self.ask(Family::Context, "info", path, None).await?))
    }

    /// What the device of a channel says that it can do, with its peer's name; none where no device there has a card. Nothing that protects
    /// may rely on it.
    ///
    /// # Errors
    /// `Refused` with `unknown-path` or `denied`; `Local` for a card of a later form than this client reads.
    pub async fn card(&self, path: &str) -> Result<Option<(String, Card)>, ClientError> {
        let asked = Map::new().with("card", true);
        let info = map_of(&self.ask(Family::Context, "info", path, Some(asked)).await?);
        let Some(card) = info.get("card") else {
            return Ok(None);
        };
        let card = Card::read(card).map_err(ClientError::Local)?;
        let peer = info.get("device").and_then(Value::as_str);
        Ok(Some((peer.unwrap_or_default().to_owned(), card)))
    }

    /// The members of a context.
    ///
    /// # Errors
    /// `Refused` with `unknown-path` or `denied`.
    pub async fn members(&self, path: &str) -> Result<Vec<Member>, ClientError> {
        self.pages("members", path, |page| Member::list(page, "members"))
            .await
    }

    /// Asks for a list page by page, as long as the hub says that there is more.
    async fn pages<T>(
        &self,
        name: &'static str,
        path: &str,
        read: impl Fn(&Parcel) -> Result<Vec<T>, ClientError>,
    ) -> Result<Vec<T>, ClientError> {
        let mut all = Vec::new();
        let mut after = None;
        loop {
            let content = after.map(|after: Value| Map::new().with("after", after));
            let page = self.ask(Family::Context, name, path, content).await?;
            all.extend(read(&page)?);
            let map = map_of(&page);
            let more = map.get("more").and_then(Value::as_bool) == Some(true);
            match map.get("next").filter(|_| more) {
                Some(next) => after = Some(next.clone()),
                None => return Ok(all),
            }
        }
    }

    /// The statistics of a channel and of each member, or of the channels of a session that this peer may ask about.
    ///
    /// # Errors
    /// `Refused` with `unknown-path`, `wrong-kind` (a token) or `denied`.
    pub async fn stats(&self, path: &str) -> Result<Stats, ClientError> {
        Stats::from_reply(&self.ask(Family::Context, "stats", path, None).await?)
    }

    /// Creates a context (M24); joins its parent session meanwhile. `spec` holds `kind` (`session`, `channel`,
    /// `token`), `manager`, and other keys of that kind.
    ///
    /// # Errors
    /// `Refused` with `exists`, `denied`, `bad-content`, `unknown-manager` and others.
    pub async fn create(&self, path: &str, spec: Map) -> Result<ContextInfo, ClientError> {
        let above = Path::parse(path)?.parent().unwrap_or_else(Path::root);
        let _member = self.enter(&above, None).await?;
        ContextInfo::from_reply(&self.ask(Family::Context, "create", path, Some(spec)).await?)
    }

    /// Deletes a context with all below it.
    ///
    /// # Errors
    /// `Refused` with `unknown-path`, `permanent` or `denied`.
    pub async fn delete(&self, path: &str) -> Result<(), ClientError> {
        self.ask(Family::Context, "delete", path, None).await.map(drop)
    }

    /// Invites a peer to a context, subject to its manager; joins the context meanwhile. The peer gets
    /// [`Event::Invited`](crate::Event::Invited).
    ///
    /// # Errors
    /// `Refused` with `unknown-path`, `unknown-peer` or `denied`.
    pub async fn invite(&self, path: &str, peer: &str) -> Result<(), ClientError> {
        let _member = self.enter(&Path::parse(path)?, None).await?;
        let content = Map::new().with("peer", peer);
        self.ask(Family::Context, "invite", path, Some(content))
            .await
            .map(drop)
    }

    /// Expels a peer from a context and all below it, and keeps it out for a time, by default 1 min; `text` is the
    /// reason and may be empty. Its tokens there are lost. Expelled from `/`, it is disconnected.
    ///
    /// # Errors
    /// `Refused` with `unknown-path`, `unknown-peer` or `denied`.
    pub async fn expel(
        &self,
        path: &str,
        peer: &str,
        text: &str,
        time: Option<Duration>,
    ) -> Result<(), ClientError> {
        let mut content = Map::new().with("peer", peer);
        if !text.is_empty() {
            content.set("text", text);
        }
        if let Some(time) = time {
            content.set("for", millis(time));
        }
        self.ask(Family::Context, "expel", path, Some(content))
            .await
            .map(drop)
    }

    /// The hub's questions to this peer, from now on: about contexts that it manages, created with the manager
    /// `self`, and those where it has the chair.
    pub fn consults(&self) -> Consults {
        Consults::new(self.clone(), self.shared().subscribe_consults())
    }

    /// Joins a session, parents first.
    ///
    /// # Errors
    /// `Refused` with `unknown-path` or `denied`; `Local` with `wrong-kind` if it is not a session.
    pub async fn session(&self, path: &str) -> Result<Session, ClientError> {
        self.enter_kind(path, ContextKind::Session, None)
            .await
            .map(Session::new)
    }

    /// Joins a channel, parents first.
    ///
    /// # Errors
    /// As [`Client::session`].
    pub async fn channel(&self, path: &str) -> Result<Channel, ClientError> {
        self.enter_kind(path, ContextKind::Channel, None)
            .await
            .map(Channel::new)
    }

    /// Joins a channel, parents first, with thinning, which applies to all proxies of this client: [`Channel::thin`].
    ///
    /// ```no_run
    /// # async fn example(client: mom_client::Client) -> Result<(), mom_client::ClientError> {
    /// use mom_client::Thinning;
    /// let thinning = Thinning { rate: Some("5/s".parse()?), ..Thinning::default() };
    /// let camera = client.channel_thinned("/camera/x", thinning).await?;
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// As [`Client::session`].
    pub async fn channel_thinned(&self, path: &str, thinning: Thinning) -> Result<Channel, ClientError> {
        let terms = Terms {
            thinning,
            ..Terms::default()
        };
        self.enter_kind(path, ContextKind::Channel, Some(terms))
            .await
            .map(Channel::new)
    }

    /// Joins a channel, parents first, as a device: this peer halts at each `stop` there, stays halted until `unstop`, and says
    /// so after each of both by a message `state` whose content, a map, has `stopped`. Who stops devices waits for that word.
    ///
    /// # Errors
    /// As [`Client::session`].
    pub async fn channel_as_device(&self, path: &str) -> Result<Channel, ClientError> {
        self.channel_of_device(path, None).await
    }

    /// The same for a device that says what it can do: others read its card by [`Client::card`].
    ///
    /// # Errors
    /// As [`Client::session`], and `bad-content` for a card that the hub does not take, with the slot of what is wrong.
    pub async fn channel_with_card(&self, path: &str, card: &Card) -> Result<Channel, ClientError> {
        let card = to_value(card).map_err(ClientError::Local)?;
        self.channel_of_device(path, Some(Arc::new(card))).await
    }

    async fn channel_of_device(&self, path: &str, card: Option<Arc<Value>>) -> Result<Channel, ClientError> {
        let terms = Terms {
            device: true,
            card,
            ..Terms::default()
        };
        self.enter_kind(path, ContextKind::Channel, Some(terms))
            .await
            .map(Channel::new)
    }

    /// Events that no other subscription takes, from now on: those of contexts without a proxy, refusals of sends
    /// there, and the state of the link. It keeps neither the client nor the connection alive.
    pub fn unaddressed(&self) -> Events {
        let shared = self.shared();
        Events::new(shared.subscribe_unaddressed(), Arc::clone(shared), None)
    }

    /// The hub's clock as measured over this link, for the age of arriving parcels.
    pub fn clock(&self) -> HubClock {
        self.shared().clock.clone()
    }

    /// The state of the link, to read or to wait for.
    pub fn state(&self) -> watch::Receiver<LinkState> {
        self.shared().link.subscribe()
    }

    /// Logs out after everything sent before, and waits briefly for the answer. Clones and proxies are unusable
    /// afterwards.
    pub async fn close(self) {
        let shared = self.shared();
        shared.end();
        let mut link = shared.link.subscribe();
        // If the logout is not answered in time, the end of the connection does the same.
        let _ = timeout(CLOSE, link.wait_for(|link| matches!(link, LinkState::Closed(_)))).await;
    }

    async fn ask(
        &self,
        family: Family,
        name: &str,
        path: &str,
        content: Option<Map>,
    ) -> Result<Parcel, ClientError> {
        let mut parcel = verb(family, name, &Path::parse(path)?);
        parcel.content = content.map(Into::into);
        self.request(parcel).await
    }
}
