//! The families of parcels (M8).

use std::fmt;

/// The first half of a parcel's class; the framework dispatches on it (M8).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Family {
    /// Whatever the applications agree on.
    Message,
    /// Who is there.
    Login,
    /// The tree: create, join, list …
    Context,
    /// Exclusive control: grab, release …
    Token,
    /// Managing peers.
    Manager,
    /// What happened (M30).
    Event,
    /// A request was carried out.
    Reply,
    /// A request was refused.
    Error,
    /// Heartbeats and clocks.
    Time,
}

impl Family {
    /// All families; the position is the number in the binary form.
    pub const ALL: [Family; 9] = [
        Family::Message,
        Family::Login,
        Family::Context,
        Family::Token,
        Family::Manager,
        Family::Event,
        Family::Reply,
        Family::Error,
        Family::Time,
    ];

    /// The word on the wire.
    pub fn word(self) -> &'static str {
        match self {
            Family::Message => "message",
            Family::Login => "login",
            Family::Context => "context",
            Family::Token => "token",
            Family::Manager => "manager",
            Family::Event => "event",
            Family::Reply => "reply",
            Family::Error => "error",
            Family::Time => "time",
        }
    }

    /// The family with this word.
    pub fn from_word(word: &str) -> Option<Family> {
        Family::ALL.into_iter().find(|family| family.word() == word)
    }

    /// The number in the binary form.
    pub fn number(self) -> u8 {
        self as u8
    }

    /// The family with this number in the binary form.
    pub fn from_number(number: u8) -> Option<Family> {
        Family::ALL.get(usize::from(number)).copied()
    }
}

impl fmt::Display for Family {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.word())
    }
}
