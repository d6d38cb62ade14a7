//! A robot in C with a middle: by the bytes of the page, and over loopback.

mod c_common;

use std::io::{BufRead as _, BufReader};
use std::net::UdpSocket;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use c_common::both::Both;
use c_common::{CUBO, c_end, header};
use mom_rsp::middle::{self, Middle};
use mom_rsp::robot::{self, Body};
use mom_rsp::{Dropped, Layout};
use mom_rsp_model::Model;

/// A robot's program that says `b0…bf`, then the session of the page.
struct Page;

impl Body for Page {
    fn random(&mut self, bytes: &mut [u8]) {
        match bytes {
            [_, _, _, _, _, _] => bytes.copy_from_slice(&[0x11, 0x22, 0x33, 0x44, 0x55, 0x66]),
            _ => rising(bytes, 0xB0),
        }
    }

    fn effector(&mut self, _: u8, _: &[u8]) {}

    fn command(&mut self, _: u8, _: &[u8]) {}
}

fn rising(bytes: &mut [u8], first: u8) {
    for (byte, value) in bytes.iter_mut().zip(first..) {
        *byte = value;
    }
}

/// The packets of the page, as hexadecimal digits.
fn blocks() -> Vec<String> {
    let page = include_str!("../../../docs/rsp.md");
    let all = page.split("```packet\n").skip(1);
    all.map(|rest| {
        rest.split("```")
            .next()
            .expect("an end")
            .split_whitespace()
            .collect()
    })
    .collect()
}

/// A middle, and a robot in Rust and in C whose clock is 4 s ahead.
struct Talk<'m> {
    middle: Middle<'m>,
    robot: Both<'m, 16, 8192, 8, 4>,
    blocks: Vec<String>,
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

impl Talk<'_> {
    /// What the middle has to say at this ms.
    fn packets(&mut self, ms: u64) -> Vec<Vec<u8>> {
        std::iter::from_fn(|| self.middle.poll(ms * 1000).map(<[u8]>::to_vec)).collect()
    }

    fn hear(&mut self, ms: u64, packet: &[u8]) -> Result<(), Dropped> {
        self.robot
            .receive((4000 + ms) * 1000, &mut packet.to_vec(), &mut Page)
    }

    /// The middle says the one packet of this block, and the robot hears it.
    fn middle_says(&mut self, ms: u64, block: usize) {
        let packets = self.packets(ms);
        assert_eq!(
            packets.iter().map(|packet| hex(packet)).collect::<Vec<_>>(),
            [self.blocks[block].as_str()]
        );
        assert_eq!(self.hear(ms, &packets[0]), Ok(()));
    }

    /// The robot says the packet of this block, and the middle hears it; a refusal is for another one.
    fn robot_says(&mut self, ms: u64, block: usize) {
        let mut out = vec![0; 4096];
        let len = self
            .robot
            .poll((4000 + ms) * 1000, &mut out, &mut Page)
            .expect("a packet");
        assert_eq!(hex(&out[..len]), self.blocks[block]);
        let _ = self.middle.receive(ms * 1000, &mut out[..len]);
    }
}

