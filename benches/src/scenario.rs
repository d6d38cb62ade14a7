//! Which loads are measured through which hubs, side by side in one run.

use std::time::Duration;

use crate::driver::{Message, Topic};
use crate::one_core::OneCore;
use crate::pace::median;
use crate::{Delays, Driver, Error, Hub, Pace, RoundTrips, Stream};

/// One row of the table.
#[derive(Clone, Copy, Debug)]
pub struct Scenario {
    /// Its name.
    pub name: &'static str,
    /// What is done.
    pub load: Load,
    /// How large each parcel is.
    pub size: Size,
    /// The names of the hubs that take it; the first is what the others are compared with.
    pub hubs: &'static [&'static str],
    /// What the ratio of the last hub to the first should be.
    pub goal: Option<Goal>,
}

/// A load.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Load {
    /// As many parcels as can be from one peer to so many.
    Stream(usize),
    /// One parcel there and back, on whatever cores the system takes.
    RoundTrip,
    /// One parcel there and back, everything on one core.
    RoundTripOnOneCore,
}

/// The size of a parcel in bytes.
#[derive(Clone, Copy, Debug)]
pub enum Size {
    /// Of what it carries.
    Payload(usize),
    /// Of all of it, as its sender writes it.
    Frame(usize),
}

/// A bound on a ratio.
#[derive(Clone, Copy, Debug)]
pub enum Goal {
    /// Rates should not fall below it.
    AtLeast(f64),
    /// Delays should not rise above it.
    AtMost(f64),
}

/// What one hub came to in one scenario: medians over all runs.
#[derive(Clone, Debug)]
pub struct Figures {
    /// The hub's name.
    pub hub: String,
    /// Deliveries per second, or the median round trip in µs.
    pub value: f64,
    /// The round trip in µs that one in a hundred exceeds.
    pub p99: Option<f64>,
    /// The value over the first hub's of the same run.
    pub ratio: f64,
    /// Processor seconds of the hub per million deliveries.
    pub cpu: Option<f64>,
}

const BINARY: &[&str] = &["relay", "MOM"];
const XML: &[&str] = &["relay", "MOM XML"];

const fn binary(name: &'static str, load: Load, payload: usize, goal: Option<Goal>) -> Scenario {
    Scenario {
        name,
        load,
        size: Size::Payload(payload),
        hubs: BINARY,
        goal,
    }
}

/// All scenarios.
pub const ALL: [Scenario; 9] = [
    binary("1→1, 16 B", Load::Stream(1), 16, None),
    binary("1→1, 1 KiB", Load::Stream(1), 1024, Some(Goal::AtLeast(0.3))),
    binary("1→1, 64 KiB", Load::Stream(1), 64 * 1024, None),
    binary("1→100, 256 B", Load::Stream(100), 256, None),
    Scenario {
        name: "1→1, 300 B in all, XML",
        load: Load::Stream(1),
        size: Size::Frame(300),
        hubs: XML,
        goal: None,
    },
    binary("round trip, 16 B", Load::RoundTrip, 16, Some(Goal::AtMost(1.5))),
    binary(
        "round trip, 1000 B",
        Load::RoundTrip,
        1000,
        Some(Goal::AtMost(1.5)),
    ),
    binary(
        "round trip on one core, 16 B",
        Load::RoundTripOnOneCore,
        16,
        Some(Goal::AtMost(1.5)),
    ),
    binary(
        "round trip on one core, 1000 B",
        Load::RoundTripOnOneCore,
        1000,
        Some(Goal::AtMost(1.5)),
    ),
];

impl Load {
    /// Whether it is a delay that is measured, and not a rate.
    pub fn is_delay(self) -> bool {
        matches!(self, Load::RoundTrip | Load::RoundTripOnOneCore)
    }
}

impl Goal {
    /// Whether a ratio is as it should be.
    pub fn is_met(self, ratio: f64) -> bool {
        match self {
            Goal::AtLeast(least) => ratio >= least,
            Goal::AtMost(most) => ratio <= most,
        }
    }
}

