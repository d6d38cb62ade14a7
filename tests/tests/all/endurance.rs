//! Both ends of RSP as programs in networks of their own, which check each other packet by packet.

use std::net::UdpSocket;
use std::time::Duration;

use mom_tests::datagrams::{Datagrams, Weather};
use mom_tests::network::{RelayedLink, Shape};
use mom_tests::programs::{Running, example};
use tokio::task::spawn_blocking;

/// ms between two data packets of an end.
const PERIOD: &str = "1";

/// S15, S19 to S22: under delay, loss, doubling and reordering no value is wrong, and nothing is done twice or left out.
///
/// `MOM_PACKETS` is how many data packets each end takes at least.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_ends_in_networks_of_their_own_agree_on_everything() {
    let packets = std::env::var("MOM_PACKETS").unwrap_or_else(|_| "2000".to_owned());
    let shape = Shape {
        jitter: Duration::from_millis(1),
        loss: 0.02,
        ..Shape::mbit(20.0, Duration::from_millis(2))
    };
    let link = RelayedLink::new(shape, shape, 19, "cubic").expect("two networks");
    let (near, far) = (&link.ends.hub, &link.ends.far);
    let program = example("mom-rsp", "endurance");
    let mut command = far.command(&program);
    command.args(["robot", &format!("{}:0", far.host())]);
    let robot = Running::of("endurance", &mut command);
    let said = robot.line_with("listens on");
    let address = said.rsplit(' ').next().expect("an address").to_owned();
    // What the relay does not do to packets: it keeps their order.
    let sockets = near.within(|| -> std::io::Result<_> {
        let any = || UdpSocket::bind((near.host(), 0));
        let out = any()?;
        out.connect(&address)?;
        Ok((any()?, out))
    });
    let (inner, outer) = sockets.expect("a network").expect("sockets");
    let entrance = inner.local_addr().expect("it has one").to_string();
    let weather = Datagrams::between(inner, outer, 19).expect("a network");
    weather.set(Weather {
        loss: 0.02,
        doubled: 0.05,
        jitter: Duration::from_millis(4),
        ..Weather::default()
    });
    let mut command = near.command(&program);
    command.args(["middle", &entrance, &packets, PERIOD]);
    let middle = Running::of("endurance", &mut command);
    let ended = spawn_blocking(move || {
        // It says each 10 s how far it is.
        let there = loop {
            let line = middle.line_with("middle: ");
            if !line.ends_with(" packets") {
                break line;
            }
        };
        let here = robot.line_with("robot: ");
        ((there, here), middle.wait(), robot.wait())
    });
    let ((there, here), middle, robot) = ended.await.expect("they end");
    println!("{there}\n{here}\n{:?}", link.relay.take_passed());
    assert!(there.ends_with(": right") && here.ends_with(": right"));
    assert!(middle.success() && robot.success());
}
