//! The comparison as tables for a document and as raw figures for a later comparison.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use mom_benches::machine;
use serde_json::{Map, Value, json};

use crate::brokers::{Kind, Programs};
use crate::canary::Hindrance;
use crate::metric::Metric;
use crate::plan::{Goal, Load, ROWS, Row, Rule};
use crate::run::Outcome;

/// What stands before the tables in a document.
pub const BEGIN: &str = "<!-- bench-peers: begin -->";
/// What stands after them.
pub const END: &str = "<!-- bench-peers: end -->";

/// How a goal stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Judged {
    /// Ours.
    pub value: f64,
    /// What it is compared with, and whose that is; none for a plain bound.
    pub other: Option<(Kind, f64)>,
    /// The bound on ours.
    pub bound: f64,
    /// Whether it is kept.
    pub met: bool,
}

/// Judges a goal; none where a figure is missing.
pub fn judge(outcome: &Outcome, goal: &Goal) -> Option<Judged> {
    let value = outcome.value(outcome.own(), goal.metric)?;
    let best = || outcome.best_peer(goal.metric);
    let relay = || Some((Kind::Relay, outcome.value(Kind::Relay, goal.metric)?));
    let (other, bound, at_least) = match goal.rule {
        Rule::AtLeast(least) => (None, least, true),
        Rule::AtMost(most) => (None, most, false),
        Rule::TimesBest(times) => best().map(|best| (Some(best), times * best.1, true))?,
        Rule::OfBest(times) => best().map(|best| (Some(best), times * best.1, false))?,
        Rule::OfRelay(times) => relay().map(|relay| (Some(relay), times * relay.1, false))?,
    };
    Some(Judged {
        value,
        other,
        bound,
        met: match at_least {
            true => value >= bound,
            false => value <= bound,
        },
    })
}

fn words(goal: &Goal) -> String {
    let title = goal.metric.title();
    match goal.rule {
        Rule::AtLeast(least) => format!("{title} ≥ {}", goal.metric.show(least)),
        Rule::AtMost(most) => format!("{title} ≤ {}", goal.metric.show(most)),
        Rule::TimesBest(times) => format!("{title} ≥ {times} × the best peer's"),
        Rule::OfBest(times) => format!("{title} ≤ {times} × the best peer's"),
        Rule::OfRelay(times) => format!("{title} ≤ {times} × the relay's"),
    }
}

/// The conditions, the goals, all figures, and what is missing.
pub fn markdown(outcomes: &[Outcome], programs: &Programs, runs: usize, load: Option<f64>) -> String {
    let mut out = conditions(programs, runs, load);
    out += &goals(outcomes);
    for metric in [Metric::Rate, Metric::P50, Metric::P99, Metric::Cpu, Metric::Share] {
        let streams = |row: &Row| !matches!(row.load, Load::Stop | Load::Canary(_));
        out += &matrix(outcomes, &[metric], streams);
    }
    out += &matrix(outcomes, &[Metric::Memory], |row| row.load == Load::Idle);
    let stop = [
        Metric::P50,
        Metric::P99,
        Metric::Arrived,
        Metric::Link,
        Metric::Frames,
        Metric::Told,
        Metric::Cpu,
    ];
    out += &matrix(outcomes, &stop, |row| row.load == Load::Stop);
    let canary = [
        Metric::IdleP50,
        Metric::IdleP99,
        Metric::P50,
        Metric::P99,
        Metric::Arrived,
        Metric::Rate,
        Metric::Cores,
        Metric::Grown,
    ];
    for hindrance in [Hindrance::Flood, Hindrance::Sleeper] {
        out += &matrix(outcomes, &canary, |row| row.load == Load::Canary(hindrance));
    }
    out + &failures(outcomes, programs)
}

fn conditions(programs: &Programs, runs: usize, load: Option<f64>) -> String {
    let peers = Kind::ALL
        .into_iter()
        .filter(|kind| kind.is_peer() && programs.has(*kind));
    let versions: Vec<_> = peers
        .map(|kind| format!("{} {}", kind.name(), programs.version(kind)))
        .collect();
    format!(
        "Measured on {}{}; {} of {runs} in one run. {}.\n\n",
        machine::describe(),
        load.map_or(String::new(), |load| format!(
            ", with a load average of {load:.1} before it began"
        )),
        if runs > 1 { "medians" } else { "figures" },
        versions.join(", ")
    )
}

