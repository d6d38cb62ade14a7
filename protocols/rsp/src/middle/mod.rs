//! The middle's end, which allocates: the device manager and the simulacrum of one robot (S2, S3).
//!
//! A program writes, reads and commands whenever it likes; [`poll`](Middle::poll) gives the datagrams to be sent, one data packet each
//! period, and what has happened comes as [`Notice`]s.

mod blobs;
mod clock;
mod device;
mod hear;
mod notice;
mod say;

use alloc::boxed::Box;
use alloc::collections::VecDeque;
use alloc::vec;
use alloc::vec::Vec;

pub use notice::{MiddleFault, Notice, Offset, Reading, Reason, Refusal, Settings, State};

use blobs::Outgoing;
use clock::Clock;
use device::{ElementState, Kept};

use crate::number;
use crate::seal::NONCE;
use crate::traffic::Traffic;
use crate::{Counters, Direction, Element, Kind, Layout, Motion, PERIODS, Payload, Refused};

/// Notices that can wait; what makes more of them is refused, or comes again.
const NOTICES: usize = 1024;

/// The most that the first packet of a session may take longer than those that follow, µs.
const FIRST_MOST: u64 = 2_000_000;

/// The wait after the first hello, and the longest, µs.
const HELLO: u64 = 200_000;
const HELLO_MOST: u64 = 1_000_000;

/// The control that is confirmed, or sent until it is (S6, S7, S10).
struct Control {
    number: u8,
    period: u16,
    is_confirmed: bool,
}

/// Fills bytes with what nobody can foresee.
type Random<'m> = Box<dyn FnMut(&mut [u8]) + Send + 'm>;

/// The middle's end of the protocol, for one robot.
pub struct Middle<'m> {
    layout: &'m Layout<'m>,
    settings: Settings,
    random: Random<'m>,
    devices: Vec<ElementState>,
    state: State,
    /// Of the session, and of the one that is over, whose end may be asked for again.
    traffic: Option<Traffic>,
    /// Of the hello that waits for its answer.
    nonce: [u8; NONCE],
    /// The wait after the next hello.
    wait: u64,
    /// When the first of these hellos left.
    called: Option<u64>,
    /// When the next packets are due.
    next: u64,
    /// When the newest authentic packet arrived.
    heard: u64,
    /// When the newest data packet arrived.
    newest: Option<u64>,
    /// The device maps of the newest data packets of either direction.
    maps: [Vec<u8>; 2],
    control: Control,
    /// Due in this period: the data packet, the control, so many bytes of fragments; at once: an end.
    due_data: bool,
    due_control: bool,
    budget: u16,
    due_end: bool,
    /// The robot has ended the session first: its ends are answered.
    is_answerer: bool,
    /// How often the robot shall have cleared its buffers (S16).
    cleared: u8,
    /// All buffers of the robot, those that are free, and since when nothing came of those that are not.
    buffers: (u8, u8, u64),
    outgoing: Outgoing,
    lost_blobs: u32,
    /// What the robot has said to this hello.
    refused: Option<Refusal>,
    ticket: u32,
    notices: VecDeque<Notice>,
    clock: Clock,
    counters: Counters,
    out: Vec<u8>,
}

impl<'m> Middle<'m> {
    /// A middle's end that asks for nothing yet. `random` fills bytes with what nobody can foresee.
    ///
    /// # Errors
    ///
    /// What is wrong with the settings.
    pub fn new(
        layout: &'m Layout<'m>,
        settings: Settings,
        random: impl FnMut(&mut [u8]) + Send + 'm,
    ) -> Result<Self, MiddleFault> {
        if !PERIODS.contains(&settings.period) {
            return Err(MiddleFault::Period);
        }
        if settings.key.is_some() && !cfg!(feature = "cipher") {
            return Err(MiddleFault::Cipher);
        }
        Ok(Middle {
            layout,
            random: Box::new(random),
            devices: layout.elements.iter().map(|_| ElementState::new()).collect(),
            state: State::Idle,
            traffic: None,
            nonce: [0; NONCE],
            wait: HELLO,
            called: None,
            next: 0,
            heard: 0,
            newest: None,
            maps: [Vec::new(), Vec::new()],
            control: Control {
                number: 0,
                period: settings.period,
                is_confirmed: true,
            },
            due_data: false,
            due_control: false,
            budget: 0,
            due_end: false,
            is_answerer: false,
            cleared: 0,
            buffers: (0, 0, 0),
            outgoing: Outgoing::default(),
            lost_blobs: 0,
            refused: None,
            ticket: 0,
            notices: VecDeque::new(),
            clock: Clock::default(),
            counters: Counters::NONE,
            out: vec![0; layout.largest().max(256)],
            settings,
        })
    }

