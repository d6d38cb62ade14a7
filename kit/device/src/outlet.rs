//! The way out to the hub: one parcel after the other, in order, over lost links too.

use std::collections::VecDeque;
use std::future::{Future, pending};
use std::pin::Pin;

use mom_client::{Client, ClientError, Delivery, ErrorKind, Parcel};

/// The most parcels that are held back; a whole queue of commands that ends at once is far below.
const MOST: usize = 4096;

/// A parcel on its way into the client's queue.
pub type Sending = Pin<Box<dyn Future<Output = Result<(), ClientError>> + Send>>;

/// Sends what waits, beside the device's own work, so that a slow link holds up neither motion nor halts.
///
/// The client's queue bounds, orders and replaces what waits for a slow link. Here waits only what that queue has no
/// capacity for, and, while the link is down, everything that has to be said all the same: who sent a command wants to
/// hear how it ended.
#[must_use]
pub struct Outlet<S> {
    send: S,
    held: VecDeque<Parcel>,
    sending: Option<(Parcel, Sending)>,
    down: bool,
}

/// What sends by this client.
pub fn sender(client: &Client) -> impl Fn(Parcel) -> Sending + Send + Sync + 'static + use<> {
    let client = client.clone();
    move |parcel| {
        let client = client.clone();
        Box::pin(async move { client.send(parcel).await })
    }
}

impl<S> std::fmt::Debug for Outlet<S> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Outlet")
            .field("held", &self.held.len())
            .field("down", &self.down)
            .finish_non_exhaustive()
    }
}

impl<S: Fn(Parcel) -> Sending> Outlet<S> {
    /// An outlet that hands parcels to `send`.
    pub fn new(send: S) -> Self {
        Self {
            send,
            held: VecDeque::new(),
            sending: None,
            down: false,
        }
    }

    /// Takes what is to be sent.
    pub fn push(&mut self, out: &mut Vec<Parcel>) {
        for parcel in out.drain(..) {
            if parcel.delivery == Some(Delivery::Latest) {
                // The newer one goes to the end, not to the older one's place: it must not overtake what led to it.
                self.held.retain(|older| !replaces(&parcel, older));
            }
            self.held.push_back(parcel);
        }
        let dropped = self.held.len().saturating_sub(MOST);
        if dropped > 0 {
            self.held.drain(..dropped);
            tracing::warn!(dropped, "the link is too slow; messages were dropped");
        }
    }

    /// Holds everything back, or no more.
    pub fn set_down(&mut self, down: bool) {
        self.down = down;
    }

    /// Whether everything is held back.
    #[must_use]
    pub fn is_down(&self) -> bool {
        self.down
    }

    /// Sends one parcel; never ends while there is none. May be dropped at any time, nothing is lost.
    pub async fn work(&mut self) {
        if self.sending.is_none() && !self.down {
            self.sending = self
                .held
                .pop_front()
                .map(|parcel| (parcel.clone(), (self.send)(parcel)));
        }
        let Some((_, sending)) = &mut self.sending else {
            return pending().await;
        };
        let sent = sending.await;
        let parcel = self.sending.take().map(|(parcel, _)| parcel);
        match sent {
            // The event that tells of it is on its way.
            Err(error) if error.kind() == ErrorKind::Connection => self.keep(parcel),
            Err(error) => tracing::warn!(%error, "a message was not sent"),
            Ok(()) => {}
        }
    }

    /// Sends all that waits, unless the link is down.
    pub async fn flush(&mut self) {
        while self.sending.is_some() || !(self.down || self.held.is_empty()) {
            self.work().await;
        }
    }

    /// A state is told anew when the link is back; all else has to be said later.
    fn keep(&mut self, parcel: Option<Parcel>) {
        if let Some(parcel) = parcel.filter(|parcel| parcel.delivery != Some(Delivery::Latest)) {
            self.held.push_front(parcel);
        }
    }
}

