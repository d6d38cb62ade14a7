//! Running the scenarios: each hub is started anew for each figure, so that none inherits anything.

use std::collections::BTreeMap;
use std::time::Duration;

use mom_benches::scenario::{Trips, interleaved, per_million};
use mom_benches::{Error, Hub, Stream, Streamed, Topic, median};

use crate::brokers::{Kind, Programs};
use crate::idle::idle;
use crate::metric::{Metric, Sample};
use mom_tests::network::Network;

use crate::network::SlowLink;
use crate::plan::{Effort, Load, Row};

/// What all runs of one scenario came to.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The scenario.
    pub row: Row,
    /// The samples of each hub, one a run.
    pub samples: BTreeMap<Kind, Vec<Sample>>,
    /// Why a hub has fewer than all.
    pub failures: BTreeMap<Kind, String>,
    /// What happened to a hub that has figures all the same.
    pub notes: BTreeMap<Kind, String>,
}

impl Outcome {
    /// The median over the runs.
    pub fn value(&self, kind: Kind, metric: Metric) -> Option<f64> {
        let samples = self.samples.get(&kind)?;
        median(
            samples
                .iter()
                .filter_map(|sample| sample.get(&metric).copied())
                .collect(),
        )
    }

    /// The best value of the peers that carried everything, and whose it is.
    pub fn best_peer(&self, metric: Metric) -> Option<(Kind, f64)> {
        let complete = |kind: &Kind| self.value(*kind, Metric::Share).is_none_or(|share| share > 0.99);
        let peers = self.row.hubs.iter().copied().filter(|kind| kind.is_peer());
        let values = peers
            .filter(complete)
            .filter_map(|kind| Some((kind, self.value(kind, metric)?)));
        match metric.more_is_better() {
            true => values.max_by(|one, other| one.1.total_cmp(&other.1)),
            false => values.min_by(|one, other| one.1.total_cmp(&other.1)),
        }
    }

    fn take(&mut self, kind: Kind, result: Result<Sample, Error>, progress: &mut impl FnMut(&str)) {
        match result {
            Ok(sample) => {
                let shown: Vec<_> = sample
                    .iter()
                    .map(|(metric, value)| format!("{} {}", metric.title(), metric.show(*value)))
                    .collect();
                progress(&format!("  {}: {}", kind.name(), shown.join("; ")));
                self.samples.entry(kind).or_default().push(sample);
            }
            Err(error) => {
                progress(&format!("  {}: {error}", kind.name()));
                self.failures.entry(kind).or_insert_with(|| error.to_string());
            }
        }
    }

    /// Ours in this scenario.
    pub fn own(&self) -> Kind {
        let own = self.row.hubs.iter().copied().find(|kind| kind.is_mom());
        own.unwrap_or(Kind::Mom)
    }
}

/// Runs all scenarios once for each run. A hub that fails has no figure, and the reason is kept; the rest goes on.
pub fn run(
    rows: &[Row],
    programs: &Programs,
    wanted: impl Fn(Kind) -> bool,
    effort: &Effort,
    mut progress: impl FnMut(&str),
) -> Vec<Outcome> {
    let outcome = |row: &Row| Outcome {
        row: *row,
        samples: BTreeMap::new(),
        failures: BTreeMap::new(),
        notes: BTreeMap::new(),
    };
    let mut outcomes: Vec<Outcome> = rows.iter().map(outcome).collect();
    for run in 0..effort.runs {
        for outcome in &mut outcomes {
            let row = outcome.row;
            let mut hubs = row.hubs.to_vec();
            hubs.retain(|kind| programs.has(*kind) && wanted(*kind));
            // Nobody is always the first, or always behind the same one.
            let first = run % hubs.len().max(1);
            hubs.rotate_left(first);
            progress(&format!("run {} of {}: {}", run + 1, effort.runs, row.name));
            if row.load == Load::PingPong {
                for (kind, result) in ping_pong(&row, &hubs, programs, effort) {
                    outcome.take(kind, result, &mut progress);
                }
                continue;
            }
            for kind in hubs {
                let sampled = match row.load {
                    Load::Stop | Load::Canary(_) => {
                        stop(row.load, kind, programs, effort).map(|(sample, note)| {
                            outcome.notes.extend(note.map(|note| (kind, note)));
                            sample
                        })
                    }
                    _ => sample(&row, kind, programs, effort),
                };
                outcome.take(kind, sampled, &mut progress);
            }
        }
    }
    outcomes
}

