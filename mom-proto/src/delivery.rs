//! Delivery classes (design §7).

/// What may happen to a parcel when a receiver is slow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Delivery {
    /// Never dropped: a receiver whose queue is full is closed as `slow-receiver`.
    #[default]
    Reliable,
    /// The newest of a sender and name replaces an older one that still waits.
    Latest,
    /// The oldest waiting ones are dropped when the queue is full.
    Fleeting,
}

impl Delivery {
    /// All classes; the position is the number in the binary form.
    pub const ALL: [Delivery; 3] = [Delivery::Reliable, Delivery::Latest, Delivery::Fleeting];

    /// The word on the wire.
    pub fn word(self) -> &'static str {
        match self {
            Delivery::Reliable => "reliable",
            Delivery::Latest => "latest",
            Delivery::Fleeting => "fleeting",
        }
    }

    /// The class with this word.
    pub fn from_word(word: &str) -> Option<Delivery> {
        Delivery::ALL.into_iter().find(|delivery| delivery.word() == word)
    }
}
