//! The verbs: requests of peers (design §5, M26).

use std::fmt;

use crate::nearest::nearest;
use crate::{Code, Family, Limits, WireError};

/// A request of a peer: the family and name of its parcel.
///
/// All messages are one verb, [`Verb::Send`], except `stop` and `unstop`, which have rights of their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Verb {
    /// `login login`: authenticate, for the first time or again (M12, M13).
    Login,
    /// `login answer`: prove a key by signing the hub's challenge.
    Answer,
    /// `login resume`: go on with a link over another connection.
    Resume,
    /// `login logout`: leave for good.
    Logout,
    /// `context create`: make a session, channel or token (M22, M24).
    Create,
    /// `context lookup`: what is there.
    Lookup,
    /// `context list`: the children.
    List,
    /// `context info`: all about one context, or `token info`.
    Info,
    /// `context join` (M23).
    Join,
    /// `context join` as a device: no request of its own, but a right of its own, as others rely on what a device says.
    Device,
    /// `context leave` (M23).
    Leave,
    /// `context delete`.
    Delete,
    /// `context members`.
    Members,
    /// `context stats`: statistics of a channel, or of the channels of a session.
    Stats,
    /// `context audit`: who was granted or refused what, or lost it.
    Audit,
    /// `context explain`: who may do what there, and by which rule.
    Explain,
    /// `context what-if`: what another configuration would have decided.
    WhatIf,
    /// `context invite`: invite a peer to a context, and tell its manager.
    Invite,
    /// `context expel`: remove a peer from a context and all below it.
    Expel,
    /// `token grab` (M28, M29).
    Grab,
    /// `token release`.
    Release,
    /// `token renew` (M29).
    Renew,
    /// `token give`: offer what one owns to another peer (M41).
    Give,
    /// `token accept`: accept an offer, or hand over to a peer that asked.
    Accept,
    /// `token decline`: refuse an offer, or a peer that asked.
    Decline,
    /// `token request`: ask the owner to hand over.
    Request,
    /// `token break`: take a token away from its owner.
    Break,
    /// `token inhibit`: hold together with others, so that nobody owns.
    Inhibit,
    /// `token uninhibit`: end that hold.
    Uninhibit,
    /// Any message (M27).
    Send,
    /// `message stop`: to halt a device without owning its token (M43).
    Stop,
    /// `message unstop`: to let it move again.
    Unstop,
    /// `manager verdict`: a managing peer's answer to a `consult` (M24).
    Verdict,
    /// `time ping`.
    Ping,
    /// `time pong`.
    Pong,
    /// `time ack`: how many parcels were read.
    Ack,
    /// `time resent`: what follows was not said before the connection was lost.
    Resent,
}

impl Verb {
    /// The most bytes of a message's content that the hub opens, where it has to know what a device says of itself.
    pub const OPENED: usize = 64 * 1024;

    /// The most bytes of a sign of life's content that the hub opens: times and counts.
    pub const SIGN_OF_LIFE: usize = 1024;

    /// All verbs.
    pub const ALL: [Verb; 37] = [
        Verb::Login,
        Verb::Answer,
        Verb::Resume,
        Verb::Logout,
        Verb::Create,
        Verb::Lookup,
        Verb::List,
        Verb::Info,
        Verb::Join,
        Verb::Device,
        Verb::Leave,
        Verb::Delete,
        Verb::Members,
        Verb::Stats,
        Verb::Audit,
        Verb::Explain,
        Verb::WhatIf,
        Verb::Invite,
        Verb::Expel,
        Verb::Grab,
        Verb::Release,
        Verb::Renew,
        Verb::Give,
        Verb::Accept,
        Verb::Decline,
        Verb::Request,
        Verb::Break,
        Verb::Inhibit,
        Verb::Uninhibit,
        Verb::Send,
        Verb::Stop,
        Verb::Unstop,
        Verb::Verdict,
        Verb::Ping,
        Verb::Pong,
        Verb::Ack,
        Verb::Resent,
    ];

