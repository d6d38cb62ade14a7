//! The device as a peer: hears its channel, lets time pass, and sends what is to be said.

use std::time::{Duration, SystemTime};

use mom_client::{Channel, Client, Event, Events, FenceGate, Parcel, Time};
use tokio::time::{Instant, timeout};

use crate::clock::{instant_of, sleep_or_wait, time_since};
use crate::outlet::{Outlet, Sending, sender};
use crate::server::STATE;
use crate::{DeviceError, DeviceServer, DeviceTime, Machine, State};

/// How long the last statuses may take to leave when the program ends.
const FAREWELL: Duration = Duration::from_secs(1);

/// A device at work in its channel.
///
/// Its program calls [`DevicePeer::step`] again and again, beside whatever else happens to the device, which it tells by
/// [`DevicePeer::note`] and [`DevicePeer::fail`].
pub struct DevicePeer<M: Machine> {
    client: Client,
    server: DeviceServer<M>,
    events: Events,
    gate: FenceGate,
    outlet: Outlet<Box<dyn Fn(Parcel) -> Sending + Send + Sync>>,
    out: Vec<Parcel>,
    begin: Instant,
    pace: u32,
    put_out: Option<String>,
}

/// What a device has waited for, to be taken in by [`DevicePeer::take`].
#[derive(Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "it lives for one turn of a loop, and a box for each event would cost more"
)]
pub enum Happening {
    /// An event of its channel.
    Event(Event),
    /// It is time to go on.
    Due,
    /// Something that it said has left.
    Left,
}

impl<M: Machine> DevicePeer<M> {
    /// Begins to obey the commands of this channel. `begin` is when its time began.
    #[must_use]
    pub fn start(client: &Client, channel: &Channel, machine: M, begin: Instant) -> Self {
        let mut server = DeviceServer::new(machine, channel.path().clone(), time_of_day());
        server.set_name(client.name());
        let mut out = Vec::new();
        server.report(&mut out);
        Self {
            server,
            events: channel.events(),
            gate: channel.gate(),
            outlet: Outlet::new(Box::new(sender(client))),
            out,
            begin,
            pace: 1,
            put_out: None,
            client: client.clone(),
        }
    }

    /// Has it take no command that is older than this when it begins, whatever its sender says: [`DeviceServer::with_max_age`].
    #[must_use]
    pub fn with_max_age(mut self, max_age: Duration) -> Self {
        self.server = self.server.with_max_age(max_age);
        self
    }

    /// Has its time pass so many times as fast as that of its users: [`DeviceServer::at_pace`].
    #[must_use]
    pub fn at_pace(mut self, pace: u32) -> Self {
        self.pace = pace.max(1);
        self.server = self.server.at_pace(self.pace);
        self
    }

    /// Has it ask for its commands, each time for so long, and take none that is too late: [`DeviceServer::pulling`].
    #[must_use]
    pub fn pulling(mut self, wait: Duration) -> Self {
        let wait = DeviceTime::try_from(wait.as_micros()).unwrap_or(DeviceTime::MAX);
        self.server = self.server.pulling(wait);
        // What is too late is refused in words.
        self.events = self.events.with_expired();
        self
    }

    /// The device itself.
    pub fn machine(&self) -> &M {
        self.server.machine()
    }

    /// How it stands.
    pub fn state(&self) -> State {
        self.server.state()
    }

    /// Its time.
    pub fn now(&self) -> DeviceTime {
        time_since(self.begin).saturating_mul(self.pace.into())
    }

    /// The gate of its channel, which knows who owns its token.
    pub fn gate(&self) -> &FenceGate {
        &self.gate
    }

    /// Why it was expelled from its channel, if it was: it hears nothing more there.
    pub fn put_out(&self) -> Option<&str> {
        self.put_out.as_deref()
    }

    /// Whether its link to the hub is down, so that nothing can be said.
    pub fn is_down(&self) -> bool {
        self.outlet.is_down()
    }

    /// Lets something be done to the device that no command does, such as that news of it have come.
    pub fn note(&mut self, what: impl FnOnce(&mut M)) {
        let now = self.now();
        self.server.note(now, what, &mut self.out);
    }

    /// Ends every command with this error, because the device cannot carry it out.
    pub fn fail(&mut self, error: &DeviceError) {
        let now = self.now();
        self.server.fail(now, error, &mut self.out);
    }

