//! Zones: boxes in space with a token each, which the arm enters only if its commander owns them (M40).
//!
//! Zones may overlap. No two that do have different owners, which the hub sees to; so every part of the arm is either in a zone of its
//! commander, or in none.
//!
//! Several machines share one frame, in which the zones' boxes stand; [`Mount`] says where this arm's table is in it. The arm is in
//! a zone with its hand, what that carries, and its forearm.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use mom_client::{Map, Path, Value};
use mom_device::{DeviceError, ErrorName};

use crate::pose::{Pose, Xyz};

mod shape;
#[cfg(test)]
mod tests;

use shape::parts;
pub use shape::{FOREARM_RADIUS, HAND_RADIUS, ZoneBox};

/// mm and degrees between the poses at which a leg is checked.
const STEP: f64 = 10.0;
const TURN_STEP: f64 = 2.0;
/// Where the arm's table stands in the frame of the zones.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mount {
    /// mm of the table's middle.
    pub x: f64,
    /// mm of the table's middle.
    pub y: f64,
    /// Degrees by which the table is turned, counter-clockwise seen from above.
    pub yaw: f64,
}

/// The zones that the arm knows of, and who owns them.
#[derive(Debug, Clone, Default)]
pub struct Zones {
    mount: Mount,
    zones: BTreeMap<Path, Zone>,
}

#[derive(Debug, Clone, Default)]
struct Zone {
    /// None while it is not known: then it may be anywhere.
    bounds: Option<ZoneBox>,
    owner: Option<String>,
    /// The newest fence that was heard of: what tells of an older one is late.
    fence: u64,
    /// Whether the ownership of that fence has ended.
    over: bool,
    /// Whether its token was deleted. It stays closed, as nobody can own it: that a token is gone does not say that its owner has left the
    /// box.
    gone: bool,
    /// How many more times the hub has to tell of it before a yes to a grant, of which nothing came, holds no more.
    promised: u8,
}

/// What is closed to the arm now.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Closed {
    mount: Mount,
    commander: Option<String>,
    zones: Vec<ClosedZone>,
    /// The commander's own.
    own: Vec<ZoneBox>,
}

#[derive(Debug, Clone, PartialEq)]
struct ClosedZone {
    name: Path,
    bounds: Option<ZoneBox>,
    owner: Option<String>,
    gone: bool,
}

impl Zones {
    /// None yet, for an arm that stands there.
    #[must_use]
    pub fn new(mount: Mount) -> Self {
        Self {
            mount,
            zones: BTreeMap::new(),
        }
    }

    /// There is a zone with this token. Until more is heard of it, it may be anywhere, and nobody owns it.
    pub fn add(&mut self, token: Path) {
        let zone = self.zones.entry(token).or_default();
        if zone.gone {
            *zone = Zone::default();
        }
    }

    /// There is no such token any more: its zone is closed to everybody, until there is one again or the arm's program begins anew.
    pub fn remove(&mut self, token: &Path) {
        if let Some(zone) = self.zones.get_mut(token) {
            *zone = Zone {
                bounds: zone.bounds,
                gone: true,
                ..Zone::default()
            };
        }
    }

    /// What the hub tells of the token: `{zone {from, to}, owner?, fence}`.
    pub fn told(&mut self, token: &Path, info: &Map) {
        let Some(zone) = self.zones.get_mut(token).filter(|zone| !zone.gone) else {
            return;
        };
        zone.bounds = info.get("zone").and_then(ZoneBox::read);
        zone.promised = zone.promised.saturating_sub(1);
        let fence = info.get("fence").and_then(Value::as_int).unwrap_or_default();
        let fence = u64::try_from(fence).unwrap_or_default();
        match info.get("owner").and_then(Value::as_str) {
            Some(owner) => zone.grab(owner, fence),
            None if fence >= zone.fence => zone.owner = None,
            None => {}
        }
    }

    /// A peer has got it.
    pub fn grabbed(&mut self, token: &Path, owner: &str, fence: u64) {
        if let Some(zone) = self.zones.get_mut(token).filter(|zone| !zone.gone) {
            zone.grab(owner, fence);
        }
    }

    /// Its owner has lost it.
    pub fn released(&mut self, token: &Path, fence: u64) {
        if let Some(zone) = self.zones.get_mut(token)
            && fence >= zone.fence
        {
            (zone.fence, zone.over, zone.owner, zone.promised) = (fence, true, None, 0);
        }
    }

    /// Nothing is known any more of a zone but that it is there.
    pub fn forget_one(&mut self, token: &Path) {
        if let Some(zone) = self.zones.get_mut(token).filter(|zone| !zone.gone) {
            *zone = Zone::default();
        }
    }

    /// Nothing is known any more but that they are there: the connection is lost, and after it fences may be others.
    pub fn forget(&mut self) {
        for zone in self.zones.values_mut().filter(|zone| !zone.gone) {
            *zone = Zone::default();
        }
    }

    /// What is closed to this commander; to nobody, all is.
    #[must_use]
    pub fn closed_to(&self, commander: Option<&str>) -> Closed {
        let is_own =
            |zone: &Zone| commander.is_some() && zone.owner.as_deref() == commander && zone.promised == 0;
        let mut closed = Closed {
            mount: self.mount,
            commander: commander.map(str::to_owned),
            ..Closed::default()
        };
        for (name, zone) in &self.zones {
            match zone.bounds {
                Some(bounds) if is_own(zone) => closed.own.push(bounds),
                bounds => closed.zones.push(ClosedZone {
                    name: name.clone(),
                    bounds,
                    owner: zone.owner.clone(),
                    gone: zone.gone,
                }),
            }
        }
        // The one that is named is the one to be grabbed: not a free one where another's is in the way, and no larger one than needed.
        closed.zones.sort_by(|a, b| {
            b.owner
                .is_some()
                .cmp(&a.owner.is_some())
                .then(a.size().total_cmp(&b.size()))
        });
        closed
    }