/// The session in bytes of `docs/rsp.md`: a middle, and a robot in Rust and in C, say what stands there.
#[test]
fn both_ends_say_the_bytes_of_the_page() {
    let model = Model::read(CUBO).expect("a model");
    let place = |name: &str| model.find(name).expect("an element").0 as u8;
    let elements = model.wire_elements();
    let layout = model.layout(&elements);
    let mut key = [0; 32];
    rising(&mut key, 0);
    let asks = |first: u8| {
        let settings = middle::Settings {
            key: Some(key),
            ..Default::default()
        };
        Middle::new(&layout, settings, move |bytes: &mut [u8]| rising(bytes, first)).expect("settings")
    };
    let settings = robot::Settings {
        key: Some(key),
        ..Default::default()
    };
    let mut talk = Talk {
        middle: asks(0xA0),
        robot: Both::new(&layout, settings).expect("it fits"),
        blocks: blocks(),
    };
    talk.middle.start(1_000_000);
    talk.middle_says(1000, 0);
    talk.robot_says(1000, 1);
    for (name, speed) in [("left-wheel", 100_i16), ("right-wheel", -100)] {
        talk.middle
            .write(place(name), &speed.to_be_bytes())
            .expect("a speed");
    }
    talk.middle_says(1004, 2);
    let pose = [0x09, 0xC4, 0x09, 0xC4, 0x03, 0x84];
    talk.robot.set(place("pose"), &pose).expect("a pose");
    talk.robot_says(1004, 3);

    let mut other = asks(0xC0);
    other.start(0);
    let hello = other.poll(0).expect("a hello").to_vec();
    assert_eq!(talk.hear(1010, &hello), Err(Dropped::Busy));
    talk.robot_says(1010, 9);

    talk.middle
        .set_activated(place("motion"), false)
        .expect("a module");
    let picture: Vec<u8> = (0..500_u32).map(|at| at as u8).collect();
    talk.middle.send_blob(place("lcd"), &picture).expect("a picture");
    // Data, control, and two fragments.
    let sent = talk.packets(1024);
    assert_eq!(
        [hex(&sent[1]), hex(&sent[3])],
        [talk.blocks[4].clone(), talk.blocks[6].clone()]
    );
    for packet in &sent {
        assert_eq!(talk.hear(1024, packet), Ok(()));
    }
    talk.robot_says(1024, 5);
    let mut out = vec![0; 4096];
    while let Some(len) = talk.robot.poll(5_024_000, &mut out, &mut Page) {
        assert_eq!(talk.middle.receive(1_024_000, &mut out[..len]), Ok(()));
    }
    talk.middle.end(1_044_000);
    talk.middle_says(1044, 7);
    talk.robot_says(1044, 8);
}

/// The example, and a middle that drives it over loopback; the robot is killed when it is dropped.
struct Served {
    robot: Child,
    socket: UdpSocket,
    layout: &'static Layout<'static>,
    middle: Middle<'static>,
    begin: Instant,
    heard: Vec<String>,
    /// The lines that the robot prints.
    said: Receiver<String>,
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.robot.kill();
        let _ = self.robot.wait();
    }
}

/// So long a test waits for what comes about in some ms.
const PATIENCE: Duration = Duration::from_secs(20);

impl Served {
    fn new(key: Option<[u8; 32]>) -> Option<Served> {
        // A machine that is busy with other tests may be silent for longer than 500 ms.
        let patient = CUBO.replace("watchdog = 500", "watchdog = 2000");
        let model = Model::read(&patient).expect("a model");
        assert_eq!(model.watchdog(), 2000);
        let main = c_end::folder().join("example/cubo.c");
        let inputs = [&[main], &c_end::sources()[..]].concat();
        let program = c_end::program("c-cubo", &inputs, &[header(&model)])?;
        let digits: Option<String> = key.map(|key| key.iter().map(|byte| format!("{byte:02x}")).collect());
        let mut robot = Command::new(program)
            .env("ASAN_OPTIONS", "detect_leaks=0")
            .args(["127.0.0.1", "0"])
            .args(digits)
            .stdout(Stdio::piped())
            .spawn()
            .expect("it runs");
        let output = BufReader::new(robot.stdout.take().expect("an output"));
        let (lines, said) = channel();
        std::thread::spawn(move || {
            output
                .lines()
                .map_while(Result::ok)
                .try_for_each(|line| lines.send(line))
        });
        let line: String = said.recv_timeout(PATIENCE).expect("where it listens");
        let address = line.strip_prefix("listens on ").expect("an address");
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        socket.connect(address).expect("the robot");
        socket
            .set_read_timeout(Some(Duration::from_millis(2)))
            .expect("a time");
        let settings = middle::Settings {
            key,
            silence: 2000,
            ..Default::default()
        };
        let layout: &'static Layout<'static> = Box::leak(Box::new(model.into_layout()));
        let random = |bytes: &mut [u8]| rising(bytes, 0x31);
        let mut middle = Middle::new(layout, settings, random).expect("settings");
        middle.start(0);
        Some(Served {
            robot,
            socket,
            layout,
            middle,
            begin: Instant::now(),
            heard: Vec::new(),
            said,
        })
    }