    /// Asks for a session until there is one, and again whenever it is lost. Nothing if it does so already, or is about to end one.
    pub fn start(&mut self, now: u64) {
        if self.state == State::Idle {
            self.call(now);
        }
    }

    /// Ends the session, or the asking for one (S23).
    pub fn end(&mut self, now: u64) {
        match self.state {
            State::Up => {
                self.forget();
                self.is_answerer = false;
                (self.state, self.next, self.heard) = (State::Ending, now, now);
            }
            State::Calling => {
                self.state = State::Idle;
                self.tell(Notice::Ended);
            }
            State::Idle | State::Ending => {}
        }
    }

    /// Since when it asks for a session, µs; none while it does not, or has not begun to.
    #[must_use]
    pub fn calling_since(&self) -> Option<u64> {
        self.called.filter(|_| self.state == State::Calling)
    }

    /// Why the robot gives no session, as it said last since then.
    #[must_use]
    pub fn refusal(&self) -> Option<&Refusal> {
        self.refused.as_ref().filter(|_| self.state == State::Calling)
    }

    /// What happened, oldest first.
    pub fn next_notice(&mut self) -> Option<Notice> {
        let notice = self.notices.pop_front()?;
        if let Notice::Changed { element } = notice
            && let Some(device) = self.devices.get_mut(usize::from(element))
        {
            device.is_told = false;
        }
        Some(notice)
    }

    /// Where it is.
    #[must_use]
    pub fn state(&self) -> State {
        self.state
    }

    /// An effector shall have this value from the next packet on; an incremental one shall move by this step.
    ///
    /// # Errors
    ///
    /// [`Refused::NoSession`], [`Refused::Element`], [`Refused::Kind`], [`Refused::Size`]; [`Refused::Value`] for a number that is not
    /// finite, or a step that would make more than its type holds of what the robot has not confirmed; [`Refused::Inactive`].
    pub fn write(&mut self, element: u8, value: &[u8]) -> Result<(), Refused> {
        let paper = self.settings.paper;
        let of = self.usable(element, &[Kind::Effector])?;
        if !of.payload.takes(value) {
            return Err(Refused::Size);
        }
        if !of.payload.is_finite(value) {
            return Err(Refused::Value);
        }
        let device = self
            .devices
            .get_mut(usize::from(element))
            .ok_or(Refused::Element)?;
        if let (Motion::Incremental { .. }, Payload::Numbers(number, _)) = (of.motion, of.payload) {
            let held = if paper {
                &mut device.step
            } else {
                device.value.get_or_insert_default()
            };
            held.resize(value.len(), 0);
            let base = device
                .confirmed
                .as_ref()
                .map(|confirmed| &confirmed.value[..])
                .filter(|_| !paper);
            let mut sums = Vec::with_capacity(value.len());
            let load = |bytes: &[u8], at: usize| {
                number::load(number, bytes.get(at..at + number.size()).unwrap_or_default())
            };
            for at in (0..value.len()).step_by(number.size()) {
                let (total, step) = (load(held, at), load(value, at));
                if !number::fits(number, base.map_or(0, |base| load(base, at)), total, step) {
                    return Err(Refused::Value);
                }
                sums.push(number::add(number, total, step));
            }
            for (held, sum) in held.chunks_mut(number.size()).zip(sums) {
                number::store(sum, held);
            }
        } else {
            let held = device.value.get_or_insert_default();
            if !device.is_new && held == value && !(device.changes.is_empty() && device.confirmed.is_none()) {
                return Ok(());
            }
            held.clear();
            held.extend_from_slice(value);
        }
        device.is_new = true;
        Ok(())
    }

    /// What an effector shall have, as it was written in this session; of an incremental one the sum of all steps, which wraps. Steps in
    /// paper mode leave no sum.
    #[must_use]
    pub fn wanted(&self, element: u8) -> Option<&[u8]> {
        self.device(element)?.value.as_deref()
    }

