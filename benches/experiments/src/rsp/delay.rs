//! S11: the parts of the delay from a program's `write` to the robot's wheel, measured over loopback.

use std::fmt::Write as _;
use std::net::UdpSocket as Socket;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, anyhow, ensure};
use fastrand::Rng;
use mom_cubo::model::LAYOUT;
use mom_cubo::model::elements::{LeftWheel, Speaker};
use mom_plots::{Axis, Plot, Series, quantiles};
use mom_rsp::middle::{Settings as Ends, State};
use mom_rsp::robot::{self, Body};
use mom_rsp::typed::Named as _;
use mom_rsp::{Header, Type};
use tokio::net::UdpSocket;
use tokio::time::sleep_until;

use super::world::{cubo, ip_bytes, middle};
use super::{MS, PERIOD};
use crate::{IMAGES, Section, Settings, quantile, runtime};

/// Sessions, and packets of each.
const SESSIONS: u64 = 20;
const PACKETS: usize = 60;
/// A session that has not got so far by then fails, s.
const PATIENCE: u64 = 30;
/// Of the example: m between both ends, and Mbit/s of each of the links.
const FAR: f64 = 100_000.0;
const RATES: [f64; 3] = [0.8, 1.0, 10.0];
/// m/s.
const LIGHT: f64 = 299_792_458.0;

/// The parts, in their order.
const PARTS: [&str; 6] = [
    "the middle's wait for T",
    "encode",
    "system call",
    "network, until the robot's program has it",
    "decode",
    "the motion filter's wait for T",
];

/// When what happened to one value, µs with fractions; parts that were not seen are no number.
type Sample = [f64; PARTS.len()];

/// What the robot's thread saw of one packet, since the common beginning.
#[derive(Clone, Copy, Debug)]
struct Heard {
    sequence: u16,
    /// The datagram was here, was decoded, and the wheel had its value.
    arrived: Duration,
    decoded: Duration,
    moved: Option<Duration>,
}

/// The robot: it notes when its wheel gets a value.
struct Wheel {
    random: Rng,
    begin: Instant,
    heard: Arc<Mutex<Vec<Heard>>>,
}

impl Body for Wheel {
    fn random(&mut self, bytes: &mut [u8]) {
        self.random.fill(bytes);
    }

    fn effector(&mut self, element: u8, _: &[u8]) {
        let mut heard = self.heard.lock().unwrap_or_else(PoisonError::into_inner);
        // All that arrived since the last output is in this one.
        let waiting = heard.iter_mut().rev().take_while(|heard| heard.moved.is_none());
        if element == LeftWheel::PLACE {
            waiting.for_each(|heard| heard.moved = Some(self.begin.elapsed()));
        }
    }

    fn command(&mut self, _: u8, _: &[u8]) {}
}

async fn serve(socket: Socket, mut wheel: Wheel, over: Arc<Mutex<bool>>) -> Result<()> {
    socket.set_nonblocking(true)?;
    let socket = UdpSocket::from_std(socket)?;
    let begin = wheel.begin;
    let now = || begin.elapsed().as_micros() as u64;
    let mut end = cubo(robot::Settings::default())?;
    let (mut buffer, mut out) = (vec![0; 4096], vec![0; 4096]);
    let mut to = None;
    while !*over.lock().unwrap_or_else(PoisonError::into_inner) {
        while let Ok((length, from)) = socket.try_recv_from(&mut buffer) {
            let arrived = begin.elapsed();
            let datagram = buffer.get_mut(..length).unwrap_or_default();
            let header = Header::decode(datagram).map_err(|why| anyhow!("a header: {why}"))?;
            end.receive(now(), datagram, &mut wheel)
                .map_err(|why| anyhow!("a datagram was dropped: {why}"))?;
            let decoded = begin.elapsed();
            to = Some(from);
            if header.kind == Type::Data {
                wheel
                    .heard
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .push(Heard {
                        sequence: header.sequence,
                        arrived,
                        decoded,
                        moved: None,
                    });
            }
        }
        while let Some(length) = end.poll(now(), &mut out, &mut wheel) {
            if let (Some(to), Some(datagram)) = (to, out.get(..length)) {
                socket.send_to(datagram, to).await?;
            }
        }
        let wake = end.wake().unwrap_or(now() + 20 * MS);
        let wake = (begin + Duration::from_micros(wake)).into();
        tokio::select! {
            ready = socket.readable() => ready?,
            () = sleep_until(wake) => {}
        }
    }
    Ok(())
}

/// What the middle's thread saw of one packet.
#[derive(Clone, Copy, Debug)]
struct Sent {
    sequence: u16,
    /// µs between the write and the packet's turn.
    waited: f64,
    encode: Duration,
    /// When the system call began, and how long it was.
    called: Duration,
    call: Duration,
}

