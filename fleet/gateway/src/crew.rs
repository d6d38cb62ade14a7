//! The robots of a gateway, each with a task of its own, and how they follow the fleet's file.

use std::collections::{BTreeMap, BTreeSet};
use std::future::{Future, pending};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, SystemTime};

use mom_base_station::fleet::{Fleet, Robot as Entry};
use mom_base_station::station::Station;
use mom_client::{Channel, Client, ClientError};
use mom_device::DeviceTime;
use tokio::sync::{mpsc, watch};
use tokio::task::{JoinError, JoinSet};
use tokio::time::{Instant, timeout};

use crate::Unit;
use crate::editor::{FleetFile, Taking};
use crate::robot::{Leaving, Robot};
use crate::site::{GatewayOptions, ROBOTS_PER_CONNECTION, RobotSite};
use crate::station::{RobotWire, line};

/// So long an end of the program waits for what was begun with a new fleet: longer than each step of it takes.
const TAKING_OVER: Duration = Duration::from_secs(5);

/// Fleets that are to be taken over, one after the other, and the base station whose robots they are.
#[derive(Debug)]
pub struct Changes {
    /// The base station of the gateway's robots.
    pub station: Station,
    /// Each is a whole fleet.
    pub fleets: mpsc::Receiver<Taking>,
    /// The fleet that is driven.
    pub present: watch::Sender<Fleet>,
    /// Where it is kept, if people at the hub may edit it.
    pub file: Option<FleetFile>,
}

/// A robot that lives.
struct Living {
    stop: watch::Sender<Option<Leaving>>,
    /// Which of the clients is its.
    client: usize,
}

pub(crate) struct Crew {
    clients: Vec<Client>,
    options: Arc<GatewayOptions>,
    begin: Instant,
    epoch: DeviceTime,
    /// How many robots have never been there.
    missing: Arc<AtomicUsize>,
    living: BTreeMap<u32, Living>,
    tasks: JoinSet<(u32, Result<(), ClientError>)>,
}

type Ended = Result<(u32, Result<(), ClientError>), JoinError>;