/// What one run of one hub came to.
#[derive(Clone, Copy, Debug)]
struct Sample {
    value: f64,
    p99: Option<f64>,
    cpu: Option<f64>,
}

/// Runs scenarios, each through its hubs in turn, and all of them again for each run. Gives the figures of
/// each scenario in the order of its hubs. A hub that is not there is left out.
///
/// # Errors
/// The first scenario that failed, named.
pub fn run(
    scenarios: &[Scenario],
    hubs: &[Hub],
    pace: &Pace,
    mut progress: impl FnMut(usize, &Scenario),
) -> Result<Vec<Vec<Figures>>, (String, Error)> {
    let mut samples: Vec<Vec<Vec<Sample>>> = vec![Vec::new(); scenarios.len()];
    for run in 0..pace.runs {
        for (scenario, samples) in scenarios.iter().zip(&mut samples) {
            progress(run, scenario);
            let sample = scenario.run(&scenario.hubs(hubs), pace);
            samples.push(sample.map_err(|error| (scenario.name.to_owned(), error))?);
        }
    }
    let all = scenarios.iter().zip(&samples);
    Ok(all
        .map(|(scenario, runs)| summary(&scenario.hubs(hubs), runs))
        .collect())
}

impl Scenario {
    fn hubs<'a>(&self, hubs: &'a [Hub]) -> Vec<&'a Hub> {
        let named = |name: &&str| hubs.iter().find(|hub| hub.name == **name);
        self.hubs.iter().filter_map(named).collect()
    }

    fn run(&self, hubs: &[&Hub], pace: &Pace) -> Result<Vec<Sample>, Error> {
        match self.load {
            Load::Stream(receivers) => hubs.iter().map(|hub| self.stream(receivers, hub, pace)).collect(),
            Load::RoundTrip => self.round_trips(hubs, pace),
            Load::RoundTripOnOneCore => {
                let _one_core = OneCore::new(hubs)?;
                self.round_trips(hubs, pace)
            }
        }
    }

    fn stream(&self, receivers: usize, hub: &Hub, pace: &Pace) -> Result<Sample, Error> {
        let stream = Stream {
            payload: self.size.payload(&*hub.driver)?,
            topic: Topic::Forth,
            receivers,
            window: None,
            warm_up: pace.warm_up,
            time: pace.stream,
        };
        let streamed = stream.run(hub)?;
        Ok(Sample {
            value: streamed.deliveries.per_second(),
            p99: None,
            cpu: per_million(streamed.cpu, streamed.deliveries.count),
        })
    }

    fn round_trips(&self, hubs: &[&Hub], pace: &Pace) -> Result<Vec<Sample>, Error> {
        let all = interleaved(hubs, self.size, pace.rounds, pace.connections, pace.block);
        let sample = |(delays, cpu): &Trips| Sample {
            value: delays.quantile(0.5),
            p99: Some(delays.quantile(0.99)),
            cpu: per_million(*cpu, 2 * delays.count() as u64),
        };
        let all = all.map_err(|(_, error)| error)?;
        Ok(all.iter().map(sample).collect())
    }
}

/// What one hub's round trips took, and the processor time of the hub.
pub type Trips = (Delays, Option<Duration>);

/// Round trips in alternating blocks, so that whatever else the machine does meets all hubs alike; and over many
/// connections, because where the system puts their threads doubles or halves the delay for as long as they last.
///
/// # Errors
/// The place of the hub that failed, and why.
pub fn interleaved(
    hubs: &[&Hub],
    size: Size,
    rounds: usize,
    connections: usize,
    block: usize,
) -> Result<Vec<Trips>, (usize, Error)> {
    let mut all: Vec<Trips> = vec![(Delays::default(), Some(Duration::ZERO)); hubs.len()];
    for _ in 0..connections.max(1) {
        let mut turns = Vec::new();
        for (index, hub) in hubs.iter().enumerate() {
            let start = || RoundTrips::start(hub, size.payload(&*hub.driver)?);
            turns.push(start().map_err(|error| (index, error))?);
        }
        let mut each = |what: &dyn Fn(&mut RoundTrips<'_>) -> Result<(), Error>| {
            let mut numbered = turns.iter_mut().enumerate();
            numbered.try_for_each(|(index, trips)| what(trips).map_err(|error| (index, error)))
        };
        let mut rounds = rounds / connections.max(1);
        each(&|trips| trips.warm_up(block))?;
        while rounds > 0 {
            let block = block.clamp(1, rounds);
            each(&|trips| trips.block(block))?;
            rounds -= block;
        }
        for ((delays, cpu), trips) in all.iter_mut().zip(&turns) {
            delays.extend(&trips.delays);
            *cpu = cpu.zip(trips.cpu).map(|(sum, more)| sum + more);
        }
    }
    Ok(all)
}

