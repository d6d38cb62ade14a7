//! Durable grants: records of tokens put into a store, each token a closed loop of put, answer, next put.

use std::collections::BTreeSet;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path as FilePath;
use std::sync::mpsc;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use mom_hub::{Holder, Record, Ticket};
use mom_proto::{Path, Time};
use mom_store::Store;
use tokio::runtime::Builder;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::time::timeout_at;

use crate::{Delays, Error};

/// Numbers of tokens that change hands at once.
pub const TOKENS: [usize; 6] = [1, 2, 4, 8, 16, 64];

/// The size of a page of the floor's file.
const PAGE: usize = 4096;

/// How the answers of a [`Keeper`] arrive.
pub type Answers = UnboundedReceiver<(Ticket, bool)>;

/// What makes records durable.
pub trait Keeper {
    /// Takes a record in, and answers its ticket once.
    fn put(&self, record: Record, ticket: Ticket);

    /// Writes what waits and closes the files, so that nothing of it falls on the next turn.
    fn end(self: Box<Self>);
}

/// A [`Keeper`] that has begun, and its answers.
pub type OpenKeeper = (Box<dyn Keeper>, Answers);

/// Something to measure: its name, and how it begins on an empty directory.
pub struct Subject {
    /// As the table shows it.
    pub name: &'static str,
    /// Opens it.
    pub open: fn(&FilePath) -> Result<OpenKeeper, Error>,
}

/// The store, and the least that two synced writes cost.
pub const SUBJECTS: &[Subject] = &[
    Subject {
        name: "floor",
        open: open_floor,
    },
    Subject {
        name: "store",
        open: open_store,
    },
];

/// What came of one turn.
pub struct DurableGrants {
    /// Durable grants.
    pub per_second: f64,
    /// From each put to its answer.
    pub delays: Delays,
}

/// How tokens change hands.
#[derive(Clone, Copy, Debug)]
pub struct GrantLoad {
    /// So many at once.
    pub tokens: usize,
    /// For so long, and until there is a figure, after a tenth of it to warm up.
    pub time: Duration,
    /// From an answer to the next put of the same token, on average; each is drawn anew, from none to twice as much.
    pub pause: Duration,
}

/// Lets tokens change hands, each a closed loop.
///
/// # Errors
/// A store that cannot be used, or that fails.
pub fn grant(subject: &Subject, directory: &FilePath, load: &GrantLoad) -> Result<DurableGrants, Error> {
    let (keeper, answers) = (subject.open)(directory)?;
    let runtime = Builder::new_current_thread().enable_time().build();
    let runtime = runtime.map_err(Error::io("the timer of a measurement"))?;
    let granted = runtime.block_on(grant_all(&*keeper, answers, load));
    keeper.end();
    granted
}

async fn grant_all(
    keeper: &dyn Keeper,
    mut answers: Answers,
    load: &GrantLoad,
) -> Result<DurableGrants, Error> {
    let mut fence = 0;
    let mut put = |token: usize| {
        fence += 1;
        let record = record(token, fence)?;
        let now = Instant::now();
        keeper.put(record, Ticket(token as u64));
        Ok::<_, Error>(now)
    };
    let mut begun = vec![Instant::now(); load.tokens];
    let mut due: BTreeSet<(Instant, usize)> = (0..load.tokens).map(|token| (Instant::now(), token)).collect();
    let mut pauses = Pauses(1);
    let start = Instant::now() + load.time / 10;
    let mut delays = Vec::new();
    loop {
        let now = Instant::now();
        if now >= start + load.time && !delays.is_empty() {
            let per_second = delays.len() as f64 / (now - start).as_secs_f64();
            let delays = Delays::of(delays);
            return Ok(DurableGrants { per_second, delays });
        }
        while let Some((_, token)) = due.first().copied().filter(|(at, _)| *at <= now) {
            due.pop_first();
            begun[token] = put(token)?;
        }
        let answer = match due.first() {
            Some((at, _)) => timeout_at((*at).into(), answers.recv()).await,
            None => Ok(answers.recv().await),
        };
        let Ok(answer) = answer else {
            continue;
        };
        let now = Instant::now();
        let (ticket, ok) = answer.ok_or_else(ended)?;
        let token = ticket.0 as usize;
        if !ok {
            return Err(Error::Unexpected("a record that cannot be durable".to_owned()));
        }
        if begun[token] >= start {
            delays.push(now - begun[token]);
        }
        match load.pause.is_zero() {
            true => begun[token] = put(token)?,
            false => drop(due.insert((now + pauses.next(load.pause), token))),
        }
    }
}

