//! The end of work while a command of ours may run: it is cancelled, and heard to have ended.

use std::future::{Future, pending};
use std::pin::{Pin, pin};
use std::time::Duration;

use mom_client::{Family, Map, Parcel};
use tokio::time::timeout;

use crate::{DeviceChannel, VerbFailure};

/// So long an answer is waited for before the question is repeated.
pub const REPEATED: Duration = Duration::from_millis(300);
/// How often it is asked.
pub const TIMES: u32 = 3;
/// So long the hub may take to have a token back.
const RELEASED: Duration = Duration::from_secs(1);
/// So long a device may take to end a command after the hub's `halt`.
pub const HALTED: Duration = Duration::from_secs(2);

/// Asks until an answer comes: [`TIMES`] times, each [`REPEATED`]. None if there is none. A question that cannot be sent, or hangs, is
/// repeated as one that is lost.
pub async fn insist<T, Asked: Future<Output = ()>>(
    mut ask: impl FnMut() -> Asked,
    answer: impl Future<Output = T>,
) -> Option<T> {
    let mut answer = pin!(answer);
    for _ in 0..TIMES {
        let round = async {
            ask().await;
            pending::<()>().await;
        };
        tokio::select! {
            biased;
            answer = &mut answer => return Some(answer),
            _ = timeout(REPEATED, round) => {}
        }
    }
    None
}

/// How a device took the end of the work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Halt {
    /// It has said that its command has ended.
    Confirmed,
    /// It has said so after a `stop` only, which holds until an unstop.
    Stopped,
    /// It has said nothing.
    Silent,
}

impl Halt {
    /// Whether the device has obeyed.
    ///
    /// # Errors
    /// In words: it was stopped, or says nothing.
    pub fn verdict(self, device: &str) -> Result<(), VerbFailure> {
        match self {
            Halt::Confirmed => Ok(()),
            Halt::Stopped => Err(VerbFailure::new(
                format!("{device} did not end its command when the hub halted it, so it was stopped"),
                format!("see what is wrong with it, then let it go with: mom unstop {device}"),
            )),
            Halt::Silent => Err(VerbFailure::new(
                format!(
                    "{device} has not said that it has ended its command, neither to the hub's halt nor to {TIMES} stops"
                ),
                "go and look; switch it off where it moves",
            )),
        }
    }
}

/// Ends a command that runs: `release` gives the token back, and the hub halts the device. Where `ended` (the device says that its
/// command is over) is not done soon after it, the device is told to stop, [`TIMES`] times.
pub async fn halt(
    device: &DeviceChannel,
    release: impl Future<Output = Result<(), VerbFailure>>,
    ended: impl Future<Output = ()>,
) -> (Result<(), VerbFailure>, Halt) {
    let mut ended: Pin<&mut _> = pin!(ended);
    let released = match timeout(RELEASED, release).await {
        Ok(released) => released,
        Err(_) => Err(VerbFailure::plain(
            "the hub does not say that it has the token back",
        )),
    };
    if timeout(HALTED, &mut ended).await.is_ok() {
        return (released, Halt::Confirmed);
    }
    let stop = || {
        let device = device.clone();
        let content = Map::new().with("reason", "it did not end a command when its token was given back");
        let message = Parcel::new(Family::Message, "stop").content(content);
        async move { drop(device.send(message, "stop").await) }
    };
    let halt = match insist(stop, ended).await {
        Some(()) => Halt::Stopped,
        None => Halt::Silent,
    };
    (released, halt)
}

#[cfg(test)]
mod tests {
    use std::future::ready;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn what_is_not_answered_is_asked_three_times() {
        let mut asked = 0;
        let ask = || {
            asked += 1;
            ready(())
        };
        assert_eq!(insist(ask, pending::<()>()).await, None);
        assert_eq!(asked, TIMES);
        // A request that hangs does not prolong the wait, and an answer ends it.
        let begun = tokio::time::Instant::now();
        assert_eq!(insist(pending, pending::<()>()).await, None);
        assert_eq!(begun.elapsed(), REPEATED * TIMES);
        let late = tokio::time::sleep(REPEATED + REPEATED / 2); // tidy: an answer that comes late, in virtual time
        let mut asked = 0;
        let ask = || {
            asked += 1;
            ready(())
        };
        assert_eq!(insist(ask, late).await, Some(()));
        assert_eq!(asked, 2);
    }
}
