//! What was found, as a table and as JSON.

use std::time::Duration;

use mom_client::ClockOffset;
use serde_json::{Value as Json, json};

use super::Examined;
use super::examine::{Measured, Trips};
use crate::output::style::{Tone, ink, padded};
use crate::output::words::{self, visible};

/// The columns after the door and its address.
const HEADINGS: [&str; 7] = ["TCP", "open", "answer", "1 B", "1 kB", "10 kB", "password"];
/// The sizes among them.
const SHOWN: [usize; 3] = [1, 1000, 10_000];

/// The table: a row for each door, open or not.
pub(super) fn table(hub: &str, examined: &[Examined]) -> String {
    let names = examined
        .iter()
        .map(|examined| (examined.door.name.to_owned(), short(examined)));
    let names: Vec<(String, String)> = names.collect();
    let wide = |lengths: &mut dyn Iterator<Item = usize>| lengths.max().unwrap_or_default();
    let door_width = wide(&mut names.iter().map(|(door, _)| door.chars().count()));
    let address_width = wide(&mut names.iter().map(|(_, address)| address.chars().count()));
    let rows: Vec<Option<[String; 7]>> = examined
        .iter()
        .map(|examined| {
            examined
                .outcome
                .as_ref()
                .ok()
                .map(|measured| cells(examined, measured))
        })
        .collect();
    let widths: [usize; 7] = std::array::from_fn(|column| {
        let cells = rows.iter().flatten().map(|row| row[column].chars().count());
        cells.max().unwrap_or_default().max(HEADINGS[column].len())
    });
    let line = |cells: [&str; 7]| {
        let cells = cells.iter().zip(widths);
        cells
            .map(|(cell, width)| format!("  {cell:>width$}"))
            .collect::<String>()
    };
    let mut lines = vec![heading(hub, examined)];
    if rows.iter().any(Option::is_some) {
        let blanks = " ".repeat(door_width + 2 + address_width);
        lines.push(ink(format!("{blanks}{}", line(HEADINGS)), Tone::Faint));
    }
    for ((examined, (door, address)), row) in examined.iter().zip(&names).zip(&rows) {
        let (tone, rest) = match (row, &examined.outcome) {
            (Some(row), _) => (Tone::Good, line(row.each_ref().map(String::as_str))),
            (None, Err(blocked)) => (Tone::Bad, format!("  {}", visible(&blocked.text()))),
            (None, Ok(_)) => (Tone::Good, String::new()),
        };
        let door = padded(door, door_width, tone);
        lines.push(format!(
            "{door}  {}{rest}",
            padded(address, address_width, Tone::Place)
        ));
    }
    lines.join("\n")
}

/// Without the fingerprint, which is the same for all.
fn short(examined: &Examined) -> String {
    let mut address = examined.address.clone();
    address.pin = None;
    address.to_string()
}

fn heading(hub: &str, examined: &[Examined]) -> String {
    let mut heading = ink(hub, Tone::Strong);
    if let Some(at) = examined.iter().find_map(Examined::at) {
        heading.push_str(&format!(" at {at}"));
    }
    if let Some(clock) = clock(examined) {
        let (side, micros) = match clock.micros {
            0.. => ("ahead", clock.micros),
            _ => ("behind", clock.micros.saturating_neg()),
        };
        heading.push_str(&format!(
            ", its clock {} ± {} {side}",
            words::measured(Duration::from_micros(micros.unsigned_abs())),
            words::measured(Duration::from_micros(clock.error)),
        ));
    }
    heading
}

/// The best estimate of the hub's clock: that of the door with the least error.
fn clock(examined: &[Examined]) -> Option<ClockOffset> {
    let clocks = examined
        .iter()
        .filter_map(|examined| examined.outcome.as_ref().ok()?.clock);
    clocks.min_by_key(|clock| clock.error)
}

fn cells(examined: &Examined, measured: &Measured) -> [String; 7] {
    let time = |time: Option<Duration>| time.map_or_else(|| "-".to_owned(), words::measured);
    let trip = |size| time(measured.near(size).map(Trips::median));
    let password = if examined.takes_password() { "yes" } else { "no" };
    [
        time(measured.step(|entry| entry.tcp)),
        time(measured.step(|entry| entry.open)),
        time(measured.step(|entry| entry.answer)),
        trip(SHOWN[0]),
        trip(SHOWN[1]),
        trip(SHOWN[2]),
        password.to_owned(),
    ]
}

/// What to do about what blocks, each advice once.
pub(super) fn advice(hub: &str, examined: &[Examined]) -> Vec<String> {
    let mut advice: Vec<String> = Vec::new();
    for examined in examined {
        let Err(blocked) = &examined.outcome else { continue };
        let line = format!(
            "{} {}",
            ink(format_args!("{}:", blocked.word()), Tone::Notice),
            blocked.hint(hub)
        );
        if !advice.contains(&line) {
            advice.push(line);
        }
    }
    let through = |examined: &&Examined| examined.proxy.is_some();
    let doors: Vec<&str> = examined
        .iter()
        .filter(through)
        .map(|examined| examined.door.name)
        .collect();
    if let Some(proxy) = proxy(examined) {
        advice.push(format!(
            "{} these doors go through {}, which the environment names: {}; the others go past it",
            ink("proxy:", Tone::Notice),
            visible(proxy),
            doors.join("; ")
        ));
    }
    advice
}

