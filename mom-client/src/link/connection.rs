//! One connection: a task that reads, a task that writes, and the keeper of heartbeats and leases.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use mom_net::{NetError, Reader, Transceiver};
use mom_proto::Family;
use mom_proto::codec::Frame;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until, timeout};

use crate::link::sending;
use crate::peer::pending::AnswerTo;
use crate::peer::shared::{Shared, verb};
use crate::wire::clock::uptime;

/// How long to wait for the hub's last parcels when nothing more can be written, and for its close after our logout.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// Runs a connection to its end; gives why it ended.
pub(crate) async fn run(shared: &Arc<Shared>, transceiver: Transceiver) -> String {
    let (heard, spoke) = (Arc::new(Moment::now()), Arc::new(AtomicU64::new(uptime())));
    // Ends when it is dropped with this future.
    let mut tasks = JoinSet::new();
    let reading = tasks
        .spawn(read(
            Arc::clone(shared),
            (Arc::clone(&heard), Arc::clone(&spoke)),
            transceiver.reader,
        ))
        .id();
    let link = shared.lock().outbox.mark().link;
    tasks.spawn(sending::write(Arc::clone(shared), transceiver.writer, link));
    let first = tokio::select! {
        ended = tasks.join_next_with_id() => Ended::Task(ended),
        () = keep(shared, &heard, &spoke) => Ended::Silence,
    };
    let why = match first {
        Ended::Silence => "the hub has been silent for too long".to_owned(),
        Ended::Task(Some(Ok((id, ended)))) if id != reading => {
            // The hub's last error says whether to reconnect.
            match timeout(LAST_WORDS, tasks.join_next()).await {
                Ok(Some(Ok(Err(error)))) if ended.is_ok() => error.to_string(),
                _ => words(ended),
            }
        }
        Ended::Task(Some(Ok((_, ended)))) => words(ended),
        Ended::Task(Some(Err(failed))) => failed.to_string(),
        Ended::Task(None) => words(Ok(())),
    };
    // What both ends have counted is final, and all that was not sent is back in the outbox.
    tasks.shutdown().await;
    why
}

/// How a task has ended, and which.
type Joined = Result<(tokio::task::Id, Result<(), NetError>), tokio::task::JoinError>;

/// What has ended first.
enum Ended {
    /// Reading or writing.
    Task(Option<Joined>),
    /// Nothing: the hub says nothing any more.
    Silence,
}

fn words(ended: Result<(), NetError>) -> String {
    match ended {
        Ok(()) => "the hub closed the link".to_owned(),
        Err(error) => error.to_string(),
    }
}

async fn read(
    shared: Arc<Shared>,
    (heard, spoke): (Arc<Moment>, Arc<AtomicU64>),
    mut reader: Reader,
) -> Result<(), NetError> {
    let gone = u64::try_from(shared.lock().me.limits.gone.as_millis()).unwrap_or(u64::MAX);
    let mut alive = uptime();
    loop {
        while let Some(frame) = reader.try_next()? {
            let counts = !matches!(&frame, Frame::Parcel(parcel) if parcel.family == Family::Time);
            if matches!(&frame, Frame::Parcel(parcel) if parcel.is(Family::Time, "ping")) {
                // It is answered.
                spoke.store(uptime(), Ordering::Relaxed);
            }
            let word = match &frame {
                Frame::Parcel(parcel) => Some(parcel.checksum_word()),
                Frame::Malformed { .. } => None,
            };
            match frame {
                Frame::Parcel(parcel) => shared.receive(*parcel),
                Frame::Malformed { error, .. } => shared.receive_malformed(error),
            }
            if counts {
                shared.count_read(word, reader.brought());
            }
        }
        if !reader.arrive().await? {
            return Ok(());
        }
        // Bytes are a sign of life, whatever they are of: a large parcel may be long on its way. But what lies there after a halt of
        // the whole program was said before, and the hub, which has not heard of it either, has given the link up: a device must not
        // move by it.
        let (now, before) = (uptime(), alive.min(spoke.load(Ordering::Relaxed)));
        if now.saturating_sub(before) >= gone {
            return Err(stood_still());
        }
        alive = now;
        heard.note();
    }
}

/// Says `time ping` at once and each heartbeat, renews leases, and ends when the hub has been silent for too long.
async fn keep(shared: &Shared, heard: &Moment, spoke: &AtomicU64) {
    let limits = shared.lock().me.limits.clone();
    let mut pinged = Instant::now();
    let mut heard_at = pinged;
    shared.clock.forget();
    shared.measure();
    loop {
        let now = Instant::now();
        heard_at = heard_at.max(heard.at());
        // The hub has given the link up, too, where it has not heard of this side for so long.
        let unheard = uptime().saturating_sub(spoke.load(Ordering::Relaxed));
        if now >= heard_at + limits.gone || u128::from(unheard) >= limits.gone.as_millis() {
            return;
        }
        shared.note_stale(heard_at, now >= heard_at + limits.heartbeat * 3 / 2);
        // Also on a busy link: a peer that only sends would not learn that the hub is alive, a peer that only
        // receives would seem dead to it, and the estimate of the hub's clock would grow old.
        if now >= pinged + limits.heartbeat {
            pinged = now;
            spoke.store(uptime(), Ordering::Relaxed);
            shared.measure();
            continue;
        }
        renew(shared, now);
        let renewal = shared.lock().guards.next_renewal();
        let wake = (pinged + limits.heartbeat).min(heard_at + limits.gone);
        let wake = renewal.map_or(wake, |renewal| wake.min(renewal));
        // A pong that does not come is noticed before the connection is given up.
        let stale = heard_at + limits.heartbeat * 3 / 2;
        let wake = if stale > now { wake.min(stale) } else { wake };
        tokio::select! {
            () = sleep_until(wake) => match wake.elapsed() {
                late if late >= limits.gone => return,
                // While this task was late nobody was heard.
                late => heard_at += late,
            },
            () = shared.keeping.notified() => {}
        }
    }
}

fn renew(shared: &Shared, now: Instant) {
    let mut state = shared.lock();
    for (path, fence) in state.guards.take_due(now) {
        let mut waiter = Some(AnswerTo::Renewal(path.clone(), fence));
        // Without a link the guards are lost already.
        let _ = shared.ask_in(&mut state, verb(Family::Token, "renew", &path), &mut waiter);
    }
    drop(state);
    shared.outgoing.notify_one();
}

fn stood_still() -> NetError {
    let text = "this program stalled for longer than the link's timeout";
    NetError::Io(std::io::Error::new(std::io::ErrorKind::TimedOut, text))
}

/// An instant that two tasks share, exact to a ms.
#[derive(Debug)]
struct Moment {
    start: Instant,
    millis: AtomicU64,
}

impl Moment {
    fn now() -> Moment {
        Moment {
            start: Instant::now(),
            millis: AtomicU64::new(0),
        }
    }

    fn note(&self) {
        let millis = u64::try_from(self.start.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.millis.store(millis, Ordering::Relaxed);
    }

    fn at(&self) -> Instant {
        self.start + Duration::from_millis(self.millis.load(Ordering::Relaxed))
    }
}
