//! A robot between its channel and its wire.

use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use mom_brs::Code;
use mom_client::{Channel, ClientError, LinkState, Parcel};
use mom_device::{
    DeviceError, DevicePeer, ErrorName, Machine, Outlet, instant_of, sender, sleep_or_wait, time_since,
};
use mom_wheeled::{StatusTeller, come_back};
use tokio::sync::{Notify, watch};
use tokio::task::yield_now;
use tokio::time::{Instant, sleep, sleep_until, timeout};

use crate::Unit;
use crate::site::RobotSite;
use crate::station::{News, RobotWire, is_stop};

/// So long a robot may take to say that it stands before the program ends all the same.
const LAST_STOP: Duration = Duration::from_secs(1);
/// So long a login takes at most at a hub that is there: its robots need not be met anew for it.
const LOGIN: Duration = Duration::from_secs(1);

/// One robot for as long as its gateway lives, in its channel and without it.
pub(crate) struct Robot {
    place: RobotSite,
    line: RobotWire,
    unit: Unit,
    status: Option<StatusTeller>,
    begin: Instant,
    /// How many have never been there, until this one is.
    missing: Option<Arc<AtomicUsize>>,
}

/// Why a robot is left for good.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Leaving {
    /// The program ends.
    Program,
    /// The fleet's file does not have it any more as it was, in these words.
    Fleet(&'static str),
}

/// Why it obeys no more.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Ended {
    Shutdown,
    /// Its channel is gone.
    Gone,
    /// Its wire is.
    Unwired,
    /// Its gateway's link to the hub is lost, with all places and tokens.
    Adrift,
}

impl Robot {
    pub(crate) fn new(
        place: RobotSite,
        line: RobotWire,
        unit: Unit,
        begin: Instant,
        missing: Arc<AtomicUsize>,
    ) -> Self {
        let status = place
            .status()
            .map(|path| StatusTeller::new(path, place.unit, place.group.clone()));
        Self {
            place,
            line,
            unit,
            status,
            begin,
            missing: Some(missing),
        }
    }

    pub(crate) fn unit(&self) -> u32 {
        self.line.unit
    }

    /// Obeys in its channel, and stands while there is none; until the program stops, or the hub does not want its gateway any more.
    pub(crate) async fn live(
        mut self,
        mut channel: Option<Channel>,
        mut stopping: watch::Receiver<Option<Leaving>>,
    ) -> Result<(), ClientError> {
        loop {
            let mut ended = match &channel {
                Some(channel) => self.obey(channel, &mut stopping).await,
                None => Ended::Gone,
            };
            if matches!(ended, Ended::Gone | Ended::Adrift) {
                let why = match ended {
                    Ended::Adrift => "the hub is out of reach, and its place there is gone",
                    _ => "its place in its channel is gone, or another device has it",
                };
                tracing::warn!(
                    unit = self.line.unit,
                    why,
                    "the robot stands until it has a place"
                );
                // It joins anew, and so hears first how it stands.
                channel = None;
                match self.wait_for_channel(ended == Ended::Adrift, &mut stopping).await {
                    Ok(Some(back)) => channel = Some(back),
                    Ok(None) => ended = Ended::Shutdown,
                    Err(error) => {
                        self.leave().await;
                        return Err(error);
                    }
                }
            }
            if channel.is_none() || matches!(ended, Ended::Shutdown | Ended::Unwired) {
                self.stand().await;
                if matches!(*stopping.borrow(), Some(Leaving::Fleet(_))) {
                    self.place.leave().await;
                    if let Some(missing) = self.missing.take() {
                        missing.fetch_sub(1, Ordering::Relaxed);
                    }
                }
                return Ok(());
            }
        }
    }