    /// The word of rules, logs and parcels.
    pub fn word(self) -> &'static str {
        match self {
            Verb::Login => "login",
            Verb::Answer => "answer",
            Verb::Resume => "resume",
            Verb::Logout => "logout",
            Verb::Create => "create",
            Verb::Lookup => "lookup",
            Verb::List => "list",
            Verb::Info => "info",
            Verb::Join => "join",
            Verb::Device => "device",
            Verb::Leave => "leave",
            Verb::Delete => "delete",
            Verb::Members => "members",
            Verb::Stats => "stats",
            Verb::Audit => "audit",
            Verb::Explain => "explain",
            Verb::WhatIf => "what-if",
            Verb::Invite => "invite",
            Verb::Expel => "expel",
            Verb::Grab => "grab",
            Verb::Release => "release",
            Verb::Renew => "renew",
            Verb::Give => "give",
            Verb::Accept => "accept",
            Verb::Decline => "decline",
            Verb::Request => "request",
            Verb::Break => "break",
            Verb::Inhibit => "inhibit",
            Verb::Uninhibit => "uninhibit",
            Verb::Verdict => "verdict",
            Verb::Send => "send",
            Verb::Stop => "stop",
            Verb::Unstop => "unstop",
            Verb::Ping => "ping",
            Verb::Pong => "pong",
            Verb::Ack => "ack",
            Verb::Resent => "resent",
        }
    }

    /// The family whose parcels ask for this.
    pub fn family(self) -> Family {
        match self {
            Verb::Login | Verb::Answer | Verb::Resume | Verb::Logout => Family::Login,
            Verb::Create | Verb::Lookup | Verb::List | Verb::Info => Family::Context,
            Verb::Join | Verb::Device | Verb::Leave | Verb::Delete | Verb::Members => Family::Context,
            Verb::Stats | Verb::Audit | Verb::Explain | Verb::WhatIf => Family::Context,
            Verb::Invite | Verb::Expel => Family::Context,
            Verb::Grab | Verb::Release | Verb::Renew => Family::Token,
            Verb::Give | Verb::Accept | Verb::Decline | Verb::Request => Family::Token,
            Verb::Break | Verb::Inhibit | Verb::Uninhibit => Family::Token,
            Verb::Verdict => Family::Manager,
            Verb::Send | Verb::Stop | Verb::Unstop => Family::Message,
            Verb::Ping | Verb::Pong | Verb::Ack | Verb::Resent => Family::Time,
        }
    }

    /// The verb with this word in rules.
    pub fn from_word(word: &str) -> Option<Verb> {
        Verb::ALL.into_iter().find(|verb| verb.word() == word)
    }

    /// The verb of a parcel.
    ///
    /// # Errors
    /// `unknown-verb` with the nearest one, also for families that only the hub sends.
    pub fn of(family: Family, name: &str) -> Result<Verb, WireError> {
        match (family, name) {
            (Family::Message, "stop") => Ok(Verb::Stop),
            (Family::Message, "unstop") => Ok(Verb::Unstop),
            (Family::Message, _) => Ok(Verb::Send),
            (Family::Token, "info") => Ok(Verb::Info),
            // The same rights, asked for a channel that one has not joined, or for all below a session.
            (Family::Context, "stop") => Ok(Verb::Stop),
            (Family::Context, "unstop") => Ok(Verb::Unstop),
            (Family::Event | Family::Reply | Family::Error, _) => Err(WireError::new(
                Code::UNKNOWN_VERB,
                format!("only the hub sends parcels of family {family}"),
            )
            .slot("family")),
            _ => Verb::ALL
                .into_iter()
                .find(|verb| verb.is_asked_for() && verb.family() == family && verb.word() == name)
                .ok_or_else(|| {
                    let names = Verb::ALL
                        .iter()
                        .filter(|verb| verb.is_asked_for() && verb.family() == family)
                        .map(|verb| verb.word());
                    let everywhere = Verb::ALL.iter().map(|verb| verb.word());
                    let near = nearest(name, names).or_else(|| nearest(name, everywhere));
                    WireError::new(
                        Code::UNKNOWN_VERB,
                        format!("family {family} has no verb {name:?}"),
                    )
                    .slot("name")
                    .nearest_opt(near)
                }),
        }
    }

    /// The most bytes of content that the hub opens of a parcel that is not a message: more is refused before it is looked at. Of a message
    /// the hub opens nothing that it does not need, and nothing above [`Verb::OPENED`].
    pub fn opens(self, limits: &Limits) -> usize {
        match self {
            Verb::Login | Verb::Answer | Verb::Resume => limits.before_login.min(limits.control),
            Verb::Pong | Verb::Ack | Verb::Resent => Self::SIGN_OF_LIFE,
            // One may be as large as what is measured with it; above the same size it is not looked into.
            Verb::Ping => limits.control,
            Verb::Logout | Verb::Create | Verb::Lookup | Verb::List | Verb::Info => limits.control,
            Verb::Join | Verb::Device | Verb::Leave | Verb::Delete | Verb::Members => limits.control,
            Verb::Stats | Verb::Audit | Verb::Explain | Verb::WhatIf => limits.control,
            Verb::Invite | Verb::Expel | Verb::Verdict => limits.control,
            Verb::Grab | Verb::Release | Verb::Renew | Verb::Give | Verb::Accept => limits.control,
            Verb::Decline | Verb::Request | Verb::Break => limits.control,
            Verb::Inhibit | Verb::Uninhibit => limits.control,
            Verb::Send | Verb::Stop | Verb::Unstop => limits.control.min(Self::OPENED),
        }
    }

    /// Whether a parcel asks for it; what is not a request is a right that another request needs as well.
    fn is_asked_for(self) -> bool {
        self != Verb::Device
    }

    /// Whether nobody can be refused this: giving up what one has, and being alive.
    pub fn gives_up(self) -> bool {
        matches!(
            self,
            Verb::Leave
                | Verb::Release
                | Verb::Decline
                | Verb::Uninhibit
                | Verb::Logout
                | Verb::Ping
                | Verb::Pong
                | Verb::Ack
                | Verb::Resent
        )
    }
}

