//! Making a client.

use std::fmt::{self, Display};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;

use mom_net::{Address, ClientTls, Identity, TlsError, Transceiver, Trust};
use mom_proto::codec::Form;
use mom_proto::{Code, Time, WireError};
use parking_lot::Mutex;

use crate::contexts::client::{Client, Handle};
use crate::device::installation::Installation;
use crate::link::doors::Doors;
use crate::link::login::{Connector, Local};
use crate::link::{driver, reconnect};
use crate::peer::shared::{Boxed, Settings, Shared};
use crate::wire::clock::{HubClock, Wall};
use crate::wire::link_secret::LinkSecret;
use crate::wire::proof::Credentials;
use crate::{ClientError, Key, Proof, Reconnect, Report, TokenSource};

/// Longer than chairs usually have for an answer (M24).
const REQUEST_TIMEOUT: Duration = Duration::from_secs(40);
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);

/// The settings of a client before it connects.
///
/// ```no_run
/// # async fn example() -> Result<(), mom_client::ClientError> {
/// use std::time::Duration;
/// use mom_client::Client;
///
/// let client = Client::builder("tcp://127.0.0.1:7666")
///     .user("alice")
///     .password("alice")
///     .nickname("ally")
///     .request_timeout(Duration::from_secs(3))
///     .connect()
///     .await?;
/// assert_eq!(client.name(), "ally");
/// # Ok(())
/// # }
/// ```
#[must_use = "a builder does nothing until connect"]
pub struct Builder {
    /// Where the hub is.
    hub: Result<HubPlace, ClientError>,
    credentials: Credentials,
    /// Which hub is the right one, over TLS.
    trust: Option<Trust>,
    /// A key that could not be read.
    fault: Option<ClientError>,
    wall: Wall,
    settings: Settings,
    /// How to reconnect; none = not at all.
    reconnect: Option<Reconnect>,
    waits: bool,
    /// Who reports failures.
    reporter: Option<(String, String)>,
}

/// Where a hub is.
enum HubPlace {
    Address(Address),
    Here(Local, Option<Form>),
}

impl Builder {
    pub(crate) fn remote(address: &str) -> Builder {
        Builder::new(
            address
                .parse::<Address>()
                .map(HubPlace::Address)
                .map_err(ClientError::from),
        )
    }

    pub(crate) fn local(
        connect: impl Fn() -> Transceiver + Send + Sync + 'static,
        form: Option<Form>,
    ) -> Builder {
        Builder::new(Ok(HubPlace::Here(Arc::new(connect), form)))
    }

    fn new(hub: Result<HubPlace, ClientError>) -> Builder {
        Builder {
            hub,
            credentials: Credentials {
                user: String::new(),
                proof: Proof::Password(String::new()),
                nickname: None,
                hub: None,
                address: None,
                link: None,
                heartbeat: None,
                compress: false,
            },
            trust: None,
            fault: None,
            wall: Arc::new(crate::wire::clock::system),
            settings: Settings {
                request_timeout: REQUEST_TIMEOUT,
                connect_timeout: CONNECT_TIMEOUT,
                event_buffer: 1024,
                installation: Installation::unknown(),
            },
            reconnect: Some(Reconnect::default()),
            waits: false,
            reporter: None,
        }
    }

    /// The user to log in as.
    pub fn user(mut self, user: impl Into<String>) -> Builder {
        self.credentials.user = user.into();
        self
    }

    /// The user's password. It is sent over TLS or loopback only: over another address [`connect`](Builder::connect) refuses.
    pub fn password(self, password: impl Into<String>) -> Builder {
        self.proof(Proof::Password(password.into()))
    }

    /// A key of the user's, for devices. It is accepted from anywhere, because no secret is on the wire.
    pub fn key(self, key: Key) -> Builder {
        self.proof(Proof::Key(key))
    }

    /// The same, from a file written by `mom keygen`; an invalid file is an error of [`connect`](Builder::connect).
    pub fn key_file(mut self, file: impl AsRef<Path>) -> Builder {
        match Key::from_file(file) {
            Ok(key) => self.key(key),
            Err(error) => {
                self.fault = Some(error);
                self
            }
        }
    }

    /// A token (JWT) of an issuer that the hub trusts; it names the user itself, and is sent where a password is. When
    /// it expires the hub closes the link, unless [`Client::authenticate_again`] came before.
    pub fn token(self, token: impl Into<String>) -> Builder {
        self.proof(Proof::Token(token.into()))
    }

