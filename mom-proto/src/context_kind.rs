//! The kinds of context (M22).

use std::fmt;

/// What a context is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ContextKind {
    /// A directory of contexts.
    Session,
    /// Where messages are exchanged.
    Channel,
    /// Exclusive control, owned by one peer at a time.
    Token,
}

impl ContextKind {
    /// All kinds.
    pub const ALL: [ContextKind; 3] = [ContextKind::Session, ContextKind::Channel, ContextKind::Token];

    /// The word on the wire.
    pub fn word(self) -> &'static str {
        match self {
            ContextKind::Session => "session",
            ContextKind::Channel => "channel",
            ContextKind::Token => "token",
        }
    }

    /// The kind with this word.
    pub fn from_word(word: &str) -> Option<ContextKind> {
        ContextKind::ALL.into_iter().find(|kind| kind.word() == word)
    }
}

impl fmt::Display for ContextKind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.word())
    }
}
