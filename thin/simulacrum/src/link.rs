//! The middle of one robot on its socket, and the Robot API (S7, S8).

use std::io;
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::time::Duration;

use mom_rsp::middle::{Middle, MiddleFault, Notice, Offset, Settings, State};
use mom_rsp::{Counters, Direction, Kind, Refused, Sound};
use mom_rsp_model::{Model, ModelElement};
use parking_lot::Mutex;
use tokio::net::UdpSocket;
use tokio::sync::{Notify, broadcast, watch};
use tokio::time::{Instant, sleep_until, timeout};

use crate::values::from_wire;

mod pace;
mod trouble;

use pace::Pace;
use trouble::Way;

/// A datagram is at most so long.
const LONGEST: usize = 65_536;
/// Notices that wait for one who listens; who is later than that is told so.
const WAITING: usize = 1024;
/// Datagrams that are read before something is sent again, so that a flood does not hold up the packets of each period (S9).
const AT_ONCE: usize = 64;
/// How long a robot may take to say that its session is over.
const FAREWELL: Duration = Duration::from_secs(1);

/// A function that is called with each value of a sensor, or each event, as it is heard (S8).
pub type Listener = Box<dyn FnMut(&Notice, &Simulacrum) + Send>;

/// The mirror of one robot: what is wanted of it, what it said last, and how well it is reached. Clones are of the same robot.
#[derive(Clone)]
pub struct Simulacrum(Arc<Shared>);

struct Shared {
    name: String,
    model: Model,
    begin: Instant,
    /// Bytes of fragments that are sent each period beside sounds.
    pictures: u16,
    middle: Mutex<Middle<'static>>,
    /// There is something to send before the next period.
    hurry: Notify,
    /// How often each element was heard, for those who wait for it.
    heard: Vec<watch::Sender<u64>>,
    notices: broadcast::Sender<Arc<Notice>>,
    listeners: Mutex<Vec<(u8, Listener)>>,
    traffic: Mutex<Traffic>,
    way: Mutex<Way>,
    /// Chooses the period, where nobody has said one.
    pace: Mutex<Option<Pace>>,
}

/// What has travelled.
#[derive(Debug, Default, Clone)]
pub(crate) struct Traffic {
    /// Datagrams and their bytes, without UDP and IP.
    pub(crate) sent: (u64, u64),
    pub(crate) received: (u64, u64),
    /// The newest datagrams of either direction, for who looks at their bits: at most their first 64 bytes.
    pub(crate) down: Vec<u8>,
    pub(crate) up: Vec<u8>,
    /// The bits of the device maps of either direction that were 1 since this was asked last.
    pub(crate) lit: [Vec<u8>; 2],
}

impl Traffic {
    fn light(lit: &mut Vec<u8>, map: &[u8]) {
        lit.resize(map.len(), 0);
        for (lit, bits) in lit.iter_mut().zip(map) {
            *lit |= bits;
        }
    }
}

/// One value as it is known.
#[derive(Debug, Clone, PartialEq)]
pub struct Known {
    /// In the units of the model.
    pub values: Vec<f64>,
    /// How long ago it was heard or confirmed.
    pub age: Duration,
}

impl Simulacrum {
    /// The mirror of a robot of this model, of which nothing is known yet. [`serve`] connects it.
    ///
    /// # Errors
    ///
    /// Settings that are out of their range.
    pub fn new(name: &str, model: Model, mut settings: Settings) -> Result<Self, MiddleFault> {
        let pictures = settings.budget;
        settings.budget = budget(&model, pictures, settings.period);
        // The layout is as old as the program, as robots are named when it starts.
        let layout = Box::leak(Box::new(model.clone().into_layout()));
        let middle = Middle::new(layout, settings, |bytes| {
            // A nonce that is not random would still be new, as the robot's is.
            if getrandom::fill(bytes).is_err() {
                tracing::error!("the system gives no random numbers");
            }
        })?;
        Ok(Self(Arc::new(Shared {
            name: name.to_owned(),
            heard: model.elements().iter().map(|_| watch::Sender::new(0)).collect(),
            model,
            begin: Instant::now(),
            pictures,
            middle: Mutex::new(middle),
            hurry: Notify::new(),
            notices: broadcast::Sender::new(WAITING),
            listeners: Mutex::default(),
            traffic: Mutex::default(),
            way: Mutex::default(),
            pace: Mutex::default(),
        })))
    }

