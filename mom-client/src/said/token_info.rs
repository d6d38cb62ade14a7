//! A token's state as the hub describes it, typed.

use std::time::Duration;

use mom_proto::{Map, Value};

use crate::Member;
use crate::words::{level, millis_of, name_list, number, owned};

/// A token's owner, queue, offers and requests (M33).
///
/// ```
/// use mom_client::{Map, TokenInfo};
/// let info = TokenInfo::read(&Map::new().with("owner", "ally").with("fence", 7).with("lease-left", 1500));
/// assert_eq!((info.owner.as_deref(), info.lease_left.unwrap().as_millis()), (Some("ally"), 1500));
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct TokenInfo {
    /// The peer that owns it; none = nobody does.
    pub owner: Option<String>,
    /// The level that defends it: the owner's, or the giver's if higher.
    pub owner_level: Option<i32>,
    /// The highest fence issued.
    pub fence: u64,
    /// How long its owner has owned it.
    pub held: Option<Duration>,
    /// How long a grant lasts without renewal; none = unlimited.
    pub lease: Option<Duration>,
    /// The remainder of the lease.
    pub lease_left: Option<Duration>,
    /// The deadman time, after which it is lost without a renewal; none = no such limit.
    pub deadman: Option<Duration>,
    /// What happens at the end of the lease: `lazy` or `eager`.
    pub expiry: Option<String>,
    /// The peers that hold it together, so that nobody owns it.
    pub holders: Vec<String>,
    /// The peers that wait for it, the next one first.
    pub queue: Vec<Waiting>,
    /// The peer that it is offered to.
    pub offer: Option<Offered>,
    /// The peers that have asked the owner for it.
    pub requests: Vec<Asking>,
    /// The loan, if another peer gave it to the owner for a while.
    pub delegated: Option<Delegated>,
    /// The reservation after a restart of the hub.
    pub reserved: Option<Reserved>,
}

/// A peer that waits for a token.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Waiting {
    /// Who.
    pub member: Member,
    /// How long it has waited.
    pub waiting: Duration,
}

/// A peer that a token is offered to.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Offered {
    /// Who.
    pub to: String,
    /// How long it may still take to accept.
    pub within: Duration,
    /// It returns by itself after this time.
    pub time: Option<Duration>,
    /// It returns by itself after so many guarded messages.
    pub commands: Option<u64>,
}

/// A peer that has asked a token's owner for it.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Asking {
    /// Who.
    pub peer: String,
    /// How long the owner may still take to answer.
    pub within: Duration,
}

/// An ownership that returns to its giver.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Delegated {
    /// The peer that gave it.
    pub from: String,
    /// The remaining time; none = unlimited.
    pub left: Option<Duration>,
    /// The remaining guarded messages; none = unlimited.
    pub commands: Option<u64>,
}

/// A token reserved, after a restart of the hub, for its earlier owner.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Reserved {
    /// That peer; none = unknown, so nobody can have it yet.
    pub peer: Option<String>,
    /// Its user.
    pub user: Option<String>,
    /// For how long.
    pub time: Duration,
}

impl TokenInfo {
    /// Reads what [`Client::info`](crate::Client::info) gives; absent keys are empty.
    pub fn read(info: &Map) -> TokenInfo {
        TokenInfo {
            owner: owned(info, "owner"),
            owner_level: level(info, "owner-level"),
            fence: number(info, "fence").unwrap_or_default(),
            held: millis_of(info, "held"),
            lease: millis_of(info, "lease"),
            lease_left: millis_of(info, "lease-left"),
            deadman: millis_of(info, "deadman"),
            expiry: owned(info, "expiry"),
            holders: name_list(info, "holders"),
            queue: list(info, "queue", Waiting::read),
            offer: map(info, "offer").and_then(Offered::read),
            requests: list(info, "requests", Asking::read),
            delegated: map(info, "delegated").and_then(Delegated::read),
            reserved: map(info, "reserved").map(Reserved::read),
        }
    }
}

impl Waiting {
    fn read(map: &Map) -> Option<Waiting> {
        Some(Waiting {
            member: Member::from_map(map)?,
            waiting: millis_of(map, "waiting").unwrap_or_default(),
        })
    }
}

