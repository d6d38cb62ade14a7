//! Log lines that anybody can cause at will: the first of its kind from an address is written at once, those that
//! follow within a while are counted, and one line says how many.
//!
//! So a stranger that fails, or comes and goes, as fast as the network lets it writes a few lines a minute. Which
//! addresses count as one is up to the caller.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::Arc;

use mom_proto::Micros;
use parking_lot::Mutex;

/// How long lines are counted before one says how many.
const WINDOW: Micros = 10_000_000;

/// Addresses and kinds that are told apart; what is beyond them is counted by its event alone.
const KINDS: usize = 1024;

/// What happened, where from, and the code or user that tells it from others; none = no matter which.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Kind {
    event: &'static str,
    from: Option<IpAddr>,
    detail: Option<Arc<str>>,
}

/// A line for all that were counted.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Counted {
    kind: Kind,
    count: u64,
    seconds: u64,
}

/// The lines of the last while.
#[derive(Debug, Default)]
pub struct FoldedLines {
    counts: Mutex<HashMap<Kind, (Micros, u64)>>,
}

impl FoldedLines {
    /// Whether a line of this kind is to be written now; otherwise it is counted.
    pub fn first(
        &self,
        event: &'static str,
        from: Option<IpAddr>,
        detail: Option<&str>,
        now: Micros,
    ) -> bool {
        let mut kind = Kind {
            event,
            from,
            detail: detail.map(Arc::from),
        };
        let mut counts = self.counts.lock();
        if counts.len() >= KINDS && !counts.contains_key(&kind) {
            kind = Kind {
                event,
                from: None,
                detail: None,
            };
        }
        match counts.get_mut(&kind) {
            Some((_, count)) => {
                *count += 1;
                false
            }
            None => counts.insert(kind, (now, 0)).is_none(),
        }
    }

    /// Writes what was counted long enough, or all of it. To be called about each second.
    pub fn report(&self, now: Micros, all: bool) {
        for Counted { kind, count, seconds } in self.drain(now, all) {
            let Kind { event, from, detail } = kind;
            let from = from.map_or_else(|| "many addresses".to_owned(), |from| from.to_string());
            let of = detail.map(|detail| format!(" ({detail})")).unwrap_or_default();
            tracing::info!("{event}{of}: {count} more of the same from {from} in the last {seconds} s");
        }
    }

    fn drain(&self, now: Micros, all: bool) -> Vec<Counted> {
        let mut counted = Vec::new();
        self.counts.lock().retain(|kind, (since, count)| {
            let time = now.saturating_sub(*since);
            if time < WINDOW && !all {
                return true;
            }
            *since = now;
            if *count > 0 {
                counted.push(Counted {
                    kind: kind.clone(),
                    count: std::mem::take(count),
                    seconds: time.div_ceil(1_000_000),
                });
                return true;
            }
            false
        });
        counted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(number: u32) -> Option<IpAddr> {
        Some(IpAddr::from(number.to_be_bytes()))
    }

    #[test]
    fn the_first_is_written_the_others_are_counted() {
        let lines = FoldedLines::default();
        let first = |from, now| lines.first("login refused", address(from), Some("bad-login"), now);
        assert!(first(1, 0));
        assert!((1..=1000).all(|now| !first(1, now)));
        assert!(first(2, 1000) && lines.first("closed", address(1), None, 0));
        assert_eq!(lines.drain(WINDOW - 1, false), []);
        let counted = lines.drain(WINDOW, false);
        let expected = Counted {
            kind: Kind {
                event: "login refused",
                from: address(1),
                detail: Some("bad-login".into()),
            },
            count: 1000,
            seconds: 10,
        };
        assert_eq!(counted, std::slice::from_ref(&expected));
        // It goes on: no line of its own, as long as others came in the last while.
        assert!(!first(1, WINDOW + 1));
        assert_eq!(lines.drain(2 * WINDOW, false), [Counted { count: 1, ..expected }]);
        assert_eq!(lines.drain(3 * WINDOW, false), []);
        assert!(first(1, 3 * WINDOW) && lines.counts.lock().len() == 1);
    }

    #[test]
    fn many_addresses_fill_neither_memory_nor_log() {
        let lines = FoldedLines::default();
        let written = (0..100_000).filter(|from| lines.first("closed", address(*from), None, 0));
        assert_eq!(written.count(), KINDS + 1);
        let counted = lines.drain(0, true);
        assert_eq!(counted.len(), 1);
        assert_eq!(counted[0].kind.from, None);
        assert_eq!(counted[0].count, 100_000 - KINDS as u64 - 1);
    }
}
