//! A model with one element of each kind that a packet is repeated for, and of each motion.

use mom_rsp::robot::{self, Robot};
use mom_rsp::{Element, Kind, Layout, Motion, Number, Payload};

pub(super) const COMMAND: u8 = 0;
pub(super) const MEMORY_COMMAND: u8 = 1;
pub(super) const EVENT: u8 = 2;
pub(super) const MEMORY_EVENT: u8 = 3;
pub(super) const HOLD: u8 = 4;
pub(super) const LINE: u8 = 5;
pub(super) const LIMITED: u8 = 6;
pub(super) const STEPS: u8 = 7;

/// The most change of [`LIMITED`], in units a second.
pub(super) const RATE: f32 = 6000.0;

const fn absolute(interpolate: bool, rate: Option<f32>) -> Motion {
    Motion::Absolute { interpolate, rate }
}

const fn element(name: &'static str, kind: Kind, motion: Motion) -> Element<'static> {
    Element {
        name,
        kind,
        payload: Payload::Numbers(Number::I16, 1),
        motion,
        safe: match kind {
            Kind::Effector => &[0, 0],
            _ => &[],
        },
        period: 0,
        module: None,
        of: None,
        digest: 0,
    }
}

pub(super) static PROBE: Layout<'static> = Layout::new(
    8,
    [8; 32],
    &[
        element("command", Kind::Command, absolute(false, None)),
        element("memory-command", Kind::MemoryCommand, absolute(false, None)),
        element("event", Kind::Event, absolute(false, None)),
        element("memory-event", Kind::MemoryEvent, absolute(false, None)),
        element("hold", Kind::Effector, absolute(false, None)),
        element("line", Kind::Effector, absolute(true, None)),
        element("limited", Kind::Effector, absolute(false, Some(RATE))),
        element("steps", Kind::Effector, Motion::Incremental { rate: None }),
    ],
);

/// Its end, with eight buffers for memory events.
pub(super) type Probe = Robot<'static, 8, { robot::values(&PROBE) }, 8, { robot::slot(&PROBE) }>;