impl Offered {
    fn read(map: &Map) -> Option<Offered> {
        Some(Offered {
            to: owned(map, "to")?,
            within: millis_of(map, "within").unwrap_or_default(),
            time: millis_of(map, "for"),
            commands: number(map, "commands"),
        })
    }
}

impl Asking {
    fn read(map: &Map) -> Option<Asking> {
        Some(Asking {
            peer: owned(map, "peer")?,
            within: millis_of(map, "within").unwrap_or_default(),
        })
    }
}

impl Delegated {
    fn read(map: &Map) -> Option<Delegated> {
        Some(Delegated {
            from: owned(map, "from")?,
            left: millis_of(map, "left"),
            commands: number(map, "commands"),
        })
    }
}

impl Reserved {
    fn read(map: &Map) -> Reserved {
        Reserved {
            peer: owned(map, "peer"),
            user: owned(map, "user"),
            time: millis_of(map, "for").unwrap_or_default(),
        }
    }
}

fn map<'a>(info: &'a Map, key: &str) -> Option<&'a Map> {
    info.get(key).and_then(Value::as_map)
}

fn list<T>(info: &Map, key: &str, read: impl Fn(&Map) -> Option<T>) -> Vec<T> {
    let list = info.get(key).and_then(Value::as_list).unwrap_or_default();
    list.iter()
        .filter_map(|item| item.as_map().and_then(&read))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(seconds: i64) -> Option<Duration> {
        u64::try_from(seconds).ok().map(Duration::from_secs)
    }

    #[test]
    fn an_ownership_is_read() {
        let info = Map::new()
            .with("owner", "ally")
            .with("owner-level", 3)
            .with("held", 61_000)
            .with("lease", 180_000)
            .with("lease-left", 120_000)
            .with("deadman", 2000)
            .with("expiry", "lazy")
            .with("fence", 9)
            .with(
                "delegated",
                Map::new()
                    .with("from", "carol")
                    .with("left", 5000)
                    .with("commands", 3),
            );
        let expected = TokenInfo {
            owner: Some("ally".to_owned()),
            owner_level: Some(3),
            fence: 9,
            held: seconds(61),
            lease: seconds(180),
            lease_left: seconds(120),
            deadman: seconds(2),
            expiry: Some("lazy".to_owned()),
            delegated: Some(Delegated {
                from: "carol".to_owned(),
                left: seconds(5),
                commands: Some(3),
            }),
            ..TokenInfo::default()
        };
        assert_eq!(TokenInfo::read(&info), expected);
    }

    #[test]
    fn who_wants_it_is_read() {
        let bob = Map::new()
            .with("peer", "bob~2")
            .with("user", "bob")
            .with("level", 1);
        let offer = Map::new()
            .with("to", "bob")
            .with("within", 9000)
            .with("for", 60_000);
        let asking = Map::new().with("peer", "bob~2").with("within", 7000);
        let kept = Map::new()
            .with("user", "dan")
            .with("peer", "dan~2")
            .with("for", 30_000);
        let info = Map::new()
            .with("holders", vec!["carol".into(), "dan".into()])
            .with("queue", vec![bob.with("waiting", 4000).into()])
            .with("offer", offer)
            .with("requests", vec![asking.into()])
            .with("reserved", kept);
        let expected = TokenInfo {
            holders: vec!["carol".to_owned(), "dan".to_owned()],
            queue: vec![Waiting {
                member: Member {
                    peer: "bob~2".to_owned(),
                    user: "bob".to_owned(),
                    level: 1,
                    device: false,
                },
                waiting: Duration::from_secs(4),
            }],
            offer: Some(Offered {
                to: "bob".to_owned(),
                within: Duration::from_secs(9),
                time: seconds(60),
                commands: None,
            }),
            requests: vec![Asking {
                peer: "bob~2".to_owned(),
                within: Duration::from_secs(7),
            }],
            reserved: Some(Reserved {
                peer: Some("dan~2".to_owned()),
                user: Some("dan".to_owned()),
                time: Duration::from_secs(30),
            }),
            ..TokenInfo::default()
        };
        assert_eq!(TokenInfo::read(&info), expected);
    }

    #[test]
    fn what_is_missing_is_empty() {
        let free = Map::new().with("fence", 2).with("lease-left", Value::Null);
        let expected = TokenInfo {
            fence: 2,
            ..TokenInfo::default()
        };
        assert_eq!(TokenInfo::read(&free), expected);
    }
}
