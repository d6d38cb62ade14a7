//! The robot server over real sockets, against a base station written from the paper's words alone, in Python.

use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use mom_linuxbot::{Access, Options, Robot, Rules, Status, serve};
use mom_wheels::{Chassis, Driver, DriverError, Fault, Motors, Sensors, Simulated, Watchdog, WheelTime};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::process::Command;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// So long a test waits for what must come.
const PATIENCE: Duration = Duration::from_secs(30);
/// Longer than a test takes: for those that must not see the watchdog at work.
const CALM: Rules = Rules {
    watchdog: Watchdog::NONE,
    stop_when_lost: true,
};

struct Server {
    address: SocketAddr,
    /// Ends it when it is dropped.
    stop: oneshot::Sender<()>,
    serving: JoinHandle<std::io::Result<()>>,
}

impl Server {
    async fn start(rules: Rules, options: Options) -> Self {
        Self::of(Box::new(Simulated::linuxbot()), rules, options).await
    }

    async fn of(driver: Box<dyn Driver>, rules: Rules, options: Options) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("it has one");
        let robot = Robot::new(driver, Chassis::LINUXBOT, rules);
        let (stop, stopping) = oneshot::channel::<()>();
        let serving = tokio::spawn(serve(listener, robot, options, async move {
            let _ = stopping.await;
        }));
        Self {
            address,
            stop,
            serving,
        }
    }

    async fn station(&self) -> Station {
        Station(TcpStream::connect(self.address).await.expect("it listens"))
    }

    async fn end(self) {
        drop(self.stop);
        let ended = timeout(PATIENCE, self.serving).await.expect("it ends");
        ended.expect("no panic").expect("no error");
    }
}

struct Station(TcpStream);

impl Station {
    async fn say(&mut self, text: &str) {
        self.0.write_all(text.as_bytes()).await.expect("it reads");
    }

    /// The next so many bytes; fewer if the connection ends, be it closed or reset.
    async fn hear(&mut self, length: u64) -> String {
        let mut text = String::new();
        let mut piece = (&mut self.0).take(length);
        let read = timeout(PATIENCE, piece.read_to_string(&mut text));
        match read.await.expect("it comes") {
            Err(error) if error.kind() != ErrorKind::ConnectionReset => panic!("{error}"),
            _ => text,
        }
    }

    async fn status(&mut self) -> Status {
        self.say("04").await;
        let reply = self.hear(8).await;
        let bits = reply.strip_prefix("04 ").and_then(|bits| bits.parse().ok());
        Status::from_bits(bits.expect("a mask"))
    }
}

#[tokio::test]
async fn a_base_station_of_the_paper_drives_it() {
    let server = Server::start(CALM, Options::default()).await;
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/base_station.py");
    let mut python = Command::new("python3");
    python.arg(script).arg(server.address.port().to_string());
    let said = timeout(PATIENCE, python.output())
        .await
        .expect("it ends")
        .expect("python3");
    let (told, wrong) = (
        String::from_utf8_lossy(&said.stdout),
        String::from_utf8_lossy(&said.stderr),
    );
    assert_eq!(
        told.lines().collect::<Vec<_>>(),
        [
            "null: 00",
            "status: 04  moving",
            "spinning: moving",
            "second: 90 00127 00000 00000 00001 then closed after ",
            "stopped: standing",
            "again: 00",
        ],
        "{wrong}"
    );
    server.end().await;
}

/// Whatever it has said by then: a connection that is closed with unread bytes is reset, and the last word lost.
#[tokio::test]
async fn who_comes_second_hears_who_drives() {
    let server = Server::start(CALM, Options::default()).await;
    let mut first = server.station().await;
    assert!(!first.status().await.moving);
    for _ in 0..20 {
        let mut second = server.station().await;
        second.say(&"06 00100 00100".repeat(50)).await;
        assert_eq!(second.hear(27).await, "90 00127 00000 00000 00001");
    }
    assert!(!first.status().await.moving, "nobody else has moved it");
    server.end().await;
}

/// W23: and who is not listed hears nothing, and holds nobody up.
#[tokio::test]
async fn base_stations_that_are_not_listed_are_closed() {
    let elsewhere = Access::only([IpAddr::V4(Ipv4Addr::new(192, 0, 2, 1))]);
    let options = Options {
        access: elsewhere,
        ..Options::default()
    };
    let server = Server::start(CALM, options).await;
    for _ in 0..3 {
        let mut station = server.station().await;
        assert_eq!(station.hear(1).await, "");
    }
    server.end().await;
}

