//! An event in words, and as the slots that it came in.

use std::fmt::Display;
use std::time::Duration;

use mom_client::{ContextInfo, ContextKind, Event, Map, Member, Parcel, Path, StopState, Value, WireError};

use super::handover::{self, number, optional};
use super::{error_map, words};

/// An event in words.
pub(crate) fn event_words(event: &Event) -> String {
    let name = |text: &str| words::visible(text);
    match event {
        Event::Joined(Member { peer, level, .. }) => format!("{} joined (level {level})", name(peer)),
        Event::Left(Member { peer, .. }) => format!("{} left", name(peer)),
        Event::Count(count) => words::count(*count, "member"),
        Event::Created(ContextInfo { path, kind, .. }) => format!("{kind} {path} was created"),
        Event::Deleted { path } => format!("{path} was deleted"),
        Event::Grabbed {
            owner,
            level,
            fence,
            lease,
            path,
        } => {
            let lease = match lease {
                Some(lease) => format!("lease {}", words::duration(*lease)),
                None => "no lease".to_owned(),
            };
            format!(
                "{} grabbed {path} (level {level}, fence {fence}, {lease})",
                name(owner)
            )
        }
        Event::Released {
            owner,
            reason,
            by,
            path,
            ..
        } => released(&name(owner), reason, by.as_deref().map(name), path),
        Event::Requested { .. }
        | Event::Offer { .. }
        | Event::Lapsed { .. }
        | Event::Queued { .. }
        | Event::Inhibited { .. }
        | Event::Uninhibited { .. } => handover::words_of(event),
        Event::Invited { .. } | Event::Expelled { .. } => door_words(event),
        Event::Stops(stop) => stop_words(stop),
        Event::Dropped {
            reason,
            count,
            parcel,
        } => {
            let one = match class_of(parcel) {
                Some(class) => format!("{} parcel", name(&class)),
                None => "parcel".to_owned(),
            };
            format!(
                "{} dropped on the way: {}",
                words::count(*count, &one),
                name(reason)
            )
        }
        Event::Refused(error, _) => format!("refused: {}", name(&error.to_string())),
        Event::Lagged(count) => {
            format!(
                "{} not shown: more came than could be written",
                words::count(*count, "parcel")
            )
        }
        Event::LinkDown => "the connection is lost; connecting again".to_owned(),
        Event::Rejoined => "connected again".to_owned(),
        Event::Resumed => "connected again; nothing was lost".to_owned(),
        Event::Message(parcel) | Event::Other(parcel) => name(parcel.name()),
        _ => "something this program does not know".to_owned(),
    }
}

/// Who is let in or put out.
fn door_words(event: &Event) -> String {
    let name = |text: &str| words::visible(text);
    match event {
        Event::Invited { by, path, .. } => format!("{} invites you to {path}", name(by)),
        Event::Expelled { peer, by, text, path } => {
            let by = by.as_deref().map(|by| format!(" by {}", name(by)));
            let text = text.as_deref().map(|text| format!(": {}", name(text)));
            format!(
                "{} was expelled from {path}{}{}",
                name(peer),
                by.unwrap_or_default(),
                text.unwrap_or_default()
            )
        }
        _ => String::new(),
    }
}

/// `bob (level 1)`, and the user where it is not the peer's name.
pub(crate) fn member_words(member: &Member) -> String {
    let user = match member.user == member.peer {
        true => String::new(),
        false => format!("{}, ", words::visible(&member.user)),
    };
    format!("{} ({user}level {})", words::visible(&member.peer), member.level)
}

/// How an owner lost a token.
fn released(owner: &str, reason: &str, by: Option<String>, path: impl Display) -> String {
    let by = by.filter(|by| by != owner);
    match (reason, by) {
        ("released", _) => format!("{owner} released {path}"),
        ("expired", Some(by)) => format!("the time of {owner} on {path} was over, {by} was next"),
        ("expired", None) => format!("the lease of {owner} on {path} was over"),
        ("preempted", Some(by)) => format!("{by} takes {path} from {owner}, by level"),
        ("disconnected", _) => format!("{owner} lost {path}: disconnected"),
        ("deleted", _) => format!("{owner} lost {path}: it was deleted"),
        ("given", Some(by)) => format!("{owner} gave {path} to {by}"),
        ("returned", _) => format!("{path} goes back from {owner} to who gave it"),
        ("broken", Some(by)) => format!("{by} took {path} away from {owner}"),
        ("revoked", _) => format!("{owner} lost {path}: it may no longer be there"),
        (reason, Some(by)) => format!("{owner} lost {path} to {by}: {}", words::visible(reason)),
        (reason, None) => format!("{owner} lost {path}: {}", words::visible(reason)),
    }
}

