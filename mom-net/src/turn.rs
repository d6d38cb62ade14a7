//! Turns of tasks that share a thread.

use std::task::{Context, Poll};

/// Lets others have the thread before a reader goes on that has read something and has nothing to give: a sender of nothing takes no
/// longer turns than one of parcels.
pub(crate) fn next_turn<T>(context: &Context<'_>) -> Poll<T> {
    context.waker().wake_by_ref();
    Poll::Pending
}
