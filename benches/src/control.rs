//! Control under load: many peers that want one token, and many that log in at once while one drives.
//!
//! Peers are light tasks of one thread over real sockets, in binary. What is measured is what an operator feels: the time from
//! one's release to the next one's grant, and the time that a renewal and a stop take.

use std::cell::{Cell, RefCell};
use std::rc::Rc;
use std::time::{Duration, Instant};

use mom_net::{Address, Transceiver};
use mom_proto::codec::Frame;
use mom_proto::{Code, Family, Limits, Map, Parcel, Path, Value, WireError};
use tokio::sync::Notify;
use tokio::task::{JoinSet, LocalSet};

use crate::{Delays, Error};

/// The session, token and channel of the configuration.
const CELL: &str = "/cell";
const TOKEN: &str = "/cell/token";
const ARM: &str = "/cell/arm";

/// How often the driver renews and a peer stops, while others log in.
const BEAT: Duration = Duration::from_millis(10);

/// Peers that contend for one token.
#[derive(Clone, Debug)]
pub struct Contention {
    /// How many there are.
    pub peers: usize,
    /// Grants per second, all together.
    pub per_second: f64,
    /// From a release, as its peer says it, to the next grant, as the next peer hears it.
    pub handover: Delays,
    /// Jain's index of the grants per peer: 1 = all had the same number, 1/peers = one had all.
    pub fairness: f64,
    /// Grants that did not go to who waited longest.
    pub out_of_turn: u64,
}

/// Logins at once, and what the driver felt of them.
#[derive(Clone, Debug)]
pub struct Storm {
    /// How many peers logged in.
    pub logins: usize,
    /// The time until the last was in.
    pub took: Duration,
    /// Answers `try-later` on the way.
    pub put_off: u64,
    /// Renewals with nobody else there, and during the storm.
    pub renewals: [Delays; 2],
    /// Stops, from their sender to the robot, likewise.
    pub stops: [Delays; 2],
}

/// One logged-in connection.
pub(crate) struct Peer {
    pub(crate) link: Transceiver,
    last: u64,
}

impl Peer {
    async fn connect(address: &str, user: &str) -> Result<Peer, Error> {
        let address: Address = format!("bin://{address}")
            .parse()
            .map_err(|error| Error::Unexpected(format!("{error}")))?;
        let link = mom_net::connect(&address, &Limits::default(), None)
            .await
            .map_err(|error| net("connecting", &error))?;
        let mut peer = Peer { link, last: 0 };
        let credentials = Map::new().with("name", user).with("password", user);
        let login = Parcel::new(Family::Login, "login").context(Path::root());
        peer.ask(login.content(credentials)).await?;
        Ok(peer)
    }

    pub(crate) async fn enter(address: &str, user: &str, places: &[&str]) -> Result<Peer, Error> {
        let mut peer = Peer::connect(address, user).await?;
        for place in places {
            peer.ask(about(Family::Context, "join", place)?).await?;
        }
        Ok(peer)
    }

    async fn say(&mut self, parcel: Parcel) -> Result<u64, Error> {
        self.last += 1;
        let sent = self.link.writer.send(parcel.id(self.last)).await;
        sent.map_err(|error| net("saying", &error))?;
        Ok(self.last)
    }

    async fn hear(&mut self) -> Result<Parcel, Error> {
        let heard = self.link.reader.next().await;
        match heard.map_err(|error| net("hearing", &error))? {
            Some(Frame::Parcel(parcel)) => Ok(*parcel),
            other => Err(Error::Unexpected(format!("{other:?} in place of a parcel"))),
        }
    }

    /// Waits for the answer to a request.
    async fn answer(&mut self, id: u64) -> Result<Value, Error> {
        loop {
            let parcel = self.hear().await?;
            match parcel.family {
                Family::Error if parcel.reference == Some(id) || parcel.reference.is_none() => {
                    return Err(Error::Hub {
                        what: "a request".to_owned(),
                        error: WireError::from_parcel(&parcel),
                    });
                }
                Family::Reply if parcel.reference == Some(id) => return Ok(parcel.value()),
                Family::Time if parcel.name() == "ping" => {
                    let mut pong = Parcel::new(Family::Time, "pong").context(Path::root());
                    pong.reference = parcel.id;
                    let sent = self.link.writer.send(pong).await;
                    sent.map_err(|error| net("answering", &error))?;
                }
                _ => {}
            }
        }
    }

