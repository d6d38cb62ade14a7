//! Being in contexts, and hearing of them.

use std::sync::Arc;

use mom_proto::{Family, Map, Parcel, Path, Thinning};

use crate::ClientError;
use crate::peer::pending::AnswerTo;
use crate::peer::shared::{Shared, verb};
use crate::peer::state::Status;
use crate::peer::subscribers::EventQueue;
use crate::peer::wanted::{Terms, Want};
use crate::words::map_of;

impl Shared {
    /// Wants contexts, the uppermost first, and asks to join those that this client is not in; the last of them
    /// on these terms, if they are said.
    #[expect(
        clippy::type_complexity,
        reason = "two lists, each of pairs, used in one place"
    )]
    pub(crate) fn want(
        &self,
        way: &[Path],
        terms: Option<&Terms>,
    ) -> Result<(Vec<(Path, u64)>, Vec<Want>), ClientError> {
        let mut state = self.lock();
        state.check_up()?;
        let (mut places, mut wants) = (Vec::new(), Vec::new());
        let mut asked = Ok(());
        for path in way {
            let (serial, want) = state.places.want(path);
            places.push((path.clone(), serial));
            if matches!(want, Want::Join(_)) {
                let mut waiter = Some(AnswerTo::Join(path.clone(), serial));
                let last = places.len() == way.len();
                let terms = terms.filter(|_| last).cloned().unwrap_or_default();
                if let Some(place) = state.places.get(path, serial) {
                    place.terms = terms.clone();
                }
                let cards = state.me.takes_cards;
                let content = terms.content(&state.places.latch(path), &self.settings.installation, cards);
                asked = self.ask_in(&mut state, join(path, content), &mut waiter);
            }
            wants.push(want);
            if asked.is_err() {
                break;
            }
        }
        drop(state);
        self.outgoing.notify_one();
        match asked {
            Ok(()) => Ok((places, wants)),
            Err(error) => {
                self.unwant(&places);
                Err(error)
            }
        }
    }

    /// Wants contexts no more, and leaves those that nobody else wants.
    pub(crate) fn unwant(&self, places: &[(Path, u64)]) {
        let mut state = self.lock();
        for (path, serial) in places.iter().rev() {
            if state.places.unwant(path, *serial) {
                state.subscribers.close_within(path);
                // Without a link there is nothing to leave.
                let _ = self.ask_in(
                    &mut state,
                    verb(Family::Context, "leave", path),
                    &mut Some(AnswerTo::Nobody),
                );
            }
        }
        drop(state);
        self.outgoing.notify_one();
    }

    /// Joins a channel again, to be spared of something else than before.
    pub(crate) async fn thin(&self, path: &Path, thinning: Thinning) -> Result<(), ClientError> {
        let known = self.lock().places.terms(path);
        self.set_terms(path, Terms { thinning, ..known }).await
    }

    /// Joins a channel again, on other terms.
    pub(crate) async fn set_terms(&self, path: &Path, terms: Terms) -> Result<(), ClientError> {
        // An empty map too: without content the hub leaves everything as it was.
        let content = {
            let state = self.lock();
            let latch = state.places.latch(path);
            terms.map(&latch, &self.settings.installation, state.me.takes_cards)
        };
        let parcel = verb(Family::Context, "join", path).content(content);
        let reply = self.request(parcel).await?;
        let mut state = self.lock();
        state.places.set_terms(path, terms);
        if let Some(word) = state.places.first_word(path, &map_of(&reply)) {
            state.subscribers.deliver_only(path, &word);
        }
        Ok(())
    }

    /// Leaves a context and all below it.
    pub(crate) async fn leave(&self, path: &Path) -> Result<(), ClientError> {
        let asked = self.request(verb(Family::Context, "leave", path)).await;
        if asked.is_ok() {
            let mut state = self.lock();
            state.places.remove_within(path);
            state.subscribers.close_within(path);
        }
        asked.map(drop)
    }

    pub(crate) fn subscribe(&self, path: &Path) -> Arc<EventQueue> {
        let mut state = self.lock();
        let queue = state.subscribers.subscribe(path, self.settings.event_buffer);
        if matches!(state.status, Status::Closed(_)) {
            queue.close();
        }
        queue
    }

    pub(crate) fn subscribe_unaddressed(&self) -> Arc<EventQueue> {
        let mut state = self.lock();
        let queue = state
            .subscribers
            .subscribe_unaddressed(self.settings.event_buffer);
        if matches!(state.status, Status::Closed(_)) {
            queue.close();
        }
        queue
    }

    pub(crate) fn subscribe_consults(&self) -> Arc<EventQueue> {
        let mut state = self.lock();
        let queue = state.subscribers.subscribe_consults(self.settings.event_buffer);
        if matches!(state.status, Status::Closed(_)) {
            queue.close();
        }
        queue
    }

    pub(crate) fn unsubscribe(&self, queue: &Arc<EventQueue>) {
        self.lock().subscribers.unsubscribe(queue);
    }
}

/// The request to join a context on these terms.
pub(crate) fn join(path: &Path, terms: Option<Map>) -> Parcel {
    let parcel = verb(Family::Context, "join", path);
    match terms {
        Some(content) => parcel.content(content),
        None => parcel,
    }
}
