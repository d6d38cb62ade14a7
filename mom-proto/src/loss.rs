//! What may still be handed out after a connection was lost (design §7).

use crate::{Family, Parcel, event};

/// Whether a parcel that was said before its connection was lost may be handed out after it. `guarded`: a token guards it.
///
/// At a loss devices are halted. What moves one, lets it move, or changes who drives it was meant for the moment before, and its
/// sender does not see what has become of the device since.
///
/// ```
/// use mom_proto::{Family, Parcel, outlives_loss};
/// assert!(outlives_loss(&Parcel::new(Family::Message, "stop"), false));
/// assert!(!outlives_loss(&Parcel::new(Family::Message, "unstop"), false));
/// ```
pub fn outlives_loss(parcel: &Parcel, guarded: bool) -> bool {
    match (parcel.family, parcel.name()) {
        (Family::Message, event::STOP | event::HALT) => true,
        (Family::Message, event::UNSTOP | event::COMMAND) => false,
        (Family::Message, _) => !guarded,
        (Family::Context, event::UNSTOP) => false,
        (Family::Token, "give" | "inhibit") => false,
        (Family::Token, "accept") => !answers_request(parcel),
        // Without a fence it would end an ownership that began after it was said.
        (Family::Token, "release") => parcel.fence.is_some(),
        _ => true,
    }
}

/// Whether an `accept` hands a token over to who asked for it; any other takes what was offered.
pub fn answers_request(accept: &Parcel) -> bool {
    accept.value().get("peer").is_some()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Map;

    #[test]
    fn what_moves_a_device_is_of_its_moment() {
        use Family::{Context, Event, Login, Message, Reply, Token};
        for (family, name, expected) in [
            (Message, "stop", true),
            (Message, "halt", true),
            (Message, "unstop", false),
            (Message, "command", false),
            (Message, "note", true),
            (Token, "give", false),
            (Token, "inhibit", false),
            (Token, "uninhibit", true),
            (Token, "release", false),
            (Token, "accept", true),
            (Token, "renew", true),
            (Token, "break", true),
            (Context, "leave", true),
            (Context, "stop", true),
            (Context, "unstop", false),
            (Login, "logout", true),
            (Event, "command", true),
            (Reply, "ok", true),
        ] {
            assert_eq!(
                outlives_loss(&Parcel::new(family, name), false),
                expected,
                "{family} {name}"
            );
        }
        let guarded = |name| outlives_loss(&Parcel::new(Message, name), true);
        assert!(!guarded("note") && !guarded("goal") && guarded("stop"));
    }

    #[test]
    fn slots_decide_about_release_and_accept() {
        let mut release = Parcel::new(Family::Token, "release");
        release.fence = Some(3);
        assert!(outlives_loss(&release, false));
        let accept = Parcel::new(Family::Token, "accept");
        assert!(!outlives_loss(
            &accept.content(Map::new().with("peer", "bob")),
            false
        ));
    }
}
