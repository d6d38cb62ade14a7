//! The time of devices, and waiting by it.

use std::future::pending;
use std::time::Duration;

use tokio::time::{Instant, sleep_until};

use crate::DeviceTime;

/// A device's time now, where its time began at `begin`.
#[must_use]
pub fn time_since(begin: Instant) -> DeviceTime {
    DeviceTime::try_from(begin.elapsed().as_micros()).unwrap_or(DeviceTime::MAX)
}

/// When it is `due` by the time of a device.
#[must_use]
pub fn instant_of(begin: Instant, due: DeviceTime) -> Instant {
    begin + Duration::from_micros(u64::try_from(due).unwrap_or(0))
}

/// Waits until then; without a time it never ends.
pub async fn sleep_or_wait(wake: Option<Instant>) {
    match wake {
        Some(wake) => sleep_until(wake).await,
        None => pending().await,
    }
}