fn goals(outcomes: &[Outcome]) -> String {
    let mut out = "| scenario | goal | MOM | compared with | MOM over it | |\n|---|---|---:|---:|---:|---|\n"
        .to_owned();
    for outcome in outcomes {
        for goal in outcome.row.goals {
            let name = outcome.row.name;
            let Some(judged) = judge(outcome, goal) else {
                let _ = writeln!(out, "| {name} | {} | | | | not measured |", words(goal));
                continue;
            };
            let show = |value| goal.metric.show(value);
            let (other, ratio) = match judged.other {
                Some((kind, value)) => (
                    format!("{} {}", kind.name(), show(value)),
                    format!("{:.2}", judged.value / value),
                ),
                None => (String::new(), String::new()),
            };
            // Writing to a String cannot fail.
            let _ = writeln!(
                out,
                "| {name} | {} | {} | {other} | {ratio} | {} |",
                words(goal),
                show(judged.value),
                match judged.met {
                    true => "met".to_owned(),
                    false => format!("missed: {:.2} of it", distance(&judged, goal)),
                }
            );
        }
    }
    out + "\n"
}

/// How far a missed goal is: the part of it that was reached, below 1.
fn distance(judged: &Judged, goal: &Goal) -> f64 {
    match goal.rule {
        Rule::AtLeast(_) | Rule::TimesBest(_) => judged.value / judged.bound,
        Rule::AtMost(_) | Rule::OfBest(_) | Rule::OfRelay(_) => judged.bound / judged.value,
    }
}

/// One table: a row for each scenario and metric, a column for each hub that has a figure anywhere in it.
fn matrix(outcomes: &[Outcome], metrics: &[Metric], takes: impl Fn(&Row) -> bool) -> String {
    let rows: Vec<(&Outcome, Metric)> = outcomes
        .iter()
        .filter(|outcome| takes(&outcome.row))
        .flat_map(|outcome| metrics.iter().map(move |metric| (outcome, *metric)))
        .filter(|(outcome, metric)| {
            outcome
                .samples
                .keys()
                .any(|kind| outcome.value(*kind, *metric).is_some())
        })
        .collect();
    let measured = |kind: &Kind| {
        rows.iter()
            .any(|(outcome, metric)| outcome.value(*kind, *metric).is_some())
    };
    let hubs: Vec<Kind> = Kind::ALL.into_iter().filter(measured).collect();
    let Some(((first, _), title)) = rows.first().zip(metrics.first()) else {
        return String::new();
    };
    let title = match metrics.len() {
        1 => title.title(),
        _ => first.row.name,
    };
    let names: Vec<_> = hubs.iter().map(|kind| kind.name()).collect();
    let mut out = format!(
        "| {title} | {} |\n|---|{}\n",
        names.join(" | "),
        "---:|".repeat(hubs.len())
    );
    for (outcome, metric) in &rows {
        let cell = |kind: &Kind| {
            outcome
                .value(*kind, *metric)
                .map_or(String::new(), |value| metric.show(value))
        };
        let cells: Vec<_> = hubs.iter().map(cell).collect();
        let name = match metrics.len() {
            1 => outcome.row.name,
            _ => metric.title(),
        };
        let _ = writeln!(out, "| {name} | {} |", cells.join(" | "));
    }
    out + "\n"
}

/// A hub that is faster than a relay shows that the relay is not a floor there, or a mistake of the measurement.
fn beats_the_floor(outcome: &Outcome) -> Vec<Kind> {
    let floors = [Kind::RawRelay, Kind::Relay].map(|kind| outcome.value(kind, Metric::Rate));
    let Some(floor) = floors.into_iter().flatten().reduce(f64::max) else {
        return Vec::new();
    };
    let rate = |kind: &Kind| outcome.value(*kind, Metric::Rate);
    let hubs = outcome.row.hubs.iter().copied();
    hubs.filter(|kind| rate(kind).is_some_and(|rate| rate > floor))
        .collect()
}