    /// The same, from a function that is asked at each login, so that a token that has expired is fetched anew. Where
    /// it has worked once its errors are those of a connection: it is asked again later.
    pub fn token_from<F, E>(self, ask: impl Fn() -> F + Send + Sync + 'static) -> Builder
    where
        F: Future<Output = Result<String, E>> + Send + 'static,
        E: Display,
    {
        self.proof(Proof::TokenFrom(TokenSource::new(ask)))
    }

    /// The certificate of this peer, shown to a hub over TLS and a proof of who it is: its fingerprint stands in the
    /// users file (`certificates`).
    pub fn certificate(self, identity: Identity) -> Builder {
        self.proof(Proof::Certificate(identity))
    }

    /// Which hub is the right one over TLS (`bins://`, `tcps://`). By default the one with the certificate that the address
    /// names (`?pin=sha256:…`), and else one that this system trusts.
    ///
    /// ```no_run
    /// # async fn example() -> Result<(), Box<dyn std::error::Error>> {
    /// use mom_client::{Client, Trust};
    ///
    /// let shown_by_the_hub = "sha256:4355a46b19d348dc2f57c046f8ef63d4538ebb936000f3c9ee954a27460dd865";
    /// let client = Client::builder("bins://lab.example.org")
    ///     .trust(Trust::Pinned(shown_by_the_hub.parse()?))
    ///     .user("alice")
    ///     .password("alice")
    ///     .connect()
    ///     .await?;
    /// # Ok(())
    /// # }
    /// ```
    pub fn trust(mut self, trust: Trust) -> Builder {
        self.trust = Some(trust);
        self
    }

    /// Log in as a guest, where the hub lets them in.
    pub fn guest(self) -> Builder {
        self.proof(Proof::Guest)
    }

    /// The proof of identity; the last one set counts.
    pub fn proof(mut self, proof: Proof) -> Builder {
        self.credentials.proof = proof;
        self.fault = None;
        self
    }

    /// The hub for which a key may sign, by the name in the hub's configuration. Without it the key signs for any hub
    /// it is connected to, and a malicious hub could relay the signature to another.
    pub fn hub_name(mut self, hub: impl Into<String>) -> Builder {
        self.credentials.hub = Some(hub.into());
        self
    }

    /// The requested name at the hub instead of the user's.
    pub fn nickname(mut self, nickname: impl Into<String>) -> Builder {
        self.credentials.nickname = Some(nickname.into());
        self
    }

    /// Asks for a link that survives the loss of its connection for so long: this peer keeps its memberships, its tokens while
    /// their leases run, and what was under way. A hub gives one over TLS and on its own machine, since the link has a secret.
    ///
    /// What moves a device, lets it move or changes who drives it (messages that need a token, `command`, `unstop`, offers) is never sent
    /// late, because the hub has halted the devices: [`Event::Dropped`](crate::Event::Dropped) says `lost` if it was not sent and
    /// `unknown` if it had left, and who waits for its answer hears [`ClientError::Unknown`] then.
    pub fn link(mut self, grace: Duration) -> Builder {
        self.credentials.link = Some(grace);
        self
    }

    /// How often both sides say that they are there, from 100 ms to 10 s; by default as the hub says, and never more seldom. A connection
    /// is lost after three times that without a byte: a peer that moves a device, or is one, wants it short. Out of that range
    /// [`connect`](Builder::connect) refuses.
    pub fn heartbeat(mut self, every: Duration) -> Builder {
        self.credentials.heartbeat = Some(every);
        self
    }

    /// How long to wait for a reply, and for a connection with its login. The defaults are 40 s for a reply, because
    /// a manager may have to ask a peer, and 10 s for a connection. A lost link ends the wait sooner.
    pub fn request_timeout(mut self, timeout: Duration) -> Builder {
        self.settings.request_timeout = timeout;
        self.settings.connect_timeout = timeout;
        self
    }

    /// Asks for compression: the contents of messages are compressed by zstd in both directions where that saves an eighth, but
    /// for those named `image`. It is worth its time on links of a few hundred Mbit/s and less, and costs the sender some
    /// milliseconds for each MiB. A connection in XML or JSON is compressed as a whole, which brings it to about a tenth of its bytes.
    /// Not by default.
    pub fn compress(mut self, compress: bool) -> Builder {
        self.credentials.compress = compress;
        self
    }

    /// How to reconnect after a lost link; [`Reconnect::default`] by default.
    pub fn reconnect(mut self, reconnect: Reconnect) -> Builder {
        self.reconnect = Some(reconnect);
        self
    }

    /// A lost link closes the client.
    pub fn no_reconnect(mut self) -> Builder {
        self.reconnect = None;
        self
    }

    /// Waits where the hub is not there yet, with the delays of [`reconnect`](Builder::reconnect), and logs that: for devices,
    /// which may be switched on before the hub is.
    pub fn wait_for_hub(mut self) -> Builder {
        self.waits = true;
        self
    }

    /// The most events that wait for one subscriber; 1024 by default.
    pub fn event_buffer(mut self, events: usize) -> Builder {
        self.settings.event_buffer = events;
        self
    }

    /// Which installed program a device is: the same after each start, and no other's, 64 bytes at most. Where a channel has one
    /// device, a program that is started later takes the place of its own earlier start, which hears
    /// [`Event::Expelled`](crate::Event::Expelled) and halts; any other device is refused as `occupied`. By default
    /// each client is another one.
    pub fn installation(mut self, id: &str) -> Builder {
        self.settings.installation = Installation::new(id);
        self
    }

    /// The clock that stamps this peer's parcels, for devices with a clock of their own; the system's wall clock by
    /// default. It may be wrong and may be set: the hub measures its offset (M34).
    pub fn wall_clock(mut self, wall: impl Fn() -> Time + Send + Sync + 'static) -> Builder {
        self.wall = Arc::new(move || Some(wall()));
        self
    }

    /// Reports to the hub, once and by plain HTTP, the error by which the first attempt to connect fails, if it is one of the connection;
    /// under this name and version of a program. Off by default: it goes in the clear, to any server at the address.
    pub fn report_failures(mut self, program: &str, version: &str) -> Builder {
        self.reporter = Some((program.to_owned(), version.to_owned()));
        self
    }

    /// Connects and logs in, without retrying unless [`wait_for_hub`](Builder::wait_for_hub) says so. Needs a tokio
    /// runtime, in which the client's tasks then run.
    ///
    /// # Errors
    /// `Address` for a wrong address, `Local` for a bad key, a heartbeat out of range and, with the code `insecure`, for a password or
    /// token that others could read on the way, `Connection` and `TimedOut` for an unreachable hub, `Refused` with
    /// `bad-login` and other refusals of the hub.
    pub async fn connect(self) -> Result<Client, ClientError> {
        self.connecting().await
    }

    /// See [`Boxed`].
    fn connecting(self) -> Boxed<'static, Result<Client, ClientError>> {
        Box::pin(self.connect_and_drive())
    }

