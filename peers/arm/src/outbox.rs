//! What waits to be sent: bounded, with the newest state in the place of an older one (design §7).

use std::collections::VecDeque;

use mom_client::{Delivery, Parcel};

/// The most parcels that wait; a whole queue of commands that ends at once is far below.
pub(crate) const MOST: usize = 4096;

/// Parcels that wait for the link, in order.
///
/// A parcel of delivery `latest` takes the place of a waiting one of its name and receivers: after a pause of
/// the link there is no use in old poses. If the queue is full the oldest parcel is dropped and counted.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    queue: VecDeque<Parcel>,
    dropped: u64,
}

impl Outbox {
    /// Takes a parcel.
    pub(crate) fn push(&mut self, parcel: Parcel) {
        let replaces = |older: &Parcel| {
            older.delivery == Some(Delivery::Latest)
                && older.name == parcel.name
                && older.address == parcel.address
        };
        // It goes to the end, not to the older one's place: it must not overtake what led to it.
        if parcel.delivery == Some(Delivery::Latest)
            && let Some(place) = self.queue.iter().position(replaces)
        {
            self.queue.remove(place);
        }
        if self.queue.len() >= MOST {
            self.queue.pop_front();
            self.dropped += 1;
        }
        self.queue.push_back(parcel);
    }

    /// Takes back the one that was given out last.
    pub(crate) fn put_back(&mut self, parcel: Parcel) {
        self.queue.push_front(parcel);
    }

    /// The next one to send.
    pub(crate) fn pop(&mut self) -> Option<Parcel> {
        self.queue.pop_front()
    }

    /// Whether nothing waits.
    pub(crate) fn is_empty(&self) -> bool {
        self.queue.is_empty()
    }

    /// How many were dropped since this was last asked.
    pub(crate) fn take_dropped(&mut self) -> u64 {
        std::mem::take(&mut self.dropped)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_client::Family;

    fn parcel(word: &str) -> Parcel {
        let mut parcel = Parcel::new(Family::Message, word.split('-').next().unwrap()).content(word);
        parcel.delivery = word.starts_with("state").then_some(Delivery::Latest);
        if word.ends_with("bob") {
            parcel.address = Some(vec!["bob".into()]);
        }
        parcel
    }

    fn check(pushed: &[&str], popped: &[&str]) {
        let mut outbox = Outbox::default();
        pushed.iter().for_each(|word| outbox.push(parcel(word)));
        let got: Vec<String> = std::iter::from_fn(|| outbox.pop())
            .map(|parcel| parcel.value().as_str().unwrap().to_owned())
            .collect();
        assert_eq!(got, popped, "{pushed:?}");
        assert_eq!(outbox.take_dropped(), 0);
    }

    #[test]
    fn a_newer_state_replaces_an_older_one_and_nothing_else() {
        check(&["state-1", "state-2"], &["state-2"]);
        check(&["state-1", "status-1", "state-2"], &["status-1", "state-2"]);
        check(&["status-1", "status-2"], &["status-1", "status-2"]);
        check(&["state-1-bob", "state-2"], &["state-1-bob", "state-2"]);
    }

    #[test]
    fn a_full_outbox_drops_the_oldest_and_counts() {
        let mut outbox = Outbox::default();
        (0..MOST + 3).for_each(|number| outbox.push(parcel(&format!("status-{number}"))));
        assert_eq!((outbox.take_dropped(), outbox.take_dropped()), (3, 0));
        assert_eq!(outbox.pop().unwrap().value().as_str(), Some("status-3"));
    }
}