    pub(crate) async fn ask(&mut self, parcel: Parcel) -> Result<Value, Error> {
        let id = self.say(parcel).await?;
        self.answer(id).await
    }
}

/// What the contending peers share.
struct Round {
    last_release: Cell<Option<Instant>>,
    handovers: RefCell<Vec<Duration>>,
    /// Who waits, in the order in which they began to.
    waiting: RefCell<Vec<usize>>,
    out_of_turn: Cell<u64>,
    grants: RefCell<Vec<u64>>,
    left: Cell<u64>,
    done: Notify,
}

/// Lets `peers` peers take turns until there were `grants` of them.
///
/// # Errors
/// A hub that refuses anything, or goes.
pub fn contention(address: &str, user: &str, peers: usize, grants: u64) -> Result<Contention, Error> {
    run(async {
        let mut all = Vec::with_capacity(peers);
        for _ in 0..peers {
            all.push(Peer::enter(address, user, &[CELL]).await?);
        }
        let round = Rc::new(Round {
            last_release: Cell::new(None),
            handovers: RefCell::default(),
            waiting: RefCell::default(),
            out_of_turn: Cell::new(0),
            grants: RefCell::new(vec![0; peers]),
            left: Cell::new(grants),
            done: Notify::new(),
        });
        let begin = Instant::now();
        let mut tasks = JoinSet::new();
        for (index, peer) in all.into_iter().enumerate() {
            tasks.spawn_local(contend(peer, index, Rc::clone(&round)));
        }
        loop {
            tokio::select! {
                () = round.done.notified() => break,
                ended = tasks.join_next() => match ended {
                    Some(Ok(Ok(()))) => {}
                    Some(Ok(Err(error))) => return Err(error),
                    other => return Err(Error::Unexpected(format!("{other:?} in place of a peer"))),
                },
            }
        }
        let time = begin.elapsed();
        tasks.shutdown().await;
        let counts = round.grants.borrow();
        Ok(Contention {
            peers,
            per_second: counts.iter().sum::<u64>() as f64 / time.as_secs_f64(),
            handover: Delays::of(round.handovers.take()),
            fairness: jain(&counts),
            out_of_turn: round.out_of_turn.get(),
        })
    })
}

async fn contend(mut peer: Peer, index: usize, round: Rc<Round>) -> Result<(), Error> {
    loop {
        let wait = Map::new().with("wait", "unlimited");
        let id = peer
            .say(about(Family::Token, "grab", TOKEN)?.content(wait))
            .await?;
        round.waiting.borrow_mut().push(index);
        peer.answer(id).await?;
        let heard = Instant::now();
        if let Some(released) = round.last_release.take() {
            round.handovers.borrow_mut().push(heard - released);
        }
        // The hub reads the sockets in its own order, so only what is far out of turn is its fault.
        let place = {
            let mut waiting = round.waiting.borrow_mut();
            let place = waiting
                .iter()
                .position(|waiting| *waiting == index)
                .unwrap_or_default();
            waiting.remove(place);
            place
        };
        let peers = round.grants.borrow().len();
        if round.handovers.borrow().len() > peers && place > peers / 10 + 1 {
            round.out_of_turn.set(round.out_of_turn.get() + 1);
        }
        round.grants.borrow_mut()[index] += 1;
        round.left.set(round.left.get().saturating_sub(1));
        if round.left.get() == 0 {
            round.done.notify_one();
            std::future::pending::<()>().await;
        }
        round.last_release.set(Some(Instant::now()));
        peer.ask(about(Family::Token, "release", TOKEN)?).await?;
    }
}