    async fn connect_and_drive(mut self) -> Result<Client, ClientError> {
        if let Some(error) = self.fault {
            return Err(error);
        }
        self.credentials.check_heartbeat()?;
        let connector = match self.hub? {
            HubPlace::Address(address) => {
                let doors = doors(&address, &mut self.credentials, self.trust)?;
                Connector::Remote(doors)
            }
            HubPlace::Here(local, form) => Connector::Local(local, form),
        };
        let ids = AtomicU64::new(1);
        let patience = self.reconnect.as_ref().filter(|_| self.waits);
        let reporter = Mutex::new(self.reporter);
        let connect = || async {
            let connected = connector
                .connect(&self.credentials, &ids, self.settings.connect_timeout)
                .await;
            if let (Err(error), Some(address)) = (&connected, connector.address()) {
                let reporter = reporter.lock().take();
                report_failure(reporter, &address, error).await;
            }
            connected
        };
        let connected = match patience {
            Some(patience) => reconnect::wait(patience, connect).await?,
            None => connect().await?,
        };
        self.credentials.address = connector.address();
        let secret = LinkSecret::read(&connected.welcome.content);
        let shared = Shared::new(
            self.settings,
            self.credentials,
            HubClock::new(self.wall),
            connector.form(),
            ids,
            connected.welcome,
        );
        shared.begin_link(&mut shared.lock(), secret.filter(|_| self.reconnect.is_some()));
        let shared = Arc::new(shared);
        let drive = driver::run(
            Arc::clone(&shared),
            connector,
            self.reconnect,
            connected.transceiver,
        );
        tokio::spawn(drive);
        Ok(Client::of(Arc::new(Handle { shared })))
    }
}

/// The doors that these credentials may be said through.
fn doors(
    address: &Address,
    credentials: &mut Credentials,
    trust: Option<Trust>,
) -> Result<Doors, ClientError> {
    let secret = matches!(
        credentials.proof,
        Proof::Password(_) | Proof::Token(_) | Proof::TokenFrom(_)
    );
    let mut permitted = address.doors(address.any && secret);
    if matches!(credentials.proof, Proof::Certificate(_)) {
        permitted.retain(|door| door.tls || !address.any);
    }
    // Of an address that names one door, its own words say what is wrong with that.
    credentials.address = Some(permitted.first().unwrap_or(address).clone());
    credentials.check()?;
    let mut tls = None;
    if permitted.iter().any(|door| door.tls) {
        let trust = trust.or(address.pin.map(Trust::Pinned)).unwrap_or_default();
        let identity = match &credentials.proof {
            Proof::Certificate(identity) => Some(identity),
            _ => None,
        };
        match ClientTls::new(&trust, identity) {
            Ok(made) => tls = Some(made),
            // On a machine that trusts nobody its own hub is still there.
            Err(_) if permitted.iter().any(|door| !door.tls) => permitted.retain(|door| !door.tls),
            Err(error) => return Err(unusable(&error)),
        }
    }
    Ok(Doors::new(permitted, tls))
}

/// Reports an error of the connection: what a hub refuses it knows.
async fn report_failure(reporter: Option<(String, String)>, address: &Address, error: &ClientError) {
    let (Some((program, version)), ClientError::Connection(_) | ClientError::TimedOut { .. }) =
        (reporter, error)
    else {
        return;
    };
    let report = Report::of(error).by(&program, &version);
    match crate::link::report::send(address, &report).await {
        Ok(()) => tracing::info!("the failure is reported to the hub"),
        Err(error) => tracing::debug!("the failure cannot be reported: {error}"),
    }
}

fn unusable(error: &TlsError) -> ClientError {
    ClientError::Local(WireError::new(Code::BAD_LOGIN, error.to_string()))
}

impl fmt::Debug for Builder {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Builder")
            .field("credentials", &self.credentials)
            .field("settings", &self.settings)
            .field("reconnect", &self.reconnect)
            .finish_non_exhaustive()
    }
}
