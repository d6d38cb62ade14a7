//! The program itself over real sockets, measured by where its robot is, not by what it says of its motors.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::os::unix::process::CommandExt as _;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

/// Longer than anything takes, however busy the machine is.
const PATIENCE: Duration = Duration::from_secs(30);
const FULL: &[u8] = b"06 01000 01000";
const STOP: &[u8] = b"06 00000 00000";
/// mm: where the first of the third row begins on a floor for 25, and where the wall holds it.
const BEGIN: f64 = 500.0;
const WALL: f64 = 4900.0;

struct Program {
    child: Child,
    page: String,
    control: String,
}

impl Program {
    fn start(options: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_mom-device"))
            .arg0("mom-linuxbot")
            .args(["--listen", "127.0.0.1:0", "--web", "127.0.0.1:0"])
            .args(["--robots", "25", "--only", "11"])
            .args(options)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("it starts");
        let mut lines = BufReader::new(child.stdout.take().expect("it is piped")).lines();
        let mut after = |words: &str| {
            let line = lines.next().expect("a line").expect("in text");
            let (_, after) = line.split_once(words).expect("it says where");
            after.trim_end_matches('/').to_owned()
        };
        let (control, page) = (after("listens at "), after("page at http://"));
        Self { child, page, control }
    }

    fn connect(&self) -> TcpStream {
        let station = TcpStream::connect(&self.control).expect("it listens");
        station.set_nodelay(true).expect("it can");
        station
    }

    /// What its page says: where it is, and what its motors are set to.
    fn look(&self) -> (f64, i64) {
        let mut stream = TcpStream::connect(&self.page).expect("it listens");
        stream
            .write_all(b"GET /status.json HTTP/1.1\r\nHost: robot\r\nConnection: close\r\n\r\n")
            .expect("it reads");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("it answers");
        let (_, body) = answer.split_once("\r\n\r\n").expect("a head");
        let status: Value = serde_json::from_str(body).expect("an object");
        (
            status["x"].as_f64().expect("mm"),
            status["left"].as_i64().expect("per mille"),
        )
    }

    /// Looks until that is so; where it is then.
    fn until(&self, wanted: impl Fn(f64, i64) -> bool) -> f64 {
        let until = Instant::now() + PATIENCE;
        loop {
            let (x, left) = self.look();
            if wanted(x, left) {
                return x;
            }
            assert!(Instant::now() < until, "it never came to that: {x} mm, {left}");
        }
    }

    /// Where it has come to its rest: its place is the same for some looks, which are 50 ms apart at least.
    fn rest(&self) -> f64 {
        let (mut last, mut same) = (f64::NAN, 0);
        self.until(|_, _| true);
        let until = Instant::now() + PATIENCE;
        while same < 4 {
            let (x, _) = self.look();
            same = if x.total_cmp(&last).is_eq() { same + 1 } else { 0 };
            last = x;
            assert!(Instant::now() < until, "it moves on and on: {x} mm");
        }
        last
    }

    fn signal(&self, name: &str) {
        let id = self.child.id().to_string();
        let sent = Command::new("kill").args([&format!("-{name}"), &id]).status();
        assert!(sent.is_ok_and(|sent| sent.success()), "{name} reaches it");
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A station writes one digit too many while the robot drives at full speed, and then stops, so many ms apart.
fn stops_after_a_digit_too_many(options: &[&str], stops: usize, apart: u64) {
    let robot = Program::start(options);
    let mut station = robot.connect();
    station.write_all(FULL).expect("it reads");
    robot.until(|x, _| x > BEGIN + 20.0);
    station.write_all(b"06 01000 010000").expect("it reads");
    for _ in 0..stops {
        std::thread::sleep(Duration::from_millis(apart)); // tidy: how far the stops are apart is what is tried
        // It may have hung up.
        let _ = station.write_all(STOP);
    }
    let rest = robot.rest();
    let said = format!(
        "{options:?}, {stops} stops, {apart} ms apart: {rest} mm, motors {}",
        robot.look().1
    );
    assert!(robot.look().1 == 0 && rest < WALL - 500.0, "{said}");
}

#[test]
fn a_digit_too_many_does_not_hide_the_stops_behind_it() {
    for options in [&[][..], &["--paper"]] {
        for (stops, apart) in [(60, 0), (10, 20), (5, 60), (1, 250)] {
            stops_after_a_digit_too_many(options, stops, apart);
        }
    }
}

/// It means to stand, and writes six digits: nothing is understood but the `00` that is found in the silence before its frames.
#[test]
fn a_station_that_is_never_understood_is_hung_up_and_the_robot_stands() {
    for options in [&[][..], &["--paper"]] {
        let robot = Program::start(options);
        let mut station = robot.connect();
        station.write_all(FULL).expect("it reads");
        robot.until(|x, _| x > BEGIN + 20.0);
        let until = Instant::now() + PATIENCE;
        while station.write_all(b"006 000000 000000").is_ok() {
            std::thread::sleep(Duration::from_millis(20)); // tidy: such a station repeats its stop, as fast as a key that is held
            assert!(Instant::now() < until, "it is never hung up");
        }
        let rest = robot.rest();
        assert!(
            robot.look().1 == 0 && rest < WALL - 500.0,
            "{options:?}: {rest} mm"
        );
        // It listens again.
        let mut next = robot.connect();
        next.write_all(b"00").expect("it reads");
        next.read_exact(&mut [0; 2]).expect("a NULL");
    }
}

/// The program is stopped while its robot drives at full speed: its driver stops the motors at the watchdog's time.
#[test]
fn a_program_that_stands_still_does_not_drive_on() {
    let robot = Program::start(&[]);
    let mut station = robot.connect();
    station.write_all(FULL).expect("it reads");
    let begun = robot.until(|x, _| x > BEGIN + 20.0);
    robot.signal("STOP");
    std::thread::sleep(Duration::from_millis(1500)); // tidy: what is tried is that the program stands still so long
    robot.signal("CONT");
    let rest = robot.rest();
    assert!(
        rest - begun < 700.0,
        "{} mm, which is more than its watchdog lets it",
        rest - begun
    );
    assert_eq!(robot.look().1, 0);
}

/// What it was told to do is halted at its end, and it says how it ended.
#[test]
fn it_ends_at_a_signal() {
    let mut robot = Program::start(&["--paper"]);
    let mut station = robot.connect();
    station.write_all(FULL).expect("it reads");
    robot.until(|_, left| left == 1000);
    robot.signal("TERM");
    assert!(robot.child.wait().expect("a child can be waited for").success());
}
