//! This peer's estimate of the hub's clock, and the age of arriving parcels (M6, M34).

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use mom_proto::{ClockOffset, Exchange, Family, Map, OffsetEstimator, Parcel, Time, event};
use parking_lot::Mutex;
use tokio::time::Instant;

/// Exchanges right after the login, one after the other; later one per heartbeat.
const QUICK: usize = 4;

/// The time of a peer's wall clock.
pub(crate) type Wall = Arc<dyn Fn() -> Option<Time> + Send + Sync>;

/// The hub's clock, estimated by the link's own pings. Cheap to clone; all clones are the same clock.
///
/// It uses the monotonic clock, so setting the wall clock does not disturb it.
///
/// ```no_run
/// # async fn example(client: mom_client::Client) -> Result<(), mom_client::ClientError> {
/// use mom_client::Event;
/// let clock = client.clock();
/// let mut events = client.channel("/robot/arm").await?.events();
/// while let Some(event) = events.next().await {
///     let Event::Message(parcel) = event else { continue };
///     if let Some(age) = clock.age(&parcel) {
///         println!("{} of {:?} ago, ± {:?}", parcel.name(), age.duration(), age.error());
///     }
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Clone)]
pub struct HubClock {
    inner: Arc<ClockState>,
}

struct ClockState {
    wall: Wall,
    /// The own clock that is compared with the hub's: `anchor` at `start`, monotonic from then on.
    anchor: i64,
    start: Instant,
    state: Mutex<EstimatorState>,
    expired: AtomicU64,
}

#[derive(Debug, Default)]
struct EstimatorState {
    estimator: OffsetEstimator,
    /// The ping that has not been answered yet: its id, and when it was sent.
    asked: Option<(u64, Time)>,
}

/// How long ago something was created, as a receiver sees it now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Age {
    /// µs; below 0 at most by the error.
    pub micros: i64,
    /// The error bound, µs; none = the hub does not know the sender's clock, and the age counts from the parcel's
    /// arrival at the hub.
    pub error_micros: Option<u64>,
}

impl Age {
    /// The age, at least 0.
    pub fn duration(&self) -> Duration {
        Duration::from_micros(u64::try_from(self.micros).unwrap_or_default())
    }

    /// The error bound; none = the age is greater by the unknown time from the sender to the hub.
    pub fn error(&self) -> Option<Duration> {
        self.error_micros.map(Duration::from_micros)
    }

    /// The age plus its error, if known.
    pub fn at_most(&self) -> Option<Duration> {
        self.error().map(|error| self.duration() + error)
    }
}

impl HubClock {
    pub(crate) fn new(wall: Wall) -> HubClock {
        HubClock {
            inner: Arc::new(ClockState {
                anchor: wall().map_or(0, Time::micros),
                wall,
                start: Instant::now(),
                state: Mutex::default(),
                expired: AtomicU64::new(0),
            }),
        }
    }

    /// The hub's time now, with its error bound; none before the first exchange of a link.
    pub fn now(&self) -> Option<(Time, Duration)> {
        let offset = self.offset()?;
        let time = Time::from_micros(offset.other(self.own()))?;
        Some((time, Duration::from_micros(offset.error)))
    }

    /// How old a parcel is now: its age when it reached the hub, and the time since then. None without an estimate of
    /// the hub's clock, and for parcels that the hub did not stamp.
    pub fn age(&self, parcel: &Parcel) -> Option<Age> {
        let received = parcel.received?;
        let offset = self.offset()?;
        let since = offset.other(self.own()).saturating_sub(received.micros());
        Some(Age {
            micros: since.saturating_add(parcel.age.unwrap_or_default()),
            error_micros: parcel.age_error.map(|error| error.saturating_add(offset.error)),
        })
    }

    /// Whether a parcel has expired, as far as is known. A stop never expires.
    pub fn is_expired(&self, parcel: &Parcel) -> bool {
        let stop = parcel.family == Family::Message && parcel.name() == event::STOP;
        parcel.expires.filter(|_| !stop).is_some_and(|expires| {
            let life = i64::try_from(expires.saturating_mul(1000)).unwrap_or(i64::MAX);
            self.age(parcel).is_some_and(|age| age.micros >= life)
        })
    }

    /// How many messages were not delivered to subscribers because they had expired.
    pub fn expired(&self) -> u64 {
        self.inner.expired.load(Ordering::Relaxed)
    }

    /// Counts an expired message.
    pub(crate) fn note_expired(&self) {
        self.inner.expired.fetch_add(1, Ordering::Relaxed);
    }

    /// The time of the peer's wall clock, for stamps.
    pub(crate) fn wall(&self) -> Option<Time> {
        (self.inner.wall)()
    }

    /// The content of a ping of this id, which is sent now.
    pub(crate) fn ask(&self, id: u64) -> Map {
        self.inner.state.lock().asked = Some((id, self.own()));
        self.stamp(Map::new(), "sent")
    }

    /// The content of the answer to the hub's ping.
    pub(crate) fn answer(&self) -> Map {
        let content = self.stamp(Map::new(), "received");
        self.stamp(content, "sent")
    }

    /// Learns from the answer to a ping; whether to ask again at once.
    pub(crate) fn answered(&self, pong: &Parcel) -> bool {
        let heard = self.own();
        let mut state = self.inner.state.lock();
        let Some((_, sent)) = state.asked.filter(|(id, _)| pong.reference == Some(*id)) else {
            return false;
        };
        state.asked = None;
        // A hub of an earlier version reports only when it received the ping.
        let Some(exchange) = Exchange::of(sent, pong, heard) else {
            return false;
        };
        let used = state.estimator.push(exchange, self.elapsed());
        used && state.estimator.exchanges() < QUICK
    }

    /// Starts over with another link: the hub may have been restarted.
    pub(crate) fn forget(&self) {
        *self.inner.state.lock() = EstimatorState::default();
    }

    /// The hub's clock minus the own monotonic one.
    pub(crate) fn offset(&self) -> Option<ClockOffset> {
        self.inner.state.lock().estimator.at(self.elapsed())
    }

    fn own(&self) -> Time {
        let elapsed = i64::try_from(self.elapsed()).unwrap_or(i64::MAX);
        Time::from_micros(self.inner.anchor.saturating_add(elapsed)).unwrap_or(Time::MAX)
    }

    fn elapsed(&self) -> u64 {
        u64::try_from(self.inner.start.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    fn stamp(&self, content: Map, key: &str) -> Map {
        match self.wall() {
            Some(time) => content.with(key, time),
            None => content,
        }
    }
}

impl fmt::Debug for HubClock {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("HubClock")
            .field("state", &self.inner.state)
            .finish_non_exhaustive()
    }
}

/// The system's wall clock.
pub(crate) fn system() -> Option<Time> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
    Time::from_micros(i64::try_from(since.as_micros()).ok()?)
}

/// The ms since the machine's start, with those in which it slept.
pub(crate) fn uptime() -> u64 {
    #[cfg(target_os = "linux")]
    let time = {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
        Duration::try_from(time).unwrap_or_default()
    };
    #[cfg(not(target_os = "linux"))]
    let time = {
        static START: std::sync::LazyLock<std::time::Instant> =
            std::sync::LazyLock::new(std::time::Instant::now);
        START.elapsed()
    };
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}
