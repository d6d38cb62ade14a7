//! What of a token is stored, and what a restart makes of it.

use mom_proto::{Fence, Micros, Path};

use super::record::{Holder, Record};
use super::state::{Reserved, Token};

/// How long nobody else may have a token without a lease after a restart, µs: as long as a lost peer may go unnoticed.
const REST: Micros = 30_000_000;

impl Token {
    /// The record that has to be durable before a grant to this owner; none if the stored one covers it.
    pub(crate) fn needed_record(
        &self,
        path: &Path,
        owner: Holder,
        before: Option<Holder>,
        floor: Fence,
    ) -> Option<Record> {
        let lease = self.longest_lease();
        let fence = u64::from(self.fence.max(floor).next());
        let covered = self.record.as_ref().is_some_and(|known| {
            known.owner.as_ref() == Some(&owner)
                && known.before.is_none()
                && known.lease == lease
                && fence < known.last_fence()
        });
        (!covered).then(|| Record {
            path: path.clone(),
            fence,
            before: before.filter(|before| *before != owner),
            owner: Some(owner),
            lease,
        })
    }

    /// Brings the record near the truth, if it is not; the new one is to be stored. Nobody waits for that: until it is
    /// durable, the older record only refuses more after a restart.
    pub(crate) fn correct_record(&mut self, owner: Option<Holder>) -> Option<Record> {
        // The lease of a free token says nothing any more.
        let lease = match owner {
            Some(_) => self.longest_lease(),
            None => Some(0),
        };
        let fence = u64::from(self.fence);
        let known = self.record.as_mut().filter(|_| self.granting.is_none())?;
        if known.owner == owner && known.before.is_none() && known.lease == lease {
            return None;
        }
        *known = Record {
            path: known.path.clone(),
            fence: known.fence.max(fence),
            owner,
            before: None,
            lease,
        };
        Some(known.clone())
    }

    /// A record may be durable or not: nothing that it covers may be granted without another one.
    pub(crate) fn doubt_record(&mut self) {
        if let Some(record) = &mut self.record {
            record.lease = Some(0);
        }
    }

    /// Until when a restart keeps this peer from the token.
    pub(crate) fn kept_by_restart(&self, peer: Option<&Holder>, now: Micros) -> Option<Micros> {
        let reserved = self.reserved.as_ref().filter(|reserved| now < reserved.until)?;
        let same = reserved.holder.is_some() && reserved.holder.as_ref() == peer;
        (!same).then_some(reserved.until)
    }

    /// Takes over the record of before the start; `floor` is the fence above which this start grants.
    pub(crate) fn restore(&mut self, record: Record, floor: Fence) {
        // Fences that the record covers may have been given out: epochs are further apart, unless clocks were set back.
        let covered = Fence::from(record.last_fence());
        let highest = if covered > floor {
            covered
        } else {
            record.fence.into()
        };
        self.fence = self.fence.max(highest);
        if record.owner.is_some() || record.before.is_some() {
            self.reserved = Some(Reserved {
                holder: record.owner.clone().filter(|_| record.before.is_none()),
                // Or the lease of today: a longer one may have been given before it was in the record.
                // From the start on, also for a token that is made later.
                until: longer(record.lease, self.terms.lease).unwrap_or(REST),
            });
        }
        self.record = Some(record);
    }

    /// The longest lease that the owner has, or the next one will have.
    fn longest_lease(&self) -> Option<Micros> {
        match &self.owner {
            Some(owner) => longer(owner.lease, self.terms.lease),
            None => self.terms.lease,
        }
    }
}

/// The longer of two leases; one without end counts as [`REST`] beside another.
fn longer(one: Option<Micros>, other: Option<Micros>) -> Option<Micros> {
    match (one, other) {
        (None, None) => None,
        (one, other) => one.unwrap_or(REST).max(other.unwrap_or(REST)).into(),
    }
}
