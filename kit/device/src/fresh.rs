//! How old a command may be when it begins.

use mom_client::{Age, HUB, Parcel};

use crate::{DeviceError, DeviceTime, ErrorName};

/// Until when a command may begin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Freshness {
    /// µs that it may be old, whatever its sender says; none if that is its sender's business alone.
    pub(crate) max_age: Option<DeviceTime>,
    /// How many times as fast as the senders' time the device's passes.
    pub(crate) pace: DeviceTime,
}

impl Freshness {
    /// Until when a command may begin, by the time of the device: until it expires, and until it is older than the device allows. An
    /// unknown age fails the device's own limit.
    ///
    /// # Errors
    ///
    /// `too-old`.
    pub(crate) fn use_by(
        &self,
        name: &str,
        command: &Parcel,
        age: Option<Age>,
        now: DeviceTime,
    ) -> Result<Option<DeviceTime>, DeviceError> {
        // The hub's own command is the safe state, which does not grow old.
        if command.sender.as_deref() == Some(HUB) {
            return Ok(None);
        }
        let later = |micros: DeviceTime| now.saturating_add(micros.saturating_mul(self.pace));
        let life = command
            .expires
            .and_then(|ms| DeviceTime::try_from(ms.saturating_mul(1000)).ok());
        let expires = life.map(|life| later(life.saturating_sub(age.map_or(0, |age| age.micros))));
        let Some(max_age) = self.max_age else {
            return Ok(expires);
        };
        let Some(oldest) = age.and_then(|age| age.at_most()) else {
            let text = format!(
                "{name} takes commands of at most {} ms, and the age of this one is not known: its sender has not measured its clock yet",
                max_age / 1000
            );
            return Err(DeviceError::new(ErrorName::TooOld, text).with_retry());
        };
        let oldest = DeviceTime::try_from(oldest.as_micros()).unwrap_or(DeviceTime::MAX);
        if oldest > max_age {
            let text = format!(
                "the command is {} ms old, and {name} takes those of at most {} ms",
                oldest / 1000,
                max_age / 1000
            );
            return Err(DeviceError::new(ErrorName::TooOld, text));
        }
        let own = later(max_age - oldest);
        Ok(Some(expires.map_or(own, |expires| expires.min(own))))
    }
}
