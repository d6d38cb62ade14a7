//! What peers say that do not own a token, but may be the owner's user under another name: one person may have several programs.

use std::collections::BTreeMap;

use mom_client::Parcel;

/// The most parcels that wait until it is known whose they are.
pub const MOST_WAITING: usize = 16;
/// All guests are this one user to the hub, and yet not one person.
const GUEST: &str = "guest";

/// Parcels that wait until the hub has said whose they are.
#[derive(Debug, Default)]
pub struct Others {
    /// Nobody has asked yet whose they are.
    new: Vec<Parcel>,
    /// The hub is being asked.
    asked: Vec<Parcel>,
}

impl Others {
    /// Keeps a parcel; false where [`MOST_WAITING`] wait already.
    pub fn keep(&mut self, parcel: &Parcel) -> bool {
        let has_room = self.new.len() < MOST_WAITING;
        if has_room {
            self.new.push(parcel.clone());
        }
        has_room
    }

    /// Whether the hub is to be asked now, once for all that wait; [`Others::take`] has to follow its answer.
    pub fn ask(&mut self) -> bool {
        if self.new.is_empty() || !self.asked.is_empty() {
            return false;
        }
        self.asked = std::mem::take(&mut self.new);
        true
    }

    /// The parcels that the hub was asked about.
    pub fn take(&mut self) -> Vec<Parcel> {
        std::mem::take(&mut self.asked)
    }
}

/// Whether both peers are one person, by the users of all peers. The hub made both names, so that nobody can pretend to be another.
#[must_use]
pub fn are_one(users: &BTreeMap<String, String>, one: &str, other: &str) -> bool {
    let user = users.get(one).filter(|user| *user != GUEST);
    user.is_some() && user == users.get(other)
}

#[cfg(test)]
mod tests {
    use mom_client::Family;

    use super::*;

    #[test]
    fn guests_and_strangers_are_nobody_twice() {
        let users = [
            ("a", "alice"),
            ("a~2", "alice"),
            ("b", "bob"),
            ("g", "guest"),
            ("h", "guest"),
        ];
        let users = users
            .map(|(peer, user)| (peer.to_owned(), user.to_owned()))
            .into();
        for (one, other, expected) in [
            ("a", "a~2", true),
            ("a", "b", false),
            ("g", "h", false),
            ("a", "nobody", false),
            ("nobody", "nobody", false),
        ] {
            assert_eq!(are_one(&users, one, other), expected, "{one} {other}");
            assert_eq!(are_one(&users, other, one), expected, "{other} {one}");
        }
    }

    #[test]
    fn one_question_is_asked_at_a_time() {
        let parcel = Parcel::new(Family::Message, "write");
        let mut others = Others::default();
        assert!(!others.ask() && others.keep(&parcel) && others.ask());
        assert!(others.keep(&parcel) && !others.ask());
        assert_eq!(others.take().len(), 1);
        for _ in 1..MOST_WAITING {
            assert!(others.keep(&parcel));
        }
        assert!(!others.keep(&parcel) && others.ask());
        assert_eq!((others.take().len(), others.take().len()), (MOST_WAITING, 0));
    }
}
