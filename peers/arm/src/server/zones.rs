//! Zones (M40): what the server hears of them, and what it says when one is to be granted.

use mom_client::{FenceGate, Map, Parcel, Path};

use super::RobotServer;
use crate::motion::ArmTime;
use crate::zones::Zones;

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

impl RobotServer {
    /// This server, for an arm that keeps out of the zones that its commander does not own.
    #[must_use]
    pub fn in_zones(mut self, zones: Zones) -> Self {
        self.zones = zones;
        self.arm.close(self.zones.closed_to(None), 0, &mut Vec::new());
        self
    }

    /// Takes news of the zones.
    pub fn handle_zones(&mut self, news: &ZoneNews, now: ArmTime, out: &mut Vec<Parcel>) {
        match news {
            ZoneNews::Added(token) => self.zones.add(token.clone()),
            ZoneNews::Removed(token) => self.zones.remove(token),
            ZoneNews::Told(token, info) => self.zones.told(token, info),
            ZoneNews::Unknown(token) => self.zones.forget_one(token),
            ZoneNews::Forgotten => self.zones.forget(),
            ZoneNews::Grabbed(token, owner, fence) => self.zones.grabbed(token, owner, *fence),
            ZoneNews::Released(token, fence) => self.zones.released(token, *fence),
        }
        self.close_zones(now, out);
    }

    /// Whether a peer may be granted a zone's token, as far as the arm is concerned. Who owns the arm's token may, and drive out; for everybody
    /// else the arm keeps out of the zone from now on.
    ///
    /// # Errors
    ///
    /// Why not.
    pub fn grant(
        &mut self,
        token: &Path,
        peer: &str,
        gate: &FenceGate,
        now: ArmTime,
        out: &mut Vec<Parcel>,
    ) -> Result<(), String> {
        self.advance(now, out);
        // The gate hears it first when the arm's token changes hands.
        let owner = gate.guard().and_then(|guard| guard.owner);
        if owner.as_deref() == Some(peer) {
            return Ok(());
        }
        if !self.arm.is_linked() {
            return Err(
                "the link to the arm's controller is down, so where the arm is is not known".to_owned(),
            );
        }
        // What has begun may lead there.
        let commander = self.commander.as_deref();
        if self.arm.is_busy() && commander.is_some_and(|commander| self.zones.is_owner(token, commander)) {
            return Err(format!("the arm is being driven by the owner of {token}"));
        }
        self.zones.check_grant(token, &self.arm.state().pose)?;
        self.zones.promise(token);
        self.close_zones(now, out);
        Ok(())
    }

    /// Who may move the arm is another, or nobody any more.
    pub(super) fn set_commander(&mut self, commander: Option<&str>, now: ArmTime, out: &mut Vec<Parcel>) {
        if self.commander.as_deref() != commander {
            self.commander = commander.map(str::to_owned);
            self.close_zones(now, out);
        }
    }

    /// Who owns the channel's token, as far as that is known; for the beginning.
    pub fn learn_commander(&mut self, gate: &FenceGate, now: ArmTime, out: &mut Vec<Parcel>) {
        let owner = gate.guard().and_then(|guard| guard.owner);
        self.set_commander(owner.as_deref(), now, out);
    }

    fn close_zones(&mut self, now: ArmTime, out: &mut Vec<Parcel>) {
        let closed = self.zones.closed_to(self.commander.as_deref());
        self.act(out, |arm, events| arm.close(closed, now, events));
    }
}
