//! The delays before reconnecting.

use std::hash::{BuildHasher, RandomState};
use std::time::Duration;

use mom_proto::{Code, WireError};
use tokio::time::{Instant, sleep};

use crate::ClientError;

/// The delays before reconnecting: `first`, then twice as long each time, up to `most`; each is shortened at random
/// by up to a half, so that a fleet does not reconnect all at once.
///
/// ```
/// use std::time::Duration;
/// use mom_client::Reconnect;
/// let patient = Reconnect { give_up_after: None, ..Reconnect::default() };
/// assert_eq!(patient.most, Duration::from_secs(5));
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reconnect {
    /// The delay before the first attempt.
    pub first: Duration,
    /// The longest delay.
    pub most: Duration,
    /// The client is closed when the link has been lost for this long; none = never.
    pub give_up_after: Option<Duration>,
}

impl Default for Reconnect {
    fn default() -> Reconnect {
        Reconnect {
            first: Duration::from_millis(100),
            most: Duration::from_secs(5),
            give_up_after: None,
        }
    }
}

/// The attempts to connect, at first or after a link was lost.
#[derive(Debug)]
pub(crate) struct Attempts<'a> {
    reconnect: &'a Reconnect,
    begin: Instant,
    next: Duration,
}

/// What follows an attempt that failed.
#[derive(Debug)]
pub(crate) enum Next {
    /// Another one, after so long.
    Wait(Duration),
    /// None: the hub refuses for good.
    Refused(WireError),
    /// None: it has taken so long.
    TooLong(Duration),
}

impl<'a> Attempts<'a> {
    pub(crate) fn new(reconnect: &'a Reconnect) -> Attempts<'a> {
        Attempts {
            reconnect,
            begin: Instant::now(),
            next: reconnect.first.min(reconnect.most),
        }
    }

    /// When they began.
    pub(crate) fn begin(&self) -> Instant {
        self.begin
    }

    /// What follows one that failed.
    pub(crate) fn after(&mut self, error: &ClientError) -> Next {
        let at_least = match error {
            ClientError::Refused(error) if !error.code.may_retry() && !error.code.may_reconnect() => {
                return Next::Refused(error.clone());
            }
            ClientError::Refused(error) => error.retry_in(),
            // A proxy has come between.
            ClientError::Local(error) if error.code == Code::INSECURE => return Next::Refused(error.clone()),
            _ => None,
        };
        let passed = self.begin.elapsed();
        match self.reconnect.give_up_after.is_some_and(|most| passed >= most) {
            true => Next::TooLong(passed),
            false => Next::Wait(self.wait(at_least)),
        }
    }

    /// How long to wait now, but no less than the hub asked for.
    pub(crate) fn wait(&mut self, at_least: Option<Duration>) -> Duration {
        let wait = shorten(self.next, RandomState::new().hash_one(0));
        self.next = (self.next * 2).min(self.reconnect.most);
        wait.max(at_least.unwrap_or_default())
    }
}

/// Tries until there is a hub, it refuses for good, or that takes too long.
pub(crate) async fn wait<T, F: Future<Output = Result<T, ClientError>>>(
    reconnect: &Reconnect,
    connect: impl Fn() -> F,
) -> Result<T, ClientError> {
    let mut attempts = Attempts::new(reconnect);
    let mut said = String::new();
    loop {
        let error = match connect().await {
            Ok(connected) => return Ok(connected),
            // What is wrong on this side does not pass.
            Err(error @ (ClientError::Local(_) | ClientError::Address(_) | ClientError::Closed(_))) => {
                return Err(error);
            }
            Err(error) => error,
        };
        let Next::Wait(wait) = attempts.after(&error) else {
            return Err(error);
        };
        // Once for each reason: it may take all night.
        let why = error.to_string();
        if said != why {
            tracing::warn!("waiting for the hub: {why}");
            said = why;
        }
        sleep(wait).await;
    }
}

/// Takes up to a half away.
fn shorten(wait: Duration, random: u64) -> Duration {
    let part = u32::try_from(random % 1024).unwrap_or_default();
    wait - wait / 2 * part / 1024
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_up_to_the_most() {
        let reconnect = Reconnect {
            first: Duration::from_millis(100),
            most: Duration::from_millis(350),
            give_up_after: None,
        };
        let mut attempts = Attempts::new(&reconnect);
        for most in [100, 200, 350, 350] {
            let wait = attempts.wait(None);
            let most = Duration::from_millis(most);
            assert!(most / 2 <= wait && wait <= most, "{wait:?} of {most:?}");
        }
        assert_eq!(
            attempts.wait(Some(Duration::from_secs(9))),
            Duration::from_secs(9)
        );
    }

    /// A hub that is full or busy may have a place later; one that refuses the proof will not take it.
    #[test]
    fn what_may_pass_is_waited_for() {
        let reconnect = Reconnect::default();
        let mut attempts = Attempts::new(&reconnect);
        let refused = |code| ClientError::Refused(WireError::new(code, "no"));
        for passing in [
            ClientError::Connection("nobody listens".to_owned()),
            refused(Code::TOO_MANY_CONNECTIONS),
            refused(Code::TRY_LATER),
        ] {
            let next = attempts.after(&passing);
            assert!(matches!(next, Next::Wait(_)), "{passing}: {next:?}");
        }
        let next = attempts.after(&refused(Code::BAD_LOGIN));
        assert!(matches!(next, Next::Refused(_)), "{next:?}");
        let hurried = Reconnect {
            give_up_after: Some(Duration::ZERO),
            ..reconnect
        };
        let next = Attempts::new(&hurried).after(&refused(Code::TRY_LATER));
        assert!(matches!(next, Next::TooLong(_)), "{next:?}");
    }

    #[test]
    fn at_most_a_half_is_taken_away() {
        let second = Duration::from_secs(1);
        assert_eq!(shorten(second, 0), second);
        assert_eq!(shorten(second, 512), second * 3 / 4);
        assert!(shorten(second, 1023) >= second / 2);
    }
}