/// Loads whose receiver may be cut off: the figures until then count, and with them why.
fn stop(
    load: Load,
    kind: Kind,
    programs: &Programs,
    effort: &Effort,
) -> Result<(Sample, Option<String>), Error> {
    if let Load::Canary(hindrance) = load {
        let hub = programs.start(kind, &Network::Loopback, false)?;
        return effort.canary.run(&hub, hindrance);
    }
    let link = SlowLink::new()?;
    let hub = programs.start(kind, &link.ends.hub, false)?;
    let observed = effort.stop.run(&hub, &link.ends, |_| {})?;
    Ok(effort.stop.sample(observed))
}

fn sample(row: &Row, kind: Kind, programs: &Programs, effort: &Effort) -> Result<Sample, Error> {
    let hub = programs.start(kind, &Network::Loopback, row.load == Load::Crowd)?;
    match row.load {
        Load::Stream(receivers) => {
            let streamed = stream(row, &hub, receivers, Topic::Forth, effort)?;
            let mut sample = Sample::from([(Metric::Rate, streamed.deliveries.per_second())]);
            add_cpu(&mut sample, streamed.cpu, streamed.deliveries.count);
            Ok(sample)
        }
        Load::Crowd => effort.crowd.run(&hub),
        Load::Idle => idle(&hub, effort.idle.min(kind.most_idle())),
        Load::Guarded => guarded(row, &hub, effort),
        Load::Stop | Load::Canary(_) | Load::PingPong => {
            Err(Error::Unexpected("a load that is run elsewhere".to_owned()))
        }
    }
}

fn add_cpu(sample: &mut Sample, cpu: Option<Duration>, deliveries: u64) {
    if let Some(cpu) = per_million(cpu, deliveries) {
        sample.insert(Metric::Cpu, cpu);
    }
}

fn stream(row: &Row, hub: &Hub, receivers: usize, topic: Topic, effort: &Effort) -> Result<Streamed, Error> {
    let stream = Stream {
        payload: row.size.payload(&*hub.driver)?,
        topic,
        receivers,
        window: None,
        warm_up: effort.warm_up,
        time: effort.stream,
    };
    stream.run(hub)
}

/// Streams on both channels in turn, the order changing each time; the middle of the pairs' ratios counts.
fn guarded(row: &Row, hub: &Hub, effort: &Effort) -> Result<Sample, Error> {
    let (mut ratios, mut rates, mut cpus) = (Vec::new(), Vec::new(), Vec::new());
    for pair in 0..effort.pairs {
        let mut both = [Topic::Forth, Topic::Command];
        if pair % 2 == 1 {
            both.reverse();
        }
        let mut rate = BTreeMap::new();
        for topic in both {
            let streamed = stream(row, hub, 1, topic, effort)?;
            rate.insert(topic as usize, streamed.deliveries.per_second());
            if topic == Topic::Command {
                cpus.extend(per_million(streamed.cpu, streamed.deliveries.count));
            }
        }
        let [bare, guarded] = [Topic::Forth, Topic::Command].map(|topic| rate[&(topic as usize)]);
        ratios.push(guarded / bare);
        rates.push(guarded);
    }
    let middles = [
        (Metric::Guarded, ratios),
        (Metric::Rate, rates),
        (Metric::Cpu, cpus),
    ];
    let middles = middles
        .into_iter()
        .filter_map(|(metric, values)| Some((metric, median(values)?)));
    Ok(middles.collect())
}

/// All hubs run at once and take turns, so that whatever else the machine does meets them alike.
fn ping_pong(
    row: &Row,
    kinds: &[Kind],
    programs: &Programs,
    effort: &Effort,
) -> Vec<(Kind, Result<Sample, Error>)> {
    let mut hubs = Vec::new();
    for kind in kinds {
        match programs.start(*kind, &Network::Loopback, false) {
            Ok(hub) => hubs.push(hub),
            Err(error) => return vec![(*kind, Err(error))],
        }
    }
    let hubs: Vec<&Hub> = hubs.iter().collect();
    let sample = |(delays, cpu): &Trips| {
        let mut sample = Sample::from([
            (Metric::P50, delays.quantile(0.5)),
            (Metric::P99, delays.quantile(0.99)),
        ]);
        add_cpu(&mut sample, *cpu, 2 * delays.count() as u64);
        sample
    };
    match interleaved(&hubs, row.size, effort.rounds, effort.connections, effort.block) {
        Ok(trips) => kinds
            .iter()
            .zip(&trips)
            .map(|(kind, trips)| (*kind, Ok(sample(trips))))
            .collect(),
        Err((index, error)) => vec![(kinds[index], Err(error))],
    }
}