/// The name and content of an event, as they stood on the wire.
pub(super) fn event_slots(event: &Event) -> (&'static str, Map) {
    match event {
        Event::Joined(peer) => ("joined", member(peer)),
        Event::Left(peer) => ("left", member(peer)),
        Event::Count(count) => ("count", Map::new().with("count", number(*count))),
        Event::Created(info) => (
            "created",
            Map::new()
                .with("path", info.path.as_str())
                .with("kind", info.kind.word())
                .with("number", number(info.number)),
        ),
        Event::Deleted { path } => ("deleted", Map::new().with("path", path.as_str())),
        Event::Requested { .. } => ("requested", handover::slots(event)),
        Event::Offer { .. } => ("offer", handover::slots(event)),
        Event::Lapsed { .. } => ("lapsed", handover::slots(event)),
        Event::Queued { .. } => ("queued", handover::slots(event)),
        Event::Inhibited { .. } => ("inhibited", handover::slots(event)),
        Event::Uninhibited { .. } => ("uninhibited", handover::slots(event)),
        Event::Invited { by, kind, path } => (
            "invited",
            Map::new()
                .with("path", path.as_str())
                .with("by", by.as_str())
                .with("kind", optional(kind.map(ContextKind::word))),
        ),
        Event::Expelled { peer, by, text, path } => (
            "expelled",
            Map::new()
                .with("path", path.as_str())
                .with("peer", peer.as_str())
                .with("by", optional(by.as_deref()))
                .with("text", optional(text.as_deref())),
        ),
        Event::Grabbed { .. } => ("grabbed", ownership(event)),
        Event::Released { .. } => ("released", ownership(event)),
        Event::Dropped {
            reason,
            count,
            parcel,
        } => (
            "dropped",
            Map::new()
                .with("reason", reason.as_str())
                .with("count", number(*count))
                .with("delivery", optional(class_of(parcel).as_deref())),
        ),
        Event::Refused(error, reference) => ("refused", refused(error, *reference)),
        Event::Stops(stop) => ("stops", stop_map(stop)),
        Event::Lagged(count) => ("lagged", Map::new().with("count", number(*count))),
        Event::LinkDown => ("link-down", Map::new()),
        Event::Rejoined => ("rejoined", Map::new()),
        Event::Resumed => ("resumed", Map::new()),
        Event::Message(_) | Event::Other(_) => ("other", Map::new()),
        _ => ("unknown", Map::new()),
    }
}

/// The delivery class of what was dropped.
fn class_of(dropped: &Parcel) -> Option<String> {
    dropped.value().get("delivery")?.as_str().map(str::to_owned)
}

fn ownership(event: &Event) -> Map {
    let fence_of = |path: &Path, owner: &str, fence: u64| {
        Map::new()
            .with("path", path.as_str())
            .with("owner", owner)
            .with("fence", number(fence))
    };
    match event {
        Event::Grabbed {
            owner,
            level,
            fence,
            lease,
            path,
        } => {
            let millis = |lease: &Duration| number(u64::try_from(lease.as_millis()).unwrap_or(u64::MAX));
            fence_of(path, owner, *fence)
                .with("level", *level)
                .with("lease", lease.as_ref().map_or(Value::Null, millis))
        }
        Event::Released {
            owner,
            reason,
            by,
            fence,
            path,
        } => fence_of(path, owner, *fence)
            .with("reason", reason.as_str())
            .with("by", by.as_deref().map_or(Value::Null, Value::from)),
        _ => Map::new(),
    }
}

fn stop_words(stop: &StopState) -> String {
    if !stop.stopped {
        return "no device is stopped".to_owned();
    }
    let names: Vec<String> = stop.only.iter().map(|device| words::visible(device)).collect();
    let devices = match names.is_empty() {
        true => "all devices".to_owned(),
        false => names.join(", "),
    };
    format!("{devices} {}", words::stopped_by(stop))
}

fn stop_map(stop: &StopState) -> Map {
    let only: Vec<Value> = stop.only.iter().map(|device| device.as_str().into()).collect();
    Map::new()
        .with("stopped", stop.stopped)
        .with("number", number(stop.number))
        .with("by", optional(stop.by.as_deref()))
        .with("reason", optional(stop.reason.as_deref()))
        .with("only", only)
}

fn refused(error: &WireError, reference: Option<u64>) -> Map {
    let mut map = error_map(error);
    map.set("reference", reference.map_or(Value::Null, number));
    map
}

pub(super) fn member(member: &Member) -> Map {
    Map::new()
        .with("peer", member.peer.as_str())
        .with("user", member.user.as_str())
        .with("level", member.level)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn how_a_token_was_lost() {
        for (reason, by, words) in [
            ("released", Some("alice"), "alice released /robot/token"),
            (
                "expired",
                Some("bob"),
                "the time of alice on /robot/token was over, bob was next",
            ),
            (
                "preempted",
                Some("carol"),
                "carol takes /robot/token from alice, by level",
            ),
            ("disconnected", None, "alice lost /robot/token: disconnected"),
            ("broken", Some("carol"), "carol took /robot/token away from alice"),
            ("given", Some("bob"), "alice gave /robot/token to bob"),
            (
                "returned",
                None,
                "/robot/token goes back from alice to who gave it",
            ),
            (
                "revoked",
                None,
                "alice lost /robot/token: it may no longer be there",
            ),
        ] {
            assert_eq!(
                released("alice", reason, by.map(str::to_owned), "/robot/token"),
                words
            );
        }
    }

    #[test]
    fn who_is_let_in_or_put_out() {
        let path = || Path::parse("/lab").unwrap();
        let invited = Event::Invited {
            by: "carol".to_owned(),
            kind: Some(ContextKind::Session),
            path: path(),
        };
        let expelled = Event::Expelled {
            peer: "bob".to_owned(),
            by: Some("carol".to_owned()),
            text: Some("lun\nch".to_owned()),
            path: path(),
        };
        for (event, words, name, content) in [
            (
                invited,
                "carol invites you to /lab",
                "invited",
                Map::new()
                    .with("path", "/lab")
                    .with("by", "carol")
                    .with("kind", "session"),
            ),
            (
                expelled,
                "bob was expelled from /lab by carol: lun\\nch",
                "expelled",
                Map::new()
                    .with("path", "/lab")
                    .with("peer", "bob")
                    .with("by", "carol")
                    .with("text", "lun\nch"),
            ),
        ] {
            assert_eq!(event_words(&event), words);
            assert_eq!(event_slots(&event), (name, content));
        }
    }
}
