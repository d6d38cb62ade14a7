//! The stage of the arm's own dialogues: that of every device, with the keeper of its zones beside it.

use std::cell::RefCell;
use std::ops::{Deref, DerefMut};
use std::rc::Rc;

use mom_client::{Event, Path};
use mom_device::DeviceServer;
use mom_device_cases::Statements;

use super::zones;
use crate::machine::ArmMachine;
use crate::zone_keeper::ZoneKeeper;
use crate::zones::Zones;

/// What it is told where a dialogue of every device has a word in braces.
pub(super) const STATEMENTS: Statements = Statements {
    go: "move 0 0 270 0 0",
    back: "move 0 0 300 0 0",
    wrong: "mvoe 1 2",
    beyond: Some(("move 0 0 900 0 0", "workspace-boundary 5002")),
    relative: Some("by 0 0 -20 0 0"),
    velocity: Some("jog 100 0 0 0 0"),
};

/// The server with a clock and a gate that a dialogue moves.
pub(super) struct Stage {
    stage: mom_device_cases::Stage<ArmMachine>,
    keeper: Rc<RefCell<ZoneKeeper>>,
}

impl Deref for Stage {
    type Target = mom_device_cases::Stage<ArmMachine>;

    fn deref(&self) -> &Self::Target {
        &self.stage
    }
}

impl DerefMut for Stage {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.stage
    }
}

impl Stage {
    /// An arm that rests under fence 5.
    pub(super) fn new() -> Self {
        Self::with(lab(), Zones::default(), |server| server)
    }

    /// The same with another arm, in zones, and with what the server is set to.
    pub(super) fn with(
        arm: ArmMachine,
        zones: Zones,
        set: impl FnOnce(DeviceServer<ArmMachine>) -> DeviceServer<ArmMachine>,
    ) -> Self {
        let keeper = Rc::new(RefCell::new(ZoneKeeper::new(zones)));
        let beside = Rc::clone(&keeper);
        let mut stage = mom_device_cases::Stage::with(arm, set);
        // At 400 ms, from where the dialogues count.
        stage.pass(100);
        // As its peer does: before a message, and after what is not one.
        let stage = stage.beside(move |event: &Event, gate, server, now, out| {
            let mut keeper = beside.borrow_mut();
            keeper.observe(event, gate);
            let closed = keeper.closed();
            if *server.machine().closed() != closed {
                server.note(now, |arm| arm.close(closed), out);
            }
        });
        Self { stage, keeper }
    }

    fn close(&mut self) {
        let closed = self.keeper.borrow().closed();
        if *self.stage.server().machine().closed() != closed {
            self.stage.note(|arm| arm.close(closed));
        }
    }

    /// Does one line of a dialogue.
    pub(super) fn act(&mut self, line: &str) {
        let words: Vec<&str> = line.split(' ').collect();
        match words[..] {
            ["zone", ..] => {
                self.keeper.borrow_mut().hear(&zones::news(&words));
                self.close();
            }
            _ => self.stage.act(line),
        }
    }

    /// Whether a peer may be granted a zone, as far as the arm is concerned.
    pub(super) fn grant(&mut self, zone: &str, peer: &str) -> Result<(), String> {
        let zone = Path::parse(zone).unwrap();
        self.stage.pass(0);
        let state = self.stage.server().state();
        let is_busy = state.executing.is_some() || state.waiting > 0;
        let Self { stage, keeper } = self;
        let gate = stage.gate.clone();
        let arm = stage.server().machine();
        let answer = keeper.borrow_mut().grant(&zone, peer, &gate, arm, is_busy);
        self.close();
        answer
    }
}

/// The lab's arm.
pub(super) fn lab() -> ArmMachine {
    ArmMachine::with_blocks(0, crate::Block::lab())
}

/// Plays a dialogue: lines with `>` are what must have been said since the line before.
pub(super) fn check(dialogue: &str) {
    mom_device_cases::check(&mut Stage::new(), "a dialogue of the arm", dialogue);
}
