//! The robot's end: no std, no alloc, buffers of fixed size.
//!
//! A robot's program gives what arrives to [`receive`](Robot::receive), sends what [`poll`](Robot::poll) writes, and is told through
//! its [`Body`] what to do. It reports by [`set`](Robot::set) and [`raise`](Robot::raise).

mod assembly;
mod body;
mod cell;
mod hear;
mod motion;
mod playout;
mod say;

pub use assembly::Assembly;
pub use body::{Body, Outgoing, RobotFault, Settings};
pub use cell::{slot, values};
pub use playout::{Played, Playout, PlayoutCounts};
#[cfg(feature = "middle")]
pub(crate) use say::next_id;

use cell::{ACTIVE, ASKED, Buffer, Cell, EVENTS, HAS, NEW, SENT};

use crate::seal::NONCE;
use crate::traffic::Traffic;
use crate::{Counters, Element, Kind, Layout, Refused};

/// Where a robot's end is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// There is no session, or it is over.
    Down,
    Up,
    /// The robot ends the session, and waits for the middle's word.
    Ending,
}

/// A session that was given, until the first packet of it.
#[derive(Clone, Copy)]
struct Pending {
    hello: [u8; NONCE],
    welcome: [u8; NONCE],
    session: [u8; 6],
    period: u16,
    paper: bool,
}

/// What is said at the next [`poll`](Robot::poll), besides the packets of each period.
#[derive(Clone, Copy)]
struct Answers {
    welcome: bool,
    refusal: Option<(u8, [u8; NONCE])>,
    control: bool,
    end: bool,
}

/// The robot's end of the protocol, for a model of `E` elements.
///
/// `V` is [`values`] of the model, `S` its [`slot`], and `B` the number of buffers for memory events.
pub struct Robot<'m, const E: usize, const V: usize, const B: usize, const S: usize> {
    layout: &'m Layout<'m>,
    settings: Settings,
    cells: [Cell; E],
    values: [u8; V],
    slots: [Buffer<S>; B],
    /// The highest order of a buffer.
    order: u32,
    phase: Phase,
    /// Of the session, and of the one that is over, whose end may be asked for again.
    traffic: Option<Traffic>,
    pending: Option<Pending>,
    /// The session was ended here first.
    is_ender: bool,
    answers: Answers,
    paper: bool,
    /// ms.
    period: u16,
    /// When the data packet is due.
    next: u64,
    /// When the motion filter has its next output, [`NEVER`] if it has none.
    due: u64,
    /// When it had its last one.
    moved: u64,
    /// When the newest data packet arrived.
    fed: u64,
    /// Data packets below this sequence are late.
    floor: u64,
    /// Calls and parts of blobs below this sequence were sent before the newest control: they count no more.
    barrier: u64,
    /// The newest control: its sequence, and its number.
    control: Option<(u64, u8)>,
    /// The middle's counter of cleared buffers.
    cleared: u8,
    /// Bytes of fragments that may be sent in this period.
    budget: u16,
    /// The second in which hellos were answered, and how many.
    flood: (u64, u8),
    counters: Counters,
}

impl<'m, const E: usize, const V: usize, const B: usize, const S: usize> Robot<'m, E, V, B, S> {
    /// A robot of this model that has no session.
    ///
    /// # Errors
    ///
    /// What is wrong with the buffers or the settings.
    pub fn new(layout: &'m Layout<'m>, settings: Settings) -> Result<Self, RobotFault> {
        if layout.elements.len() != E {
            return Err(RobotFault::Elements);
        }
        if values(layout) > V {
            return Err(RobotFault::Values);
        }
        if slot(layout) > S || B > 255 {
            return Err(RobotFault::Buffers);
        }
        if settings.key.is_some() && !cfg!(feature = "cipher") {
            return Err(RobotFault::Cipher);
        }
        let mut robot = Robot {
            layout,
            settings,
            cells: [Cell::NEW; E],
            values: [0; V],
            slots: [Buffer::FREE; B],
            order: 0,
            phase: Phase::Down,
            traffic: None,
            pending: None,
            is_ender: false,
            answers: Answers {
                welcome: false,
                refusal: None,
                control: false,
                end: false,
            },
            paper: false,
            period: *crate::PERIODS.end(),
            next: 0,
            due: NEVER,
            moved: 0,
            fed: 0,
            floor: 0,
            barrier: 0,
            control: None,
            cleared: 0,
            budget: 0,
            flood: (0, 0),
            counters: Counters::NONE,
        };
        let mut start = 0;
        for (cell, element) in robot.cells.iter_mut().zip(layout.elements) {
            // The sum of all is a packet's size or so, far below this type's end: `check` has seen to it.
            cell.start = start as u16;
            start += cell::bytes(element.kind, element.payload);
        }
        if start > usize::from(u16::MAX) {
            return Err(RobotFault::Values);
        }
        robot.rest_all();
        Ok(robot)
    }

    /// A new value of a sensor or a monitor. It is sent if it differs from the last one (S3).
    ///
    /// # Errors
    ///
    /// [`Refused::Element`], [`Refused::Kind`], [`Refused::Size`].
    pub fn set(&mut self, element: u8, value: &[u8]) -> Result<(), Refused> {
        let (of, cell, bytes) = self.parts(element).ok_or(Refused::Element)?;
        if !matches!(of.kind, Kind::Sensor | Kind::Monitor) {
            return Err(Refused::Kind);
        }
        if !of.payload.takes(value) {
            return Err(Refused::Size);
        }
        if !cell.is(HAS) || cell::stored(of.payload, bytes) != value {
            cell::store(of.payload, bytes, value);
            cell.set(HAS | NEW);
        }
        Ok(())
    }