/// One session: a value is written at a random time of each period.
async fn command(
    socket: Socket,
    begin: Instant,
    packets: usize,
    music: bool,
    seed: u64,
) -> Result<Vec<Sent>> {
    socket.set_nonblocking(true)?;
    let socket = UdpSocket::from_std(socket)?;
    let now = || begin.elapsed().as_micros() as u64;
    let ends = Ends {
        paper: music,
        ..Ends::default()
    };
    let mut random = Rng::with_seed(seed);
    let (mut middle, mut sent) = (middle(&LAYOUT, ends, seed)?, Vec::new());
    let mut buffer = vec![0; 4096];
    // The write of this period: when it shall be, and when it was.
    let (mut planned, mut written) = (None, None);
    middle.start(now());
    while sent.len() < packets {
        ensure!(begin.elapsed().as_secs() < PATIENCE, "the robot does not answer");
        while let Ok(length) = socket.try_recv(&mut buffer) {
            // What it drops it counts.
            let _ = middle.receive(now(), buffer.get_mut(..length).unwrap_or_default());
        }
        while middle.next_notice().is_some() {}
        if middle.state() == State::Up && planned.is_some_and(|at| now() >= at) {
            let speed = (sent.len() % 400) as i16 + 1;
            let told = middle.write(LeftWheel::PLACE, &speed.to_be_bytes());
            let sound = vec![speed as u8; 1956];
            let told = told.and_then(|()| {
                if music {
                    middle.write(Speaker::PLACE, &sound)
                } else {
                    Ok(())
                }
            });
            told.map_err(|refused| anyhow!("a write was refused: {refused}"))?;
            (planned, written) = (None, Some(begin.elapsed()));
        }
        loop {
            let before = begin.elapsed();
            let Some(datagram) = middle.poll(now()) else { break };
            let encoded = begin.elapsed();
            let header = Header::decode(datagram).map_err(|why| anyhow!("a header: {why}"))?;
            let called = begin.elapsed();
            socket.send(datagram).await?;
            let call = begin.elapsed() - called;
            if header.kind == Type::Data {
                if let Some(written) = written.take() {
                    sent.push(Sent {
                        sequence: header.sequence,
                        waited: (before - written).as_secs_f64() * 1e6,
                        encode: encoded - before,
                        called,
                        call,
                    });
                }
                // At any time of the period.
                planned = Some(now() + random.u64(0..PERIOD - 2 * MS));
            }
        }
        let wake = [middle.wake(), planned]
            .into_iter()
            .flatten()
            .min()
            .unwrap_or_else(&now);
        let wake = (begin + Duration::from_micros(wake)).into();
        tokio::select! {
            ready = socket.readable() => ready?,
            () = sleep_until(wake) => {}
        }
    }
    Ok(sent)
}

fn session(packets: usize, music: bool, seed: u64) -> Result<Vec<Sample>> {
    let [robot, middle] = [Socket::bind(("127.0.0.1", 0))?, Socket::bind(("127.0.0.1", 0))?];
    middle.connect(robot.local_addr()?)?;
    let begin = Instant::now();
    let heard = Arc::new(Mutex::new(Vec::new()));
    let over = Arc::new(Mutex::new(false));
    let wheel = Wheel {
        random: Rng::with_seed(!seed),
        begin,
        heard: Arc::clone(&heard),
    };
    let stop = Arc::clone(&over);
    let served = thread::spawn(move || runtime()?.block_on(serve(robot, wheel, stop)));
    let sent = runtime()?.block_on(async {
        let sent = command(middle, begin, packets, music, seed).await;
        // The last one gets its period at the robot.
        tokio::time::sleep(Duration::from_micros(2 * PERIOD)).await;
        sent
    });
    *over.lock().unwrap_or_else(PoisonError::into_inner) = true;
    served
        .join()
        .map_err(|_| anyhow!("the robot's thread failed"))??;
    let heard = heard.lock().unwrap_or_else(PoisonError::into_inner);
    let micros = |time: Duration| time.as_secs_f64() * 1e6;
    let samples = sent?.into_iter().filter_map(|sent| {
        let heard = heard.iter().find(|heard| heard.sequence == sent.sequence)?;
        let moved = heard.moved?.checked_sub(heard.decoded)?;
        Some([
            sent.waited,
            micros(sent.encode),
            micros(sent.call),
            // The robot may have it before the system call is over.
            micros(heard.arrived.saturating_sub(sent.called + sent.call)),
            micros(heard.decoded - heard.arrived),
            micros(moved),
        ])
    });
    Ok(samples.collect())
}

