//! The table of a run, and its place in a document.

use std::fmt::Write as _;
use std::time::Duration;

use mom_proto::WireError;
use mom_proto::codec::Form;

use crate::codecs::{Coding, SIZES};
use crate::decisions::{Admissions, Decisions};
use crate::pace::median;
use crate::scenario::{Figures, Goal, Scenario};
use crate::{Delays, Error, Pace, control, machine, measure};

/// What stands before the table in a document.
pub const BEGIN: &str = "<!-- mom-bench: begin -->";
/// What stands after it.
pub const END: &str = "<!-- mom-bench: end -->";

/// A document with its table replaced by a new one; `None` without a place for it.
pub fn insert(document: &str, table: &str) -> Option<String> {
    insert_between(document, BEGIN, END, table)
}

/// A document with what stands between two marks replaced; `None` without the marks.
pub fn insert_between(document: &str, begin: &str, end: &str, text: &str) -> Option<String> {
    let (before, rest) = document.split_once(begin)?;
    let (_, after) = rest.split_once(end)?;
    Some(format!("{before}{begin}\n\n{}\n\n{end}{after}", text.trim()))
}

/// The conditions of a run in a sentence.
pub fn conditions(pace: &Pace) -> String {
    format!(
        "Measured on {}; {} of {} in one run, everything on this machine over loopback.\n",
        machine::describe(),
        if pace.runs > 1 { "medians" } else { "figures" },
        pace.runs
    )
}

/// The end-to-end part.
pub fn end_to_end(scenarios: &[Scenario], figures: &[Vec<Figures>]) -> String {
    let all = || scenarios.iter().zip(figures);
    let mut out = String::new();
    let streams: Vec<_> = all().filter(|(scenario, _)| !scenario.load.is_delay()).collect();
    if !streams.is_empty() {
        out +=
            "| deliveries per second | relay | MOM | ratio | to aim for | CPU s per million: relay | MOM |\n";
        out += "|---|---:|---:|---:|---:|---:|---:|\n";
        streams
            .into_iter()
            .for_each(|(scenario, figures)| row(&mut out, scenario, figures));
        out += "\n";
    }
    let trips: Vec<_> = all().filter(|(scenario, _)| scenario.load.is_delay()).collect();
    if !trips.is_empty() {
        out += "| p50 / p99 in µs | relay | MOM | ratio of p50 | to aim for | CPU s per million: relay | MOM |\n";
        out += "|---|---:|---:|---:|---:|---:|---:|\n";
        trips
            .into_iter()
            .for_each(|(scenario, figures)| row(&mut out, scenario, figures));
        out += "\n";
    }
    out
}

fn row(out: &mut String, scenario: &Scenario, figures: &[Figures]) {
    let value = |figures: &Figures| match figures.p99 {
        Some(p99) => format!("{:.0} / {p99:.0}", figures.value),
        None => amount(figures.value),
    };
    let cpu = |figures: &Figures| figures.cpu.map_or("–".to_owned(), short);
    let goal = match scenario.goal {
        Some(Goal::AtLeast(least)) => format!("≥ {least}"),
        Some(Goal::AtMost(most)) => format!("≤ {most}"),
        None => String::new(),
    };
    if let [floor, hub] = figures {
        // Writing to a String cannot fail.
        let _ = writeln!(
            out,
            "| {} | {} | {} | {} | {goal} | {} | {} |",
            scenario.name,
            value(floor),
            value(hub),
            short(hub.ratio),
            cpu(floor),
            cpu(hub)
        );
    }
}

/// The hub's part: decisions per second on one core.
///
/// # Errors
/// As [`Decisions::new`].
pub fn hub(pace: &Pace) -> Result<String, WireError> {
    let mut out = "| hub, on one core | per second |\n|---|---:|\n".to_owned();
    let mut row = |name: &str, turn: &mut dyn FnMut() -> u64| {
        let rate = repeated(pace, |time| measure(time, &mut *turn).per_second());
        let _ = writeln!(out, "| {name} | {} |", amount(rate));
    };
    for members in [1, 100, 1000] {
        let mut decisions = Decisions::new(members)?;
        let of = match members {
            1 => "1 member".to_owned(),
            _ => format!("{members} members"),
        };
        row(&format!("leave and join, {of}"), &mut || decisions.leave_join());
        row(&format!("grab and release, {of}"), &mut || {
            decisions.grab_release()
        });
        row(&format!("send by way of the hub, {of}"), &mut || decisions.send());
        let mut all = Admissions::new(members, false)?;
        row(&format!("admit by the route, to all of {of}"), &mut || {
            admitted(&mut all)
        });
    }
    let mut one = Admissions::new(1000, true)?;
    row("admit by the route, to one of 1000 members by name", &mut || {
        admitted(&mut one)
    });
    Ok(out)
}