fn failures(outcomes: &[Outcome], programs: &Programs) -> String {
    let mut out = String::new();
    for outcome in outcomes
        .iter()
        .filter(|outcome| matches!(outcome.row.load, Load::Stream(_)))
    {
        for kind in beats_the_floor(outcome) {
            let _ = writeln!(
                out,
                "- {}, {}: faster than both relays, so they are no floor there.",
                kind.name(),
                outcome.row.name
            );
        }
    }
    for kind in Kind::ALL.into_iter().filter(|kind| !programs.has(*kind)) {
        let _ = writeln!(out, "- {} is not installed here and was left out.", kind.name());
    }
    for outcome in outcomes {
        for (kind, note) in &outcome.notes {
            let _ = writeln!(
                out,
                "- {}, {}: the subscriber was cut off in a run: {}.",
                kind.name(),
                outcome.row.name,
                note.replace('|', "/")
            );
        }
        for (kind, reason) in &outcome.failures {
            let runs = outcome.samples.get(kind).map_or(0, Vec::len);
            let _ = writeln!(
                out,
                "- {}, {}: {}; {runs} runs counted.",
                kind.name(),
                outcome.row.name,
                reason.replace('|', "/")
            );
        }
    }
    out
}

/// All figures of all runs, for a later comparison.
pub fn raw(outcomes: &[Outcome], programs: &Programs, at: &str, load: Option<f64>) -> Value {
    let mut rows = Map::new();
    for outcome in outcomes {
        let mut hubs = Map::new();
        for (kind, samples) in &outcome.samples {
            let runs = samples.iter().map(|sample| {
                let figures = sample
                    .iter()
                    .map(|(metric, value)| (metric.key().to_owned(), json!(value)));
                Value::Object(figures.collect())
            });
            hubs.insert(kind.name().to_owned(), Value::Array(runs.collect()));
        }
        rows.insert(outcome.row.name.to_owned(), Value::Object(hubs));
    }
    let peers = Kind::ALL
        .into_iter()
        .filter(|kind| kind.is_peer() && programs.has(*kind));
    let versions = peers.map(|kind| (kind.name().to_owned(), json!(programs.version(kind))));
    json!({
        "at": at,
        "machine": machine::describe(),
        "load-before": load,
        "versions": Value::Object(versions.collect()),
        "rows": rows,
    })
}

/// What [`raw`] wrote, read back; rows, hubs and quantities that are not known any more are left out.
pub fn from_raw(raw: &Value) -> Vec<Outcome> {
    let sample = |figures: &Value| {
        let figures = figures.as_object().into_iter().flatten();
        figures
            .filter_map(|(key, value)| Some((Metric::from_key(key)?, value.as_f64()?)))
            .collect()
    };
    let samples = |row: &Row| {
        let hubs = raw.get("rows").and_then(|rows| rows.get(row.name)?.as_object());
        let hub = |(name, runs): (&String, &Value)| {
            Some((
                Kind::from_name(name)?,
                runs.as_array()?.iter().map(sample).collect(),
            ))
        };
        hubs.into_iter().flatten().filter_map(hub).collect()
    };
    let outcome = |row: &Row| Outcome {
        row: *row,
        samples: samples(row),
        failures: BTreeMap::new(),
        notes: BTreeMap::new(),
    };
    let all = ROWS.iter().map(outcome);
    all.filter(|outcome| !outcome.samples.is_empty()).collect()
}