    /// Has it obey in its channel; afterwards it was told to stand.
    async fn obey(&mut self, channel: &Channel, stopping: &mut watch::Receiver<Option<Leaving>>) -> Ended {
        let client = self.place.client.clone();
        let mut device = DevicePeer::start(&client, channel, self.unit.clone(), self.begin);
        // A hub that takes nothing holds up neither stops nor replies.
        let mut outlet = Outlet::new(sender(&client));
        let mut adrift = pin!(adrift(client.state()));
        let ended = loop {
            self.send(&mut device);
            if device.machine().has_to_send() {
                // What has been said goes out before more is, which would have no place otherwise.
                yield_now().await;
                continue;
            }
            let mut out = Vec::new();
            let told = self.tell(&device, channel, &mut out);
            outlet.set_down(device.is_down());
            outlet.push(&mut out);
            tokio::select! {
                biased;
                _ = stopping.wait_for(Option::is_some) => break Ended::Shutdown,
                more = device.step() => if !more { break Ended::Gone },
                () = &mut adrift, if device.is_down() => break Ended::Adrift,
                news = self.line.heard.next() => match news {
                    Some(news) => {
                        self.hear(&mut device, news);
                        // Replies that have come together are taken together.
                        while let Some(news) = self.line.heard.ready() {
                            self.hear(&mut device, news);
                        }
                    }
                    None => break Ended::Unwired,
                },
                () = outlet.work() => {}
                () = sleep_or_wait(told) => {}
            }
        };
        // It stands, whatever becomes of its gateway.
        let why = match ended {
            Ended::Gone => "its channel is gone",
            Ended::Adrift => "its gateway has lost the hub",
            Ended::Shutdown | Ended::Unwired => match *stopping.borrow() {
                Some(Leaving::Fleet(why)) => why,
                _ => "its gateway ends",
            },
        };
        device.halt(why);
        self.send(&mut device);
        self.unit = device.machine().clone();
        if matches!(ended, Ended::Shutdown | Ended::Unwired) {
            if matches!(*stopping.borrow(), Some(Leaving::Fleet(_))) {
                self.stand().await;
                self.tell_left(&mut device, channel, why).await;
            }
            device.end(why).await;
        }
        ended
    }

    /// Tells in its channel and in the fleet's that it is left, and why: nobody knows from then on what it does.
    async fn tell_left(&mut self, device: &mut DevicePeer<Unit>, channel: &Channel, why: &str) {
        device.note(|unit| {
            unit.lost(why);
            unit.unreached(why);
        });
        device.report();
        let mut outlet = Outlet::new(sender(&self.place.client));
        let mut out = Vec::new();
        loop {
            let due = self.tell(device, channel, &mut out);
            match (out.is_empty(), due) {
                // It was told of often just now.
                (true, Some(due)) => sleep_until(due).await,
                _ => break,
            }
        }
        outlet.push(&mut out);
        if timeout(LAST_STOP, outlet.flush()).await.is_err() {
            tracing::warn!(
                unit = self.line.unit,
                "it was not told in time that the robot is left"
            );
        }
    }

    /// Keeps the robot standing until it has a place in its channel; none if the program stops before. Where another device has that, or
    /// the hub has given this gateway up and may have let another device in, the robot is left to the one that takes it.
    async fn wait_for_channel(
        &mut self,
        is_adrift: bool,
        stopping: &mut watch::Receiver<Option<Leaving>>,
    ) -> Result<Option<Channel>, ClientError> {
        let (place, occupied) = (self.place.clone(), Notify::new());
        let mut adrift = pin!(adrift(place.client.state()));
        let enter = || async {
            // As soon as there is a hub, and not before.
            let mut link = place.client.state();
            let is_there = |link: &LinkState| !matches!(link, LinkState::Trying { .. });
            let _ = link.wait_for(is_there).await;
            let entered = place.enter().await;
            if matches!(&entered, Err(error) if error.code() == Some(&mom_client::Code::OCCUPIED)) {
                occupied.notify_one();
            }
            entered
        };
        let mut back = pin!(come_back(enter));
        let (mut leaves, mut is_left) = (is_adrift, false);
        loop {
            if leaves && !is_left {
                self.leave().await;
                is_left = true;
            }
            tokio::select! {
                biased;
                _ = stopping.wait_for(Option::is_some) => return Ok(None),
                () = occupied.notified(), if !is_left => leaves = true,
                () = &mut adrift, if !is_left => leaves = true,
                wired = self.serve_wire() => if !wired { return Ok(None) },
                entered = &mut back => {
                    if is_left {
                        (self.line.connect)(true);
                    }
                    return entered.map(Some);
                }
            }
        }
    }

    /// Has the robot stand, and hangs up: it has one base station at a time, and another one may have its channel.
    async fn leave(&mut self) {
        self.stand().await;
        (self.line.connect)(false);
    }

    /// Waits until the robot has said that it stands, if it can be reached, and tells it again until then.
    async fn stand(&mut self) {
        let until = Instant::now() + LAST_STOP;
        while self.unit.is_linked() && self.unit.is_moving() {
            tokio::select! {
                wired = self.serve_wire() => if !wired { break },
                () = sleep_until(until) => break,
            }
        }
        if self.unit.is_linked() && self.unit.is_moving() {
            tracing::error!(
                unit = self.line.unit,
                "the robot may be moving: it has not said that it stands"
            );
        }
    }

