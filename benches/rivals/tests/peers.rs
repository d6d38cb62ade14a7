//! The comparison with other brokers, small, with ours and the relay alone: figures mean nothing here, loss and order do.

use std::fmt::Display;
use std::io::{self, Write as _};
use std::path::PathBuf;
use std::sync::OnceLock;
use std::time::Duration;

use mom_benches::{Error, Hub, broker_folder};
use mom_broker::{Broker, Config};
use mom_proto::codec::Form;
use mom_rivals::{
    Canary, Crowd, Hindrance, Kind, Metric, Network, Programs, SaturatedStop, SlowLink, idle, plan,
    raise_files, run, table,
};
use mom_tests::network::{Namespaces, RelayedLink, Shape};
use mom_tests::programs::measuring;
use tempfile::TempDir;
use tokio::runtime::Runtime;

/// A broker in this process, which ends with its runtime.
struct Bench {
    _runtime: Runtime,
    _broker: Broker,
    _folder: TempDir,
    hub: Hub,
}

fn bench(form: Form) -> Bench {
    let folder = broker_folder().expect("a temporary folder can be made");
    let config = Config::load(&folder.path().join("mom.toml")).expect("the broker's configuration is right");
    let runtime = Runtime::new().expect("there are threads");
    let broker = runtime
        .block_on(Broker::start(config))
        .expect("the broker starts on any free port");
    let hub = Hub::broker(&broker.local_addr().to_string(), form).expect("guests may join");
    Bench {
        _runtime: runtime,
        _broker: broker,
        _folder: folder,
        hub,
    }
}

/// The relay's program.
fn relay() -> PathBuf {
    static RELAY: OnceLock<PathBuf> = OnceLock::new();
    RELAY.get_or_init(|| measuring("mom-benches", "relay")).clone()
}

/// Programs of which only the relay is there.
fn programs() -> Programs {
    let nowhere = tempfile::tempdir().expect("a temporary folder can be made");
    Programs::find(nowhere.path().join("broker"), relay(), nowhere.path())
        .expect("a temporary folder can be made")
}

const CROWD: Crowd = Crowd {
    peers: 6,
    rate: 100,
    payload: 64,
    warm_up: Duration::from_millis(50),
    time: Duration::from_millis(200),
};

#[test]
fn a_crowd_hears_everybody_in_order() {
    let programs = programs();
    let relay = programs
        .start(Kind::Relay, &Network::Loopback, true)
        .expect("cargo has built the relay");
    for hub in [&bench(Form::Binary).hub, &bench(Form::Xml).hub, &relay] {
        let sample = CROWD.run(hub).unwrap();
        // What is late on a busy machine is not counted, but nothing is heard twice or out of order.
        let share = sample[&Metric::Share];
        assert!(share > 0.0 && share <= 1.0, "{}: {sample:?}", hub.name);
    }
}

#[test]
fn idle_peers_all_hear_the_one_parcel() {
    raise_files();
    let programs = programs();
    let relay = programs.start(Kind::Relay, &Network::Loopback, false).unwrap();
    let sample = idle(&relay, 40).unwrap();
    assert!(sample.contains_key(&Metric::Memory), "{sample:?}");
    idle(&bench(Form::Binary).hub, 40).unwrap();
}

#[test]
fn every_row_that_the_relay_takes_has_figures_of_it() {
    let mut effort = plan::Effort::quick();
    effort.warm_up = Duration::from_millis(10);
    effort.stream = Duration::from_millis(40);
    effort.rounds = 60;
    effort.connections = 1;
    effort.crowd = CROWD;
    let rows: Vec<plan::Row> = plan::ROWS
        .into_iter()
        .filter(|row| row.hubs.contains(&Kind::Relay))
        .map(|row| match row.load {
            plan::Load::Stream(receivers) => plan::Row {
                load: plan::Load::Stream(receivers.min(20)),
                ..row
            },
            _ => row,
        })
        .collect();
    let programs = programs();
    let relays = |kind| matches!(kind, Kind::Relay | Kind::RawRelay);
    let outcomes = run(&rows, &programs, relays, &effort, |_| {});
    for outcome in &outcomes {
        assert!(
            outcome.failures.is_empty(),
            "{}: {:?}",
            outcome.row.name,
            outcome.failures
        );
        assert!(outcome.samples.contains_key(&Kind::Relay), "{}", outcome.row.name);
    }
    let markdown = table::markdown(&outcomes, &programs, 1, None);
    assert!(
        markdown.contains("| 1→1, 16 B | deliveries per second ≥ 2 × the best peer's | | | | not measured |"),
        "{markdown}"
    );
    let raw = table::raw(&outcomes, &programs, "now", None);
    assert!(
        raw.pointer("/rows/1→1, 16 B/relay/0/deliveries-per-second")
            .is_some(),
        "{raw}"
    );
}