    /// The middle says what is due, and hears what comes within a few ms.
    fn talk(&mut self) {
        let mut datagram = [0; 4096];
        let now = self.begin.elapsed().as_micros() as u64;
        while let Some(packet) = self.middle.poll(now) {
            self.socket.send(packet).expect("it leaves");
        }
        if let Ok(size) = self.socket.recv(&mut datagram) {
            let _ = self
                .middle
                .receive(self.begin.elapsed().as_micros() as u64, &mut datagram[..size]);
        }
        while let Some(notice) = self.middle.next_notice() {
            self.heard.push(format!("{notice:?}"));
        }
    }

    /// Both talk until this is so.
    fn until(&mut self, what: &str, is_so: impl Fn(&Middle<'static>) -> bool) {
        let end = Instant::now() + PATIENCE;
        while !is_so(&self.middle) {
            assert!(Instant::now() < end, "{what}");
            self.talk();
        }
    }

    /// Both talk until the robot prints its next line.
    fn until_said(&mut self, line: &str) {
        let end = Instant::now() + PATIENCE;
        loop {
            match self.said.try_recv() {
                Ok(said) => return assert_eq!(said, line),
                Err(_) => assert!(Instant::now() < end, "{line}"),
            }
            self.talk();
        }
    }

    fn place(&self, name: &str) -> u8 {
        self.layout.find(name).expect("an element")
    }
}

fn numbers(value: &[u8]) -> Vec<i16> {
    value
        .chunks_exact(2)
        .map(|two| i16::from_be_bytes([two[0], two[1]]))
        .collect()
}

/// The robot in C drives, gestures, is stopped, rests when its middle is silent, and has another session after that.
#[test]
fn a_middle_drives_the_example_over_loopback() {
    for key in [None, Some([0x5A; 32])] {
        let Some(mut served) = Served::new(key) else {
            return;
        };
        served.until_said("a session began");
        let [left, right, joints] = ["left-wheel", "right-wheel", "joints"].map(|name| served.place(name));
        let [pose, posture, gesture, motion] =
            ["pose", "posture", "gesture", "motion"].map(|name| served.place(name));
        served.until("its place", |middle| middle.read(pose).is_some());

        // Beyond its range: it drives 500 mm/s at most, and its head is at 40 degrees.
        served
            .middle
            .write(left, &3000_i16.to_be_bytes())
            .expect("a speed");
        served
            .middle
            .write(right, &3000_i16.to_be_bytes())
            .expect("a speed");
        served
            .middle
            .write(joints, &[0, 100, 0, 200, 0x7F, 0xFF])
            .expect("angles");
        served.middle.command(gesture, &[7]).expect("a gesture");
        served.until("that it drives", |middle| {
            middle
                .read(pose)
                .is_some_and(|read| numbers(read.value)[0] > 2600)
        });
        served.until_said("gesture 7");
        served.until("its joints", |middle| {
            middle
                .read(posture)
                .is_some_and(|read| numbers(read.value) == [100, 200, 400])
        });

        // A stop is confirmed, and it stands.
        served.middle.set_activated(motion, false).expect("a module");
        served.until("a stop", Middle::is_confirmed);
        served.until("that it stands", |middle| {
            middle
                .read(posture)
                .is_some_and(|read| numbers(read.value) == [0; 3])
        });

        if key.is_none() {
            continue;
        }
        // Silence: the robot rests and the session is over. Then the middle, which notices it too, asks for another.
        std::mem::take(&mut served.heard);
        assert_eq!(
            served.said.recv_timeout(PATIENCE).expect("a word"),
            "the session is over"
        );
        served.until_said("a session began");
        assert!(
            served.heard.iter().any(|notice| notice == "Lost"),
            "{:?}",
            served.heard
        );
    }
}