    /// Waits until something happens on its wire, or is due there, and does what follows; false when there is no wire any more.
    /// Nobody commands it meanwhile. May be dropped at any time.
    async fn serve_wire(&mut self) -> bool {
        if self.unit.is_overdue() {
            self.unit.given_up();
            (self.line.give_up)();
        }
        if let Err(why) = say(&self.line, &mut self.unit) {
            tracing::debug!(unit = self.line.unit, why, "the robot was not told");
        }
        let wake = self.unit.next_wake().map(|due| instant_of(self.begin, due));
        tokio::select! {
            news = self.line.heard.next() => {
                self.unit.advance(time_since(self.begin));
                match news {
                    Some(News::Linked) => self.unit.linked(),
                    Some(News::Lost(why)) => self.unit.lost(&why),
                    Some(News::Unreached(why)) => self.unit.unreached(&why),
                    // Nothing is under way that could fail.
                    Some(News::Reply(reply)) => drop(self.unit.heard(&reply)),
                    None => return false,
                }
            }
            () = sleep_or_wait(wake) => self.unit.advance(time_since(self.begin)),
        }
        true
    }

    fn hear(&mut self, device: &mut DevicePeer<Unit>, news: News) {
        match news {
            News::Linked => {
                tracing::info!(unit = self.line.unit, "the robot is connected");
                device.note(Unit::linked);
                device.report();
                let missing = self.missing.take();
                if missing.is_some_and(|missing| missing.fetch_sub(1, Ordering::Relaxed) == 1) {
                    tracing::info!("all robots are connected");
                }
            }
            News::Lost(why) => {
                tracing::warn!(unit = self.line.unit, why, "the robot is lost");
                device.note(|unit| unit.lost(&why));
                let text = format!("robot {} is lost: {why}", self.line.unit);
                device.fail(&DeviceError::new(ErrorName::Link, text));
            }
            News::Unreached(why) => {
                tracing::warn!(
                    unit = self.line.unit,
                    why,
                    "the robot is not reached, and is tried again"
                );
                device.note(|unit| unit.unreached(&why));
                device.report();
            }
            News::Reply(reply) => {
                let before = device.machine().known();
                let mut heard = Ok(());
                device.note(|unit| heard = unit.heard(&reply));
                if let Err(error) = heard {
                    device.fail(&error);
                }
                // While it moves it is told of by itself.
                let machine = device.machine();
                if !machine.is_moving() && before != machine.known() {
                    device.report();
                }
            }
        }
    }

    /// Sends what its unit has for it.
    fn send(&mut self, device: &mut DevicePeer<Unit>) {
        if device.machine().is_overdue() {
            device.note(Unit::given_up);
            tracing::warn!(unit = self.line.unit, "the robot moves and does not answer");
            (self.line.give_up)();
        }
        if !device.machine().has_to_send() {
            return;
        }
        let (line, mut said) = (&self.line, Ok(()));
        device.note(|unit| said = say(line, unit));
        if let Err(why) = said {
            let text = format!("robot {} was not told to do it: {why}", self.line.unit);
            device.fail(&DeviceError::new(ErrorName::Link, text));
            device.note(Unit::sent);
        }
    }

    /// What is to be told of it in the fleet's channel; when to look again.
    fn tell(
        &mut self,
        device: &DevicePeer<Unit>,
        channel: &Channel,
        out: &mut Vec<Parcel>,
    ) -> Option<Instant> {
        let status = self.status.as_mut()?;
        let told = status.tell(|| device.state(), || channel.gate().guard(), Instant::now());
        if let Some(mut parcel) = told {
            parcel.timestamp = device.known_time();
            out.push(parcel);
        }
        status.due(device.machine().is_moving())
    }
}

/// Waits until the hub has given up all that its peer had there, and is not there to take it in again.
async fn adrift(mut link: watch::Receiver<LinkState>) {
    let is_lost = |link: &LinkState| matches!(link, LinkState::Trying { .. });
    while link.wait_for(is_lost).await.is_ok() {
        tokio::select! {
            biased;
            _ = link.wait_for(|link| !is_lost(link)) => {}
            () = sleep(LOGIN) => return,
        }
    }
    // A client that is closed ends its events, too.
    std::future::pending::<()>().await;
}

/// Sends what a unit has for its robot; an error if something that was to be done was not sent, and so is not done. Questions are asked
/// again, and a robot that does not stand is told so again.
fn say(line: &RobotWire, unit: &mut Unit) -> Result<(), String> {
    let mut said = Ok(());
    for frame in unit.to_send() {
        if let Err(why) = (line.send)(frame) {
            tracing::warn!(unit = line.unit, why, %frame, "a frame was not sent");
            unit.unsent(&frame);
            if !is_stop(&frame) && !matches!(frame.code(), Code::STATUS | Code::POSE) {
                said = Err(why);
            }
        }
    }
    if said.is_ok() {
        unit.sent();
    }
    said
}
