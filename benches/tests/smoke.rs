//! All that `mom-bench` does end to end, small: figures mean nothing here, loss and order do.

use std::path::Path;
use std::time::Duration;

use mom_benches::control;
use mom_benches::scenario::{self, Figures, Load};
use mom_benches::{
    Driver, Error, Hub, Link, Message, Pace, Process, RelayDriver, Scan, Scanner, Stream, Template, Topic,
    broker_folder, start_relay,
};
use mom_broker::{Broker, Config};
use mom_proto::codec::Form;
use tokio::runtime::Runtime;

/// A broker in this process, which ends with its runtime, the relay's process, and their drivers.
struct Bench {
    runtime: Runtime,
    broker: Broker,
    relay: Process,
}

impl Bench {
    fn start() -> Bench {
        let folder = broker_folder().expect("a temporary folder can be made");
        let config =
            Config::load(&folder.path().join("mom.toml")).expect("the broker's configuration is right");
        let runtime = Runtime::new().expect("there are threads");
        let broker = runtime.block_on(Broker::start(config));
        let relay = start_relay(Path::new(env!("CARGO_BIN_EXE_relay")));
        Bench {
            runtime,
            broker: broker.expect("the broker starts on any free port"),
            relay: relay.expect("cargo has built the relay"),
        }
    }

    fn hubs(&self) -> Vec<Hub> {
        let address = self.broker.local_addr().to_string();
        let broker = |form| Hub::broker(&address, form).expect("the bench's user may join");
        vec![
            Hub::relay(self.relay.address()),
            broker(Form::Binary),
            broker(Form::Xml),
        ]
    }

    /// As an orderly end of both programs.
    fn stop(self) {
        self.runtime.block_on(self.broker.stop());
    }
}

fn pace() -> Pace {
    Pace {
        runs: 1,
        warm_up: Duration::from_millis(20),
        stream: Duration::from_millis(80),
        rounds: 100,
        connections: 2,
        block: 30,
        crowd: 10,
        grants: 50,
        calm: Duration::from_millis(50),
        inside: Duration::from_millis(1),
    }
}

#[test]
fn every_scenario_runs_without_loss() {
    let bench = Bench::start();
    // As many receivers as a debug build logs in within a moment.
    let scenarios = scenario::ALL.map(|scenario| match scenario.load {
        Load::Stream(receivers) => scenario::Scenario {
            load: Load::Stream(receivers.min(10)),
            ..scenario
        },
        Load::RoundTrip | Load::RoundTripOnOneCore => scenario,
    });
    let figures = scenario::run(&scenarios, &bench.hubs(), &pace(), |_, _| {}).unwrap();
    for (scenario, figures) in scenarios.iter().zip(&figures) {
        assert_eq!(figures.len(), 2, "{}", scenario.name);
        // How much a stream carries within a moment is the machine's affair; a round trip takes time anywhere.
        let delay = |figures: &Figures| !scenario.load.is_delay() || figures.value > 0.0;
        assert!(figures.iter().all(delay), "{scenario:?} {figures:?}");
    }
    bench.stop();
}

#[test]
fn every_receiver_gets_all_that_was_sent() {
    let bench = Bench::start();
    for hub in bench.hubs() {
        for receivers in [1, 3] {
            let stream = Stream {
                payload: 64,
                topic: Topic::Forth,
                receivers,
                window: None,
                warm_up: Duration::ZERO,
                time: Duration::from_millis(50),
            };
            let streamed = stream.run(&hub).unwrap();
            assert!(streamed.sent > 0, "{}: {streamed:?}", hub.name);
            let most = u64::from(streamed.sent) * receivers as u64;
            assert!(streamed.deliveries.count <= most, "{}: {streamed:?}", hub.name);
        }
    }
}

#[test]
fn a_refusal_is_told_and_not_waited_for() {
    let runtime = Runtime::new().unwrap();
    let folder = broker_folder().unwrap();
    let mut config = Config::load(&folder.path().join("mom.toml")).unwrap();
    config.root = "closed".into();
    let broker = runtime.block_on(Broker::start(config)).unwrap();
    let refused = Hub::broker(&broker.local_addr().to_string(), Form::Binary);
    assert!(matches!(refused, Err(Error::Hub { .. })));
}

/// A relay's driver that looks away once in a while.
struct Forgetful(RelayDriver);

struct Forgetting {
    scanner: Box<dyn Scanner>,
    left: u32,
}

impl Driver for Forgetful {
    fn connect(&self, hears: &[Topic], says: &[Topic]) -> Result<Link, Error> {
        self.0.connect(hears, says)
    }

    fn template(&self, message: Message) -> Result<Template, Error> {
        self.0.template(message)
    }

    fn scanner(&self) -> Box<dyn Scanner> {
        Box::new(Forgetting {
            scanner: self.0.scanner(),
            left: 100,
        })
    }
}

impl Scanner for Forgetting {
    fn scan(&mut self, bytes: &[u8]) -> Result<Scan, Error> {
        match self.scanner.scan(bytes)? {
            Scan::Parcel(length, _) if self.left == 0 => {
                self.left = 100;
                Ok(Scan::Other(length))
            }
            found => {
                self.left = self.left.saturating_sub(1);
                Ok(found)
            }
        }
    }
}

#[test]
fn a_lost_parcel_is_no_figure() {
    let relay = start_relay(Path::new(env!("CARGO_BIN_EXE_relay"))).unwrap();
    let mut hub = Hub::relay(relay.address());
    hub.driver = Box::new(Forgetful(RelayDriver::new(relay.address())));
    let stream = Stream {
        payload: 16,
        topic: Topic::Forth,
        receivers: 2,
        window: None,
        warm_up: Duration::ZERO,
        time: Duration::from_millis(50),
    };
    let lost = stream.run(&hub);
    assert!(matches!(lost, Err(Error::Order { .. })), "{lost:?}");
}

#[test]
fn a_crowd_takes_turns_and_logs_in() {
    let bench = Bench::start();
    let address = bench.broker.local_addr().to_string();
    let pace = pace();
    let contended = control::contention(&address, "peer", pace.crowd, pace.grants).unwrap();
    assert!(contended.fairness > 0.9, "{contended:?}");
    assert!(contended.handover.count() > 0);
    let storm = control::storm(&address, "peer", pace.crowd, pace.calm).unwrap();
    assert_eq!(storm.logins, pace.crowd);
    assert!(
        storm
            .renewals
            .iter()
            .chain(&storm.stops)
            .all(|delays| delays.count() > 0),
        "{storm:?}"
    );
    bench.stop();
}