/// All sessions; of each part all values, sorted.
fn measure(settings: &Settings, music: bool) -> Result<Vec<Vec<f64>>> {
    let (sessions, packets) = if settings.quick {
        (1, 8)
    } else {
        (SESSIONS, PACKETS)
    };
    let mut parts = vec![Vec::new(); PARTS.len()];
    for number in 0..sessions {
        for sample in session(packets, music, settings.seed + number)? {
            for (part, value) in parts.iter_mut().zip(sample) {
                part.push(value);
            }
        }
    }
    let first = parts.first().context("there are parts")?;
    ensure!(!first.is_empty(), "no packet was seen at both ends");
    for part in &mut parts {
        part.sort_by(f64::total_cmp);
    }
    Ok(parts)
}

pub(crate) fn run(settings: &Settings) -> Result<Section> {
    let motion = measure(settings, false)?;
    let music = measure(settings, true)?;
    Ok(Section {
        markdown: markdown(&motion, &music),
        plots: vec![("experiment-rsp-delay.svg", plot(&motion))],
    })
}

fn markdown(motion: &[Vec<f64>], music: &[Vec<f64>]) -> String {
    let mut text = format!(
        "The paper's equation for the delay, T_d = Σ (l_i / C + tr_i + tl_i(k) + M / b_i), counts links and nodes: length over speed of light, routing, load, size over rate; it takes the load for what cannot be foreseen (S11). \
         Here the parts are measured from a program's `write` to the robot's wheel, between two threads with a UDP socket each over loopback, T = 20 ms: {} values with 24 bytes to a packet, and {} with music, 1990 bytes, in paper mode. Writes come at random times; {SESSIONS} sessions each.\n\n\
         **Inputs:** the times of the writes. Timers of these programs count in whole ms, as the robots' do. The machine is shared with other work.\n\n\
         | part, µs | in the equation | motion: p50 | mean | p99 | most | with music: p50 | p99 |\n|---|---|---:|---:|---:|---:|---:|---:|\n",
        motion.first().map_or(0, Vec::len),
        music.first().map_or(0, Vec::len),
    );
    let terms = [
        "no",
        "no",
        "load of the first node",
        "l / C, tr, tl, M / b",
        "no",
        "no",
    ];
    for (((name, term), motion), music) in PARTS.iter().zip(terms).zip(motion).zip(music) {
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "| {name} | {term} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} |",
            quantile(motion, 0.5),
            motion.iter().sum::<f64>() / motion.len() as f64,
            quantile(motion, 0.99),
            quantile(motion, 1.0),
            quantile(music, 0.5),
            quantile(music, 0.99),
        );
    }
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len().max(1) as f64;
    let means: Vec<f64> = motion.iter().map(|part| mean(part)).collect();
    let _ = writeln!(
        text,
        "\nOf {:.1} ms in the mean, {:.1} are the middle's wait for its turn, which the equation has not: T / 2 in the mean, as writes come at any time. The robot's motion filter would wait as long if it had a clock of its own; but an output follows the packet that brought its value, unless the one before came less than 7/8 of T ago. \
         What the equation has, beside them, over {:.0} km at {}:\n\n| bytes with IP and UDP | l / C, ms | M / b, ms: {} |\n|---:|---:|{}",
        means.iter().sum::<f64>() / 1000.0,
        means.first().unwrap_or(&0.0) / 1000.0,
        FAR / 1000.0,
        RATES.map(|rate| format!("{rate} Mbit/s")).join(", "),
        RATES.map(|rate| format!("{rate} Mbit/s")).join(" | "),
        "---:|".repeat(RATES.len()),
    );
    for bytes in [34, 1992].map(ip_bytes) {
        let times = RATES.map(|rate| format!("{:.2}", bytes as f64 * 8.0 / rate / 1000.0));
        let _ = writeln!(
            text,
            "| {bytes} | {:.2} | {} |",
            FAR / LIGHT * 1000.0,
            times.join(" | ")
        );
    }
    let _ = writeln!(
        text,
        "\nSo size alone is within a period but where the rate is about what it fills, and then its queue is the load that cannot be foreseen.\n\n![Parts of the delay](images/{IMAGES}-rsp-delay.svg)"
    );
    text
}

fn plot(motion: &[Vec<f64>]) -> String {
    let plot = Plot::new(
        "From a write to the wheel over loopback (S11)",
        Axis::log("µs"),
        Axis::linear("share of the values"),
    );
    let with = |plot: Plot, (name, values): (&&'static str, &Vec<f64>)| {
        // A logarithmic axis has no 0; some hundred points are enough.
        let mut curve = quantiles(values);
        curve.retain(|(value, _)| *value > 0.0);
        let step = (curve.len() / 200).max(1);
        plot.with(Series::steps(*name, curve.into_iter().step_by(step).collect()))
    };
    PARTS.iter().zip(motion).fold(plot, with).to_svg()
}