    /// Ends every command, for a reason in plain words.
    pub fn halt(&mut self, reason: &str) {
        let now = self.now();
        self.server.halt(reason, now, &mut self.out);
    }

    /// When what it tells of itself was so, if that was not just now.
    pub fn known_time(&self) -> Option<Time> {
        let age = self.now().saturating_sub(self.machine().known_at()?) / DeviceTime::from(self.pace);
        Time::from_micros(time_of_day().micros().saturating_sub(age))
    }

    /// Says how it stands.
    pub fn report(&mut self) {
        self.server.report(&mut self.out);
    }

    /// Waits until something happens to it, by the hub or by time, and decides what follows; `false` when there will be no more,
    /// as its channel is gone or its client closed. May be dropped at any time, and nothing is lost.
    ///
    /// What it says leaves with the next call: what was decided can be made known elsewhere first.
    pub async fn step(&mut self) -> bool {
        let Some(happening) = self.wait().await else {
            return false;
        };
        self.take(&happening);
        true
    }

    /// Waits as [`DevicePeer::step`] does, and decides nothing: what happened is to be handed to [`DevicePeer::take`] at once, after
    /// whatever has to be known before. May be dropped at any time, and nothing is lost.
    pub async fn wait(&mut self) -> Option<Happening> {
        let now = self.now();
        self.server.ask(&self.gate, now, &mut self.out);
        self.send();
        let wake = self.server.next_wake().into_iter();
        let wake = wake.chain(self.server.asks_at(&self.gate)).min();
        let wake = wake.map(|due| self.at(due));
        tokio::select! {
            event = self.events.next() => event.map(Happening::Event),
            () = sleep_or_wait(wake) => Some(Happening::Due),
            () = self.outlet.work() => Some(Happening::Left),
        }
    }

    /// Decides what follows from what happened.
    pub fn take(&mut self, happening: &Happening) {
        match happening {
            Happening::Event(event) => self.hear(event),
            Happening::Due => {
                let now = self.now();
                self.server.advance(now, &mut self.out);
            }
            Happening::Left => {}
        }
    }

    /// Halts it, lets it say so, and ends. The client stays as it is.
    pub async fn end(self, reason: &str) {
        self.leave(reason).await;
    }

    /// The same, and gives the device itself back, for the next time that it has a channel.
    pub async fn leave(mut self, reason: &str) -> M {
        self.halt(reason);
        self.send();
        if timeout(FAREWELL, self.outlet.flush()).await.is_err() {
            tracing::warn!("the last messages did not leave in time");
        }
        self.server.into_machine()
    }

    /// Why it hears nothing more in its channel, in words that follow "the robot stands, as".
    #[must_use]
    pub fn why_gone(&self) -> String {
        match &self.put_out {
            Some(why) => format!("it was expelled from its channel: {why}"),
            None => "its channel is gone".to_owned(),
        }
    }

    /// Hands over what is to be said; a state is as old as what it tells.
    fn send(&mut self) {
        if let Some(time) = self.known_time() {
            for state in self.out.iter_mut().filter(|parcel| parcel.name() == STATE) {
                state.timestamp = Some(time);
            }
        }
        self.outlet.push(&mut self.out);
    }

    fn hear(&mut self, event: &Event) {
        let age = match event {
            Event::Message(parcel) => self.client.clock().age(parcel),
            _ => None,
        };
        // It may have come back as another peer, by whose name it is put out and says its own stops.
        if matches!(event, Event::Rejoined) {
            self.server.set_name(self.client.name());
        }
        let now = self.now();
        self.server.handle(event, &self.gate, age, now, &mut self.out);
        match event {
            Event::Expelled { peer, text, path, .. } if *peer == self.client.name() => {
                let why = text.as_deref().unwrap_or("nobody says why");
                tracing::warn!(channel = %path, why, "this device was put out of its channel, and stands");
                self.put_out = Some(why.to_owned());
            }
            Event::LinkDown => self.outlet.set_down(true),
            Event::Rejoined | Event::Resumed => self.outlet.set_down(false),
            _ => {}
        }
    }

    fn at(&self, due: DeviceTime) -> Instant {
        // Not before it is due.
        let pace = DeviceTime::from(self.pace);
        instant_of(self.begin, due.saturating_add(pace - 1) / pace)
    }
}

fn time_of_day() -> Time {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    let micros = since.ok().and_then(|since| i64::try_from(since.as_micros()).ok());
    micros.and_then(Time::from_micros).unwrap_or_default()
}
