//! Which zones are closed to the arm (M40): what its peer hears of them and of its own owner, and what it says when one is to be granted.

use mom_client::{Event, FenceGate, HUB, Map, Path};
use mom_device::{COMMAND, Machine};

use crate::machine::ArmMachine;
use crate::zones::{Closed, Zones};

/// News of the zones' tokens.
#[derive(Debug, Clone)]
pub enum ZoneNews {
    /// There is one.
    Added(Path),
    /// There is one no more.
    Removed(Path),
    /// A peer has got one, with this fence.
    Grabbed(Path, String, u64),
    /// The owner of this fence has lost one.
    Released(Path, u64),
    /// What `info` tells of one.
    Told(Path, Map),
    /// What was heard of one may not be so any more.
    Unknown(Path),
    /// The same of all.
    Forgotten,
}

/// Knows who moves the arm, and which zones are closed to it therefore.
#[derive(Debug)]
pub struct ZoneKeeper {
    zones: Zones,
    /// Who owns the channel's token, as far as was heard; the zones of others are closed to it.
    commander: Option<String>,
    /// The token that guards its channel, and the newest fence of it that was heard of.
    guard: Option<Path>,
    fence: u64,
}

impl ZoneKeeper {
    /// For an arm that nobody commands yet.
    #[must_use]
    pub fn new(zones: Zones) -> Self {
        Self {
            zones,
            commander: None,
            guard: None,
            fence: 0,
        }
    }

    /// Takes news of the zones.
    pub fn hear(&mut self, news: &ZoneNews) {
        match news {
            ZoneNews::Added(token) => self.zones.add(token.clone()),
            ZoneNews::Removed(token) => self.zones.remove(token),
            ZoneNews::Told(token, info) => self.zones.told(token, info),
            ZoneNews::Unknown(token) => self.zones.forget_one(token),
            ZoneNews::Forgotten => self.zones.forget(),
            ZoneNews::Grabbed(token, owner, fence) => self.zones.grabbed(token, owner, *fence),
            ZoneNews::Released(token, fence) => self.zones.released(token, *fence),
        }
    }

    /// Takes an event of the arm's channel: who may move it may be another, or nobody any more.
    pub fn observe(&mut self, event: &Event, gate: &FenceGate) {
        let guard = gate.guard().map(|guard| guard.token);
        if self.guard != guard {
            // Fences of two tokens say nothing of each other.
            (self.guard, self.fence) = (guard, 0);
        }
        match event {
            Event::Grabbed { fence, owner, .. } if *fence >= self.fence => {
                (self.fence, self.commander) = (*fence, Some(owner.clone()));
            }
            Event::Released { fence, .. } if *fence >= self.fence => {
                (self.fence, self.commander) = (*fence, None);
            }
            // The token's events may still be under way; the command's fence has the same information.
            Event::Message(command) if command.name() == COMMAND && gate.check(command).is_ok() => {
                let fence = command.fence.unwrap_or(0);
                let sender = command.sender.as_deref().filter(|sender| *sender != HUB);
                if fence >= self.fence
                    && command.fence.is_some()
                    && let Some(sender) = sender
                {
                    (self.fence, self.commander) = (fence, Some(sender.to_owned()));
                }
            }
            Event::LinkDown => self.commander = None,
            Event::Rejoined | Event::Resumed => self.learn(gate),
            _ => {}
        }
    }

    /// Who owns the channel's token, as far as that is known; for the beginning.
    pub fn learn(&mut self, gate: &FenceGate) {
        self.commander = gate.guard().and_then(|guard| guard.owner);
    }

    /// What is closed to the arm now.
    #[must_use]
    pub fn closed(&self) -> Closed {
        self.zones.closed_to(self.commander.as_deref())
    }

    /// Whether a peer may be granted a zone's token, as far as the arm is concerned. Who owns the arm's token may, and drive out; for
    /// everybody else the arm keeps out of the zone from now on. `is_busy`: the arm carries something out, or something waits.
    ///
    /// # Errors
    ///
    /// Why not.
    pub fn grant(
        &mut self,
        token: &Path,
        peer: &str,
        gate: &FenceGate,
        arm: &ArmMachine,
        is_busy: bool,
    ) -> Result<(), String> {
        // The gate hears it first when the arm's token changes hands.
        let owner = gate.guard().and_then(|guard| guard.owner);
        if owner.as_deref() == Some(peer) {
            return Ok(());
        }
        if !arm.is_reached() {
            return Err(
                "the link to the arm's controller is down, so where the arm is is not known".to_owned(),
            );
        }
        // What has begun may lead there.
        let commander = self.commander.as_deref();
        if is_busy && commander.is_some_and(|commander| self.zones.is_owner(token, commander)) {
            return Err(format!("the arm is being driven by the owner of {token}"));
        }
        self.zones.check_grant(token, &arm.pose())?;
        self.zones.promise(token);
        Ok(())
    }
}