/// Whether a newer state makes an older one useless.
fn replaces(newer: &Parcel, older: &Parcel) -> bool {
    older.delivery == Some(Delivery::Latest) && older.name == newer.name && older.address == newer.address
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use mom_client::Family;
    use tokio::time::{Duration, timeout};

    use super::*;

    type Sent = Arc<Mutex<Vec<String>>>;

    /// An outlet whose link fails the attempts of these numbers, and what it sent.
    fn outlet(failing: &'static [usize]) -> (Outlet<impl Fn(Parcel) -> Sending>, Sent) {
        let sent = Sent::default();
        let (attempts, log) = (Arc::new(Mutex::new(0)), Arc::clone(&sent));
        let send = move |parcel: Parcel| -> Sending {
            let mut attempt = attempts.lock().unwrap();
            *attempt += 1;
            if failing.contains(&*attempt) {
                return Box::pin(async { Err(ClientError::Connection("gone".to_owned())) });
            }
            log.lock().unwrap().push(parcel.name().to_owned());
            Box::pin(async { Ok(()) })
        };
        (Outlet::new(send), sent)
    }

    fn parcels(names: &[&str]) -> Vec<Parcel> {
        let parcel = |name: &&str| {
            let mut parcel = Parcel::new(Family::Message, *name);
            parcel.delivery = (*name == "state").then_some(Delivery::Latest);
            parcel
        };
        names.iter().map(parcel).collect()
    }

    #[tokio::test]
    async fn what_a_lost_link_refused_is_sent_in_order_but_for_states() {
        for (pushed, failing, expected) in [
            (["a", "b", "c"], &[][..], &["a", "b", "c"][..]),
            (["a", "b", "c"], &[1, 3], &["a", "b", "c"]),
            (["a", "state", "c"], &[2], &["a", "c"]),
        ] {
            let (mut outlet, sent) = outlet(failing);
            outlet.push(&mut parcels(&pushed));
            outlet.flush().await;
            assert_eq!(*sent.lock().unwrap(), expected);
        }
    }

    /// What the hub refuses is refused again.
    #[tokio::test]
    async fn what_was_refused_is_not_said_again() {
        let attempts = Arc::new(Mutex::new(0));
        let counted = Arc::clone(&attempts);
        let mut outlet = Outlet::new(move |_: Parcel| -> Sending {
            *counted.lock().unwrap() += 1;
            Box::pin(async {
                Err(ClientError::TimedOut {
                    what: "it".to_owned(),
                    after: Duration::from_secs(1),
                })
            })
        });
        outlet.push(&mut parcels(&["a", "b"]));
        outlet.flush().await;
        assert_eq!(*attempts.lock().unwrap(), 2);
    }

    #[test]
    fn a_queue_without_an_end_loses_its_oldest() {
        let (mut outlet, _) = outlet(&[]);
        outlet.set_down(true);
        assert!(outlet.is_down());
        outlet.push(&mut parcels(&vec!["a"; MOST]));
        assert_eq!(outlet.held.len(), MOST);
        outlet.push(&mut parcels(&["b"]));
        assert_eq!((outlet.held.len(), outlet.held[MOST - 1].name()), (MOST, "b"));
    }

    #[tokio::test(start_paused = true)]
    async fn nothing_leaves_while_the_link_is_down() {
        let (mut outlet, sent) = outlet(&[]);
        outlet.set_down(true);
        outlet.push(&mut parcels(&["a"]));
        assert!(timeout(Duration::from_secs(9), outlet.work()).await.is_err());
        outlet.flush().await;
        assert!(sent.lock().unwrap().is_empty());
        outlet.set_down(false);
        outlet.work().await;
        assert_eq!(*sent.lock().unwrap(), ["a"]);
    }

    /// What is held back after these were pushed while the link was down; words that end in `bob` are for bob.
    fn held(words: &[&str]) -> Vec<String> {
        let (mut outlet, _) = outlet(&[]);
        outlet.set_down(true);
        for word in words {
            let mut parcel = Parcel::new(Family::Message, word.split('-').next().unwrap()).content(*word);
            parcel.delivery = word.starts_with("state").then_some(Delivery::Latest);
            parcel.address = word.ends_with("bob").then(|| vec!["bob".into()]);
            outlet.push(&mut vec![parcel]);
        }
        let words = outlet.held.iter();
        words
            .map(|parcel| parcel.value().as_str().unwrap().to_owned())
            .collect()
    }

    #[test]
    fn a_newer_state_replaces_an_older_one_and_nothing_else() {
        for (pushed, expected) in [
            (&["state-1", "state-2"][..], &["state-2"][..]),
            (&["state-1", "status-1", "state-2"], &["status-1", "state-2"]),
            (&["status-1", "status-2"], &["status-1", "status-2"]),
            (&["state-1-bob", "state-2"], &["state-1-bob", "state-2"]),
        ] {
            assert_eq!(held(pushed), expected, "{pushed:?}");
        }
    }

    #[test]
    fn what_is_held_back_is_bounded_and_the_oldest_goes() {
        let words: Vec<String> = (0..MOST + 3).map(|number| format!("status-{number}")).collect();
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        let held = held(&words);
        assert_eq!((held.len(), &*held[0]), (MOST, "status-3"));
    }
}
