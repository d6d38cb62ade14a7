//! How long to wait before the next attempt to connect.

/// Doubles from the first to the most. Each pause is up to a fifth shorter, by chance, so that a fleet that lost its
/// access point at one moment does not come back at one.
#[derive(Debug)]
pub(super) struct Backoff {
    first: i64,
    most: i64,
    next: i64,
    chance: fastrand::Rng,
}

impl Backoff {
    pub(super) fn new(first: i64, most: i64, seed: u64) -> Backoff {
        let first = first.max(1);
        Backoff {
            first,
            most: most.max(first),
            next: first,
            chance: fastrand::Rng::with_seed(seed),
        }
    }

    pub(super) fn reset(&mut self) {
        self.next = self.first;
    }

    /// The next pause, in µs.
    pub(super) fn next(&mut self) -> i64 {
        let pause = self.next;
        self.next = pause.saturating_mul(2).min(self.most);
        self.shorten(pause)
    }

    /// The longest pause at once, in µs.
    pub(super) fn longest(&mut self) -> i64 {
        self.next = self.most;
        self.shorten(self.most)
    }

    fn shorten(&mut self, pause: i64) -> i64 {
        pause - self.chance.i64(0..=pause / 5)
    }
}
