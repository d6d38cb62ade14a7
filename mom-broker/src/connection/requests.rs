//! How often one connection may ask for something: each request costs the hub's lock, and may tell others something.

use std::time::Duration;

use crate::traffic::switchboard::Work;
use mom_proto::{Code, Gcra, Limit, Micros, Pace, Parcel, Verb, Wait, WireError};

const SECOND: Micros = 1_000_000;

/// Peers told and members routed that a request includes, and how many more count as another request.
const INCLUDED: u64 = 32;
const PER_REQUEST: u64 = 4;

/// The most that a request leaves to be paid back: the next one is taken a second later at the latest.
const DEBT: Micros = 2 * SECOND;

/// So many times as often as it may ask, a connection is told to try later. Beyond that it is read no faster: a refusal
/// costs as much as a small request. Not fewer, for a stop may lie behind them.
const REFUSALS: u64 = 4;

/// The requests of one connection, as times up to which they are paid back: an idle connection is small.
#[derive(Debug, Default)]
pub(super) struct Requests {
    paid_at: Micros,
    /// Of those that were refused.
    refused_at: Micros,
}

impl Requests {
    /// Counts a request, of which `most` may be made in a second, and as many at once after a rest.
    ///
    /// # Errors
    /// `try-later`, and after which time.
    pub(super) fn take(&mut self, parcel: &Parcel, most: Limit, now: Micros) -> Result<(), WireError> {
        let Limit::At(most) = most else { return Ok(()) };
        if !counts(parcel) {
            return Ok(());
        }
        let pace = pace(most);
        let mut used = Gcra::paid_at(self.paid_at);
        used.take(&pace, 1, now).map_err(|wait| {
            let text = format!("more than {most} requests in a second");
            let wait = match wait {
                Wait::For(wait) => Duration::from_micros(wait),
                Wait::Never => Duration::from_micros(SECOND),
            };
            WireError::new(Code::TRY_LATER, text).retry_after(wait.max(Duration::from_millis(1)))
        })?;
        self.paid_at = used.next(&pace);
        Ok(())
    }

    /// Counts a request that was refused; gives for how long nothing more is to be read if there were too many.
    pub(super) fn refused(&mut self, most: Limit, now: Micros) -> Option<Duration> {
        let Limit::At(most) = most else { return None };
        let pace = pace(most.saturating_mul(REFUSALS));
        let mut used = Gcra::paid_at(self.refused_at);
        match used.take(&pace, 1, now) {
            Err(Wait::For(wait)) => Some(Duration::from_micros(wait)),
            Err(Wait::Never) => None,
            Ok(()) => {
                self.refused_at = used.next(&pace);
                None
            }
        }
    }

    /// Charges what a request has cost others. What costs much, as joining a channel of a thousand members does, may be
    /// asked for less often.
    pub(super) fn charge(&mut self, counts: bool, work: Work, most: Limit, now: Micros) {
        let Limit::At(most) = most else { return };
        if !counts {
            return;
        }
        let more = work.0.saturating_sub(INCLUDED) / PER_REQUEST;
        if more > 0 {
            let pace = pace(most);
            let mut used = Gcra::paid_at(self.paid_at);
            used.charge(&pace, more, now);
            self.paid_at = used.next(&pace).min(now.saturating_add(DEBT));
        }
    }
}

fn pace(most: u64) -> Pace {
    Pace::every_within((SECOND / most).max(1), SECOND)
}

/// Whether a request is one of those that are limited. Keeping what one has, giving it up, answering the hub, and stopping
/// is not; the hub bounds how much one user may stop at once.
pub(super) fn counts(parcel: &Parcel) -> bool {
    let verb = Verb::of(parcel.family, &parcel.name);
    !matches!(verb, Ok(Verb::Renew | Verb::Release | Verb::Verdict | Verb::Stop))
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_proto::Family;

    #[test]
    fn a_burst_then_a_rate_and_never_what_gives_up() {
        let mut requests = Requests::default();
        let most = Limit::At(10);
        let ask = |requests: &mut Requests, name: &str, now| {
            requests.take(&Parcel::new(Family::Token, name), most, now)
        };
        let passed = (0..100)
            .filter(|_| ask(&mut requests, "grab", 5_000_000).is_ok())
            .count();
        assert!((10..=11).contains(&passed), "{passed}");
        let error = ask(&mut requests, "grab", 5_000_000).expect_err("too many");
        assert_eq!(error.code, Code::TRY_LATER);
        assert!(
            error
                .retry_in()
                .is_some_and(|wait| wait <= Duration::from_millis(100))
        );
        for name in ["renew", "release"] {
            assert!(ask(&mut requests, name, 5_000_000).is_ok(), "{name}");
        }
        assert!(ask(&mut requests, "grab", 5_100_000).is_ok());
        assert!(ask(&mut requests, "grab", 5_100_000).is_err());
        let held = |requests: &mut Requests, now| requests.refused(most, now).is_some();
        let refused = (0..100).filter(|_| !held(&mut requests, 5_000_000)).count();
        assert!((40..=41).contains(&refused), "{refused}");
        assert!(!held(&mut requests, 5_100_000) && requests.refused(Limit::Unlimited, 5_100_000).is_none());
        let free = requests.take(&Parcel::new(Family::Token, "grab"), Limit::Unlimited, 5_100_000);
        assert!(free.is_ok());
    }
}
