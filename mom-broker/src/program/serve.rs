//! The service: runs until SIGTERM or Ctrl-C, and reloads its configuration when the files change.

use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::pin::Pin;
use std::time::Duration;

use anyhow::{Context, Result};
use mom_broker::{Broker, BrokerError, Config, ConfigErrors, ReloadOn, check_address};
use mom_journal::LogWriter;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{EnvFilter, Layer, Registry};

#[cfg(feature = "otlp")]
use super::otlp;
#[cfg(target_os = "linux")]
use super::ready;
use super::watch::FileWatch;
use super::{descriptors, niceness};

#[derive(clap::Args)]
pub(super) struct ServeArgs {
    /// The configuration file; without one the broker is closed to everybody.
    #[arg(long, short, env = "MOM_CONFIG")]
    config: Option<PathBuf>,
    /// Listen here instead of at the configured addresses; port 0 takes any free port.
    #[arg(long, value_parser = listen_address)]
    listen: Vec<String>,
    /// Record the hub's inputs and decisions in this file, for what-if.
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Ask the system for this niceness: the lower, the sooner this broker runs where programs wait for a processor; 0 = do not ask.
    #[arg(long, env = "MOM_NICENESS", default_value_t = -10, value_parser = clap::value_parser!(i32).range(-20..=0), allow_negative_numbers = true, value_name = "N")]
    niceness: i32,
    /// Log as JSON lines.
    #[arg(long)]
    log_json: bool,
}

/// How long an ending broker waits for what it has logged to be written.
const LAST_LINES: Duration = Duration::from_secs(1);

/// How long it waits for a collector to take the last spans.
#[cfg(feature = "otlp")]
const LAST_SPANS: Duration = Duration::from_secs(3);

/// A thread that always has something to do asks the system for new events after so many slices. Each lasts some 200 µs at
/// most, and an event may be a stop.
const EVENTS: u32 = 8;

/// Files that no descriptor was left for are read again after so long.
const AGAIN: Duration = Duration::from_millis(500);

/// What became of reading the files again.
enum Reloaded {
    /// They hold from now on, and say when they are to be read next.
    Taken(ReloadOn),
    /// They are wrong, which was logged.
    Refused,
    /// There was no descriptor to read them with.
    Unread(ConfigErrors),
}

fn listen_address(text: &str) -> Result<String, String> {
    check_address(text).map(|()| text.to_owned())
}

/// Takes spans and events beside the log.
type OtherLayer = Box<dyn Layer<Registry> + Send + Sync>;

/// Changes what is logged.
type LogFilter = Box<dyn Fn(EnvFilter) -> Result<()>>;

pub(super) fn run(args: &ServeArgs) -> Result<()> {
    let niceness = niceness::ask(args.niceness);
    // Started before the file is first read, so that no change is missed.
    let watch = args.config.clone().map(FileWatch::new);
    let config = args.load()?;
    let lines = LogWriter::start(std::io::stderr()).context("cannot start the log's thread")?;
    #[cfg(feature = "otlp")]
    let (spans, export) = otlp::start()?.unzip();
    #[cfg(not(feature = "otlp"))]
    let spans = None;
    let log_filter = log(&config.log, args.log_json, &lines, spans)?;
    niceness.tell();
    if args.config.is_none() {
        tracing::warn!("no configuration: no user can log in; try --config config/lab.toml");
    } else if config.store.path.is_none() {
        tracing::warn!(
            "no [store] path: token ownership is lost when the broker ends; only fences keep rising"
        );
    }
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .event_interval(EVENTS)
        .build()
        .context("cannot start the runtime")?;
    let ended = runtime.block_on(args.serving(config, watch, &log_filter));
    #[cfg(feature = "otlp")]
    if let Some(export) = export {
        export.finish(LAST_SPANS);
    }
    lines.finish(LAST_LINES);
    ended
}

impl ServeArgs {
    fn load(&self) -> Result<Config, BrokerError> {
        let mut config = match &self.config {
            Some(file) => Config::load(file)?,
            None => Config::default(),
        };
        if !self.listen.is_empty() {
            config.listen = self
                .listen
                .iter()
                .map(|address| address.as_str().into())
                .collect();
        }
        if self.record.is_some() {
            config.record.path.clone_from(&self.record);
        }
        config.store.keep_state(|name| std::env::var_os(name))?;
        Ok(config)
    }