/// Logs `logins` peers in at once while one renews its token and another stops the robot, all the time.
///
/// # Errors
/// A hub that refuses anything but for the time being, or goes.
pub fn storm(address: &str, user: &str, logins: usize, idle: Duration) -> Result<Storm, Error> {
    run(async {
        let watch = Rc::new(Watch::default());
        let mut tasks = JoinSet::new();
        let driver = Peer::enter(address, user, &[CELL]).await?;
        let stopper = Peer::enter(address, user, &[CELL, ARM]).await?;
        let robot = Peer::enter(address, user, &[CELL, ARM]).await?;
        tasks.spawn_local(renew(driver, Rc::clone(&watch)));
        tasks.spawn_local(stop(stopper, Rc::clone(&watch)));
        tasks.spawn_local(obey(robot, Rc::clone(&watch)));
        tokio::time::sleep(idle).await;
        let calm = [watch.renewals.take(), watch.stops.take()];
        let (begin, put_off) = (Instant::now(), Rc::new(Cell::new(0)));
        let mut storm = JoinSet::new();
        for _ in 0..logins {
            let (address, user) = (address.to_owned(), user.to_owned());
            let put_off = Rc::clone(&put_off);
            storm.spawn_local(async move { patient_login(&address, &user, &put_off).await });
        }
        let mut links = Vec::with_capacity(logins);
        while let Some(ended) = storm.join_next().await {
            match ended {
                Ok(Ok(peer)) => links.push(peer),
                Ok(Err(error)) => return Err(error),
                Err(error) => return Err(Error::Unexpected(error.to_string())),
            }
        }
        let took = begin.elapsed();
        let busy = [watch.renewals.take(), watch.stops.take()];
        // A task that has ended has failed: none ends by itself.
        if let Some(Ok(Err(error))) = tasks.try_join_next() {
            return Err(error);
        }
        tasks.shutdown().await;
        let [calm_renewals, calm_stops] = calm.map(Delays::of);
        let [busy_renewals, busy_stops] = busy.map(Delays::of);
        Ok(Storm {
            logins: links.len(),
            took,
            put_off: put_off.get(),
            renewals: [calm_renewals, busy_renewals],
            stops: [calm_stops, busy_stops],
        })
    })
}

async fn patient_login(address: &str, user: &str, put_off: &Cell<u64>) -> Result<Peer, Error> {
    loop {
        match Peer::connect(address, user).await {
            Err(Error::Hub { error, .. }) if error.code == Code::TRY_LATER => {
                put_off.set(put_off.get() + 1);
                tokio::time::sleep(error.retry_in().unwrap_or(BEAT)).await;
            }
            other => return other,
        }
    }
}

/// What is measured while others log in.
#[derive(Default)]
struct Watch {
    renewals: RefCell<Vec<Duration>>,
    stops: RefCell<Vec<Duration>>,
    /// When the stop left that is under way.
    stopped: Cell<Option<Instant>>,
}

async fn renew(mut peer: Peer, watch: Rc<Watch>) -> Result<(), Error> {
    peer.ask(about(Family::Token, "grab", TOKEN)?).await?;
    loop {
        tokio::time::sleep(BEAT).await;
        let begin = Instant::now();
        peer.ask(about(Family::Token, "renew", TOKEN)?).await?;
        watch.renewals.borrow_mut().push(begin.elapsed());
    }
}

async fn stop(mut peer: Peer, watch: Rc<Watch>) -> Result<(), Error> {
    loop {
        tokio::time::sleep(BEAT).await;
        if watch.stopped.get().is_none() {
            watch.stopped.set(Some(Instant::now()));
            let mut stop = about(Family::Message, "stop", ARM)?;
            stop.receipt = Some(true);
            stop.echo = Some(false);
            peer.ask(stop).await?;
        }
    }
}

async fn obey(mut peer: Peer, watch: Rc<Watch>) -> Result<(), Error> {
    loop {
        let parcel = peer.hear().await?;
        if parcel.is(Family::Message, "stop")
            && let Some(sent) = watch.stopped.take()
        {
            watch.stops.borrow_mut().push(sent.elapsed());
        }
    }
}

/// Jain's fairness index.
fn jain(counts: &[u64]) -> f64 {
    let sum: f64 = counts.iter().map(|count| *count as f64).sum();
    let squares: f64 = counts.iter().map(|count| (*count as f64).powi(2)).sum();
    match squares > 0.0 {
        true => sum * sum / (counts.len() as f64 * squares),
        false => 1.0,
    }
}

pub(crate) fn about(family: Family, name: &str, path: &str) -> Result<Parcel, Error> {
    let path = Path::parse(path).map_err(Error::hub("a path"))?;
    Ok(Parcel::new(family, name).context(path))
}

pub(crate) fn net(what: &str, error: &mom_net::NetError) -> Error {
    Error::Unexpected(format!("{what}: {error}"))
}

/// Does this work on a runtime of one thread.
///
/// # Errors
/// Those of the work, or no runtime.
pub fn run<T>(work: impl Future<Output = Result<T, Error>>) -> Result<T, Error> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.map_err(Error::io("a runtime"))?;
    LocalSet::new().block_on(&runtime, work)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fairness_is_between_one_of_all_and_all() {
        assert!((jain(&[5, 5, 5, 5]) - 1.0).abs() < 1e-9);
        assert!((jain(&[20, 0, 0, 0]) - 0.25).abs() < 1e-9);
    }
}
