//! S26, S27: packets of motion with and without music, against packets of one size, and what becomes of them where frames are lost.

use std::fmt::Write as _;
use std::ops::Range;
use std::time::Duration;

use anyhow::{Result, ensure};
use fastrand::Rng;
use mom_cubo::model::LAYOUT;
use mom_cubo::model::elements::{Joints, LeftWheel, Lips, RightWheel, Speaker};
use mom_plots::{Axis, Plot, Series};
use mom_rsp::middle::{Middle, Notice, Settings as Ends, State};
use mom_rsp::robot::{self, Body};
use mom_rsp::typed::Named as _;
use mom_rsp::{Fragment, Header, Refused, Type};
use mom_tests::network::Shape;

use super::world::{Scene, World, cubo, ip_bytes, middle};
use super::{MS, Mean, PERIOD, SECOND};
use crate::{IMAGES, Section, Settings};

/// Two minutes at T = 20 ms.
const PACKETS: u64 = 6000;
/// Shares of the time between which a song is played: 72.8 s of the two minutes in all.
const SONGS: [Range<u64>; 2] = [1000..2820, 3500..5320];
/// Bytes of 20 ms of sound.
const SOUND: usize = 1956;
/// Bytes of a packet of fixed size: that of all effectors, which is the largest that the scenario needs.
const FIXED: usize = 1992;
/// The share of IP packets (frames) that are lost.
const LOSSES: [f64; 5] = [0.0, 0.01, 0.02, 0.05, 0.1];
const SEEDS: u64 = 10;
/// Packets of each lossy run, all with music.
const LOSSY: u64 = 3000;

/// How the ends behave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    /// Music in the packet of the motion.
    Paper,
    /// Music in fragments beside it.
    Ours,
}

/// What left in one period, bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Period {
    /// Of the data packet.
    data: usize,
    /// Of all datagrams, and of their IP packets.
    all: usize,
    ip: usize,
}

/// The program at the middle, which moves arms and lips and plays music, and the robot, which counts.
struct Show {
    random: Rng,
    mode: Mode,
    songs: Vec<Range<u64>>,
    is_playing: bool,
    /// The period is prepared whose packets have not left.
    is_prepared: bool,
    periods: Vec<Period>,
    /// Packets of control, which say that the loudspeaker is not needed.
    controls: u64,
    /// When data packets arrived.
    motions: Vec<u64>,
    /// Bytes of sound that left, and that arrived.
    played: usize,
    sound: usize,
    refused: Option<Refused>,
}

impl Show {
    fn new(mode: Mode, songs: &[Range<u64>], seed: u64) -> Show {
        Show {
            random: Rng::with_seed(seed),
            mode,
            songs: songs.to_vec(),
            is_playing: false,
            is_prepared: false,
            periods: Vec::new(),
            controls: 0,
            motions: Vec::new(),
            played: 0,
            sound: 0,
            refused: None,
        }
    }

    /// What the program wants in the next packet.
    fn play(&mut self, middle: &mut Middle<'_>) -> Result<(), Refused> {
        let number = self.periods.len() as u64;
        let phase = number as f64 * 0.02;
        let wave = |most: f64, turns: f64| ((most * (phase * turns).sin()) as i16).to_be_bytes();
        // Lips, arms, and wheels to and fro: each number differs in each packet.
        middle.write(LeftWheel::PLACE, &wave(100.0, 2.0))?;
        middle.write(RightWheel::PLACE, &wave(-100.0, 2.0))?;
        let joints = [wave(900.0, 2.0), wave(900.0, 3.0), wave(150.0, 1.0)].concat();
        middle.write(Joints::PLACE, &joints)?;
        let lips = (5000.0 + 5000.0 * (phase * 9.0).sin()) as u16;
        middle.write(Lips::PLACE, &lips.to_be_bytes())?;
        let is_music = self.songs.iter().any(|song| song.contains(&number));
        if is_music {
            let mut sound = [0; SOUND];
            self.random.fill(&mut sound);
            match self.mode {
                Mode::Paper => middle.write(Speaker::PLACE, &sound)?,
                Mode::Ours => middle.send_blob(Speaker::PLACE, &sound).map(|_| ())?,
            }
            self.played += SOUND;
        } else if self.is_playing && self.mode == Mode::Paper {
            // Its bit is 0 from here on.
            middle.set_activated(Speaker::PLACE, false)?;
        }
        self.is_playing = is_music;
        Ok(())
    }
}

