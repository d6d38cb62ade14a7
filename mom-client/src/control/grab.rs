//! Grabbing a token, with or without waiting for it.

use std::fmt;
use std::future::{Future, IntoFuture, pending};
use std::pin::{Pin, pin};
use std::time::Duration;

use mom_proto::{Family, Map, Path};
use tokio::sync::watch;
use tokio::time::sleep;

use crate::contexts::membership::Membership;
use crate::control::owning::owning;
use crate::peer::shared::{Shared, verb};
use crate::words::millis;
use crate::{ClientError, Place, TokenGuard};

/// A builder of a grab, from [`Token::grab`](crate::Token::grab): await it to send it.
///
/// ```no_run
/// # async fn example(token: mom_client::Token) -> Result<(), mom_client::ClientError> {
/// use std::time::Duration;
/// let guard = token
///     .grab()
///     .wait(Duration::from_secs(30))
///     .on_place(|place| println!("{} in the queue", place.place))
///     .await?;
/// # Ok(())
/// # }
/// ```
#[must_use = "a grab does nothing until it is awaited"]
pub struct Grab<'a> {
    member: &'a Membership,
    wait: GrabWait,
    on_place: Option<OnPlace<'a>>,
}

type OnPlace<'a> = Box<dyn FnMut(Place) + Send + 'a>;

/// For how long a grab waits in the queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum GrabWait {
    No,
    For(Duration),
    Forever,
}

impl<'a> Grab<'a> {
    pub(crate) fn new(member: &'a Membership) -> Grab<'a> {
        Grab {
            member,
            wait: GrabWait::No,
            on_place: None,
        }
    }

    /// Waits in the queue for so long, in whole ms; after it the grab is refused with `timed-out`.
    pub fn wait(mut self, most: Duration) -> Grab<'a> {
        self.wait = GrabWait::For(most);
        self
    }

    /// Waits in the queue for as long as it takes.
    pub fn wait_forever(mut self) -> Grab<'a> {
        self.wait = GrabWait::Forever;
        self
    }

    /// Called whenever the place in the queue changes; for quick changes only with the newest.
    pub fn on_place(mut self, told: impl FnMut(Place) + Send + 'a) -> Grab<'a> {
        self.on_place = Some(Box::new(told));
        self
    }

    async fn run(self) -> Result<TokenGuard, ClientError> {
        let (shared, path) = (self.member.shared(), self.member.path());
        let (waiter, receiver) = owning(self.member);
        let id = shared.next_id();
        let mut parcel = verb(Family::Token, "grab", path).id(id);
        parcel.content = self.wait.content().map(Into::into);
        let places = match self.wait {
            GrabWait::No => {
                shared.obtain(parcel, waiter)?;
                None
            }
            _ => Some(shared.obtain_waiting(parcel, id, waiter)?),
        };
        let _withdraw = places.is_some().then_some(Withdraw { shared, path, id });
        let follow = follow(shared, places, self.wait, self.on_place);
        tokio::select! {
            // Checked first: an answer that is there ends the wait, however late it is.
            biased;
            answer = receiver => {
                answer.unwrap_or_else(|_| Err(ClientError::Connection("the link was lost".to_owned())))
            }
            after = follow => Err(ClientError::TimedOut {
                what: format!("token grab {path}"),
                after,
            }),
        }
    }
}

/// Reports the places; ends, with the time that it took, when an answer is overdue.
async fn follow(
    shared: &Shared,
    places: Option<watch::Receiver<Option<Place>>>,
    wait: GrabWait,
    mut on_place: Option<OnPlace<'_>>,
) -> Duration {
    let answer = shared.settings.request_timeout;
    let after = match wait {
        GrabWait::No | GrabWait::Forever => answer,
        GrabWait::For(most) => answer.saturating_add(most),
    };
    let mut overdue = pin!(sleep(after));
    let mut patient = false;
    let Some(mut places) = places else {
        overdue.await;
        return after;
    };
    loop {
        tokio::select! {
            changed = places.changed() => {
                if changed.is_err() {
                    // Answered; the answer wakes its receiver.
                    return pending().await;
                }
                // Once it is in the queue the hub has heard of it, and only the link's end can end it.
                patient = wait == GrabWait::Forever;
                let place = *places.borrow_and_update();
                if let (Some(place), Some(told)) = (place, &mut on_place) {
                    told(place);
                }
            }
            () = &mut overdue, if !patient => return after,
        }
    }
}

impl GrabWait {
    fn content(self) -> Option<Map> {
        match self {
            GrabWait::No => None,
            GrabWait::For(most) => Some(Map::new().with("wait", millis(most))),
            GrabWait::Forever => Some(Map::new().with("wait", "unlimited")),
        }
    }
}

impl<'a> IntoFuture for Grab<'a> {
    type Output = Result<TokenGuard, ClientError>;
    type IntoFuture = Pin<Box<dyn Future<Output = Self::Output> + Send + 'a>>;

    fn into_future(self) -> Self::IntoFuture {
        Box::pin(self.run())
    }
}

impl fmt::Debug for Grab<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Grab")
            .field("path", self.member.path())
            .field("wait", &self.wait)
            .finish_non_exhaustive()
    }
}

/// Withdraws the grab if its caller is dropped before the answer is there.
struct Withdraw<'a> {
    shared: &'a Shared,
    path: &'a Path,
    id: u64,
}

impl Drop for Withdraw<'_> {
    fn drop(&mut self) {
        self.shared.give_up(self.path, self.id);
    }
}
