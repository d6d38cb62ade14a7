//! The service: its listeners, the hub's timer, and its end.

mod listen;

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use mom_config::{Config, ConfigError, ConfigErrors};
use mom_hub::{Hub, Input, Settings};
use mom_journal::{Tap, WriteError};
use mom_login::{LoginStats, Logins};
use mom_net::{SelfSigned, ServerTls, Takes, Transceiver};
use mom_proto::Fingerprint;
use mom_store::{StopFile, StoreAnswer, StoreError};
use mom_system::Clock;
use parking_lot::{Mutex, RwLock};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinSet;
use tokio::time::{Instant, timeout_at};

use crate::connection::{AdmissionLimiter, DRAIN, Remote, Services, Serving, login_time};
use crate::inquiry::Answering;
use crate::traffic::encodings::Bounds;
use crate::traffic::switchboard::{Keeping, Switchboard, Touched, flush};
use crate::web::Web;

use listen::{Listener, listen};

/// What is dropped is told to senders and receivers this often at most; counted log lines are looked at as often.
const REPORTS: Duration = Duration::from_millis(250);

/// While the hub is tight, what can be done about it is done this often.
const RELIEF: Duration = Duration::from_millis(20);

/// The wall clock is looked at this often.
const WALL_CLOCK: Duration = Duration::from_secs(1);

/// Part of `DRAIN` reserved for store writes caused by disconnects.
const LAST_RECORDS: Duration = Duration::from_secs(1);

/// A broker that cannot start.
#[derive(Debug, thiserror::Error)]
pub enum BrokerError {
    /// Its configuration is wrong.
    #[error(transparent)]
    Config(#[from] ConfigErrors),
    /// Its store cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A file that it shall write and cannot.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// An address that cannot be listened at.
    #[error("cannot listen at {address}: {error}{}", hint(error))]
    Listen {
        /// The address of the configuration.
        address: String,
        /// What the system says.
        error: std::io::Error,
    },
}

fn hint(error: &std::io::Error) -> &'static str {
    match error.kind() {
        std::io::ErrorKind::AddrInUse => "; another broker runs there, or choose another port with --listen",
        std::io::ErrorKind::PermissionDenied => "; ports below 1024 require privileges",
        _ => "",
    }
}

impl From<ConfigError> for BrokerError {
    fn from(error: ConfigError) -> BrokerError {
        BrokerError::Config(error.into())
    }
}

/// A running broker.
///
/// ```no_run
/// # async fn run() -> Result<(), mom_broker::BrokerError> {
/// use mom_broker::{Broker, Config};
///
/// let broker = Broker::start(Config::lab()).await?;
/// println!("listening at {}", broker.local_addr());
/// broker.stop().await;
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Broker {
    pub(crate) services: Services,
    addresses: Vec<SocketAddr>,
    stopping: watch::Sender<bool>,
    tasks: JoinSet<()>,
    /// Closed when the broker stops.
    doors: Arc<AdmissionLimiter>,
    /// Replaced by [`Broker::reload`].
    pub(crate) tls: Arc<RwLock<Option<ServerTls>>>,
    pub(crate) web: Arc<Web>,
    /// The configuration that it goes by; see [`Broker::reload`].
    pub(crate) running: Arc<Mutex<Config>>,
}

impl Broker {
    /// Starts listening. Returns when connections are taken.
    ///
    /// # Errors
    /// A wrong configuration, a store that cannot be used, or an address that cannot be listened at.
    pub async fn start(config: Config) -> Result<Broker, BrokerError> {
        Broker::start_at(config, Clock::system()).await
    }

