//! Who may be here: how many connections there are, how many of them have not logged in, from one address, of one user.
//!
//! A stranger who opens connections and says nothing must not keep others out, so it is never the newcomer who is turned
//! away while a stranger can be closed: of the address that has too many, else of all.

use std::collections::{BTreeSet, HashMap};
use std::net::IpAddr;
use std::sync::{Arc, Weak};

use mom_config::ConnectionCaps;
use mom_login::network;
use mom_proto::{Code, WireError};
use parking_lot::Mutex;
use tokio::sync::oneshot;

use crate::traffic::outbox::Outbox;

/// All connections from outside.
#[derive(Debug)]
pub(crate) struct AdmissionLimiter {
    caps: ConnectionCaps,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    closed: bool,
    /// Connections that are here, without those that were told to go.
    here: usize,
    /// Those that have not logged in, by the order of their arrival.
    strangers: HashMap<u64, Stranger>,
    /// Those of them that may be closed.
    idle: BTreeSet<u64>,
    /// The same by address.
    crowds: HashMap<IpAddr, Crowd>,
    /// The number of connections of each user.
    users: HashMap<Arc<str>, usize>,
    last: u64,
}

/// A connection that has not logged in.
#[derive(Debug)]
struct Stranger {
    from: IpAddr,
    reached: Reached,
}

/// How it is told to go.
#[derive(Debug)]
enum Reached {
    /// It has not said in which form it speaks.
    Greeting(oneshot::Sender<WireError>),
    Begun(Weak<Outbox>),
}

/// The strangers of one address.
#[derive(Debug, Default)]
struct Crowd {
    count: usize,
    idle: BTreeSet<u64>,
}

/// A connection that has to go.
#[must_use]
#[derive(Debug)]
pub(crate) struct Evicted(Stranger);

/// The part of one connection in the counts, until it is dropped.
#[derive(Debug)]
pub(crate) struct Seat {
    doors: Arc<AdmissionLimiter>,
    id: u64,
    /// Who has logged in.
    user: Option<Arc<str>>,
}

/// A peer that has lost its connection, and counts as one of its user until it is back or gone.
#[derive(Debug)]
pub(super) struct UserPlace {
    doors: Arc<AdmissionLimiter>,
    /// None once another connection counts in its place.
    user: Option<Arc<str>>,
}

impl Drop for UserPlace {
    fn drop(&mut self) {
        if let Some(user) = &self.user {
            self.doors.state.lock().leave(user);
        }
    }
}

impl AdmissionLimiter {
    pub(crate) fn new(caps: ConnectionCaps) -> AdmissionLimiter {
        AdmissionLimiter {
            caps,
            state: Mutex::default(),
        }
    }

    /// Lets nobody in any more.
    pub(crate) fn close(&self) {
        self.state.lock().closed = true;
    }

    /// Whether nobody else is let in, not even for another who has not logged in.
    pub(crate) fn is_full(&self) -> bool {
        let state = self.state.lock();
        state.closed || (state.here >= self.caps.all && state.idle.is_empty())
    }

    /// Connections, and those of them that have not logged in.
    pub(crate) fn counts(&self) -> (usize, usize) {
        let state = self.state.lock();
        (state.here, state.strangers.len())
    }

    /// Takes in a connection, and gives what it is told if it has to go before it has begun, and who has to go for it.
    ///
    /// # Errors
    /// `too-many-connections` if nobody can go for it.
    pub(crate) fn enter(
        self: &Arc<AdmissionLimiter>,
        from: IpAddr,
    ) -> Result<(Seat, oneshot::Receiver<WireError>, Option<Evicted>), WireError> {
        let from = network(from);
        let mut state = self.state.lock();
        if state.closed {
            return Err(full("this hub accepts no more connections"));
        }
        let crowd = state.crowds.get(&from);
        let oldest = if crowd.is_some_and(|crowd| crowd.count >= self.caps.per_address) {
            Some(crowd.and_then(|crowd| crowd.idle.first().copied()))
        } else if state.strangers.len() >= self.caps.before_login || state.here >= self.caps.all {
            Some(state.idle.first().copied())
        } else {
            None
        };
        let evicted = match oldest {
            Some(Some(oldest)) => {
                state.here -= 1;
                state.remove(oldest).map(Evicted)
            }
            Some(None) => return Err(full("this hub has reached its connection limit")),
            None => None,
        };
        state.last += 1;
        let id = state.last;
        let (tell, told) = oneshot::channel();
        let reached = Reached::Greeting(tell);
        state.here += 1;
        state.strangers.insert(id, Stranger { from, reached });
        state.idle.insert(id);
        let crowd = state.crowds.entry(from).or_default();
        crowd.count += 1;
        crowd.idle.insert(id);
        let seat = Seat {
            doors: Arc::clone(self),
            id,
            user: None,
        };
        Ok((seat, told, evicted))
    }
}

