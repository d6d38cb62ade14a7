//! How a mirrored robot is stopped: all by which it acts is switched off until it has confirmed that, and then switched on again.

use mom_rsp::Kind;
use mom_rsp_model::ModelElement;

use crate::Simulacrum;

/// What is switched off, and how far the robot has confirmed it.
///
/// What is switched off takes its safe value, and ends what it has begun; what was sent to it and has not arrived begins no more, however
/// late it comes. The middle tells it each period until the robot says so.
#[derive(Debug, Default, Clone)]
pub(super) struct Stop {
    phase: Phase,
    /// Elements that are switched on again.
    held: Vec<u8>,
    /// Whether the robot may do something that it was told since it confirmed the last stop.
    acts: bool,
}

#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
enum Phase {
    #[default]
    Over,
    /// The robot has not confirmed that all is switched off.
    Unconfirmed,
    /// It has, and has not confirmed that all is switched on again.
    Revives,
}

impl Stop {
    /// The robot may be told something from now on.
    pub(super) fn acts(&mut self) {
        self.acts = true;
    }

    /// Stops all that moves or sounds, and all commands.
    pub(super) fn all(&mut self, robot: &Simulacrum) {
        for (place, element) in (0..).zip(robot.model().elements()) {
            if is_acting(element) {
                self.hold(robot, place);
            }
        }
    }

    /// Switches one element off; one that is off already is not switched on afterwards.
    pub(super) fn hold(&mut self, robot: &Simulacrum, place: u8) {
        if !robot.is_up() {
            // Without a session the robot has its safe values, or takes them when the next one begins.
            return;
        }
        self.phase = Phase::Unconfirmed;
        if robot.with(|middle| middle.activated(place)) {
            self.held.push(place);
            switch(robot, place, false);
        }
    }

    /// Goes on as far as the robot has confirmed; whether all is over with that.
    pub(super) fn settle(&mut self, robot: &Simulacrum) -> bool {
        if self.phase == Phase::Over || !robot.is_up() || !robot.with(|middle| middle.is_confirmed()) {
            return false;
        }
        match self.phase {
            Phase::Unconfirmed => {
                for place in self.held.drain(..) {
                    switch(robot, place, true);
                }
                (self.phase, self.acts) = (Phase::Revives, false);
                robot.hurry();
                false
            }
            Phase::Revives | Phase::Over => {
                self.phase = Phase::Over;
                true
            }
        }
    }

    /// A session has begun, in which all is active at first. It may have begun before the end of the last one was heard of: what has been
    /// switched off in this one stays so until the robot has confirmed it.
    pub(super) fn begin_session(&mut self, robot: &Simulacrum) {
        self.held
            .retain(|place| !robot.with(|middle| middle.activated(*place)));
        self.acts = true;
        self.phase = match self.held.is_empty() {
            true => Phase::Over,
            false => Phase::Unconfirmed,
        };
    }

    /// Whether something is switched off for now, so that nothing can be begun.
    pub(super) fn is_under_way(&self) -> bool {
        self.phase != Phase::Over
    }

    /// Whether the robot may still do what it was told, as it has not confirmed the stop.
    pub(super) fn is_awaited(&self) -> bool {
        self.phase == Phase::Unconfirmed && self.acts
    }
}

/// Whether an element moves, sounds, or has something done; a picture on a display does not.
fn is_acting(element: &ModelElement) -> bool {
    match element.kind {
        Kind::Effector => !element.quantities.is_empty() || element.sound.is_some(),
        Kind::Command | Kind::MemoryCommand => true,
        _ => false,
    }
}

fn switch(robot: &Simulacrum, place: u8, on: bool) {
    if let Err(error) = robot.with(|middle| middle.set_activated(place, on)) {
        tracing::error!(robot = robot.name(), place, on, %error, "an element was not switched");
    }
}