    /// As [`Broker::start`], by another clock: one that is moved by hand, for simulations and tests.
    ///
    /// # Errors
    /// As [`Broker::start`].
    pub async fn start_at(config: Config, clock: Clock) -> Result<Broker, BrokerError> {
        let mut settings = Settings {
            anchor: clock.anchor(),
            epoch: u64::try_from(clock.anchor().micros() / 1_000_000).unwrap_or_default(),
            limits: config.limits.clone(),
            ..Settings::default()
        };
        config.check_login()?;
        let (mut store, mut answers) = (None, None);
        if let Some(opened) = mom_store::open(config.store.path.as_deref(), clock.anchor()).await? {
            settings.durable = true;
            settings.epoch = opened.epoch;
            settings.records = opened.records;
            (store, answers) = (Some(opened.store), Some(opened.answers));
        } else if let Some(epoch) =
            mom_store::take_epoch(config.store.state.as_deref(), clock.anchor()).await?
        {
            settings.epoch = epoch;
        }
        let (stops, stop_answers) = open_stops(&config, &mut settings).await?.unzip();
        let hub = make_hub(&config, &settings, stops.as_ref())?;
        let tap = Tap::start((&config.audit, &config.record), config.file(), &settings, &clock)?;
        let mut logins = Logins::new(config.users.clone(), config.login.clone(), clock.clone())
            .map_err(ConfigError::from)?;
        remember_places(&mut logins, config.store.path.as_deref());
        let board = Switchboard::new(hub, clock, bounds(&config), Keeping { store, stops }, tap);
        board.memory.set_bound(config.memory_bound());
        let services = Services::new(board, logins, config.limits.clone());
        let tls = Arc::new(RwLock::new(open_tls(&config)?));
        let (stopping, stop) = watch::channel(false);
        let doors = Arc::new(AdmissionLimiter::new(config.connection_caps()));
        let web = Arc::new(Web::new(Arc::clone(&doors), &config.web));
        let mut tasks = JoinSet::new();
        let mut addresses = Vec::new();
        for entry in &config.listen {
            let failed = |error| BrokerError::Listen {
                address: entry.address.clone(),
                error,
            };
            let socket = listen(&entry.address).await.map_err(failed)?;
            addresses.push(socket.local_addr().map_err(failed)?);
            let listener = Listener {
                services: services.clone(),
                doors: Arc::clone(&doors),
                tls: Arc::clone(&tls),
                web: Arc::clone(&web),
                takes: Takes::new(&entry.takes, entry.tls),
                proxies: entry.proxy.clone(),
                stop: stop.clone(),
            };
            tasks.spawn(listener.run(socket));
        }
        for answers in answers.into_iter().chain(stop_answers) {
            tasks.spawn(take_answers(Arc::clone(&services.board), answers));
        }
        let running = Arc::new(Mutex::new(config));
        spawn_housekeeping(&mut tasks, &services.board, &running, &stop);
        let broker = Broker {
            services,
            addresses,
            stopping,
            tasks,
            doors,
            tls,
            web,
            running,
        };
        broker.note_start();
        Ok(broker)
    }

    fn note_start(&self) {
        let fingerprint = self.fingerprint().map(|fingerprint| fingerprint.to_string());
        tracing::info!(addresses = ?self.addresses, fingerprint, "broker started");
    }

    /// The first address that it listens at.
    ///
    /// # Panics
    /// If it was configured to listen nowhere.
    pub fn local_addr(&self) -> SocketAddr {
        *self
            .addresses
            .first()
            .expect("a configuration without an address to listen at is refused")
    }

    /// All addresses that it listens at.
    pub fn local_addrs(&self) -> &[SocketAddr] {
        &self.addresses
    }

    /// What clients may know the hub's certificate by, if it has one.
    pub fn fingerprint(&self) -> Option<Fingerprint> {
        self.tls.read().as_ref().map(ServerTls::fingerprint)
    }

    /// Which build of the console it serves; none if none was built into this program, or it is switched off.
    pub fn console(&self) -> Option<&str> {
        self.web.console()
    }

    /// A connection from inside this process (M18). The peer still has to log in.
    pub fn connect_local(&self) -> Transceiver {
        let (here, there) = mom_net::pair();
        self.serve(here);
        there
    }

    /// Serves a peer inside this process by its connection, such as that of [`mom_net::line()`].
    pub fn serve(&self, peer: Transceiver) {
        let services = self.services.fresh();
        let login_by = Instant::now() + login_time(&services.limits);
        let mut serving = Serving::begin(services, peer, Remote::default(), None, login_by);
        tokio::spawn(async move { serving.run().await });
    }

