//! How long things are measured, and the plain timing of work inside this process.

use std::time::{Duration, Instant};

/// How long each part of a run takes.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    /// Runs of which the median counts.
    pub runs: usize,
    /// A stream's time before its measurement.
    pub warm_up: Duration,
    /// A stream's measured time.
    pub stream: Duration,
    /// Measured round trips, over all connections.
    pub rounds: usize,
    /// Pairs of connections that they are spread over, one after the other.
    pub connections: usize,
    /// Round trips before a hub's turn ends and the other's begins.
    pub block: usize,
    /// Peers that contend for one token, and that log in at once.
    pub crowd: usize,
    /// Grants among them.
    pub grants: u64,
    /// The time with nobody else there, before they log in.
    pub calm: Duration,
    /// The measured time of one row of [`crate::decisions`] or [`crate::codecs`].
    pub inside: Duration,
}

impl Pace {
    /// For figures.
    pub fn full() -> Pace {
        Pace {
            runs: 3,
            warm_up: Duration::from_millis(300),
            stream: Duration::from_millis(1000),
            rounds: 20_000,
            connections: 20,
            block: 250,
            crowd: 1000,
            grants: 5000,
            calm: Duration::from_secs(3),
            inside: Duration::from_millis(150),
        }
    }

    /// For a look whether all still works: the figures mean little.
    pub fn quick() -> Pace {
        Pace {
            runs: 1,
            warm_up: Duration::from_millis(50),
            stream: Duration::from_millis(200),
            rounds: 1000,
            connections: 2,
            block: 250,
            crowd: 40,
            grants: 200,
            calm: Duration::from_millis(200),
            inside: Duration::from_millis(20),
        }
    }
}

/// What was done in a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Things done.
    pub count: u64,
    /// The time it took.
    pub time: Duration,
}

impl Rate {
    /// Things per second.
    pub fn per_second(self) -> f64 {
        self.count as f64 / self.time.as_secs_f64()
    }
}

/// Repeats `turn`, which says how many things it did, for about `time`, after a tenth of it to warm up.
pub fn measure(time: Duration, mut turn: impl FnMut() -> u64) -> Rate {
    for_about(time / 10, &mut turn);
    for_about(time, &mut turn)
}

fn for_about(time: Duration, turn: &mut impl FnMut() -> u64) -> Rate {
    let start = Instant::now();
    let mut count = 0;
    loop {
        // The clock costs as much as a small parcel: look seldom.
        for _ in 0..16 {
            count += turn();
        }
        let elapsed = start.elapsed();
        if elapsed >= time {
            return Rate { count, time: elapsed };
        }
    }
}

/// The middle value; the lower of two.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len().checked_sub(1)? / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_runs_counts() {
        assert_eq!(median(vec![]), None);
        assert_eq!(median(vec![2.0]), Some(2.0));
        assert_eq!(median(vec![3.0, 1.0]), Some(1.0));
        assert_eq!(median(vec![9.0, 1.0, 2.0]), Some(2.0));
    }
}