impl Size {
    /// The payload that gives this size with this driver.
    ///
    /// # Errors
    /// A size that no payload gives.
    pub fn payload(self, driver: &dyn Driver) -> Result<usize, Error> {
        let whole = match self {
            Size::Payload(payload) => return Ok(payload),
            Size::Frame(whole) => whole,
        };
        let none = || Error::Unexpected(format!("no payload makes a frame of {whole} bytes"));
        let least = driver.template(Message::forth(crate::driver::NUMBER))?.size();
        let mut payload = (crate::driver::NUMBER + whole)
            .checked_sub(least)
            .ok_or_else(none)?;
        // The digits of a length may be more for a longer payload.
        let more = driver
            .template(Message::forth(payload))?
            .size()
            .saturating_sub(whole);
        payload -= more;
        match driver.template(Message::forth(payload))?.size() == whole {
            true => Ok(payload),
            false => Err(none()),
        }
    }
}

/// Processor seconds per million deliveries.
pub fn per_million(cpu: Option<Duration>, deliveries: u64) -> Option<f64> {
    cpu.filter(|_| deliveries > 0)
        .map(|cpu| cpu.as_secs_f64() / (deliveries as f64 / 1e6))
}

fn summary(hubs: &[&Hub], runs: &[Vec<Sample>]) -> Vec<Figures> {
    let of = |index: usize, value: &dyn Fn(&Sample, &Sample) -> Option<f64>| {
        let values = runs.iter().filter_map(|run| value(&run[index], &run[0]));
        median(values.collect())
    };
    let figures = |(index, hub): (usize, &&Hub)| Figures {
        hub: hub.name.clone(),
        value: of(index, &|sample, _| Some(sample.value)).unwrap_or_default(),
        p99: of(index, &|sample, _| sample.p99),
        ratio: of(index, &|sample, first| Some(sample.value / first.value)).unwrap_or_default(),
        cpu: of(index, &|sample, _| sample.cpu),
    };
    hubs.iter().enumerate().map(figures).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RelayDriver;

    #[test]
    fn ratios_are_of_the_same_run() {
        let hubs = [Hub::relay(""), Hub::relay("")];
        let sample = |value| Sample {
            value,
            p99: None,
            cpu: Some(value),
        };
        let runs =
            [(10.0, 5.0), (100.0, 20.0), (1000.0, 900.0)].map(|(one, two)| vec![sample(one), sample(two)]);
        let figures = summary(&[&hubs[0], &hubs[1]], &runs);
        assert_eq!((figures[0].value, figures[0].ratio), (100.0, 1.0));
        assert_eq!((figures[1].value, figures[1].ratio), (20.0, 0.5));
        assert_eq!((figures[1].cpu, figures[1].p99), (Some(20.0), None));
    }

    #[test]
    fn whole_frames_have_their_size() {
        let driver = RelayDriver::new("");
        assert_eq!(Size::Frame(300).payload(&driver).unwrap(), 296);
        assert_eq!(Size::Payload(300).payload(&driver).unwrap(), 300);
        assert!(Size::Frame(3).payload(&driver).is_err());
    }

    #[test]
    fn goals_bound_ratios() {
        assert!(Goal::AtLeast(0.3).is_met(0.3) && !Goal::AtLeast(0.3).is_met(0.29));
        assert!(Goal::AtMost(1.5).is_met(1.5) && !Goal::AtMost(1.5).is_met(1.6));
    }
}