    /// This arm has said that a zone may be granted: it is closed until that has come about, or has come to nothing.
    pub fn promise(&mut self, token: &Path) {
        if let Some(zone) = self.zones.get_mut(token) {
            zone.promised = 2;
        }
    }

    /// Whether this peer owns the zone.
    #[must_use]
    pub fn is_owner(&self, token: &Path, peer: &str) -> bool {
        let owner = self.zones.get(token).and_then(|zone| zone.owner.as_deref());
        owner == Some(peer)
    }

    /// Whether a peer may be granted a zone, as far as this arm is concerned: it does not stand there.
    ///
    /// # Errors
    ///
    /// Why not.
    pub fn check_grant(&self, token: &Path, at: &Pose) -> Result<(), String> {
        let Some(zone) = self.zones.get(token) else {
            return Err(format!("the arm does not know the zone {token}"));
        };
        let Some(bounds) = &zone.bounds else {
            return Err(format!("the arm does not know yet where {token} is"));
        };
        match bounds.holds(&self.mount, at) {
            false => Ok(()),
            true => Err(format!(
                "the arm stands in {token}; the owner of the arm's token may take it, and drive out"
            )),
        }
    }
}

impl Zone {
    fn grab(&mut self, owner: &str, fence: u64) {
        if fence > self.fence || (fence == self.fence && !self.over) {
            if fence > self.fence {
                self.promised = 0;
            }
            (self.fence, self.over, self.owner) = (fence, false, Some(owner.to_owned()));
        }
    }
}

impl Closed {
    /// Checks that the arm keeps out of all of them on the straight way from one pose to another, both included.
    ///
    /// # Errors
    ///
    /// [`ErrorName::ZoneNotOwned`] that names the first of them, and its owner.
    pub fn check_leg(&self, from: &Pose, to: &Pose) -> Result<(), DeviceError> {
        if self.zones.is_empty() {
            return Ok(());
        }
        let steps = (from.distance(to) / STEP)
            .max(from.turn(to) / TURN_STEP)
            .ceil()
            .max(1.0);
        let mut step = 0.0;
        while step <= steps {
            self.check(&from.between(to, step / steps))?;
            step += 1.0;
        }
        Ok(())
    }

    /// The same for one pose.
    ///
    /// # Errors
    ///
    /// As [`Closed::check_leg`].
    pub fn check(&self, pose: &Pose) -> Result<(), DeviceError> {
        let unknown = self.zones.iter().find(|zone| zone.bounds.is_none());
        let parts = parts(&self.mount, pose);
        // Where no joints can hold the pose nobody knows where the arm's parts are: they may be in each.
        let entered = |zone: &&ClosedZone| {
            let enters = |bounds| {
                let mut parts = parts.iter().flatten();
                parts.any(|part| part.enters(bounds, &self.own))
            };
            parts.is_none() || zone.bounds.as_ref().is_some_and(enters)
        };
        match unknown.or_else(|| self.zones.iter().find(entered)) {
            None => Ok(()),
            Some(zone) => Err(zone.refusal(pose, self.commander.as_deref())),
        }
    }
}

impl ClosedZone {
    /// mm³.
    fn size(&self) -> f64 {
        self.bounds.map_or(f64::INFINITY, |ZoneBox { from, to }| {
            (0..3).map(|axis| to[axis] - from[axis]).product()
        })
    }

    fn refusal(&self, at: &Pose, commander: Option<&str>) -> DeviceError {
        let Pose { x, y, z, .. } = at;
        let name = &self.name;
        let text = match (&self.bounds, commander, &self.owner) {
            _ if self.gone => format!(
                "at {x:.0} {y:.0} {z:.0} the arm is in the zone {name}, whose token was deleted: it stays closed until there is such a token again, or the arm's program begins anew"
            ),
            (None, ..) => format!("the arm does not know yet where the zone {name} is"),
            (Some(_), None, _) => {
                format!(
                    "at {x:.0} {y:.0} {z:.0} the arm is in the zone {name}, and nobody owns the arm's token"
                )
            }
            (Some(_), Some(commander), Some(owner)) => format!(
                "at {x:.0} {y:.0} {z:.0} the arm is in the zone {name}, which {owner} owns, not {commander}"
            ),
            (Some(_), Some(commander), None) => format!(
                "at {x:.0} {y:.0} {z:.0} the arm is in the zone {name}, which {commander} does not own; nobody does, so grab it first"
            ),
        };
        let error = DeviceError::new(ErrorName::ZoneNotOwned, text);
        match self.bounds {
            None if !self.gone => error.with_retry(),
            _ => error,
        }
    }
}

impl Mount {
    /// A point of the table's frame in that of the zones.
    #[must_use]
    pub fn place(&self, [x, y, z]: Xyz) -> Xyz {
        let (sin, cos) = self.yaw.to_radians().sin_cos();
        [self.x + cos * x - sin * y, self.y + sin * x + cos * y, z]
    }
}

impl fmt::Display for Mount {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{},{}", self.x, self.y, self.yaw)
    }
}

impl FromStr for Mount {
    type Err = String;

    /// `X,Y,YAW`: mm and degrees.
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Vec<f64> = text
            .split(',')
            .filter_map(|number| number.trim().parse().ok())
            .filter(|number: &f64| number.abs() <= 1e6)
            .collect();
        match (text.split(',').count(), numbers.as_slice()) {
            (3, &[x, y, yaw]) => Ok(Self { x, y, yaw }),
            _ => Err("it is three numbers, mm, mm and degrees: 500,0,180".to_owned()),
        }
    }
}