#[tokio::test]
async fn in_the_paper_a_second_one_is_just_closed_and_motors_run_on() {
    let server = Server::start(Rules::PAPER, Options::paper(Access::default())).await;
    let mut first = server.station().await;
    first.say("06 00200 00200").await;
    assert!(first.status().await.moving);
    assert_eq!(server.station().await.hear(26).await, "");
    drop(first);
    // Until the robot has seen it, the next one is closed as well.
    let moving = loop {
        let mut next = server.station().await;
        if next.0.write_all(b"04").await.is_err() {
            continue;
        }
        let reply = next.hear(8).await;
        if let Some(bits) = reply.strip_prefix("04 ") {
            break Status::from_bits(bits.parse().expect("a mask")).moving;
        }
    };
    assert!(moving, "nothing has stopped it");
    server.end().await;
}

#[tokio::test]
async fn the_watchdog_stops_it_while_the_connection_stands() {
    let rules = Rules {
        watchdog: Watchdog::after(50_000),
        ..Rules::default()
    };
    let server = Server::start(rules, Options::default()).await;
    let mut station = server.station().await;
    station.say("06 00200 00200").await;
    // Each question feeds the watchdog, so there is one only, when its time is over.
    tokio::time::sleep(Duration::from_millis(60)).await; // tidy: what is tried is that time passes
    let status = station.status().await;
    assert_eq!((status.moving, status.expired), (false, true));
    server.end().await;
}

#[tokio::test]
async fn a_silent_base_station_gives_way_to_others() {
    let options = Options {
        patience: Some(Duration::from_millis(50)),
        ..Options::default()
    };
    let server = Server::start(CALM, options).await;
    let mut silent = server.station().await;
    silent.say("06 00200 00200").await;
    assert_eq!(silent.hear(1).await, "", "it is closed");
    let mut other = server.station().await;
    assert!(!other.status().await.moving, "and the robot stands");
    server.end().await;
}

/// A base station that asks without end and reads nothing is not answered without end.
#[tokio::test]
async fn a_flood_is_read_at_the_rate_at_which_replies_are_taken() {
    let server = Server::start(CALM, Options::default()).await;
    let mut station = server.station().await;
    let flood = "00".repeat(1 << 20);
    let (mut reader, mut writer) = station.0.split();
    let written = async {
        writer
            .write_all(flood.as_bytes())
            .await
            .expect("it is taken in the end");
    };
    let read = async {
        let mut replies = vec![0; flood.len()];
        reader.read_exact(&mut replies).await.expect("all are answered");
        replies
    };
    let ((), replies) = timeout(PATIENCE, async { tokio::join!(written, read) })
        .await
        .expect("it goes on");
    assert!(replies == flood.as_bytes(), "one reply each");
    // One that reads nothing fills the sockets between them, and no more.
    let mut full = 0;
    while let Ok(wrote) = timeout(Duration::from_millis(300), station.0.write(flood.as_bytes())).await {
        full += wrote.expect("it stands");
        assert!(full < 64 << 20, "it reads on and on");
    }
    server.end().await;
}

/// A simulated robot whose driver refuses the next so many stops.
struct Stubborn(Simulated, Arc<AtomicUsize>);

impl Driver for Stubborn {
    fn set_motors(&mut self, motors: Motors, at: WheelTime) -> Result<(), DriverError> {
        let refuses = |left: usize| left.checked_sub(1);
        if motors == Motors::STOP && self.1.fetch_update(Relaxed, Relaxed, refuses).is_ok() {
            return Err(DriverError::new(Fault::Motors, "they do not obey"));
        }
        self.0.set_motors(motors, at)
    }

    fn set_leds(&mut self, leds: u8, at: WheelTime) -> Result<(), DriverError> {
        self.0.set_leds(leds, at)
    }

    fn sensors(&mut self, at: WheelTime) -> Result<Sensors, DriverError> {
        self.0.sensors(at)
    }

    fn next_wake(&mut self) -> Option<WheelTime> {
        Driver::next_wake(&mut self.0)
    }
}

#[tokio::test]
async fn a_robot_server_ends_when_its_driver_has_taken_the_stop() {
    let refuses = Arc::new(AtomicUsize::new(0));
    let driver = Stubborn(Simulated::linuxbot(), Arc::clone(&refuses));
    let server = Server::of(Box::new(driver), CALM, Options::default()).await;
    let mut station = server.station().await;
    station.say("06 00200 00200").await;
    assert!(station.status().await.moving);
    refuses.store(5, Relaxed);
    server.end().await;
    assert_eq!(refuses.load(Relaxed), 0, "it was told until it took it");
    // One that never does is not waited for without end.
    let driver = Stubborn(Simulated::linuxbot(), Arc::new(AtomicUsize::new(usize::MAX)));
    Server::of(Box::new(driver), CALM, Options::default())
        .await
        .end()
        .await;
}
