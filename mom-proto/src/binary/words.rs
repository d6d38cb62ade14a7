//! Words so common that the binary form sends their number.

use std::collections::HashMap;
use std::sync::{Arc, LazyLock};

/// The table of words; the position is the number on the wire. It only ever grows at its end.
pub const WORDS: &[&str] = &[
    "command",
    "state",
    "status",
    "image",
    "chat",
    "stop",
    "unstop",
    "halt",
    "login",
    "answer",
    "resume",
    "logout",
    "create",
    "lookup",
    "list",
    "info",
    "stats",
    "join",
    "leave",
    "delete",
    "members",
    "invite",
    "expel",
    "grab",
    "release",
    "renew",
    "give",
    "accept",
    "decline",
    "request",
    "break",
    "inhibit",
    "uninhibit",
    "consult",
    "verdict",
    "joined",
    "left",
    "created",
    "deleted",
    "grabbed",
    "released",
    "requested",
    "offer",
    "lapsed",
    "queued",
    "invited",
    "expelled",
    "dropped",
    "notice",
    "ok",
    "challenge",
    "ping",
    "pong",
    "hub",
    "inhibited",
    "uninhibited",
    "ack",
    "resent",
    "lost",
    "resumed",
];

static NUMBERS: LazyLock<HashMap<&'static str, u64>> =
    LazyLock::new(|| WORDS.iter().copied().zip(0..).collect());
static SHARED: LazyLock<Vec<Arc<str>>> =
    LazyLock::new(|| WORDS.iter().map(|word| Arc::from(*word)).collect());

/// The number of a word in the table.
pub(crate) fn number_of(word: &str) -> Option<u64> {
    NUMBERS.get(word).copied()
}

/// The word of a number.
pub(crate) fn word(number: u64) -> Option<Arc<str>> {
    usize::try_from(number)
        .ok()
        .and_then(|number| SHARED.get(number))
        .cloned()
}

/// The names of one connection that are not in the table: senders, receivers, message names.
///
/// The same few come again and again; keeping them saves an allocation for each parcel.
#[derive(Debug, Default)]
pub(crate) struct NameCache(HashMap<Box<str>, Arc<str>>);

impl NameCache {
    const MOST: usize = 256;
    /// The longest name of a message. Longer ones are refused soon, and must not stay here.
    const LONGEST: usize = 128;

    /// The shared form of a name.
    pub(crate) fn share(&mut self, name: &str) -> Arc<str> {
        if name.len() > Self::LONGEST {
            return Arc::from(name);
        }
        if let Some(shared) = self.0.get(name) {
            return Arc::clone(shared);
        }
        if self.0.len() >= Self::MOST {
            self.0.clear();
        }
        let shared: Arc<str> = Arc::from(name);
        self.0.insert(name.into(), Arc::clone(&shared));
        shared
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_word_has_one_number() {
        for (word, number) in WORDS.iter().zip(0..) {
            assert_eq!(number_of(word), Some(number), "{word} twice?");
        }
    }

    #[test]
    fn the_cache_is_bounded() {
        let mut cache = NameCache::default();
        for number in 0..10_000 {
            cache.share(&number.to_string());
        }
        assert!(cache.0.len() <= NameCache::MOST);
        let kept = cache.0.len();
        cache.share(&"x".repeat(NameCache::LONGEST + 1));
        assert_eq!(cache.0.len(), kept, "a long name is not kept");
        let (one, two) = (cache.share("bob"), cache.share("bob"));
        assert!(Arc::ptr_eq(&one, &two));
    }
}