    /// What the hashing of passwords has come to.
    pub fn login_stats(&self) -> LoginStats {
        self.services.logins.stats()
    }

    /// Asserts the invariants of the hub (design §4), as tests do after each step.
    ///
    /// # Panics
    /// If one of them does not hold: the hub's own fault.
    pub fn check(&self) {
        self.services.board.check();
    }

    /// Takes no more connections, tells all peers, lets what waits go out and the store write, at most 10 s.
    pub async fn stop(mut self) {
        let deadline = Instant::now() + DRAIN;
        let store = &self.services.board.keeping.store;
        let peers_by = store.as_ref().map_or(deadline, |_| deadline - LAST_RECORDS);
        // Nobody is listening any more if all tasks have ended.
        let _ = self.stopping.send(true);
        self.doors.close();
        self.services.board.shut_down();
        if timeout_at(peers_by, self.services.board.wait_empty())
            .await
            .is_err()
        {
            tracing::warn!("some connections did not end in time and are closed");
        }
        if let Some(store) = store
            && timeout_at(deadline, store.close()).await.is_err()
        {
            tracing::warn!("the store did not finish writing in time; unacknowledged changes may be lost");
        }
        if self.services.board.keeping.stops.is_some() {
            let board = Arc::clone(&self.services.board);
            let closed = tokio::task::spawn_blocking(move || {
                board.keeping.stops.iter().for_each(StopFile::close);
            });
            if timeout_at(deadline, closed).await.is_err() {
                tracing::warn!("the stop state was not written in time");
            }
        }
        // What is left are connections that have not said in which form they speak.
        self.tasks.shutdown().await;
        let logins = Arc::clone(&self.services.logins);
        let remembered = tokio::task::spawn_blocking(move || logins.remember()).await;
        if let Ok(Err(error)) = remembered {
            tracing::warn!(%error, "the addresses from which users log in are not stored");
        }
        self.services.board.tap.stop().await;
        tracing::info!("broker stopped");
    }
}

/// Opens what keeps stops, if anything does, and tells the hub's settings what was kept.
async fn open_stops(
    config: &Config,
    settings: &mut Settings,
) -> Result<Option<(StopFile, mpsc::UnboundedReceiver<StoreAnswer>)>, BrokerError> {
    let Some(kept) = mom_store::open_stops(&config.store, config.stops_name()).await? else {
        return Ok(None);
    };
    settings.keeps_stops = true;
    settings.stops = kept.records;
    settings.stops_unread = kept.unread.is_some();
    Ok(Some((kept.file, kept.answers)))
}

/// Makes the hub, and keeps as stopped what could not be read.
fn make_hub(config: &Config, settings: &Settings, stops: Option<&StopFile>) -> Result<Hub, BrokerError> {
    let hub = config.make_hub(settings.clone())?;
    if let Some(stops) = stops.filter(|_| settings.stops_unread) {
        let records = hub.stop_records();
        records.iter().for_each(|record| stops.keep(record, None));
    }
    Ok(hub)
}

fn bounds(config: &Config) -> Bounds {
    Bounds {
        depth: config.limits.depth,
        parcel: config.limits.parcel,
    }
}

/// Reads the certificate of the configuration, and makes it first if it is to be.
pub(crate) fn open_tls(config: &Config) -> Result<Option<ServerTls>, ConfigError> {
    let tls = &config.tls;
    if let (true, Some(certificate), Some(key)) = (tls.self_signed, &tls.certificate, &tls.key) {
        let files = SelfSigned {
            certificate: certificate.clone(),
            key: key.clone(),
        };
        let made = files.make(tls.hosts.clone());
        made.map_err(|error| config.tls_fault(&error.file, &error.why))?;
    }
    read_tls(config)
}