impl fmt::Display for Verb {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.word())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_verb_is_found_by_its_parcel() {
        for verb in Verb::ALL.into_iter().filter(|verb| verb.is_asked_for()) {
            let name = if verb == Verb::Send {
                "command"
            } else {
                verb.word()
            };
            assert_eq!(Verb::of(verb.family(), name), Ok(verb));
            assert_eq!(Verb::from_word(verb.word()), Some(verb));
        }
        assert_eq!(Verb::of(Family::Token, "info"), Ok(Verb::Info));
        assert_eq!(Verb::of(Family::Context, "stop"), Ok(Verb::Stop));
        assert_eq!(Verb::of(Family::Context, "unstop"), Ok(Verb::Unstop));
    }

    #[test]
    fn a_right_that_is_no_request_is_known_to_rules_only() {
        assert_eq!(Verb::from_word("device"), Some(Verb::Device));
        let error = Verb::of(Family::Context, "device").expect_err("no request");
        assert_eq!(error.code, Code::UNKNOWN_VERB);
    }

    #[test]
    fn little_is_opened_of_whatever_is_asked() {
        let limits = Limits::default();
        for verb in Verb::ALL {
            assert!(verb.opens(&limits) <= limits.control, "{verb}");
        }
        assert_eq!(Verb::Ack.opens(&limits), 1024);
        assert_eq!(Verb::Login.opens(&limits), 16 * 1024);
    }

    #[test]
    fn an_unknown_verb_names_the_nearest() {
        let error = Verb::of(Family::Token, "grib").expect_err("no such verb");
        assert_eq!(error.get("nearest"), Some(&"grab".into()));
        assert_eq!(
            Verb::of(Family::Reply, "ok").expect_err("hub's").code,
            Code::UNKNOWN_VERB
        );
    }
}
