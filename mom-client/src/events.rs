//! What a subscription gives.

use std::time::Duration;

use mom_proto::event as names;
use mom_proto::{Family, Parcel, Path, WireError};

use crate::info::{level, map_of, number, text};
use crate::{ContextInfo, Member};

/// Something that happened in a context or to the link.
///
/// ```
/// use mom_client::{Event, Member};
/// let event = Event::Joined(Member { peer: "ally".into(), user: "alice".into(), level: 1 });
/// assert!(matches!(event, Event::Joined(member) if member.user == "alice"));
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Event {
    /// A message, as the hub passed it on.
    Message(Parcel),
    /// A peer joined the context (M30).
    Joined(Member),
    /// A peer left it.
    Left(Member),
    /// So many are in it: what large contexts say instead of `Joined` and `Left`.
    Count(u64),
    /// A context was made in this session.
    Created(ContextInfo),
    /// This context, or one in this session, was deleted.
    Deleted {
        /// The one deleted.
        path: Path,
    },
    /// A token has a new owner.
    Grabbed {
        /// The peer that owns it now.
        owner: String,
        /// That peer's level.
        level: i32,
        /// The fence of this grant, higher than any before.
        fence: u64,
        /// How long it lasts without renewal; none = without end.
        lease: Option<Duration>,
        /// The token.
        path: Path,
    },
    /// A token's owner lost it or gave it back.
    Released {
        /// The peer that owned it.
        owner: String,
        /// Why, in one of the words of [`Reason`](crate::event::Reason).
        reason: String,
        /// The peer that caused it, if one did.
        by: Option<String>,
        /// The fence that is no more.
        fence: u64,
        /// The token.
        path: Path,
    },
    /// What this peer sent was dropped on its way.
    Dropped {
        /// Why.
        reason: String,
        /// How many parcels.
        count: u64,
        /// The event with all details.
        parcel: Parcel,
    },
    /// What this peer sent without waiting for an answer was refused; with the id of what was sent.
    Refused(WireError, Option<u64>),
    /// So many events were lost here because they were not taken in time.
    Lagged(u64),
    /// The link to the hub is lost; tokens are lost with it.
    LinkDown,
    /// The link is back and this context joined again.
    Rejoined,
    /// Any other parcel of the hub.
    Other(Parcel),
}

impl Event {
    /// Reads an event or message parcel; what is not understood stays a parcel.
    pub(crate) fn from_parcel(parcel: Parcel) -> Event {
        match parcel.family {
            Family::Message => Event::Message(parcel),
            Family::Event => match known(&parcel) {
                Some(event) => event,
                None => Event::Other(parcel),
            },
            _ => Event::Other(parcel),
        }
    }
}

fn known(parcel: &Parcel) -> Option<Event> {
    let map = map_of(parcel);
    let path = parcel.context.clone();
    let owned = |key| text(&map, key).map(str::to_owned);
    Some(match parcel.name() {
        names::JOINED | names::LEFT if map.contains_key("count") => Event::Count(number(&map, "count")?),
        names::JOINED => Event::Joined(Member::from_map(&map)?),
        names::LEFT => Event::Left(Member::from_map(&map)?),
        names::CREATED => Event::Created(ContextInfo::from_map(&map)?),
        names::DELETED => Event::Deleted { path: path? },
        names::GRABBED => Event::Grabbed {
            owner: owned("owner")?,
            level: level(&map, "level").unwrap_or_default(),
            fence: number(&map, "fence")?,
            lease: number(&map, "lease").map(Duration::from_millis),
            path: path?,
        },
        names::RELEASED => Event::Released {
            owner: owned("owner")?,
            reason: owned("reason").unwrap_or_default(),
            by: owned("by"),
            fence: number(&map, "fence")?,
            path: path?,
        },
        names::DROPPED => Event::Dropped {
            reason: owned("reason").unwrap_or_default(),
            count: number(&map, "count")?,
            parcel: parcel.clone(),
        },
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use mom_proto::Map;

    use super::*;

    fn check(name: &str, content: Map, expected: impl FnOnce(Parcel) -> Event) {
        let path = Path::parse("/robot/token").unwrap();
        let parcel = Parcel::new(Family::Event, name).context(path).content(content);
        assert_eq!(Event::from_parcel(parcel.clone()), expected(parcel), "{name}");
    }

    #[test]
    fn events_are_read() {
        let path = || Path::parse("/robot/token").unwrap();
        let alice = || {
            Map::new()
                .with("peer", "ally")
                .with("user", "alice")
                .with("level", 1)
        };
        let member = || Member {
            peer: "ally".to_owned(),
            user: "alice".to_owned(),
            level: 1,
        };
        check("joined", alice(), |_| Event::Joined(member()));
        check("left", alice(), |_| Event::Left(member()));
        check("joined", Map::new().with("count", 201), |_| Event::Count(201));
        check("deleted", Map::new(), |_| Event::Deleted { path: path() });
        let created = Map::new()
            .with("path", "/robot/arm")
            .with("kind", "channel")
            .with("number", 7);
        check("created", created, |_| {
            Event::Created(ContextInfo {
                path: Path::parse("/robot/arm").unwrap(),
                kind: mom_proto::ContextKind::Channel,
                number: 7,
                members: None,
            })
        });
        let grabbed = Map::new()
            .with("owner", "ally")
            .with("level", 1)
            .with("fence", 3)
            .with("lease", 50);
        check("grabbed", grabbed, |_| Event::Grabbed {
            owner: "ally".to_owned(),
            level: 1,
            fence: 3,
            lease: Some(Duration::from_millis(50)),
            path: path(),
        });
        let released = Map::new()
            .with("owner", "ally")
            .with("reason", "preempted")
            .with("by", "carol")
            .with("fence", 3);
        check("released", released, |_| Event::Released {
            owner: "ally".to_owned(),
            reason: "preempted".to_owned(),
            by: Some("carol".to_owned()),
            fence: 3,
            path: path(),
        });
        check(
            "dropped",
            Map::new().with("reason", "expired").with("count", 4),
            |parcel| Event::Dropped {
                reason: "expired".to_owned(),
                count: 4,
                parcel,
            },
        );
    }

    #[test]
    fn what_is_not_understood_stays_a_parcel() {
        for (name, content) in [
            ("from-the-future", Map::new()),
            ("joined", Map::new().with("peer", 3)),
            ("grabbed", Map::new().with("owner", "ally").with("fence", -1)),
            ("released", Map::new().with("fence", 3)),
            ("dropped", Map::new()),
        ] {
            check(name, content, Event::Other);
        }
    }
}
