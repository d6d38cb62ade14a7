//! The names of events (M30, design §5) and the reasons they give.

/// Someone joined a context.
pub const JOINED: &str = "joined";
/// Someone left a context.
pub const LEFT: &str = "left";
/// A child was made in a session.
pub const CREATED: &str = "created";
/// A child of a session, or the context itself, was deleted.
pub const DELETED: &str = "deleted";
/// A token has a new owner.
pub const GRABBED: &str = "grabbed";
/// A token's owner lost it.
pub const RELEASED: &str = "released";
/// A peer asks a token's owner to hand over.
pub const REQUESTED: &str = "requested";
/// A token's owner offers it to a peer.
pub const OFFER: &str = "offer";
/// An offer or a request is over without a change of owner.
pub const LAPSED: &str = "lapsed";
/// A grab waits, and at which place.
pub const QUEUED: &str = "queued";
/// An owner's time ends, because others wait.
pub const NOTICE: &str = "notice";
/// Several peers hold a token together, and nobody owns it.
pub const INHIBITED: &str = "inhibited";
/// One of them holds it no longer.
pub const UNINHIBITED: &str = "uninhibited";
/// A peer was told of a context by one of its members.
pub const INVITED: &str = "invited";
/// A peer was expelled from a context.
pub const EXPELLED: &str = "expelled";
/// Parcels were dropped on their way.
pub const DROPPED: &str = "dropped";
/// A stop went out without its content.
pub const SHORTENED: &str = "shortened";

/// Devices of a channel are stopped, and by whom.
pub const STOPPED: &str = "stopped";
/// They may move again.
pub const UNSTOPPED: &str = "unstopped";

/// A peer has lost its connection and may come back for a while.
pub const LOST: &str = "lost";
/// It has come back.
pub const RESUMED: &str = "resumed";
/// The safe-state message sent by the hub when ownership ends.
pub const HALT: &str = "halt";
/// The reserved message that halts a device until `unstop`.
pub const STOP: &str = "stop";
/// The reserved message that lets a stopped device move again.
pub const UNSTOP: &str = "unstop";
/// The message that moves a device.
pub const COMMAND: &str = "command";

/// Why an owner lost its token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// It gave the token back.
    Released,
    /// Its lease was over.
    Expired,
    /// A peer of a strictly higher level took it (M29).
    Preempted,
    /// Its connection ended, or it left.
    Disconnected,
    /// The token was deleted.
    Deleted,
    /// A peer with the right `break` took it away.
    Broken,
    /// Its rights ended: its user was changed or removed, or it was expelled.
    Revoked,
    /// It gave the token to another peer (M41).
    Given,
    /// A token given for a time or a number of commands returned to the giver.
    Returned,
    /// A peer stopped the device, and the token says that a stop ends its owner's grant.
    Stopped,
}

impl Reason {
    /// All reasons.
    pub const ALL: [Reason; 10] = [
        Reason::Released,
        Reason::Expired,
        Reason::Preempted,
        Reason::Disconnected,
        Reason::Deleted,
        Reason::Broken,
        Reason::Revoked,
        Reason::Given,
        Reason::Returned,
        Reason::Stopped,
    ];

    /// The word on the wire.
    pub fn word(self) -> &'static str {
        match self {
            Reason::Released => "released",
            Reason::Expired => "expired",
            Reason::Preempted => "preempted",
            Reason::Disconnected => "disconnected",
            Reason::Deleted => "deleted",
            Reason::Broken => "broken",
            Reason::Revoked => "revoked",
            Reason::Given => "given",
            Reason::Returned => "returned",
            Reason::Stopped => "stopped",
        }
    }

    /// The reason with this word.
    pub fn from_word(word: &str) -> Option<Reason> {
        Reason::ALL.into_iter().find(|reason| reason.word() == word)
    }
}