#[test]
fn a_program_that_is_not_there_is_told() {
    let started = programs().start(Kind::Mom, &Network::Loopback, false);
    assert!(matches!(started, Err(Error::Io { .. })));
}

#[test]
fn a_stop_passes_a_flood_and_a_sleeper() {
    let canary = Canary {
        payload: 4 * 1024,
        offered: 8e6,
        times: 10.0,
        stops: 5,
        every: Duration::from_millis(30),
        late: Duration::from_secs(2),
    };
    for hindrance in [Hindrance::Flood, Hindrance::Sleeper] {
        let (sample, cut_off) = canary.run(&bench(Form::Binary).hub, hindrance).unwrap();
        assert_eq!(cut_off, None, "{hindrance:?}");
        // One that still waits says what the next would, so on a busy machine not all of them arrive.
        let arrived = sample[&Metric::Arrived];
        assert!((1.0..=5.0).contains(&arrived), "{hindrance:?}: {sample:?}");
        assert!(sample[&Metric::Rate] > 0.0, "{hindrance:?}: {sample:?}");
    }
}

/// A broker in this process, in the network of the hub.
fn bench_at(ends: &Namespaces) -> Bench {
    let folder = broker_folder().expect("a temporary folder can be made");
    let mut config =
        Config::load(&folder.path().join("mom.toml")).expect("the broker's configuration is right");
    config.listen = vec![format!("{}:0", ends.hub.host()).into()];
    let runtime = Runtime::new().expect("there are threads");
    // The listening socket belongs to the namespace, not to the thread that polls it.
    let broker = ends.hub.within(|| runtime.block_on(Broker::start(config)));
    let broker = broker
        .expect("the namespace is there")
        .expect("the broker starts on any free port");
    let address = broker.local_addr().to_string();
    let hub = ends.hub.within(|| Hub::broker(&address, Form::Binary));
    Bench {
        hub: hub
            .expect("the namespace is there")
            .expect("the bench's user may join"),
        _runtime: runtime,
        _broker: broker,
        _folder: folder,
    }
}

/// Where namespaces may be made, that is as root; elsewhere the reason is told, and nothing is left behind.
fn allowed<T, E: Display>(made: Result<T, E>) -> Option<T> {
    made.inspect_err(|error| {
        let _ = writeln!(io::stderr(), "left out: no network namespaces here: {error}");
        assert!(!error.to_string().is_empty());
    })
    .ok()
}

#[test]
fn a_stop_passes_frames_on_a_slow_link() {
    let Some(link) = allowed(SlowLink::new()) else {
        return;
    };
    let bench = bench_at(&link.ends);
    let stop = SaturatedStop {
        frame: 16 * 1024,
        load: 30e6,
        warm_up: Duration::from_secs(2),
        pauses: None,
        stops: 5,
        every: Duration::from_millis(20),
        late: Duration::from_secs(1),
    };
    let (sample, cut_off) = stop.sample(stop.run(&bench.hub, &link.ends, |_| {}).unwrap());
    assert_eq!(cut_off, None);
    // One that still waits makes way for the next, so on a busy machine not all of them arrive; none does twice.
    let arrived = sample[&Metric::Arrived];
    assert!((1.0..=5.0).contains(&arrived), "{sample:?}");
}

/// What waits at the bottleneck when a camera begins is what a stop would wait for. The kernel's slow start made it 80 ms and
/// more, and a round trip of 100 ms left 0.9 of the link unused.
#[test]
fn a_flood_begins_gently() {
    for (delay, queue) in [(0, 20), (100, 40)].map(|(delay, queue)| (Duration::from_millis(delay), queue)) {
        let shape = Shape::mbit(20.0, delay / 2);
        let back = Shape { rate: 1e9, ..shape };
        let Some(link) = allowed(RelayedLink::new(shape, back, 1, "cubic")) else {
            return;
        };
        let bench = bench_at(&link.ends);
        let stop = SaturatedStop {
            frame: 64 * 1024,
            load: 30e6,
            warm_up: Duration::ZERO,
            pauses: None,
            stops: 150,
            every: Duration::from_millis(20),
            late: Duration::from_secs(1),
        };
        let mut passed = Vec::new();
        let note = |number| {
            if [75, 149].contains(&number) {
                passed.push(link.relay.take_passed());
            }
        };
        let observed = stop.run(&bench.hub, &link.ends, note).unwrap();
        assert_eq!(observed.failure, None);
        let longest = passed.iter().map(|passed| passed.longest_wait).max();
        assert!(
            longest <= Some(Duration::from_millis(queue)),
            "{delay:?}: {passed:?}"
        );
        assert!(
            passed.iter().all(|passed| passed.dropped == 0),
            "{delay:?}: {passed:?}"
        );
        // 3.7 MB is all that the link carries in the second half.
        assert!(passed[1].bytes > 1_200_000, "{delay:?}: {passed:?}");
    }
}