impl Body for Show {
    fn random(&mut self, bytes: &mut [u8]) {
        self.random.fill(bytes);
    }

    fn effector(&mut self, element: u8, value: &[u8]) {
        if element == Speaker::PLACE {
            self.sound += value.len();
        }
    }

    fn command(&mut self, _: u8, _: &[u8]) {}

    fn fragment(&mut self, fragment: Fragment<'_>) {
        self.sound += fragment.bytes.len();
    }
}

impl Scene for Show {
    fn at_middle(&mut self, now: u64, middle: &mut Middle<'_>) {
        while let Some(notice) = middle.next_notice() {
            // What has been switched off may be used again.
            if let Notice::Active {
                element,
                active: false,
            } = notice
            {
                self.refused = self.refused.or(middle.set_activated(element, true).err());
            }
        }
        let is_due = middle.wake().is_some_and(|wake| wake <= now);
        if middle.state() == State::Up && is_due && !self.is_prepared {
            self.is_prepared = true;
            self.refused = self.refused.or(self.play(middle).err());
        }
    }

    fn leaves_middle(&mut self, _: u64, datagram: &[u8]) -> bool {
        let kind = Header::decode(datagram).map(|header| header.kind);
        match kind {
            Ok(Type::Data) => {
                self.is_prepared = false;
                self.periods.push(Period {
                    data: datagram.len(),
                    ..Period::default()
                });
            }
            Ok(Type::Control) => self.controls += 1,
            _ => {}
        }
        if let Some(period) = self.periods.last_mut() {
            period.all += datagram.len();
            period.ip += ip_bytes(datagram.len());
        }
        true
    }

    fn reaches_robot(&mut self, now: u64, datagram: &[u8]) {
        if Header::decode(datagram).is_ok_and(|header| header.kind == Type::Data) {
            self.motions.push(now);
        }
    }
}

/// So many packets of the show over a link that loses this share of its IP packets.
fn show(mode: Mode, packets: u64, songs: &[Range<u64>], loss: f64, seed: u64) -> Result<Show> {
    let ends = Ends {
        paper: mode == Mode::Paper,
        // A period's music in one period.
        budget: 2500,
        ..Ends::default()
    };
    let shape = Shape {
        loss,
        ..Shape::mbit(100.0, Duration::from_millis(10))
    };
    let show = Show::new(mode, songs, seed);
    let mut world = World::new(
        middle(&LAYOUT, ends, seed)?,
        cubo(robot::Settings::default())?,
        show,
        shape,
        seed,
    );
    // The handshake may be lost as well.
    let latest = world.now + packets * PERIOD + 60 * SECOND;
    while (world.scene.periods.len() as u64) < packets && world.step(latest) {}
    // What has left arrives before the next packet leaves.
    world.run_until(world.now + PERIOD * 3 / 4);
    let show = world.scene;
    ensure!(
        show.refused.is_none(),
        "the middle's end refused: {:?}",
        show.refused
    );
    ensure!(show.periods.len() as u64 >= packets, "the session did not last");
    Ok(show)
}

/// What became of motion and sound: % that were lost, and the longest time without motion, ms.
#[derive(Clone, Debug, Default)]
struct Lost {
    motion: Vec<f64>,
    sound: Vec<f64>,
    gap: Vec<f64>,
}

fn lost(mode: Mode, packets: u64, loss: f64, seeds: Range<u64>) -> Result<Lost> {
    let mut lost = Lost::default();
    for seed in seeds {
        let show = show(mode, packets, std::slice::from_ref(&(0..u64::MAX)), loss, seed)?;
        let percent = |arrived: usize, sent: usize| 100.0 * (1.0 - arrived as f64 / sent.max(1) as f64);
        lost.motion.push(percent(show.motions.len(), show.periods.len()));
        lost.sound.push(percent(show.sound, show.played));
        let pairs = show.motions.iter().zip(show.motions.iter().skip(1));
        let gap = pairs.map(|(before, after)| after - before).max().unwrap_or(0);
        lost.gap.push(gap as f64 / MS as f64);
    }
    Ok(lost)
}