impl Crew {
    /// None yet; so many are to come at first.
    pub(crate) fn new(clients: Vec<Client>, options: Arc<GatewayOptions>, robots: usize) -> Self {
        Self {
            clients,
            options,
            begin: Instant::now(),
            epoch: time_of_day(),
            missing: Arc::new(AtomicUsize::new(robots)),
            living: BTreeMap::new(),
            tasks: JoinSet::new(),
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.living.len()
    }

    /// Where a robot is at the hub, through that client.
    pub(crate) fn place(&self, line: &RobotWire, client: usize) -> Option<RobotSite> {
        Some(RobotSite {
            client: self.clients.get(client)?.clone(),
            options: Arc::clone(&self.options),
            unit: line.unit,
            group: line.group.clone(),
        })
    }

    /// Has a robot live in its channel, or without it until that is there.
    pub(crate) fn live(
        &mut self,
        place: RobotSite,
        line: RobotWire,
        client: usize,
        channel: Option<Channel>,
    ) {
        let (robot, stopping) = self.robot(place, line, client);
        let unit = robot.unit();
        self.tasks
            .spawn(async move { (unit, robot.live(channel, stopping).await) });
    }

    fn robot(
        &mut self,
        place: RobotSite,
        line: RobotWire,
        client: usize,
    ) -> (Robot, watch::Receiver<Option<Leaving>>) {
        let unit = Unit::new(line.unit, self.options.table).with_epoch(self.epoch);
        let (stop, stopping) = watch::channel(None);
        self.living.insert(line.unit, Living { stop, client });
        let robot = Robot::new(place, line, unit, self.begin, Arc::clone(&self.missing));
        (robot, stopping)
    }

    /// Takes changes over, until `shutdown` is done, or no robot is left: each ends when its connection to the hub is closed for good.
    pub(crate) async fn serve(
        &mut self,
        mut changes: Option<Changes>,
        shutdown: impl Future<Output = ()>,
    ) -> Result<(), ClientError> {
        let mut shutdown = pin!(shutdown);
        let mut result = Ok(());
        loop {
            let changed = async {
                match &mut changes {
                    Some(changes) => changes
                        .fleets
                        .recv()
                        .await
                        .map(|taking| (taking, changes.station.clone())),
                    None => pending().await,
                }
            };
            tokio::select! {
                () = &mut shutdown => return result,
                ended = self.tasks.join_next(), if !self.tasks.is_empty() => {
                    if let Some(ended) = ended {
                        self.ended(ended, &mut result);
                    }
                }
                Some((Taking { fleet, told }, station)) = changed => {
                    let stops: Vec<_> = self.living.values().map(|living| living.stop.clone()).collect();
                    let taking = self.take_over(&fleet, &station, &mut result);
                    let Some(taken) = unless_ending(taking, &mut shutdown, &stops).await else {
                        return result;
                    };
                    match &taken {
                        Ok(()) => {
                            if let Some(changes) = &changes {
                                changes.present.send_replace(fleet);
                            }
                        }
                        Err(why) => tracing::error!("the fleet's file is not taken over: {why}; then send SIGHUP"),
                    }
                    if let Some(told) = told {
                        // Who has asked may be gone.
                        let _ = told.send(taken);
                    }
                }
            }
            if self.tasks.is_empty() && result.is_err() {
                return result;
            }
        }
    }

    /// Has all robots end, and waits for them.
    pub(crate) async fn end(&mut self) {
        for living in self.living.values() {
            let _ = living.stop.send(Some(Leaving::Program));
        }
        while self.tasks.join_next().await.is_some() {}
    }

    fn ended(&mut self, ended: Ended, result: &mut Result<(), ClientError>) {
        match ended {
            Ok((unit, ended)) => {
                self.living.remove(&unit);
                if let Err(error) = ended {
                    *result = Err(error);
                }
            }
            Err(error) => {
                tracing::error!(%error, "a robot's task has failed");
                // Which one it was is not told.
                self.living.retain(|_, living| !living.stop.is_closed());
            }
        }
    }

    /// Leaves the robots that the fleet does not have any more, or at another address or in another group, and takes those that it has
    /// now. The others are not touched.
    /// An error, in words, if it does not, and all stays as it was.
    async fn take_over(
        &mut self,
        fleet: &Fleet,
        station: &Station,
        result: &mut Result<(), ClientError>,
    ) -> Result<(), String> {
        let most = self.clients.len() * ROBOTS_PER_CONNECTION;
        if fleet.robots().len() > most {
            let robots = fleet.robots().len();
            return Err(format!(
                "it has {robots} robots, and this gateway's connections carry {most}: start it again"
            ));
        }
        let known: BTreeMap<u32, Arc<Entry>> = station
            .snapshot()
            .into_iter()
            .map(|now| (now.robot.unit, now.robot))
            .collect();
        let come: Vec<&Entry> = (fleet.robots().iter())
            .filter(|robot| known.get(&robot.unit).is_none_or(|now| !is_same(now, robot)))
            .collect();
        let again: BTreeSet<u32> = come.iter().map(|robot| robot.unit).collect();
        let stay: BTreeSet<u32> = fleet
            .units()
            .into_iter()
            .filter(|unit| !again.contains(unit))
            .collect();
        let left: Vec<u32> = known
            .keys()
            .filter(|unit| !stay.contains(unit))
            .copied()
            .collect();
        // Those that are at another number, or nowhere, afterwards. A change of the group alone keeps the channel, and so its stop.
        let moved: Vec<u32> = (left.iter().copied())
            .filter(|unit| {
                let entry = fleet.robots().iter().find(|robot| robot.unit == *unit);
                entry.map(|robot| &robot.address) != known.get(unit).map(|robot| &robot.address)
            })
            .collect();
        self.may_move(&known, &moved).await?;
        self.leave(&left, &again, station, result).await;
        // Who was stopped at the last moment stays who it was.
        if let Err(why) = self.may_move(&known, &moved).await {
            for robot in left.iter().filter_map(|unit| known.get(unit)) {
                self.take_in(robot, station);
            }
            return Err(why);
        }
        for robot in &come {
            self.take_in(robot, station);
        }
        let (left, come, robots) = (left.len(), come.len(), self.len());
        tracing::info!(left, come, robots, "the fleet's file is taken over");
        Ok(())
    }

    /// Has these robots stand, leave their channels, and lose their connections; those that come `again` do so anew.
    async fn leave(
        &mut self,
        left: &[u32],
        again: &BTreeSet<u32>,
        station: &Station,
        result: &mut Result<(), ClientError>,
    ) {
        for unit in left {
            let why = match again.contains(unit) {
                true => "its entry in the fleet's file has changed",
                false => "it was taken out of the fleet's file",
            };
            tracing::info!(unit, why, "the robot is left");
            if let Some(living) = self.living.get(unit) {
                let _ = living.stop.send(Some(Leaving::Fleet(why)));
            }
        }
        // They stand, and have left their channels, before their connections end.
        while left.iter().any(|unit| self.living.contains_key(unit)) {
            let Some(ended) = self.tasks.join_next().await else {
                break;
            };
            self.ended(ended, result);
        }
        let mut removing = JoinSet::new();
        for unit in left.iter().copied() {
            let station = station.clone();
            removing.spawn(async move { (unit, station.remove(unit).await) });
        }
        while let Some(removed) = removing.join_next().await {
            if let Ok((unit, Ok(false))) = removed {
                tracing::error!(unit, "the robot may be moving: it was not told to stand in time");
            }
        }
    }

    /// Whether these robots may get other numbers: not while one is stopped, as the stop holds for its channel, and another one's would let
    /// the robot move.
    async fn may_move(&self, known: &BTreeMap<u32, Arc<Entry>>, units: &[u32]) -> Result<(), String> {
        let Some(client) = self.clients.first() else {
            return Ok(());
        };
        for unit in units {
            let place = RobotSite {
                client: client.clone(),
                options: Arc::clone(&self.options),
                unit: *unit,
                group: known.get(unit).and_then(|robot| robot.group.clone()),
            };
            match place.stopped().await {
                Ok(None) => {}
                Ok(Some(stopped)) => {
                    return Err(format!(
                        "{stopped}, and would be free as another unit; have it let go first (`mom unstop`)"
                    ));
                }
                Err(error) => {
                    return Err(format!(
                        "the hub does not say whether unit {unit} is stopped: {error}"
                    ));
                }
            }
        }
        Ok(())
    }

    /// Takes a robot in, through the client that has the fewest.
    fn take_in(&mut self, robot: &Entry, station: &Station) {
        let mut counts = vec![0_usize; self.clients.len()];
        for living in self.living.values() {
            if let Some(count) = counts.get_mut(living.client) {
                *count += 1;
            }
        }
        let fewest = (0..counts.len()).min_by_key(|client| counts.get(*client).copied());
        station.add(robot);
        let Some((line, client)) = line(station, robot).zip(fewest) else {
            return;
        };
        let Some(place) = self.place(&line, client) else {
            return;
        };
        self.missing.fetch_add(1, Ordering::Relaxed);
        let (robot, stopping) = self.robot(place.clone(), line, client);
        let unit = robot.unit();
        self.tasks.spawn(async move {
            let mut told = stopping.clone();
            let channel = tokio::select! {
                entered = place.enter() => entered.ok(),
                // A hub that is away answers nothing.
                _ = told.wait_for(Option::is_some) => None,
            };
            (unit, robot.live(channel, stopping).await)
        });
        let _ = station.connect(unit);
    }
}

/// Waits for a fleet to be taken over. None where the program is to end before: all robots hear of that at once, and what the taking over
/// still has under way, such as that a robot leaves its channel, is waited for a while.
async fn unless_ending<T>(
    taking: impl Future<Output = T>,
    shutdown: &mut (impl Future<Output = ()> + Unpin),
    stops: &[watch::Sender<Option<Leaving>>],
) -> Option<T> {
    let mut taking = pin!(taking);
    tokio::select! {
        biased;
        () = shutdown => {}
        taken = &mut taking => return Some(taken),
    }
    for stop in stops {
        stop.send_replace(Some(Leaving::Program));
    }
    if timeout(TAKING_OVER, taking).await.is_err() {
        tracing::warn!("the program ends before the fleet's file was taken over");
    }
    None
}

/// Whether a robot need not be met anew: its name is nothing to the gateway.
fn is_same(one: &Entry, other: &Entry) -> bool {
    one.address == other.address && one.group == other.group
}

/// µs since 1970.
fn time_of_day() -> DeviceTime {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    since
        .ok()
        .and_then(|since| DeviceTime::try_from(since.as_micros()).ok())
        .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use std::future::ready;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn an_end_amid_a_new_fleet_is_told_to_all_at_once_and_waits_for_no_hub() {
        let (stop, mut told) = watch::channel(None);
        let begin = Instant::now();
        let stops = [stop];
        let mut shutdown = ready(());
        let ends = unless_ending(pending::<()>(), &mut shutdown, &stops);
        let hears = async {
            let _ = told.wait_for(Option::is_some).await;
            (begin.elapsed(), *told.borrow())
        };
        let (taken, (after, leaving)) = tokio::join!(ends, hears);
        assert_eq!(
            (taken, after, leaving),
            (None, Duration::ZERO, Some(Leaving::Program))
        );
        assert_eq!(begin.elapsed(), TAKING_OVER);
    }

    #[tokio::test]
    async fn what_is_taken_over_before_an_end_is_told() {
        let taken = unless_ending(ready(7), &mut pending(), &[]).await;
        assert_eq!(taken, Some(7));
    }
}