impl State {
    fn remove(&mut self, id: u64) -> Option<Stranger> {
        let stranger = self.strangers.remove(&id)?;
        self.idle.remove(&id);
        if let Some(crowd) = self.crowds.get_mut(&stranger.from) {
            crowd.count -= 1;
            crowd.idle.remove(&id);
            if crowd.count == 0 {
                self.crowds.remove(&stranger.from);
            }
        }
        Some(stranger)
    }

    fn leave(&mut self, user: &Arc<str>) {
        if let Some(count) = self.users.get_mut(user) {
            *count -= 1;
            if *count == 0 {
                self.users.remove(user);
            }
        }
    }
}

impl Evicted {
    /// Tells it to go; `close` ends a connection that has begun.
    pub(crate) fn tell(self, close: impl FnOnce(&Outbox, WireError)) {
        match self.0.reached {
            // It may have begun or ended by itself meanwhile.
            Reached::Greeting(tell) => drop(tell.send(evicted())),
            Reached::Begun(outbox) => {
                if let Some(outbox) = outbox.upgrade() {
                    close(&outbox, evicted());
                }
            }
        }
    }
}

impl Seat {
    /// Notes that the connection has an outbox.
    ///
    /// # Errors
    /// If it has to go.
    pub(super) fn begin(&self, outbox: &Arc<Outbox>) -> Result<(), WireError> {
        let mut state = self.doors.state.lock();
        let stranger = state.strangers.get_mut(&self.id).ok_or_else(evicted)?;
        stranger.reached = Reached::Begun(Arc::downgrade(outbox));
        Ok(())
    }

    /// Its proof is being checked: nobody else's arrival ends it meanwhile. Few are checked at a time.
    ///
    /// # Errors
    /// If it was told to go already, and is not counted any more.
    pub(super) fn prove(&self) -> Result<(), WireError> {
        self.set_proving(true);
        if self.was_evicted() {
            return Err(evicted());
        }
        Ok(())
    }

    /// The proof was checked.
    pub(super) fn proved(&self) {
        self.set_proving(false);
    }

    fn set_proving(&self, proving: bool) {
        let mut state = self.doors.state.lock();
        let State {
            strangers,
            idle,
            crowds,
            ..
        } = &mut *state;
        let Some(crowd) = strangers
            .get(&self.id)
            .and_then(|stranger| crowds.get_mut(&stranger.from))
        else {
            return;
        };
        if proving {
            idle.remove(&self.id);
            crowd.idle.remove(&self.id);
        } else {
            idle.insert(self.id);
            crowd.idle.insert(self.id);
        }
    }

    /// Counts the connection as one of a user.
    ///
    /// # Errors
    /// `too-many-connections` if the user has as many as one may have, or this one has to go already.
    pub(crate) fn log_in(&mut self, user: &str) -> Result<(), WireError> {
        if self.user.as_deref() == Some(user) {
            return Ok(());
        }
        let mut state = self.doors.state.lock();
        let most = self.doors.caps.per_user;
        if state.users.get(user).is_some_and(|count| *count >= most) {
            let text =
                format!("{user} already has {most} connections, the limit for one user; close one first");
            return Err(full(&text).rule("connections-per-user"));
        }
        match &self.user {
            Some(user) => state.leave(user),
            None => drop(state.remove(self.id).ok_or_else(evicted)?),
        }
        // All connections of a user share its name.
        let known = state.users.get_key_value(user);
        let user: Arc<str> = known.map_or_else(|| user.into(), |(known, _)| Arc::clone(known));
        *state.users.entry(Arc::clone(&user)).or_default() += 1;
        self.user = Some(user);
        Ok(())
    }

    /// The connection is lost, and its peer may come back; none if nobody has logged in.
    pub(super) fn park(mut self) -> Option<UserPlace> {
        let user = self.user.take()?;
        self.doors.state.lock().here -= 1;
        Some(UserPlace {
            doors: Arc::clone(&self.doors),
            user: Some(user),
        })
    }

    /// Counts in the place of a peer that has come back over this connection.
    pub(super) fn take_over(&mut self, mut place: UserPlace) {
        // Its proof was being checked, so nobody has told it to go: it still counts.
        drop(self.doors.state.lock().remove(self.id));
        self.user = place.user.take();
    }

    /// Whether nobody has logged in.
    pub(crate) fn is_stranger(&self) -> bool {
        self.user.is_none()
    }

    /// Whether it was told to go because it has not logged in.
    pub(super) fn was_evicted(&self) -> bool {
        self.user.is_none() && !self.doors.state.lock().strangers.contains_key(&self.id)
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        let mut state = self.doors.state.lock();
        match &self.user {
            Some(user) => {
                state.here -= 1;
                state.leave(user);
            }
            // Who was told to go is not counted any more.
            None => state.here -= usize::from(state.remove(self.id).is_some()),
        }
    }
}