pub(crate) fn run(settings: &Settings) -> Result<Section> {
    let (part, seeds) = if settings.quick { (10, 2) } else { (1, SEEDS) };
    let songs = SONGS.map(|song| song.start / part..song.end / part);
    let paper = show(Mode::Paper, PACKETS / part, &songs, 0.0, settings.seed)?;
    let ours = show(Mode::Ours, PACKETS / part, &songs, 0.0, settings.seed)?;
    let seeds = settings.seed..settings.seed + seeds;
    let mut rows = Vec::new();
    for loss in LOSSES {
        let of = |mode| lost(mode, LOSSY / part, loss, seeds.clone());
        rows.push((loss, of(Mode::Paper)?, of(Mode::Ours)?));
    }
    Ok(Section {
        markdown: markdown(&paper, &ours, &songs, &rows),
        plots: vec![
            ("experiment-rsp-sizes.svg", plot_sizes(&paper, &ours)),
            ("experiment-rsp-sizes-lost.svg", plot_lost(&rows)),
        ],
    })
}

/// Bytes without and with music, the mean, and how much less that is than a fixed size, %.
fn row(show: &Show, songs: &[Range<u64>], bytes: fn(&Period) -> usize, fixed: usize) -> String {
    let values = |with: bool| {
        let numbered = (0..).zip(&show.periods);
        let of = numbered.filter(move |(number, _)| with == songs.iter().any(|song| song.contains(number)));
        // The control behind a song is told by itself.
        let mut values: Vec<usize> = of.map(|(_, period)| bytes(period)).collect();
        values.sort_unstable();
        values.get(values.len() / 2).copied().unwrap_or(0)
    };
    let all: usize = show.periods.iter().map(bytes).sum();
    let mean = all as f64 / show.periods.len() as f64;
    format!(
        "{} | {} | {mean:.1} | {fixed} | {:.2} %",
        values(false),
        values(true),
        100.0 * (1.0 - mean / fixed as f64)
    )
}

fn markdown(paper: &Show, ours: &Show, songs: &[Range<u64>], rows: &[(f64, Lost, Lost)]) -> String {
    let played: u64 = songs.iter().map(|song| song.end - song.start).sum();
    let mut text = format!(
        "The paper's first experiment: lips and arms move for two minutes, at times to music; a packet had 34 bytes without music and 1992 with it, about 38.65 % less than packets of one size. \
         Here the middle's end (`mom_rsp::middle`) and CUBO's model ([cubo.toml](../config/cubo.toml)) make {} packets, one each 20 ms, with all motion in each.\n\n\
         **Inputs:** two songs, {:.1} s in all, chosen so that the saving is the paper's, which does not say how long its music was; sound of {SOUND} bytes in 20 ms; a fixed size of {FIXED} bytes, \
         which has room for all effectors.\n\n\
         | bytes each T | without music | with music | mean | fixed size | saved |\n|---|---:|---:|---:|---:|---:|\n\
         | paper | 34 | 1992 | | | 38.65 % |\n",
        paper.periods.len(),
        played as f64 * PERIOD as f64 / SECOND as f64,
    );
    let fixed = ip_bytes(FIXED);
    for (name, cells) in [
        (
            "paper mode, the packet",
            row(paper, songs, |period| period.data, FIXED),
        ),
        (
            "paper mode, with IP and UDP",
            row(paper, songs, |period| period.ip, fixed),
        ),
        (
            "own mode, all packets",
            row(ours, songs, |period| period.all, FIXED),
        ),
        (
            "own mode, with IP and UDP",
            row(ours, songs, |period| period.ip, fixed),
        ),
    ] {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "| {name} | {cells} |");
    }
    let _ = writeln!(
        text,
        "\nThe saving is the music's share of the time and nothing else: (1 − {:.1} / 120) × (1 − 34 / 1992). Paper mode says with {} packets of control that the loudspeaker is not needed, as its value would stay in each packet. \
         Own mode sends music in five fragments beside the motion; their headers cost {} bytes each T.\n",
        played as f64 * PERIOD as f64 / SECOND as f64,
        paper.controls,
        5 * (20 + 11 + 28) - 20 - 2,
    );
    text += &lost_table(rows);
    let _ = writeln!(
        text,
        "![Bytes each T](images/{IMAGES}-rsp-sizes.svg)\n\n![What is lost of motion](images/{IMAGES}-rsp-sizes-lost.svg)"
    );
    text
}

