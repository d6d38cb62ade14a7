//! The events of a subscription.

use std::time::Duration;

use mom_proto::event as names;
use mom_proto::{ContextKind, Family, Map, Parcel, Path, WireError};

use crate::words::{level, map_of, millis_of, name_list, number, owned, text};
use crate::{ContextInfo, Member, StopState};

#[cfg(test)]
mod tests;

/// Something that happened in a context or to the link.
///
/// ```
/// use mom_client::{Event, Member};
/// let alice = Member { peer: "ally".into(), user: "alice".into(), level: 1, device: false };
/// let event = Event::Joined(alice);
/// assert!(matches!(event, Event::Joined(member) if member.user == "alice"));
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Event {
    /// A message, as the hub forwarded it.
    Message(Parcel),
    /// A peer joined the context (M30).
    Joined(Member),
    /// A peer left it.
    Left(Member),
    /// The number of members: large contexts report it instead of `Joined` and `Left`.
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
        /// How long it lasts without renewal; none = unlimited.
        lease: Option<Duration>,
        /// The token.
        path: Path,
    },
    /// A token's owner lost it or gave it back.
    Released {
        /// The peer that owned it.
        owner: String,
        /// The reason, one of the words of [`Reason`](crate::event::Reason).
        reason: String,
        /// The peer that caused it, if one did.
        by: Option<String>,
        /// The fence that has ended.
        fence: u64,
        /// The token.
        path: Path,
    },
    /// A peer asks the owner of a token for it: answer with
    /// [`Token::accept_request`](crate::Token::accept_request) or
    /// [`Token::decline_request`](crate::Token::decline_request).
    Requested {
        /// Who asks.
        member: Member,
        /// How long the owner may take to answer.
        within: Duration,
        /// Why, in its words.
        text: Option<String>,
        /// The token.
        path: Path,
    },
    /// A token's owner offers it to a peer, which answers with [`Token::accept`](crate::Token::accept) or
    /// [`Token::decline`](crate::Token::decline).
    Offer {
        /// The owner.
        by: String,
        /// The peer that it is offered to.
        to: String,
        /// The owner's level.
        level: i32,
        /// How long the other may take to accept.
        within: Duration,
        /// The fence of the owner.
        fence: u64,
        /// It returns by itself after this time.
        time: Option<Duration>,
        /// It returns by itself after so many guarded messages.
        commands: Option<u64>,
        /// The token.
        path: Path,
    },
    /// An offer or a request came to nothing.
    Lapsed {
        /// `offer` or `request`.
        what: String,
        /// Who offered or asked.
        by: String,
        /// Who was to accept.
        to: String,
        /// `declined`, `timed-out`, `withdrawn`, `lost` or `left`.
        reason: String,
        /// The token.
        path: Path,
    },
    /// A grab of this peer waits in the queue of a token.
    Queued {
        /// 1 for the next.
        place: u64,
        /// Until its turn, if nobody before it renews.
        expected: Option<Duration>,
        /// The token.
        path: Path,
    },
    /// A peer has joined the shared hold of a token, which nobody owns.
    Inhibited {
        /// The peer that takes part now.
        peer: String,
        /// All that do.
        holders: Vec<String>,
        /// The token.
        path: Path,
    },
    /// A peer has left the shared hold of a token.
    Uninhibited {
        /// The peer that took part.
        peer: String,
        /// All that still do.
        holders: Vec<String>,
        /// Why it ended.
        reason: String,
        /// The token.
        path: Path,
    },
    /// This peer is invited to a context.
    Invited {
        /// By whom.
        by: String,
        /// Its kind, if the hub says so.
        kind: Option<ContextKind>,
        /// Where it is.
        path: Path,
    },
    /// A peer was expelled from a context; if it is this one, its proxies there are unusable.
    Expelled {
        /// The peer.
        peer: String,
        /// By whom.
        by: Option<String>,
        /// Why, in that one's words.
        text: Option<String>,
        /// The context.
        path: Path,
    },
    /// How the devices of this channel stand by the hub's books: when this peer joins as a device or has come back, before anything
    /// else, and where a stop began or ended without a message to this peer.
    Stops(StopState),
    /// Parcels of this peer were dropped on their way.
    Dropped {
        /// Why.
        reason: String,
        /// How many parcels.
        count: u64,
        /// The event with all details.
        parcel: Parcel,
    },
    /// A parcel that this peer sent without awaiting an answer was refused; with its id.
    Refused(WireError, Option<u64>),
    /// The number of events that were dropped here because they were not taken in time.
    Lagged(u64),
    /// The connection to the hub is lost. Tokens are lost with it, unless [`Resumed`](Event::Resumed) comes next.
    LinkDown,
    /// The link goes on over another connection: nothing was lost but what [`Dropped`](Event::Dropped) tells. Tokens are still held,
    /// as far as their leases have not ended; the devices that they move were halted.
    Resumed,
    /// The link is back and this context joined again.
    Rejoined,
    /// Any other parcel of the hub.
    Other(Parcel),
}

