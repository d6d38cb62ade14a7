//! The life of a client: one link after another until it is closed.

use std::sync::Arc;
use std::time::Duration;

use mom_net::Transceiver;
use mom_proto::event as names;
use mom_proto::{Code, Family, Path, WireError};
use tokio::time::sleep;

use crate::link::connection;
use crate::link::login::Connector;
use crate::link::reconnect::{Attempts, Next};
use crate::peer::joins::join;
use crate::peer::pending::AnswerTo;
use crate::peer::shared::{Shared, verb};
use crate::peer::state::Status;
use crate::wire::link_secret::{Counted, LinkSecret};
use crate::wire::welcome::Welcome;
use crate::{ClientError, Event, LinkState, Lost, Reconnect};

/// Drives links until the client is closed; it reconnects in this way, if at all.
pub(crate) async fn run(
    shared: Arc<Shared>,
    connector: Connector,
    reconnect: Option<Reconnect>,
    first: Transceiver,
) {
    let mut transceiver = first;
    loop {
        let why = connection::run(&shared, transceiver).await;
        tracing::debug!(why, "link ended");
        let closing = shared.lock().closing.take();
        let reconnect = match (&reconnect, &closing) {
            _ if *shared.ending.borrow() => return shared.close(None),
            (_, Some(error)) if !error.code.may_reconnect() => return shared.close(closing),
            (None, _) => {
                let lost = closing.unwrap_or_else(|| WireError::new(Code::DISCONNECTED, why));
                return shared.close(Some(lost));
            }
            (Some(reconnect), _) => reconnect,
        };
        if !shared.suspend() {
            shared.lose_link(&why, true);
        }
        match again(&shared, &connector, reconnect).await {
            Ok(next) => transceiver = next,
            Err(error) => return shared.close(error),
        }
    }
}

/// Tries to connect until it succeeds, is refused for good, or takes too long. The link goes on as long as it can, and begins anew
/// else.
async fn again(
    shared: &Shared,
    connector: &Connector,
    reconnect: &Reconnect,
) -> Result<Transceiver, Option<WireError>> {
    let mut ending = shared.ending.subscribe();
    let mut attempts = Attempts::new(reconnect);
    let mut wait = attempts.wait(None);
    let mut attempt = 0;
    loop {
        let since = attempts.begin().into_std();
        let resumable = shared.resumable();
        shared.link.send_replace(match resumable {
            Some(_) => LinkState::Resuming { since, attempt },
            None => LinkState::Trying { since, attempt },
        });
        let attempted = async {
            sleep(wait).await;
            attempt_once(shared, connector, resumable.as_ref()).await
        };
        let grace = resumable.as_ref().map(|counted| counted.secret.grace);
        let left = grace.map(|grace| grace.saturating_sub(attempts.begin().elapsed()));
        let attempted = tokio::select! {
            attempted = attempted => attempted,
            // By then the hub has given the link up: an attempt that hangs must not keep anybody from knowing.
            () = sleep(left.unwrap_or_default()), if left.is_some() => {
                Err(ClientError::Connection("the grace time is over".to_owned()))
            }
            _ = ending.wait_for(|ending| *ending) => return Err(None),
        };
        let over = resumable.is_some_and(|counted| attempts.begin().elapsed() >= counted.secret.grace);
        let error = match attempted {
            Ok(Some(transceiver)) => return Ok(transceiver),
            Ok(None) => {
                // Nothing is left to resume: the next attempt is a login, and it is made at once.
                shared.lose_link("the link could not be resumed", true);
                wait = Duration::ZERO;
                continue;
            }
            Err(error) => error,
        };
        if over {
            shared.lose_link("the hub could not be reached within the grace time", true);
        }
        tracing::debug!(%error, attempt, "no link yet");
        attempt += 1;
        wait = match attempts.after(&error) {
            Next::Wait(wait) => wait,
            Next::Refused(error) => return Err(Some(error)),
            Next::TooLong(passed) => {
                let text = format!("gave up after {passed:?}: {error}");
                return Err(Some(WireError::new(Code::DISCONNECTED, text)));
            }
        };
    }
}