    /// What it is called.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.0.name
    }

    /// Its model.
    #[must_use]
    pub fn model(&self) -> &Model {
        &self.0.model
    }

    /// The place of an element, and what it is.
    #[must_use]
    pub fn element(&self, name: &str) -> Option<(u8, &ModelElement)> {
        let (place, element) = self.0.model.find(name)?;
        Some((u8::try_from(place).ok()?, element))
    }

    /// `write(i, v)`: what an effector is to do, as on the wire. It is in each packet until it is confirmed.
    ///
    /// # Errors
    ///
    /// An element that is none, or a value of another size.
    pub fn write(&self, element: u8, value: &[u8]) -> Result<(), Refused> {
        self.0.middle.lock().write(element, value)
    }

    /// `read(i)`: what a sensor or monitor said last, and what an effector is known to have taken.
    #[must_use]
    pub fn read(&self, element: u8) -> Option<Known> {
        let middle = self.0.middle.lock();
        let reading = middle.read(element).or_else(|| middle.confirmed(element))?;
        let model = self.0.model.elements().get(usize::from(element))?;
        Some(Known {
            values: from_wire(model, reading.value),
            age: Duration::from_micros(self.now().saturating_sub(reading.at)),
        })
    }

    /// `read(int[])`: several at one moment.
    #[must_use]
    pub fn read_list(&self, elements: &[u8]) -> Vec<Option<Known>> {
        elements.iter().map(|element| self.read(*element)).collect()
    }

    /// What is wanted of an effector, in the units of the model.
    #[must_use]
    pub fn wanted(&self, element: u8) -> Option<Vec<f64>> {
        let model = self.0.model.elements().get(usize::from(element))?;
        let middle = self.0.middle.lock();
        Some(from_wire(model, middle.wanted(element)?))
    }

    /// Waits until an element is heard again, however often that has been before (S8).
    pub async fn changed(&self, element: u8) -> Option<Known> {
        let mut heard = self.0.heard.get(usize::from(element))?.subscribe();
        heard.changed().await.ok()?;
        self.read(element)
    }

    /// Has a function called with each notice of this element, in the task of [`serve`] (S8).
    pub fn listen(&self, element: u8, listener: Listener) {
        self.0.listeners.lock().push((element, listener));
    }

    /// All notices from now on, in order. Why there is no session yet may have been told before: [`Simulacrum::trouble`].
    #[must_use]
    pub fn notices(&self) -> broadcast::Receiver<Arc<Notice>> {
        self.0.notices.subscribe()
    }

    /// Has a command executed once; its end is a notice with this ticket (S19, S20).
    ///
    /// # Errors
    ///
    /// An element that is none, no session, or too many that wait.
    pub fn command(&self, element: u8, data: &[u8]) -> Result<u32, Refused> {
        let ticket = self.0.middle.lock().command(element, data);
        self.0.hurry.notify_one();
        ticket
    }

    /// Works on the middle itself; a caller that sends by it must call [`Simulacrum::hurry`].
    pub fn with<T>(&self, what: impl FnOnce(&mut Middle<'static>) -> T) -> T {
        what(&mut self.0.middle.lock())
    }

    /// Has what waits sent as soon as its period lets it.
    pub fn hurry(&self) {
        self.0.hurry.notify_one();
    }

    /// From now on the middle chooses the time between two packets itself, ms, from the loss and the round trip that it measures (S10).
    pub fn choose_period(&self, among: RangeInclusive<u16>) {
        *self.0.pace.lock() = Some(Pace::new(among));
    }

    /// Changes the time between two packets, ms (S10); from now on the middle chooses none itself.
    ///
    /// # Errors
    ///
    /// One that is out of its range.
    pub fn set_period(&self, ms: u16) -> Result<(), Refused> {
        *self.0.pace.lock() = None;
        self.take_period(ms)
    }

    /// Looks whether another period is better.
    fn look_at_period(&self) {
        let (now, mut pace) = (self.now(), self.0.pace.lock());
        let Some(pace) = pace.as_mut().filter(|_| self.is_up()) else {
            return;
        };
        let measured = self.with(|middle| (middle.period(), middle.loss(), middle.round_trip()));
        let (period, loss, round_trip) = measured;
        if let Some(ms) = pace.next(now, period, loss, round_trip) {
            tracing::info!(
                robot = self.name(),
                ms,
                before = period,
                loss,
                round_trip,
                "another period"
            );
            if let Err(error) = self.take_period(ms) {
                tracing::error!(robot = self.name(), ms, %error, "the period stays");
            }
        }
    }

    fn take_period(&self, ms: u16) -> Result<(), Refused> {
        let budget = budget(self.model(), self.0.pictures, ms);
        self.with(|middle| {
            middle.set_period(ms)?;
            middle.set_budget(budget);
            Ok(())
        })
    }

    /// Whether there is a session.
    #[must_use]
    pub fn is_up(&self) -> bool {
        self.0.middle.lock().state() == State::Up
    }

    /// How the robot's clock stands to this one's.
    #[must_use]
    pub fn clock(&self) -> Option<Offset> {
        self.0.middle.lock().clock(self.now())
    }

    /// How old the newest is that was heard of the robot; none before anything was.
    #[must_use]
    pub fn age(&self) -> Option<Duration> {
        let heard = self.0.middle.lock().heard_at()?;
        Some(Duration::from_micros(self.now().saturating_sub(heard)))
    }

    /// What was received and dropped.
    #[must_use]
    pub fn counters(&self) -> Counters {
        self.0.middle.lock().counters().clone()
    }

    /// What has travelled; the bits that were lit are dark again.
    pub(crate) fn take_traffic(&self) -> Traffic {
        let mut traffic = self.0.traffic.lock();
        let taken = traffic.clone();
        for map in &mut traffic.lit {
            map.fill(0);
        }
        taken
    }

    /// µs since the mirror was made, the clock of its [`Middle`].
    #[must_use]
    pub fn now(&self) -> u64 {
        u64::try_from(self.0.begin.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    fn at(&self, micros: u64) -> Instant {
        self.0.begin + Duration::from_micros(micros)
    }

    /// Takes a datagram; what is wrong with it is counted.
    fn receive(&self, datagram: &mut [u8]) {
        {
            let mut traffic = self.0.traffic.lock();
            traffic.received.0 += 1;
            traffic.received.1 += datagram.len() as u64;
        }
        let mut head = [0; 64];
        let length = datagram.len().min(head.len());
        if let (Some(to), Some(from)) = (head.get_mut(..length), datagram.get(..length)) {
            to.copy_from_slice(from);
        }
        let now = self.now();
        let mut middle = self.0.middle.lock();
        match middle.receive(now, datagram) {
            Ok(()) => {
                let mut traffic = self.0.traffic.lock();
                traffic.up.clear();
                traffic
                    .up
                    .extend_from_slice(head.get(..length).unwrap_or_default());
                let [_, lit] = &mut traffic.lit;
                Traffic::light(lit, middle.map(Direction::Up));
            }
            Err(why) => tracing::debug!(robot = self.name(), %why, "a datagram was dropped"),
        }
    }

    /// What is to be sent now; empty if nothing is.
    fn next_datagram(&self, into: &mut Vec<u8>) -> bool {
        into.clear();
        let now = self.now();
        let mut middle = self.0.middle.lock();
        let Some(datagram) = middle.poll(now) else {
            return false;
        };
        into.extend_from_slice(datagram);
        let map = middle.map(Direction::Down);
        let mut traffic = self.0.traffic.lock();
        traffic.sent.0 += 1;
        traffic.sent.1 += into.len() as u64;
        traffic.down.clear();
        traffic.down.extend(into.iter().take(64));
        let [lit, _] = &mut traffic.lit;
        Traffic::light(lit, map);
        true
    }

    /// Tells what has happened to all who wait and listen.
    fn dispatch(&self) {
        loop {
            let Some(notice) = self.0.middle.lock().next_notice() else {
                return;
            };
            if let Some(element) = element_of(&notice) {
                if let Some(heard) = self.0.heard.get(usize::from(element)) {
                    heard.send_modify(|times| *times += 1);
                }
                // A listener may listen to more.
                let mut listeners = std::mem::take(&mut *self.0.listeners.lock());
                for (_, listener) in listeners.iter_mut().filter(|(of, _)| *of == element) {
                    listener(&notice, self);
                }
                let mut added = self.0.listeners.lock();
                listeners.append(&mut added);
                *added = listeners;
            }
            // Nobody has to listen.
            let _ = self.0.notices.send(Arc::new(notice));
        }
    }
}

/// Bytes of fragments each period: so many, and beside them the sound that is heard meanwhile.
fn budget(model: &Model, others: u16, period: u16) -> u16 {
    let sounds = model
        .elements()
        .iter()
        .filter(|element| element.kind == Kind::Effector);
    let block: usize = sounds.filter_map(|element| element.sound).map(Sound::block).sum();
    let blocks = (u64::from(period) * 1000).div_ceil(Sound::PERIOD);
    let sounds = usize::try_from(blocks).unwrap_or(1).saturating_mul(block);
    u16::try_from(sounds).unwrap_or(u16::MAX).saturating_add(others)
}

/// The element that a notice is about.
fn element_of(notice: &Notice) -> Option<u8> {
    match notice {
        Notice::Changed { element }
        | Notice::Raised { element, .. }
        | Notice::Done { element, .. }
        | Notice::Failed { element, .. }
        | Notice::Unknown { element, .. }
        | Notice::Active { element, .. }
        | Notice::Blob { element, .. } => Some(*element),
        Notice::Up | Notice::Lost | Notice::Ended | Notice::Refused(_) => None,
    }
}

/// Connects a mirror to its robot by a socket that is connected to it, until `shutdown` is done; then the session is ended, and the robot
/// has taken its safe values or does so by its watchdog.
///
/// # Errors
///
/// A socket that fails for good. One whose robot is not there yet does not.
pub async fn serve(
    robot: Simulacrum,
    socket: UdpSocket,
    shutdown: impl Future<Output = ()>,
) -> io::Result<()> {
    let mut shutdown = std::pin::pin!(shutdown);
    robot.0.way.lock().leads_to(socket.peer_addr().ok());
    tokio::select! {
        failed = stay_linked(&robot, &socket) => return failed,
        () = &mut shutdown => {}
    }
    let now = robot.now();
    robot.with(|middle| middle.end(now));
    let over = exchange(&robot, &socket, |state| state == State::Idle);
    if timeout(FAREWELL, over).await.is_err() {
        tracing::warn!(
            robot = robot.name(),
            "the robot did not say that its session is over"
        );
    }
    Ok(())
}

/// Asks for a session, and for another one whenever the robot has ended one.
async fn stay_linked(robot: &Simulacrum, socket: &UdpSocket) -> io::Result<()> {
    loop {
        let now = robot.now();
        robot.with(|middle| middle.start(now));
        exchange(robot, socket, |state| state == State::Idle).await?;
    }
}

/// Sends and receives until the middle is in a state in which it is over.
async fn exchange(robot: &Simulacrum, socket: &UdpSocket, over: impl Fn(State) -> bool) -> io::Result<()> {
    let mut buffer = vec![0; LONGEST];
    let mut datagram = Vec::with_capacity(2048);
    loop {
        while robot.next_datagram(&mut datagram) {
            // What the system does not take is lost, as in the network; a robot that is not reached is silent, and lost by that.
            match socket.try_send(&datagram) {
                Err(error) if is_passing(&error) => robot.0.way.lock().fails(&error),
                Err(error) => tracing::warn!(robot = robot.name(), %error, "a datagram was not sent"),
                Ok(_) => {}
            }
        }
        robot.dispatch();
        robot.tell_trouble();
        robot.look_at_period();
        if over(robot.with(|middle| middle.state())) {
            return Ok(());
        }
        let wake = robot.with(|middle| middle.wake()).map(|wake| robot.at(wake));
        tokio::select! {
            ready = socket.readable() => ready?,
            () = robot.0.hurry.notified() => {}
            () = sleep_or_wait(wake) => {}
        }
        for _ in 0..AT_ONCE {
            match socket.try_recv(&mut buffer) {
                Ok(length) => {
                    if let Some(datagram) = buffer.get_mut(..length) {
                        robot.receive(datagram);
                    }
                    robot.0.way.lock().leads_on();
                }
                Err(error) if is_passing(&error) => {
                    robot.0.way.lock().fails(&error);
                    break;
                }
                Err(error) => return Err(error),
            }
        }
    }
}

/// What a socket says of a moment, such as that the robot's program has not started.
fn is_passing(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::WouldBlock
            | io::ErrorKind::ConnectionRefused
            | io::ErrorKind::HostUnreachable
            | io::ErrorKind::NetworkUnreachable
            | io::ErrorKind::NetworkDown
            | io::ErrorKind::PermissionDenied
            | io::ErrorKind::Interrupted
    )
}

async fn sleep_or_wait(wake: Option<Instant>) {
    match wake {
        Some(wake) => sleep_until(wake).await,
        None => std::future::pending().await,
    }
}
