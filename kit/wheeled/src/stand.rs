//! How a robot's program ends: not before the driver has taken the last stop.

use std::time::Duration;

use mom_device::{Machine as _, instant_of, time_since};
use tokio::time::{Instant, sleep_until};

use crate::Rover;

/// So long its driver may take to take the last stop before the program ends all the same.
const LAST_STOP: Duration = Duration::from_secs(1);

/// Has a robot stand, and waits until its driver has taken that.
pub async fn stand(rover: &mut Rover, begin: Instant) {
    let until = Instant::now() + LAST_STOP;
    rover.halt(time_since(begin));
    while !rover.stands() {
        let due = rover.next_wake().map(|due| instant_of(begin, due));
        let Some(due) = due.filter(|due| *due <= until) else {
            tracing::error!("the robot may be moving: the driver did not accept the stop");
            return;
        };
        sleep_until(due).await;
        rover.advance(time_since(begin));
    }
}