impl Event {
    /// Whether the hub has not told this peer of others, for want of room: who has joined or left since, or what was made, is not known.
    pub fn is_gap(&self) -> bool {
        let of_hub = |parcel: &Parcel| {
            let content = map_of(parcel);
            text(&content, "sender") == Some(mom_proto::HUB)
        };
        matches!(self, Event::Dropped { parcel, .. } if of_hub(parcel))
    }

    /// Reads an event or message parcel; an unknown one stays a parcel.
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
    Some(match parcel.name() {
        names::JOINED | names::LEFT if map.contains_key("count") => Event::Count(number(&map, "count")?),
        names::JOINED => Event::Joined(Member::from_map(&map)?),
        names::LEFT => Event::Left(Member::from_map(&map)?),
        names::CREATED => Event::Created(ContextInfo::from_map(&map)?),
        names::DELETED => Event::Deleted { path: path? },
        names::INVITED => Event::Invited {
            by: owned(&map, "by")?,
            kind: text(&map, "kind").and_then(ContextKind::from_word),
            // The parcel's own context may be one that this peer is in.
            path: text(&map, "path")
                .and_then(|path| Path::parse(path).ok())
                .or(path)?,
        },
        names::EXPELLED => Event::Expelled {
            peer: owned(&map, "peer")?,
            by: owned(&map, "by"),
            text: owned(&map, "text"),
            path: path?,
        },
        names::STOPPED | names::UNSTOPPED => Event::Stops(StopState::from_map(&map)),
        names::DROPPED => Event::Dropped {
            reason: owned(&map, "reason").unwrap_or_default(),
            count: number(&map, "count")?,
            parcel: parcel.clone(),
        },
        name => return of_token(name, &map, path?),
    })
}

fn of_token(name: &str, map: &Map, path: Path) -> Option<Event> {
    Some(match name {
        names::GRABBED => Event::Grabbed {
            owner: owned(map, "owner")?,
            level: level(map, "level").unwrap_or_default(),
            fence: number(map, "fence")?,
            lease: millis_of(map, "lease"),
            path,
        },
        names::RELEASED => Event::Released {
            owner: owned(map, "owner")?,
            reason: owned(map, "reason").unwrap_or_default(),
            by: owned(map, "by"),
            fence: number(map, "fence")?,
            path,
        },
        names::REQUESTED => Event::Requested {
            member: Member::from_map(map)?,
            within: millis_of(map, "within").unwrap_or_default(),
            text: owned(map, "text"),
            path,
        },
        names::OFFER => Event::Offer {
            by: owned(map, "by")?,
            to: owned(map, "to")?,
            level: level(map, "level").unwrap_or_default(),
            within: millis_of(map, "within").unwrap_or_default(),
            fence: number(map, "fence").unwrap_or_default(),
            time: millis_of(map, "for"),
            commands: number(map, "commands"),
            path,
        },
        names::LAPSED => Event::Lapsed {
            what: owned(map, "what")?,
            by: owned(map, "by").unwrap_or_default(),
            to: owned(map, "to").unwrap_or_default(),
            reason: owned(map, "reason").unwrap_or_default(),
            path,
        },
        names::QUEUED => Event::Queued {
            place: number(map, "place")?,
            expected: millis_of(map, "expected"),
            path,
        },
        names::INHIBITED => Event::Inhibited {
            peer: owned(map, "peer")?,
            holders: name_list(map, "holders"),
            path,
        },
        names::UNINHIBITED => Event::Uninhibited {
            peer: owned(map, "peer")?,
            holders: name_list(map, "holders"),
            reason: owned(map, "reason").unwrap_or_default(),
            path,
        },
        _ => return None,
    })
}
