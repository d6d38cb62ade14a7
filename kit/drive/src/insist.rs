//! Questions that are repeated until they are answered.

use std::future::{Future, pending};
use std::pin::pin;
use std::time::Duration;

use tokio::time::timeout;

/// So long an answer is waited for before the question is repeated.
pub const REPEATED: Duration = Duration::from_millis(300);
/// How often it is asked.
pub const TIMES: u32 = 3;

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
