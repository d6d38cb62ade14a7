//! Rehearses some starts and prints what came of them: `rehearse [STARTS] [DEGREES] [DELAY-MS] [SEED] [JITTER-MS]`.

use std::io::{self, Write as _};

use fastrand::Rng;
use mom_rehearsal::Start;

fn main() -> io::Result<()> {
    let number = |place: usize, usual: f64| {
        let given = std::env::args().nth(place);
        given.and_then(|text| text.parse().ok()).unwrap_or(usual)
    };
    let mut random = Rng::with_seed(number(4, 1.0) as u64);
    for _ in 0..number(1, 5.0) as usize {
        let mut start = Start::random(&mut random, number(2, 0.0), (number(3, 0.0) * 1000.0) as i64);
        start.jitter = (number(5, 0.0) * 1000.0) as i64;
        let end = start.rehearse(300);
        let progress = &end.progress;
        writeln!(
            io::stdout(),
            "{:5.1} s  {:2} commands  {} tries  {:6.2} mm  {:4.1} degrees  inside {}  delay {:?}  corrections {:.1?}  {} images  {}",
            end.seconds,
            progress.commands,
            progress.attempts,
            end.error,
            end.turned,
            end.inside,
            progress.command_delay,
            progress.corrections,
            end.images,
            end.failure.as_deref().unwrap_or("aligned"),
        )?;
    }
    Ok(())
}
