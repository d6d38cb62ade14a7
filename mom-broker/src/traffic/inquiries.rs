//! Questions of peers that the hub has let through and that the files of the broker answer, on their way to who reads those.
//!
//! One of each peer is answered at a time, and so many in all; more are told to try later. So nothing piles up here.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use mom_hub::{Inquiry, PeerId};
use mom_proto::{Code, Parcel, WireError};
use mom_system::sync::Mutex;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

/// Inquiries of all peers at a time.
const MOST: usize = 64;

/// When a peer that was told to try later may do so.
const AGAIN: Duration = Duration::from_secs(1);

/// One question.
#[derive(Debug)]
pub(crate) struct Inquired {
    pub(crate) to: PeerId,
    /// The answer, but for its content.
    pub(crate) reply: Arc<Parcel>,
    pub(crate) inquiry: Inquiry,
}

/// The questions that wait and those that are being answered.
#[derive(Debug)]
pub(crate) struct Inquiries {
    waiting: UnboundedSender<Inquired>,
    taken: Mutex<Option<UnboundedReceiver<Inquired>>>,
    /// Whose question is not answered yet.
    asking: Mutex<BTreeSet<PeerId>>,
}

impl Default for Inquiries {
    fn default() -> Inquiries {
        let (waiting, taken) = unbounded_channel();
        Inquiries {
            waiting,
            taken: Mutex::new(Some(taken)),
            asking: Mutex::new(BTreeSet::new()),
        }
    }
}

impl Inquiries {
    /// Takes in a question.
    ///
    /// # Errors
    /// `try-later` if the peer has asked another, or too many have.
    pub(crate) fn ask(&self, inquired: Inquired) -> Result<(), WireError> {
        let to = inquired.to;
        {
            let mut asking = self.asking.lock();
            let text = match (asking.contains(&to), asking.len() >= MOST) {
                (true, _) => {
                    "this peer already has a pending audit, explain or what-if request; only one is answered at a time"
                }
                (_, true) => "too many audit, explain or what-if requests are pending",
                (false, false) => "",
            };
            if !text.is_empty() {
                return Err(WireError::new(Code::TRY_LATER, text).retry_after(AGAIN));
            }
            asking.insert(to);
        }
        self.waiting.send(inquired).map_err(|_| {
            self.answered(to);
            WireError::new(
                Code::TRY_LATER,
                "this broker does not answer this request, or is shutting down",
            )
            .retry_after(AGAIN)
        })
    }

    /// The questions, for the thread that answers them; none once one has taken them.
    pub(crate) fn take(&self) -> Option<UnboundedReceiver<Inquired>> {
        self.taken.lock().take()
    }

    /// The question of a peer is answered, or will not be.
    pub(crate) fn answered(&self, to: PeerId) {
        self.asking.lock().remove(&to);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_proto::Family;

    fn of(peer: u64) -> Inquired {
        Inquired {
            to: PeerId(peer),
            reply: Arc::new(Parcel::new(Family::Reply, "ok")),
            inquiry: Inquiry::WhatIf { content: None },
        }
    }

    #[test]
    fn one_of_each_peer_and_so_many_in_all() {
        let inquiries = Inquiries::default();
        let refused = |peer| inquiries.ask(of(peer)).err().map(|error| error.code);
        assert_eq!(refused(0), None);
        assert_eq!(refused(0), Some(Code::TRY_LATER));
        inquiries.answered(PeerId(0));
        assert!((0..MOST as u64).all(|peer| refused(peer).is_none()));
        assert_eq!(refused(MOST as u64), Some(Code::TRY_LATER));
        drop(inquiries.take());
        inquiries.answered(PeerId(0));
        assert_eq!(refused(0), Some(Code::TRY_LATER));
        assert_eq!(inquiries.asking.lock().len(), MOST - 1, "it does not count");
    }
}