/// Connects once, to go on with the link or to begin anew; none if the link cannot go on.
async fn attempt_once(
    shared: &Shared,
    connector: &Connector,
    resumable: Option<&Counted>,
) -> Result<Option<Transceiver>, ClientError> {
    let after = shared.settings.connect_timeout;
    let Some(counted) = resumable else {
        let credentials = shared.credentials.lock().clone();
        let connected = connector.connect(&credentials, &shared.ids, after).await?;
        shared.credentials.lock().address = connector.address();
        shared.raise_link(connected.welcome);
        return Ok(Some(connected.transceiver));
    };
    let resumed = connector.resume(counted, &shared.ids, after).await;
    let (mut transceiver, resumption) = match resumed {
        Err(ClientError::Refused(error)) if [Code::NOT_RESUMED, Code::BAD_COUNT].contains(&error.code) => {
            return Ok(None);
        }
        resumed => resumed?,
    };
    transceiver.reader.know(shared.numbers());
    if shared.go_on(&resumption) {
        return Ok(Some(transceiver));
    }
    // What is lost on this side the hub must not wait for.
    let _ = transceiver
        .writer
        .send(verb(Family::Login, "logout", &Path::root()))
        .await;
    Ok(None)
}

impl Shared {
    /// The hub has not been heard of for a while, or has been again.
    pub(crate) fn note_stale(&self, heard: tokio::time::Instant, stale: bool) {
        self.link.send_if_modified(|link| match (&*link, stale) {
            (LinkState::Connected, true) => {
                let since = heard.into_std();
                *link = LinkState::Stale { since };
                true
            }
            (LinkState::Stale { .. }, false) => {
                *link = LinkState::Connected;
                true
            }
            _ => false,
        });
    }

    /// The link is gone: open requests get no answer, and tokens are lost (design §5).
    fn lose_link(&self, why: &str, link_is_gone: bool) {
        let mut state = self.lock();
        // Its hearers have heard that the connection is lost.
        let told = matches!(state.status, Status::Resuming);
        state.status = Status::Down;
        self.begin_link(&mut state, None);
        state.lose_holds(&Lost::new(names::Reason::Disconnected.word(), None));
        let unsent = state.outbox.clear(link_is_gone);
        let capacity = state.lose(&unsent);
        if !told {
            state.subscribers.deliver_all(&Event::LinkDown);
        }
        let joins = state.places.lose_link();
        let waiters = state.pending.take_all();
        drop(state);
        self.give_capacity(capacity);
        let error = ClientError::Connection(why.to_owned());
        for join in joins {
            drop(join.send(Err(error.clone())));
        }
        waiters.into_iter().for_each(|waiter| self.fail(waiter, &error));
    }

    /// The peer of this link has authenticated again. As another user it is another peer, and nothing of the old one
    /// belongs to it any more, as after a lost link.
    pub(crate) fn renew_login(&self, welcome: Welcome) {
        let mut state = self.lock();
        if state.me.user == welcome.user {
            state.me = Arc::new(welcome);
            return;
        }
        drop(state);
        self.lose_link("logged in as another user", false);
        self.raise_link(welcome);
    }

    /// The link is back: all wanted contexts are joined again before anything else is sent.
    fn raise_link(&self, welcome: Welcome) {
        let mut state = self.lock();
        state.status = Status::Up;
        self.begin_link(&mut state, LinkSecret::read(&welcome.content));
        state.me = Arc::new(welcome);
        let cards = state.me.takes_cards;
        let places = state.places.rejoin(&self.settings.installation, cards);
        state.rejoining = places.len();
        if places.is_empty() {
            state.subscribers.deliver_unaddressed(Event::Rejoined);
        }
        for (path, serial, terms) in places {
            let mut waiter = Some(AnswerTo::Join(path.clone(), serial));
            // The link is up, and a path that was joined before can be encoded.
            let _ = self.ask_in(&mut state, join(&path, terms), &mut waiter);
        }
        drop(state);
        self.link.send_replace(LinkState::Connected);
        self.outgoing.notify_one();
    }

    /// Nothing will come any more.
    fn close(&self, error: Option<WireError>) {
        let mut state = self.lock();
        state.status = Status::Closed(error.clone());
        state.lose_holds(&Lost::new(names::Reason::Disconnected.word(), None));
        state.outbox.clear(true);
        state.subscribers.close_all();
        let joins = state.places.lose_link();
        let waiters = state.pending.take_all();
        drop(state);
        self.close_capacity();
        let closed = ClientError::Closed(error.clone());
        for join in joins {
            drop(join.send(Err(closed.clone())));
        }
        waiters.into_iter().for_each(|waiter| self.fail(waiter, &closed));
        self.link.send_replace(LinkState::Closed(error));
    }
}