/// The proxy that some of the doors go through.
fn proxy(examined: &[Examined]) -> Option<&str> {
    examined.iter().find_map(|examined| examined.proxy.as_deref())
}

/// Times in µs.
pub(super) fn to_json(hub: &str, examined: &[Examined]) -> Json {
    let doors = examined.iter().map(|examined| {
        let mut json = json!({
            "door": examined.door.name,
            "address": examined.address.to_string(),
            "open": examined.outcome.is_ok(),
            "password": examined.takes_password(),
            "proxy": examined.proxy,
        });
        match &examined.outcome {
            Ok(measured) => {
                json["connect"] = connect(measured);
                json["round-trips"] = measured.trips.iter().map(trips).collect();
            }
            Err(blocked) => {
                json["blocked"] = blocked.word().into();
                json["text"] = blocked.text().into();
                json["hint"] = blocked.hint(hub).into();
            }
        }
        json
    });
    let clock = clock(examined).map(|clock| json!({"offset": clock.micros, "error": clock.error}));
    let doors: Vec<Json> = doors.collect();
    json!({"hub": hub, "clock": clock, "proxy": proxy(examined), "doors": doors})
}

fn connect(measured: &Measured) -> Json {
    json!({
        "name": measured.step(|entry| entry.name).map(micros),
        "tcp": measured.step(|entry| entry.tcp).map(micros),
        "open": measured.step(|entry| entry.open).map(micros),
        "answer": measured.step(|entry| entry.answer).map(micros),
    })
}

fn trips(trips: &Trips) -> Json {
    json!({
        "size": trips.size,
        "count": trips.times.len(),
        "mean": micros(trips.mean()),
        "p50": micros(trips.median()),
        "most": trips.times.last().copied().map(micros),
    })
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use std::net::{IpAddr, Ipv4Addr};

    use super::super::blocked::Blocked;
    use super::super::doors::{DOORS, Target};
    use super::super::examine::Entry;
    use super::*;

    fn examined() -> Vec<Examined> {
        let target = Target::read("lab").unwrap();
        let millis = Duration::from_millis;
        let entry = |at| Entry {
            at: IpAddr::V4(at),
            name: millis(3),
            tcp: millis(20),
            open: millis(45),
            answer: Duration::from_micros(21_500),
        };
        let measured = Measured {
            entries: vec![entry(Ipv4Addr::new(192, 0, 2, 1))],
            trips: [1, 1000, 10_000]
                .map(|size| Trips {
                    size,
                    times: vec![millis(20), millis(21), millis(40)],
                })
                .to_vec(),
            clock: Some(ClockOffset {
                micros: -1500,
                error: 10_000,
            }),
        };
        let outcomes = [
            Ok(measured.clone()),
            Err(Blocked::Refused),
            Ok(measured),
            Err(Blocked::Refused),
        ];
        let tried = DOORS.iter().zip(outcomes);
        let of = |(door, outcome)| Examined {
            door,
            address: target.address(door).unwrap(),
            proxy: None,
            outcome,
        };
        tried.map(of).collect()
    }

    #[test]
    fn the_table() {
        let text = anstream::adapter::strip_str(&table("lab:7666", &examined())).to_string();
        assert_eq!(
            text,
            "\
lab:7666 at 192.0.2.1, its clock 1.50 ms ± 10 ms behind
                                TCP   open  answer    1 B   1 kB  10 kB  password
binary       bin://lab:7666   20 ms  45 ms   21 ms  21 ms  21 ms  21 ms        no
XML          tcp://lab:7666   refused: nothing listens on this port
binary, TLS  bins://lab:7666  20 ms  45 ms   21 ms  21 ms  21 ms  21 ms       yes
XML, TLS     tcps://lab:7666  refused: nothing listens on this port"
        );
        let advice = advice("lab:7666", &examined());
        assert_eq!(advice.iter().filter(|line| line.contains("mom lab")).count(), 1);
    }

    #[test]
    fn the_json_form() {
        let json = to_json("lab:7666", &examined());
        assert_eq!(json["clock"], json!({"offset": -1500, "error": 10_000}));
        let (open, shut) = (&json["doors"][2], &json["doors"][1]);
        assert_eq!(open["password"], true);
        assert_eq!(open["connect"]["answer"], 21_500);
        assert_eq!(open["round-trips"][2]["mean"], 27_000);
        assert_eq!(
            (&shut["open"], &shut["blocked"]),
            (&json!(false), &json!("refused"))
        );
    }
}