/// Ours beside an earlier run's raw figures: the median of each goal's quantity, and the ratio to ours over the
/// best peer's then.
pub fn beside(outcomes: &[Outcome], earlier: &Value) -> String {
    let at = earlier
        .get("at")
        .and_then(Value::as_str)
        .unwrap_or("an unknown time");
    let mut out = format!("| MOM, now and at {at} | now | then | now over then |\n|---|---:|---:|---:|\n");
    for outcome in outcomes {
        let own = outcome.own();
        let runs = earlier
            .pointer("/rows")
            .and_then(|rows| rows.get(outcome.row.name)?.get(own.name())?.as_array());
        let mut metrics: Vec<Metric> = outcome.row.goals.iter().map(|goal| goal.metric).collect();
        metrics.sort_unstable();
        metrics.dedup();
        for metric in metrics {
            let then = runs
                .into_iter()
                .flatten()
                .filter_map(|run| run.get(metric.key())?.as_f64());
            let then = mom_benches::median(then.collect());
            if let Some((now, then)) = outcome.value(own, metric).zip(then) {
                let _ = writeln!(
                    out,
                    "| {}, {} | {} | {} | {:.2} |",
                    outcome.row.name,
                    metric.title(),
                    metric.show(now),
                    metric.show(then),
                    now / then
                );
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metric::Sample;

    fn outcome(rates: &[(Kind, f64)]) -> Outcome {
        let sample = |rate: f64| vec![Sample::from([(Metric::Rate, rate), (Metric::Cpu, 1e6 / rate)])];
        Outcome {
            row: ROWS[0],
            samples: rates.iter().map(|(kind, rate)| (*kind, sample(*rate))).collect(),
            failures: BTreeMap::new(),
            notes: BTreeMap::new(),
        }
    }

    #[test]
    fn goals_are_judged_against_the_best_peer_and_not_the_relay() {
        let rates = [
            (Kind::Relay, 9e6),
            (Kind::Mom, 2e6),
            (Kind::Nats, 1e6),
            (Kind::Redis, 5e5),
        ];
        let judged = judge(&outcome(&rates), &ROWS[0].goals[0]).unwrap();
        assert_eq!(judged.other, Some((Kind::Nats, 1e6)));
        assert!(judged.met, "{judged:?}");
        let missed = judge(
            &outcome(&[(Kind::Mom, 1e6), (Kind::Nats, 1e6)]),
            &ROWS[0].goals[0],
        );
        assert!(missed.is_some_and(|missed| !missed.met));
        assert_eq!(judge(&outcome(&[(Kind::Mom, 1e6)]), &ROWS[0].goals[0]), None);
    }

    #[test]
    fn who_is_faster_than_both_relays_is_named() {
        let rates = [
            (Kind::RawRelay, 1e6),
            (Kind::Relay, 2e6),
            (Kind::Mom, 1.5e6),
            (Kind::Redis, 3e6),
        ];
        assert_eq!(beats_the_floor(&outcome(&rates)), [Kind::Redis]);
        assert!(beats_the_floor(&outcome(&[(Kind::Mom, 1e6)])).is_empty());
    }

    #[test]
    fn figures_stand_in_the_columns_of_their_hubs() {
        let outcomes = [outcome(&[(Kind::Mom, 2e6), (Kind::Redis, 5e5)])];
        let table = matrix(&outcomes, &[Metric::Rate], |_| true);
        let expected =
            "| deliveries per second | MOM | redis |\n|---|---:|---:|\n| 1→1, 16 B | 2.00 M | 500 k |\n\n";
        assert_eq!(table, expected);
        assert!(goals(&outcomes).contains("| redis 500 k | 4.00 | met |"));
    }

    #[test]
    fn an_earlier_run_is_read_back() {
        let outcomes = [outcome(&[(Kind::Mom, 2e6)])];
        let earlier = json!({"at": "noon", "rows": {"1→1, 16 B": {"MOM": [{"deliveries-per-second": 1e6}]}}});
        let table = beside(&outcomes, &earlier);
        assert!(
            table.contains("| 1→1, 16 B, deliveries per second | 2.00 M | 1.00 M | 2.00 |"),
            "{table}"
        );
        assert_eq!(table.lines().count(), 3, "{table}");
    }

    #[test]
    fn raw_figures_are_read_back() {
        let outcomes = [outcome(&[(Kind::Mom, 2e6), (Kind::Redis, 5e5)])];
        let figures = |outcomes: &[Outcome]| matrix(outcomes, &[Metric::Rate, Metric::Cpu], |_| true);
        let mut raw = json!({"rows": {}});
        for (kind, samples) in &outcomes[0].samples {
            let rate = samples[0][&Metric::Rate];
            let cpu = samples[0][&Metric::Cpu];
            raw["rows"]["1→1, 16 B"][kind.name()] =
                json!([{"deliveries-per-second": rate, "cpu-s-per-million": cpu, "of-old": 1}]);
        }
        assert_eq!(figures(&from_raw(&raw)), figures(&outcomes));
    }
}