pub(crate) fn full(text: &str) -> WireError {
    WireError::new(Code::TOO_MANY_CONNECTIONS, text)
}

fn evicted() -> WireError {
    full("too many connections have not logged in, and this was the oldest of them; log in at once next time")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn doors(all: usize, before_login: usize, per_address: usize, per_user: usize) -> Arc<AdmissionLimiter> {
        Arc::new(AdmissionLimiter::new(ConnectionCaps {
            all,
            before_login,
            per_address,
            per_user,
        }))
    }

    fn address(number: u8) -> IpAddr {
        IpAddr::from([10, 0, 0, number])
    }

    type Guest = (Seat, oneshot::Receiver<WireError>);

    /// Lets a connection in, for which another may be told to go.
    fn enter(doors: &Arc<AdmissionLimiter>, from: u8) -> Guest {
        let (seat, told, evicted) = doors.enter(address(from)).expect("let in");
        if let Some(evicted) = evicted {
            evicted.tell(|_, _| panic!("none has begun"));
        }
        (seat, told)
    }

    fn was_told(guest: &mut Guest) -> bool {
        let told = guest.1.try_recv().is_ok();
        assert_eq!(told, guest.0.was_evicted());
        told
    }

    #[test]
    fn the_oldest_stranger_goes() {
        let doors = doors(100, 4, 3, 100);
        let mut guests: Vec<Guest> = [1, 2, 2, 2].map(|from| enter(&doors, from)).into();
        let more = enter(&doors, 2);
        assert!(was_told(&mut guests[1]), "the oldest of that address");
        let other = enter(&doors, 3);
        assert!(was_told(&mut guests[0]), "the oldest of all");
        assert!(!was_told(&mut guests[2]) && !was_told(&mut guests[3]));
        guests[2].0.log_in("alice").expect("here in time");
        let last = enter(&doors, 4);
        assert!(!was_told(&mut guests[3]), "one less is a stranger");
        let error = guests[0].0.log_in("bob").expect_err("too late");
        assert_eq!(error.code, Code::TOO_MANY_CONNECTIONS);
        drop((guests, more, other, last));
        let state = doors.state.lock();
        assert_eq!((state.here, state.strangers.len(), state.idle.len()), (0, 0, 0));
        assert!(state.crowds.is_empty() && state.users.is_empty());
    }

    #[test]
    fn strangers_make_way_in_a_full_house_and_peers_do_not() {
        let doors = doors(3, 3, 3, 3);
        let mut guests: Vec<Guest> = [1, 2, 3].map(|from| enter(&doors, from)).into();
        guests[0].0.log_in("alice").expect("let in");
        let mut fourth = enter(&doors, 4);
        assert!(was_told(&mut guests[1]));
        guests[2].0.log_in("bob").expect("let in");
        fourth.0.log_in("carol").expect("let in");
        assert_eq!(
            doors.enter(address(5)).expect_err("full").code,
            Code::TOO_MANY_CONNECTIONS
        );
        drop(fourth);
        let fifth = enter(&doors, 5);
        fifth.0.prove().expect("here in time");
        assert!(doors.enter(address(6)).is_err(), "its proof is being checked");
        fifth.0.proved();
        enter(&doors, 6);
        doors.close();
        assert!(doors.enter(address(7)).is_err());
    }

    /// What is counted down when it is told to go would be counted down again when it ends as the peer of a link.
    #[test]
    fn who_was_told_to_go_resumes_nothing() {
        let doors = doors(3, 3, 3, 3);
        let mut first = enter(&doors, 1);
        first.0.log_in("alice").expect("let in");
        let place = first.0.park().expect("a user");
        let back = enter(&doors, 1);
        let mut others: Vec<Guest> = [2, 3, 4].map(|from| enter(&doors, from)).into();
        let error = back.0.prove().expect_err("it has to go");
        assert_eq!(error.code, Code::TOO_MANY_CONNECTIONS);
        drop(back);
        others[0].0.prove().expect("here in time");
        others[0].0.take_over(place);
        drop(others);
        assert_eq!(doors.counts(), (0, 0));
    }

    #[test]
    fn one_user_has_so_many() {
        let doors = doors(10, 10, 10, 2);
        let mut guests: Vec<Guest> = (0..4).map(|from| enter(&doors, from)).collect();
        for guest in &mut guests[..2] {
            guest.0.log_in("guest").expect("let in");
            guest.0.log_in("guest").expect("again");
        }
        let error = guests[2].0.log_in("guest").expect_err("one more");
        assert!(
            error.to_string().contains("guest already has 2 connections"),
            "{error}"
        );
        guests[2].0.log_in("alice").expect("others are not concerned");
        guests[0].0.log_in("alice").expect("as another user");
        guests[3].0.log_in("guest").expect("so that there is a place");
    }
}