/// The part about control under load.
///
/// # Errors
/// As [`control::contention`] and [`control::storm`].
pub fn control(address: &str, user: &str, pace: &Pace) -> Result<String, Error> {
    let contended = control::contention(address, user, pace.crowd, pace.grants)?;
    let alone = control::contention(address, user, 1, pace.grants)?;
    let storm = control::storm(address, user, pace.crowd, pace.calm)?;
    let times = |delays: &Delays| format!("{:.0} / {:.0}", delays.quantile(0.5), delays.quantile(0.99));
    let ratio = |[calm, busy]: &[Delays; 2]| short(busy.quantile(0.99) / calm.quantile(0.99));
    let mut out = String::new();
    let _ = writeln!(
        out,
        "| one token, binary over sockets | grants per second | release → next grant, p50 / p99 in µs | Jain's index |\n\
         |---|---:|---:|---:|\n\
         | 1 peer, grab and release | {} | | |\n\
         | {} peers, all waiting | {} | {} | {:.3} |\n",
        amount(alone.per_second),
        contended.peers,
        amount(contended.per_second),
        times(&contended.handover),
        contended.fairness,
    );
    let _ = writeln!(
        out,
        "{} peers logged in at once, with passwords, within {:.1} s, after {} answers `try-later`.\n\n\
         | meanwhile, p50 / p99 in µs | nobody logs in | {} log in | ratio of p99 |\n\
         |---|---:|---:|---:|\n\
         | renewals of the owner | {} | {} | {} |\n\
         | stops, from sender to robot | {} | {} | {} |",
        storm.logins,
        storm.took.as_secs_f64(),
        storm.put_off,
        storm.logins,
        times(&storm.renewals[0]),
        times(&storm.renewals[1]),
        ratio(&storm.renewals),
        times(&storm.stops[0]),
        times(&storm.stops[1]),
        ratio(&storm.stops),
    );
    Ok(out)
}

fn admitted(admissions: &mut Admissions) -> u64 {
    u64::from(std::hint::black_box(admissions.admit()).is_ok())
}

/// The codecs' part: MB of the wire per second on one core.
///
/// # Errors
/// As [`Coding::new`].
pub fn codecs(pace: &Pace) -> Result<String, WireError> {
    let mut out =
        "| codec, on one core | on the wire | encode, MB/s | per second | decode, MB/s | per second |\n\
                   |---|---:|---:|---:|---:|---:|\n"
            .to_owned();
    for form in [Form::Binary, Form::Xml, Form::Json] {
        for content in SIZES {
            let mut coding = Coding::new(form, content)?;
            let size = coding.size();
            let bytes = |done: Result<usize, WireError>| done.map_or(0, |bytes| bytes as u64);
            let encode = repeated(pace, |time| measure(time, || bytes(coding.encode())).per_second());
            let decode = repeated(pace, |time| {
                measure(time, || bytes(coding.decode_many())).per_second()
            });
            let _ = writeln!(
                out,
                "| {}, content of {} | {size} B | {:.0} | {} | {:.0} | {} |",
                form.word(),
                bytes_of(content),
                encode / 1e6,
                amount(encode / size as f64),
                decode / 1e6,
                amount(decode / size as f64)
            );
        }
    }
    Ok(out)
}

fn repeated(pace: &Pace, mut once: impl FnMut(Duration) -> f64) -> f64 {
    median((0..pace.runs).map(|_| once(pace.inside)).collect()).unwrap_or_default()
}

fn bytes_of(size: usize) -> String {
    match size {
        size if size % 1024 == 0 => format!("{} KiB", size / 1024),
        size => format!("{size} B"),
    }
}

/// A ratio or a few seconds.
pub fn short(number: f64) -> String {
    match number {
        small if small < 0.0995 => format!("{small:.3}"),
        other => format!("{other:.2}"),
    }
}

/// A number to three digits.
pub fn amount(number: f64) -> String {
    let (number, unit) = match number {
        large if large >= 999.5e3 => (large / 1e6, " M"),
        middle if middle >= 999.5 => (middle / 1e3, " k"),
        small => (small, ""),
    };
    match number {
        large if large >= 99.95 => format!("{large:.0}{unit}"),
        middle if middle >= 9.995 => format!("{middle:.1}{unit}"),
        small => format!("{small:.2}{unit}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_takes_the_place_of_the_old_one() {
        let document = format!("# A\n\n{BEGIN}\nold\n{END}\n\nb\n");
        let inserted = insert(&document, "| new |\n").unwrap();
        assert_eq!(inserted, format!("# A\n\n{BEGIN}\n\n| new |\n\n{END}\n\nb\n"));
        assert_eq!(insert(&inserted, "| new |").unwrap(), inserted);
        assert_eq!(insert("# A", "x"), None);
    }

    #[test]
    fn amounts_have_three_digits() {
        for (number, text) in [
            (3.456, "3.46"),
            (12.34, "12.3"),
            (999.4, "999"),
            (999.6, "1.00 k"),
            (12_345.0, "12.3 k"),
            (123_456.0, "123 k"),
            (3_456_789.0, "3.46 M"),
        ] {
            assert_eq!(amount(number), text);
        }
    }

    #[test]
    fn every_scenario_has_its_row() {
        let figures = |hub: &str, value, p99| Figures {
            hub: hub.to_owned(),
            value,
            p99,
            ratio: 0.5,
            cpu: Some(1.234),
        };
        let all = crate::scenario::ALL;
        let rows: Vec<_> = all
            .iter()
            .map(|scenario| {
                let p99 = scenario.load.is_delay().then_some(187.0);
                vec![figures("relay", 2e6, p99), figures("MOM", 1e6, p99)]
            })
            .collect();
        let table = end_to_end(&all, &rows);
        for scenario in all {
            assert!(table.contains(&format!("| {} | ", scenario.name)), "{table}");
        }
        assert!(
            table.contains("| 1→1, 1 KiB | 2.00 M | 1.00 M | 0.50 | ≥ 0.3 | 1.23 | 1.23 |"),
            "{table}"
        );
        assert!(table.contains("2000000 / 187"), "{table}");
    }
}