fn lost_table(rows: &[(f64, Lost, Lost)]) -> String {
    let mut text = "A packet of 1992 bytes is two IP packets, and is lost with either (S27); the motion is in it. In own mode motion is a packet of its own, \
         and a lost fragment is 5 ms of sound. \
         Each IP packet is lost by itself with the given probability (an input), all packets are with music, and the intervals are 95 % over the seeds.\n\n\
         | frames lost | paper mode: motion lost, % | two of two arrive, % lost | sound lost, % | longest time without motion, ms | own mode: motion lost, % | sound lost, % | longest time without motion, ms |\n\
         |---:|---:|---:|---:|---:|---:|---:|---:|\n"
        .to_owned();
    for (loss, paper, ours) in rows {
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "| {:.0} % | {:.2} | {:.2} | {:.2} | {:.0} | {:.2} | {:.2} | {:.0} |",
            100.0 * loss,
            Mean::of(&paper.motion),
            100.0 * (1.0 - (1.0 - loss).powi(2)),
            Mean::of(&paper.sound),
            Mean::of(&paper.gap),
            Mean::of(&ours.motion),
            Mean::of(&ours.sound),
            Mean::of(&ours.gap),
        );
    }
    text + "\n"
}

fn plot_sizes(paper: &Show, ours: &Show) -> String {
    let line = |show: &Show, bytes: fn(&Period) -> usize| {
        let values: Vec<f64> = show.periods.iter().map(|period| bytes(period) as f64).collect();
        let mut line = Vec::new();
        let mut last = None;
        for (at, value) in values.iter().enumerate() {
            // Corners are enough.
            if last != Some(value) {
                let at = at as f64 * PERIOD as f64 / SECOND as f64;
                line.extend(last.map(|last| (at, *last)));
                line.push((at, *value));
                last = Some(value);
            }
        }
        let end = values.len() as f64 * PERIOD as f64 / SECOND as f64;
        line.extend(last.map(|last| (end, *last)));
        line
    };
    Plot::new(
        "Packets with and without music (S26, the paper's figure 10)",
        Axis::linear("s"),
        Axis::linear("bytes each T, without IP and UDP"),
    )
    .with(Series::line("paper mode", line(paper, |period| period.data)))
    .with(Series::line(
        "own mode, all packets",
        line(ours, |period| period.all),
    ))
    .mark_y(FIXED as f64, "fixed size")
    .to_svg()
}

fn plot_lost(rows: &[(f64, Lost, Lost)]) -> String {
    let line = |value: &dyn Fn(&(f64, Lost, Lost)) -> f64| -> Vec<(f64, f64)> {
        rows.iter().map(|row| (100.0 * row.0, value(row))).collect()
    };
    Plot::new(
        "Motion beside music where frames are lost (S27)",
        Axis::linear("% of the IP packets that are lost"),
        Axis::linear("% of the packets with motion that are lost"),
    )
    .with(Series::line(
        "paper mode: two IP packets",
        line(&|(_, paper, _)| Mean::of(&paper.motion).mean),
    ))
    .with(Series::line(
        "own mode: music in fragments",
        line(&|(_, _, ours)| Mean::of(&ours.motion).mean),
    ))
    .to_svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_the_papers() {
        let paper = show(Mode::Paper, 100, std::slice::from_ref(&(20..50)), 0.0, 1).unwrap();
        let sizes: Vec<usize> = paper.periods.iter().map(|period| period.data).collect();
        let with = |number: usize| if (20..50).contains(&number) { 1992 } else { 34 };
        assert_eq!(sizes, (0..100).map(with).collect::<Vec<_>>(), "S26");
        assert_eq!((paper.periods[0].ip, paper.periods[20].ip), (62, 2040), "S27");
        let ours = show(Mode::Ours, 100, std::slice::from_ref(&(20..50)), 0.0, 1).unwrap();
        assert_eq!(ours.periods[30].all, 34 + 5 * 31 + 1956);
        assert_eq!(ours.sound, 30 * SOUND);
    }
}