    /// What the robot has of an effector, and when that was confirmed.
    #[must_use]
    pub fn confirmed(&self, element: u8) -> Option<Reading<'_>> {
        self.device(element)?.confirmed.as_ref().map(Kept::reading)
    }

    /// The newest value of a sensor or a monitor, also after the session is over: `at` says how old it is.
    #[must_use]
    pub fn read(&self, element: u8) -> Option<Reading<'_>> {
        self.device(element)?.reading.as_ref().map(Kept::reading)
    }

    /// Asks for a sensor's or monitor's value though it may not have changed; of a memory event, for what the robot holds (S22).
    ///
    /// # Errors
    ///
    /// [`Refused::NoSession`], [`Refused::Element`], [`Refused::Kind`], [`Refused::Inactive`].
    pub fn ask(&mut self, element: u8) -> Result<(), Refused> {
        self.usable(element, &[Kind::Sensor, Kind::Monitor, Kind::MemoryEvent])?;
        let device = self
            .devices
            .get_mut(usize::from(element))
            .ok_or(Refused::Element)?;
        device.asked = device.asked.or(Some(None));
        Ok(())
    }

    /// Has a command or memory command executed, after those of the same element that wait. The number is in the notice of its
    /// result: [`Notice::Done`], [`Notice::Failed`] or [`Notice::Unknown`].
    ///
    /// # Errors
    ///
    /// [`Refused::NoSession`], [`Refused::Element`], [`Refused::Kind`], [`Refused::Size`], [`Refused::Inactive`]; [`Refused::Full`]
    /// where too many commands or notices wait.
    pub fn command(&mut self, element: u8, data: &[u8]) -> Result<u32, Refused> {
        let of = self.usable(element, &[Kind::Command, Kind::MemoryCommand])?;
        if !of.payload.takes(data) {
            return Err(Refused::Size);
        }
        let device = self
            .devices
            .get_mut(usize::from(element))
            .ok_or(Refused::Element)?;
        let most = self.settings.queue + usize::from(device.call.is_none());
        if device.queue.len() >= most || self.notices.len() >= NOTICES {
            return Err(Refused::Full);
        }
        self.ticket = self.ticket.wrapping_add(1);
        device.queue.push_back((self.ticket, data.to_vec()));
        Ok(self.ticket)
    }

    /// Wants an element active or not; a module stands for its members (S6, S7). An effector that is deactivated takes its safe value,
    /// and forgets what was written. Calls of a command that is deactivated are withdrawn, with a [`Notice::Unknown`] each: once the robot
    /// has confirmed it, one that was sent begins no more, and one that had begun has ended.
    ///
    /// # Errors
    ///
    /// [`Refused::NoSession`], [`Refused::Element`].
    pub fn set_activated(&mut self, element: u8, activated: bool) -> Result<(), Refused> {
        if self.state != State::Up {
            return Err(Refused::NoSession);
        }
        let device = self
            .devices
            .get_mut(usize::from(element))
            .ok_or(Refused::Element)?;
        device.wanted = activated;
        Ok(())
    }

    /// Whether an element is wanted active, and its module too.
    #[must_use]
    pub fn activated(&self, element: u8) -> bool {
        self.with_module(element, |device| device.wanted)
    }

    /// Whether an element is active, as the robot has said.
    #[must_use]
    pub fn active(&self, element: u8) -> bool {
        self.device(element).is_some_and(|device| device.active)
    }

    /// Changes the time between two packets of both ends (S10).
    ///
    /// # Errors
    ///
    /// [`Refused::Period`], also when there is no session.
    pub fn set_period(&mut self, ms: u16) -> Result<(), Refused> {
        if !PERIODS.contains(&ms) {
            return Err(Refused::Period);
        }
        self.settings.period = ms;
        Ok(())
    }

    /// Time between two packets of this end, ms.
    #[must_use]
    pub fn period(&self) -> u16 {
        self.settings.period
    }

    /// Whether the robot has confirmed activation and period as they are wanted.
    #[must_use]
    pub fn is_confirmed(&self) -> bool {
        self.control.is_confirmed && !self.is_control_old()
    }

    /// Has the robot forget the memory events that it holds (S16).
    ///
    /// # Errors
    ///
    /// [`Refused::NoSession`].
    pub fn clear_buffers(&mut self) -> Result<(), Refused> {
        if self.state != State::Up {
            return Err(Refused::NoSession);
        }
        self.cleared = self.cleared.wrapping_add(1);
        Ok(())
    }

    /// Sends bytes to an effector in parts, behind the data packets (S13). Parts that are lost are not sent again. Its number.
    ///
    /// # Errors
    ///
    /// [`Refused::NoSession`], [`Refused::Element`], [`Refused::Kind`], [`Refused::Inactive`]; [`Refused::Size`] for no bytes or too
    /// many; [`Refused::Full`] when 16 blobs wait.
    pub fn send_blob(&mut self, element: u8, bytes: &[u8]) -> Result<u16, Refused> {
        self.usable(element, &[Kind::Effector])?;
        if bytes.is_empty() || bytes.len() > self.settings.blob || u32::try_from(bytes.len()).is_err() {
            return Err(Refused::Size);
        }
        if self.outgoing.is_full() {
            return Err(Refused::Full);
        }
        let device = self
            .devices
            .get_mut(usize::from(element))
            .ok_or(Refused::Element)?;
        let blob = device.blob;
        device.blob = blob.wrapping_add(1);
        self.outgoing.push(element, blob, bytes.to_vec());
        Ok(blob)
    }

    /// From the next packet on, so many bytes of fragments are sent each period at most.
    pub fn set_budget(&mut self, bytes: u16) {
        self.settings.budget = bytes;
    }

    /// The robot's clock beside this one.
    #[must_use]
    pub fn clock(&self, now: u64) -> Option<Offset> {
        self.clock.offset(now)
    }

    /// When the newest data packet of the robot arrived, in any session: what a sensor said last was so then, too, as one whose value
    /// differs is in each packet.
    #[must_use]
    pub fn heard_at(&self) -> Option<u64> {
        self.newest
    }

    /// The device map of the newest data packet of a direction (S17); empty before the first.
    #[must_use]
    pub fn map(&self, direction: Direction) -> &[u8] {
        let [down, up] = &self.maps;
        match direction {
            Direction::Down => down,
            Direction::Up => up,
        }
    }

    /// From a data packet to the robot's packet that acknowledges it, µs, smoothed; the robot's wait for its period is in it.
    #[must_use]
    pub fn round_trip(&self) -> Option<u64> {
        self.clock.round_trip()
    }

    /// The share of the robot's last 128 packets that has not arrived, 0 to 1.
    #[must_use]
    pub fn loss(&self) -> f32 {
        self.traffic.as_ref().map_or(0.0, |traffic| traffic.heard.loss())
    }

    /// Blobs of the robot that never became complete, or were too large.
    #[must_use]
    pub fn lost_blobs(&self) -> u32 {
        self.lost_blobs
    }

    /// Buffers for memory events that are free at the robot (S16).
    #[must_use]
    pub fn free_buffers(&self) -> u8 {
        self.buffers.1
    }

    /// What arrived, and what became of it.
    #[must_use]
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    fn device(&self, element: u8) -> Option<&ElementState> {
        self.devices.get(usize::from(element))
    }

    /// Whether something holds of an element and of its module.
    fn with_module(&self, element: u8, holds: impl Fn(&ElementState) -> bool) -> bool {
        let module = self.layout.element(element).and_then(|of| of.module);
        self.device(element).is_some_and(&holds)
            && module.is_none_or(|module| self.device(module).is_some_and(&holds))
    }

    /// Whether packets may carry something of an element: it is wanted active, and the robot was told so.
    fn is_open(&self, element: u8) -> bool {
        self.with_module(element, |device| device.wanted && device.level)
    }

    /// An element of one of these kinds that can be used now.
    fn usable(&self, element: u8, kinds: &[Kind]) -> Result<&'m Element<'m>, Refused> {
        let layout = self.layout;
        let of = layout
            .elements
            .get(usize::from(element))
            .ok_or(Refused::Element)?;
        if !kinds.contains(&of.kind) {
            return Err(Refused::Kind);
        }
        if self.state != State::Up {
            return Err(Refused::NoSession);
        }
        match self.is_open(element) {
            true => Ok(of),
            false => Err(Refused::Inactive),
        }
    }

    /// Tells what the program could also ask for; a program that does not listen misses it.
    fn tell(&mut self, notice: Notice) {
        if self.notices.len() < NOTICES {
            self.notices.push_back(notice);
        }
    }

    /// The session is over: nothing of it is sent again by itself.
    fn forget(&mut self) {
        for place in 0..self.devices.len() {
            self.withdraw(place as u8);
        }
        for device in &mut self.devices {
            device.rest();
            *device = ElementState {
                reading: device.reading.take(),
                is_told: device.is_told,
                ..ElementState::new()
            };
        }
        self.outgoing.clear();
        (self.due_data, self.due_control, self.budget) = (false, false, 0);
    }

    /// No call of an element that is not acknowledged is sent again.
    fn withdraw(&mut self, element: u8) {
        let Some(device) = self.devices.get_mut(usize::from(element)) else {
            return;
        };
        let call = device.call.take().map(|call| call.ticket);
        for ticket in call
            .into_iter()
            .chain(device.queue.drain(..).map(|(ticket, _)| ticket))
        {
            // As many as `command` has let in.
            self.notices.push_back(Notice::Unknown { element, ticket });
        }
    }

    /// Asks for a session with a new nonce.
    fn call(&mut self, now: u64) {
        self.called = None;
        (self.random)(&mut self.nonce);
        self.state = State::Calling;
        (self.wait, self.next, self.due_end, self.refused) = (HELLO, now, false, None);
        // One nonce stands for one hello, whatever is wanted meanwhile.
        self.control.period = self.settings.period;
    }

    fn period_us(&self) -> u64 {
        u64::from(self.settings.period) * 1000
    }

    /// What is sent once is taken for lost after this time, µs (S20).
    fn patience(&self) -> u64 {
        let round = self.clock.round_trip().unwrap_or(0);
        (4 * self.period_us()).max(2 * round)
    }
}

impl Kept {
    fn reading(&self) -> Reading<'_> {
        Reading {
            value: &self.value,
            at: self.at,
            stamp: self.stamp,
        }
    }
}