/// Pauses that look like chance and are the same in each turn.
struct Pauses(u64);

impl Pauses {
    fn next(&mut self, average: Duration) -> Duration {
        // Knuth's linear congruence; its upper bits are good enough for a pause.
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        average.mul_f64((self.0 >> 33) as f64 / f64::from(1_u32 << 30))
    }
}

fn ended() -> Error {
    Error::Unexpected("the end of the store".to_owned())
}

fn record(token: usize, fence: u64) -> Result<Record, Error> {
    let path = Path::parse(&format!("/robot/{token:02}/token")).map_err(Error::hub("a path"))?;
    let user = format!("operator-{}", fence % 7);
    Ok(Record {
        path,
        fence,
        owner: Some(Holder {
            name: format!("{user}~2"),
            user,
        }),
        before: None,
        lease: Some(180_000_000),
    })
}

fn now() -> Result<Time, Error> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let time = i64::try_from(since.as_micros()).ok().and_then(Time::from_micros);
    time.ok_or_else(|| Error::Unexpected("the time of this machine".to_owned()))
}

impl Keeper for Store {
    fn put(&self, record: Record, ticket: Ticket) {
        Store::put(self, record, Some(ticket));
    }

    fn end(self: Box<Self>) {
        if let Ok(runtime) = Builder::new_current_thread().build() {
            runtime.block_on(self.close());
        }
    }
}

fn open_store(directory: &FilePath) -> Result<OpenKeeper, Error> {
    let now = now()?;
    let opened = Store::open(directory, now).map_err(|error| Error::Unexpected(error.to_string()))?;
    Ok((Box::new(opened.store), opened.answers))
}

/// A file of which a page is written and synced twice for all that waits: what a commit of two phases cannot be
/// faster than.
struct Floor {
    /// None once it ends.
    waiting: Option<mpsc::Sender<Ticket>>,
    writer: Option<JoinHandle<()>>,
}

impl Keeper for Floor {
    fn put(&self, _: Record, ticket: Ticket) {
        if let Some(waiting) = &self.waiting {
            // A writer that has failed answers nothing more, which ends the measurement.
            let _ = waiting.send(ticket);
        }
    }

    fn end(mut self: Box<Self>) {
        self.waiting = None;
        if let Some(writer) = self.writer.take() {
            // Its file is not used any more, however it ended.
            let _ = writer.join();
        }
    }
}

fn open_floor(directory: &FilePath) -> Result<OpenKeeper, Error> {
    let failed = || Error::io("the file of the floor");
    std::fs::create_dir_all(directory).map_err(failed())?;
    let file = File::create(directory.join("floor")).map_err(failed())?;
    file.write_all_at(&[1; 64 * PAGE], 0).map_err(failed())?;
    file.sync_all().map_err(failed())?;
    let (waiting, puts) = mpsc::channel();
    let (said, answers) = unbounded_channel();
    let writer = thread::spawn(move || write_twice(&file, &puts, &said));
    let floor = Floor {
        waiting: Some(waiting),
        writer: Some(writer),
    };
    Ok((Box::new(floor), answers))
}

fn write_twice(file: &File, puts: &mpsc::Receiver<Ticket>, said: &UnboundedSender<(Ticket, bool)>) {
    let mut round = 0_u8;
    while let Ok(first) = puts.recv() {
        let mut tickets = vec![first];
        tickets.extend(puts.try_iter());
        round = round.wrapping_add(1);
        let page = |number: u64| {
            file.write_all_at(&[round; PAGE], number * PAGE as u64)
                .and_then(|()| file.sync_data())
        };
        let ok = page(u64::from(round % 63) + 1).and_then(|()| page(0)).is_ok();
        for ticket in tickets {
            // Nobody listens once the measurement is over.
            let _ = said.send((ticket, ok));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_subject_makes_grants_durable() {
        for subject in SUBJECTS {
            let folder = tempfile::TempDir::new().unwrap();
            for pause in [Duration::ZERO, Duration::from_millis(5)] {
                let load = GrantLoad {
                    tokens: 3,
                    time: Duration::from_millis(200),
                    pause,
                };
                let state = folder.path().join(format!("{pause:?}"));
                let granted = grant(subject, &state, &load).unwrap();
                assert!(granted.delays.count() > 0, "{} {pause:?}", subject.name);
                assert!(granted.delays.quantile(0.5) <= granted.delays.quantile(0.99));
            }
        }
    }
}
