//! Delivery classes (design §7).

/// What may happen to a parcel when a receiver is slow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Delivery {
    /// Never dropped: what happens where a receiver's queue is full is the channel's [`Overflow`].
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

/// What happens to a `reliable` parcel for which a receiver has no capacity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Overflow {
    /// The receiver is closed as `slow-receiver`: nobody waits for it.
    #[default]
    Close,
    /// The sender waits, and after a time gets `try-later`: then nobody gets the parcel.
    Wait,
}

impl Overflow {
    /// All of them.
    pub const ALL: [Overflow; 2] = [Overflow::Close, Overflow::Wait];

    /// The word in requests and in the configuration.
    pub fn word(self) -> &'static str {
        match self {
            Overflow::Close => "close",
            Overflow::Wait => "wait",
        }
    }

    /// The one with this word.
    pub fn from_word(word: &str) -> Option<Overflow> {
        Overflow::ALL.into_iter().find(|overflow| overflow.word() == word)
    }
}
