//! Rehearses some starts and prints what came of them: `rehearse [STARTS] [DEGREES] [DELAY-MS] [SEED] [JITTER-MS] [DROPPED]
//! [FROZEN-EVERY-MS] [FROZEN-FOR-MS] [STALE-MS] [WRONG-MS]`.

use std::io::{self, Write as _};

use fastrand::Rng;
use mom_rehearsal::{Start, Trouble};

fn main() -> io::Result<()> {
    let number = |place: usize, usual: f64| {
        let given = std::env::args().nth(place);
        given.and_then(|text| text.parse().ok()).unwrap_or(usual)
    };
    let mut random = Rng::with_seed(number(4, 1.0) as u64);
    for seed in 0..number(1, 5.0) as usize {
        let mut start = Start::random(&mut random, number(2, 0.0), (number(3, 0.0) * 1000.0) as i64);
        start.jitter = (number(5, 0.0) * 1000.0) as i64;
        let micros = |place| (number(place, 0.0) * 1000.0) as i64;
        start.trouble = Trouble {
            dropped: number(6, 0.0),
            frozen: [micros(7), micros(8)],
            stale: micros(9),
            wrong: micros(10),
            stands: [0, 0],
            blind: None,
            seed: seed as u64,
        };
        let end = start.rehearse(300);
        let progress = &end.progress;
        writeln!(
            io::stdout(),
            "{:5.1} s  {:2} commands  {} tries  {:6.2} mm  {:4.1} degrees  inside {}  delay {:?}  off the way {:5.1} mm  corrections {:.1?}  {} images  {}",
            end.seconds,
            progress.commands,
            progress.attempts,
            end.error,
            end.turned,
            end.inside,
            progress.command_delay,
            end.stray,
            progress.corrections,
            end.images,
            end.failure.as_deref().unwrap_or("aligned"),
        )?;
    }
    Ok(())
}