/// Reads the certificate of the configuration, none if it names none or one that is to be made yet.
///
/// # Errors
/// Files that cannot be read or do not belong together.
pub fn read_tls(config: &Config) -> Result<Option<ServerTls>, ConfigError> {
    let tls = &config.tls;
    let (Some(certificate), Some(key)) = (&tls.certificate, &tls.key) else {
        return Ok(None);
    };
    if tls.self_signed && !certificate.exists() && !key.exists() {
        return Ok(None);
    }
    let read = ServerTls::from_files(certificate, key);
    read.map(Some)
        .map_err(|error| config.tls_fault(&error.file, &error.why))
}

/// Lets it be known after a restart where users have logged in before, if there is a directory for that.
fn remember_places(logins: &mut Logins, directory: Option<&Path>) {
    if let Some(Err(error)) = directory.map(|directory| logins.remember_in(directory)) {
        tracing::warn!(%error, "the addresses from which users logged in before are unknown, and new ones will not be stored");
    }
}

/// What a broker does beside its connections.
fn spawn_housekeeping(
    tasks: &mut JoinSet<()>,
    board: &Arc<Switchboard>,
    running: &Arc<Mutex<Config>>,
    stop: &watch::Receiver<bool>,
) {
    tasks.spawn(keep_deadlines(Arc::clone(board), stop.clone()));
    tasks.spawn(keep_memory(Arc::clone(board), stop.clone()));
    tasks.spawn(follow_wall_clock(Arc::clone(board), stop.clone()));
    tasks.spawn(report(Arc::clone(board), stop.clone()));
    let answering = Answering::new(Arc::clone(board), Arc::clone(running));
    tasks.spawn(answering.run(stop.clone()));
}

/// Calls the hub when one of its deadlines comes.
async fn keep_deadlines(board: Arc<Switchboard>, mut stop: watch::Receiver<bool>) {
    loop {
        let next = board.deadline();
        let due = async {
            match next {
                Some(at) => board.clock.reach(at).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            _ = stop.changed() => return,
            () = board.deadline_changed.notified() => {}
            () = due => {
                let mut touched = Touched::new();
                board.decide(Input::Tick, &mut touched);
                flush(&mut touched);
            }
        }
    }
}

/// Looks whether the wall clock was set, and tells the hub.
async fn follow_wall_clock(board: Arc<Switchboard>, mut stop: watch::Receiver<bool>) {
    let mut steps = board.clock.steps();
    loop {
        tokio::select! {
            _ = stop.changed() => return,
            () = tokio::time::sleep(WALL_CLOCK) => board.clock.follow(),
            Ok(()) = steps.changed() => {
                let ahead = *steps.borrow_and_update();
                let time = board.clock.civil();
                tracing::warn!(%time, "the wall clock was set; leases and deadlines go on as before");
                let mut touched = Touched::new();
                board.decide(Input::Wall { ahead }, &mut touched);
                flush(&mut touched);
            }
        }
    }
}

/// Holds what waits within the bound on memory.
async fn keep_memory(board: Arc<Switchboard>, mut stop: watch::Receiver<bool>) {
    loop {
        tokio::select! {
            _ = stop.changed() => return,
            () = board.memory.tight() => board.relieve(),
        }
        tokio::select! {
            _ = stop.changed() => return,
            () = tokio::time::sleep(RELIEF) => {}
        }
    }
}

/// Tells the hub which of its records are durable; ends with the store.
async fn take_answers(board: Arc<Switchboard>, mut answers: mpsc::UnboundedReceiver<StoreAnswer>) {
    while let Some((ticket, ok)) = answers.recv().await {
        let mut touched = Touched::new();
        board.decide(Input::Stored { ticket, ok }, &mut touched);
        flush(&mut touched);
    }
}

/// Tells peers what was dropped, and the log what was counted.
async fn report(board: Arc<Switchboard>, mut stop: watch::Receiver<bool>) {
    loop {
        tokio::select! {
            _ = stop.changed() => return,
            () = tokio::time::sleep(REPORTS) => {
                let mut touched = Touched::new();
                board.report_drops(&mut touched);
                flush(&mut touched);
                board.tap.lines.report(board.clock.now(), false);
            }
        }
    }
}

#[cfg(test)]
mod tests;