    /// Boxed, because tokio has three ways to wait for what it is given, and all of it would be compiled once for each.
    fn serving<'a>(
        &'a self,
        config: Config,
        watch: Option<FileWatch>,
        log_filter: &'a LogFilter,
    ) -> Pin<Box<dyn Future<Output = Result<()>> + 'a>> {
        Box::pin(self.serve(config, watch, log_filter))
    }

    async fn serve(
        &self,
        config: Config,
        mut watch: Option<FileWatch>,
        log_filter: &LogFilter,
    ) -> Result<()> {
        let mut terminate = signal(SignalKind::terminate()).context("cannot wait for SIGTERM")?;
        let mut interrupt = signal(SignalKind::interrupt()).context("cannot wait for Ctrl-C")?;
        let mut quit = signal(SignalKind::quit()).context("cannot wait for SIGQUIT")?;
        // These would end it at once, without a word to those that are connected.
        let mut users = [
            signal(SignalKind::user_defined1()).context("cannot wait for SIGUSR1")?,
            signal(SignalKind::user_defined2()).context("cannot wait for SIGUSR2")?,
            signal(SignalKind::alarm()).context("cannot wait for SIGALRM")?,
        ];
        let mut hang_up = signal(SignalKind::hangup()).context("cannot wait for SIGHUP")?;
        let mut on_change = config.reload == ReloadOn::Change;
        let mut again = false;
        descriptors::make_room(config.connections);
        let listeners = config.listen.clone();
        let broker = Broker::start(config).await?;
        // On standard output, so that a caller that chose port 0 can read the actual port.
        for (listener, address) in listeners.iter().zip(broker.local_addrs()) {
            writeln!(std::io::stdout(), "listening at {}", listener.shown(*address))?;
        }
        std::io::stdout().flush()?;
        #[cfg(target_os = "linux")]
        ready::tell();
        loop {
            let changed = async {
                match watch.as_mut().filter(|_| on_change) {
                    Some(watch) => watch.changed().await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                _ = terminate.recv() => {
                    tracing::info!("SIGTERM: stopping");
                    break;
                }
                _ = interrupt.recv() => break,
                _ = quit.recv() => {
                    tracing::info!("SIGQUIT: stopping");
                    break;
                }
                name = meaningless(&mut users) => {
                    tracing::warn!("{name} is ignored: SIGHUP reloads the configuration, SIGTERM stops the broker");
                    continue;
                }
                _ = hang_up.recv() => tracing::info!("SIGHUP: reading the configuration again"),
                () = changed => tracing::info!("the configuration has changed: reading it again"),
                () = tokio::time::sleep(AGAIN), if again => {}
            }
            // Marks the files as known before they are read.
            if let Some(watch) = &mut watch {
                watch.look();
            }
            match self.reload(&broker, log_filter) {
                Reloaded::Taken(reload) => (on_change, again) = (reload == ReloadOn::Change, false),
                Reloaded::Refused => again = false,
                Reloaded::Unread(error) => {
                    if !again {
                        tracing::error!("{error}; the configuration stays as it was until it can be read");
                    }
                    again = true;
                }
            }
        }
        broker.stop().await;
        Ok(())
    }

    /// Reads the files again. Errors are logged and change nothing.
    fn reload(&self, broker: &Broker, log_filter: &LogFilter) -> Reloaded {
        if self.config.is_none() {
            tracing::warn!("there is no configuration file to read again");
            return Reloaded::Refused;
        }
        let reloaded = self.load().and_then(|config| {
            descriptors::make_room(config.connections);
            let (log, reload) = (config.log.clone(), config.reload);
            let report = broker.reload(config)?;
            Ok((report, log, reload))
        });
        let (report, log, reload) = match reloaded {
            Ok(reloaded) => reloaded,
            Err(BrokerError::Config(errors)) if errors.busy() => return Reloaded::Unread(errors),
            Err(BrokerError::Config(errors)) => {
                // A line for each, as logs are read.
                for error in errors.iter() {
                    tracing::error!("the configuration stays as it was: {error}");
                }
                return Reloaded::Refused;
            }
            Err(error) => {
                tracing::error!("the configuration stays as it was: {error}");
                return Reloaded::Refused;
            }
        };
        if report.keys.iter().any(|key| key == "log") {
            let changed = EnvFilter::try_new(&log)
                .map_err(anyhow::Error::new)
                .and_then(log_filter);
            if let Err(error) = changed {
                tracing::warn!("log: {error:#}");
            }
        }
        Reloaded::Taken(reload)
    }
}

/// Starts the log, and whatever else takes what is traced.
fn log(filter: &str, json: bool, lines: &LogWriter, others: Option<OtherLayer>) -> Result<LogFilter> {
    let filter = EnvFilter::try_new(filter).with_context(|| format!("log: {filter:?} is not a filter"))?;
    let lines = lines.clone();
    let shown = tracing_subscriber::fmt::layer()
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(move || lines.clone())
        // What takes no lines takes no complaint either, and to insist would panic.
        .log_internal_errors(false);
    let shown = if json { shown.json().boxed() } else { shown.boxed() };
    // The filter is this layer's own: others have theirs.
    let (filter, handle) = tracing_subscriber::reload::Layer::new(filter);
    tracing_subscriber::registry()
        .with(others)
        .with(shown.with_filter(filter))
        .init();
    Ok(Box::new(move |filter| Ok(handle.reload(filter)?)))
}

/// Waits for one of these signals; gives its name.
async fn meaningless(users: &mut [Signal; 3]) -> &'static str {
    let [one, two, alarm] = users;
    tokio::select! {
        _ = one.recv() => "SIGUSR1",
        _ = two.recv() => "SIGUSR2",
        _ = alarm.recv() => "SIGALRM",
    }
}