    /// An event or a memory event has happened (S21, S22). An event needs a session; a memory event takes one of the buffers, until the
    /// middle has it.
    ///
    /// # Errors
    ///
    /// [`Refused::Element`], [`Refused::Kind`], [`Refused::Size`], [`Refused::Inactive`]; [`Refused::Full`] when 4 events of the element
    /// wait, or no buffer is free; [`Refused::NoSession`] for an event.
    pub fn raise(&mut self, element: u8, data: &[u8]) -> Result<(), Refused> {
        let is_up = self.is_up();
        let is_active = self.is_active(element);
        let (of, cell, bytes) = self.parts(element).ok_or(Refused::Element)?;
        let (kind, payload) = (of.kind, of.payload);
        match kind {
            Kind::Event | Kind::MemoryEvent if !payload.takes(data) => Err(Refused::Size),
            Kind::Event | Kind::MemoryEvent if !is_active => Err(Refused::Inactive),
            Kind::Event if !is_up => Err(Refused::NoSession),
            Kind::Event if usize::from(cell.count) >= EVENTS => Err(Refused::Full),
            Kind::Event => {
                let place = (usize::from(cell.head) + usize::from(cell.count)) % EVENTS;
                let size = payload.size();
                let to = bytes
                    .get_mut(place * size..(place + 1) * size)
                    .ok_or(Refused::Size)?;
                cell::store(payload, to, data);
                cell.count += 1;
                Ok(())
            }
            Kind::MemoryEvent => {
                let order = self.order.wrapping_add(1).max(1);
                let slot = self
                    .slots
                    .iter_mut()
                    .find(|slot| slot.order == 0)
                    .ok_or(Refused::Full)?;
                let to = slot.data.get_mut(..data.len()).ok_or(Refused::Size)?;
                to.copy_from_slice(data);
                (slot.element, slot.id, slot.waits) = (element, 0, true);
                (slot.order, slot.len) = (order, data.len() as u16);
                self.order = order;
                Ok(())
            }
            _ => Err(Refused::Kind),
        }
    }

    /// Ends the session: safe values now, and the middle is told until it has heard it (S23).
    pub fn end(&mut self, now: u64, body: &mut impl Body) {
        if self.phase == Phase::Up {
            self.over(body);
            (self.phase, self.is_ender) = (Phase::Ending, true);
            (self.fed, self.next) = (now, now);
        }
    }

    /// Whether there is a session.
    #[must_use]
    pub fn is_up(&self) -> bool {
        self.phase == Phase::Up
    }

    /// Whether an element is active, and its module too.
    #[must_use]
    pub fn is_active(&self, element: u8) -> bool {
        let active = |place: usize| self.cells.get(place).is_some_and(|cell| cell.is(ACTIVE));
        let module = self.layout.element(element).and_then(|of| of.module);
        active(usize::from(element)) && module.is_none_or(|module| active(usize::from(module)))
    }

    /// When the watchdog has all effectors take their safe values, if no data packet comes before; `None` without a session or a watchdog.
    /// Hardware that stops by itself is given this time, for when the robot's own program stands still.
    #[must_use]
    pub fn deadline(&self) -> Option<u64> {
        (self.is_up() && self.is_watched()).then(|| self.fed + self.watchdog_us())
    }

    /// Time between two data packets, ms; of the last session if there is none.
    #[must_use]
    pub fn period(&self) -> u16 {
        self.period
    }

    /// Buffers for memory events that are free (S16).
    #[must_use]
    pub fn free_buffers(&self) -> u8 {
        self.slots.iter().filter(|slot| slot.order == 0).count() as u8
    }

    /// What arrived, and what became of it.
    #[must_use]
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    fn period_us(&self) -> u64 {
        u64::from(self.period) * 1000
    }

    /// An element with its state and its bytes.
    fn parts(&mut self, place: u8) -> Option<(&'m Element<'m>, &mut Cell, &mut [u8])> {
        let element = self.layout.elements.get(usize::from(place))?;
        let cell = self.cells.get_mut(usize::from(place))?;
        let start = usize::from(cell.start);
        let bytes = self
            .values
            .get_mut(start..start + cell::bytes(element.kind, element.payload))?;
        Some((element, cell, bytes))
    }

    /// All effectors as after [`make_safe`](Self::make_safe), without telling anybody.
    fn rest_all(&mut self) {
        for place in 0..E {
            if let Some((element, cell, bytes)) = self.parts(place as u8)
                && element.kind == Kind::Effector
            {
                cell.clear(NEW);
                cell.credit = 0.0;
                motion::rest(element, bytes);
            }
        }
    }

    /// The session is over: safe values, and what was said of events is forgotten.
    fn over(&mut self, body: &mut impl Body) {
        self.phase = Phase::Down;
        self.due = NEVER;
        for place in 0..E {
            let place = place as u8;
            let Some((element, cell, _)) = self.parts(place) else {
                continue;
            };
            let lost = if element.kind == Kind::Event {
                core::mem::take(&mut cell.count)
            } else {
                0
            };
            let is_effector = element.kind == Kind::Effector;
            *cell = Cell {
                start: cell.start,
                flags: ACTIVE | cell.flags & HAS | if cell.is(HAS) { NEW } else { 0 },
                ..Cell::NEW
            };
            if is_effector {
                self.make_safe(place, body);
            }
            for _ in 0..lost {
                body.unknown(place);
            }
        }
        for slot in &mut self.slots {
            // What was never sent is still nobody else's, and waits for the next session.
            if slot.order != 0 && slot.id != 0 {
                let element = slot.element;
                *slot = Buffer::FREE;
                body.unknown(element);
            }
        }
        body.session(false);
    }
}

/// A time that does not come.
const NEVER: u64 = u64::MAX;

/// The flags of a sensor that put it into the next packet.
const DUE: u8 = SENT | ASKED;
