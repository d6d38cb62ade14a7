//! S28: following a path by poses that come back over a link with delay, jitter, loss and a narrow rate, by packets of several kinds.

mod follower;
mod report;
mod sockets;
mod track;

use std::time::Duration;

use anyhow::Result;
use mom_cubo::model::LAYOUT;
use mom_rsp::middle::Settings as Ends;
use mom_rsp::robot;
use mom_tests::network::Shape;

use super::SECOND;
use super::world::{World, cubo, middle};
use crate::{Section, Settings};
use follower::{Drove, Follower};
use track::Track;

/// What carries the packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transport {
    Udp,
    /// With Nagle's algorithm or without.
    Tcp(bool),
}

/// A way of speaking with the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Arm {
    name: &'static str,
    transport: Transport,
    /// All elements are in each packet, 1992 bytes down and 688 up.
    fixed: bool,
    /// S19 to S23 to the letter.
    paper: bool,
    filter: bool,
}

const OURS: Arm = Arm {
    name: "RSP",
    transport: Transport::Udp,
    fixed: false,
    paper: false,
    filter: true,
};
const PAPER: Arm = Arm {
    name: "paper mode",
    paper: true,
    ..OURS
};
/// Over UDP, in virtual time.
const DATAGRAMS: [Arm; 4] = [
    OURS,
    Arm {
        name: "RSP, no motion filter",
        filter: false,
        ..OURS
    },
    PAPER,
    Arm {
        name: "fixed size",
        fixed: true,
        ..PAPER
    },
];
/// Over the kernel's TCP, in real time.
const STREAMS: [Arm; 4] = [
    Arm {
        name: "variable, TCP",
        transport: Transport::Tcp(false),
        ..PAPER
    },
    Arm {
        name: "variable, TCP, Nagle",
        transport: Transport::Tcp(true),
        ..PAPER
    },
    Arm {
        name: "fixed size, TCP",
        transport: Transport::Tcp(false),
        fixed: true,
        ..PAPER
    },
    Arm {
        name: "fixed size, TCP, Nagle",
        transport: Transport::Tcp(true),
        fixed: true,
        ..PAPER
    },
];

/// RSP there, to see that both times agree.
const CHECK: Arm = Arm {
    name: "RSP, in real time",
    ..OURS
};

/// A link, both ways alike.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Link {
    /// ms each way.
    delay: u64,
    /// Up to so much more, as a share of the delay.
    jitter: f64,
    loss: f64,
    /// Mbit/s.
    rate: f64,
}

const BASE: Link = Link {
    delay: 50,
    jitter: 0.2,
    loss: 0.01,
    rate: 10.0,
};

impl Link {
    fn shape(self) -> Shape {
        let delay = Duration::from_millis(self.delay);
        Shape {
            jitter: delay.mul_f64(self.jitter),
            loss: self.loss,
            ..Shape::mbit(self.rate, delay)
        }
    }
}

/// One factor at a time around the base.
fn links(quick: bool) -> Vec<(String, Link)> {
    let mut links = vec![("base".to_owned(), BASE)];
    if quick {
        // A handshake of TCP that loses a packet takes seconds.
        return vec![("base".to_owned(), Link { loss: 0.0, ..BASE })];
    }
    links.extend([0, 100, 200, 400].map(|delay| (format!("delay {delay} ms"), Link { delay, ..BASE })));
    let far = Link {
        delay: 200,
        loss: 0.0,
        ..BASE
    };
    links.push(("200 ms, no loss".to_owned(), far));
    links.push(("jitter 0".to_owned(), Link { jitter: 0.0, ..BASE }));
    links.extend(
        [0.0, 0.02, 0.05, 0.1].map(|loss| (format!("loss {:.0} %", 100.0 * loss), Link { loss, ..BASE })),
    );
    links.extend([0.8, 1.0].map(|rate| (format!("{rate} Mbit/s"), Link { rate, ..BASE })));
    links
}

/// ms without a packet after which a session in own mode is over at the middle.
const SILENCE: u16 = 2000;
const SEEDS: u64 = 30;
/// Of the arms in real time.
const STREAM_SEEDS: u64 = 5;
/// Robots that drive at the same time there.
const LANES: usize = 16;

/// All drives of one arm over one link.
struct Cell {
    arm: Arm,
    drives: Vec<Drove>,
}

/// A link with all arms.
struct Row {
    name: String,
    link: Link,
    cells: Vec<Cell>,
}

impl Row {
    fn add(&mut self, arm: Arm, drove: Drove) {
        match self.cells.iter_mut().find(|cell| cell.arm == arm) {
            Some(cell) => cell.drives.push(drove),
            None => self.cells.push(Cell {
                arm,
                drives: vec![drove],
            }),
        }
    }
}

impl Arm {
    fn ends(self) -> Ends {
        Ends {
            paper: self.paper,
            // TCP may be silent for long, and goes on. With less than a round trip there is no session in own mode.
            silence: if self.paper { 60_000 } else { SILENCE },
            ..Ends::default()
        }
    }

    /// A drive over UDP in virtual time.
    fn drive(self, track: &Track, link: Link, seed: u64) -> Result<Drove> {
        let follower = Follower::new(track, self.filter, self.fixed, seed)?;
        let mut world = World::new(
            middle(&LAYOUT, self.ends(), seed)?,
            cubo(robot::Settings::default())?,
            follower,
            link.shape(),
            seed,
        );
        let latest = world.now + 300 * SECOND;
        while !world.scene.is_over() && world.step(latest) {}
        Ok(world.scene.drove())
    }
}

pub(crate) fn run(settings: &Settings) -> Result<Section> {
    let quick = settings.quick;
    let (seeds, stream_seeds) = if quick { (2, 1) } else { (SEEDS, STREAM_SEEDS) };
    let [variable, nagle, fixed, fixed_nagle] = STREAMS;
    let (tracks, in_real_time) = match quick {
        true => (vec![Track::square().shortened(100.0)], vec![fixed_nagle]),
        false => (
            vec![Track::square(), Track::eight()],
            vec![variable, nagle, fixed, fixed_nagle, CHECK],
        ),
    };
    let mut tables = Vec::new();
    for track in &tracks {
        let mut rows = Vec::new();
        for (name, link) in links(quick) {
            let mut cells = Vec::new();
            for arm in DATAGRAMS {
                let drives: Result<Vec<Drove>> = (settings.seed..settings.seed + seeds)
                    .map(|seed| arm.drive(track, link, seed))
                    .collect();
                cells.push(Cell { arm, drives: drives? });
            }
            rows.push(Row { name, link, cells });
        }
        tables.push(rows);
    }
    let missing = sockets::drive_all(
        &tracks,
        &mut tables,
        &in_real_time,
        settings.seed..settings.seed + stream_seeds,
    );
    Ok(report::section(&tracks, &tables, missing.err()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use follower::Outcome;

    #[test]
    fn a_robot_follows_a_path_and_a_long_delay_makes_it_worse() {
        let track = Track::square().shortened(3000.0);
        let near = OURS.drive(&track, BASE, 1).unwrap();
        assert_eq!(near.outcome, Outcome::Done);
        assert!(near.rms > 1.0 && near.rms < 60.0, "{near:?}");
        assert!(near.age > 50.0 && near.age < 120.0, "{near:?}");
        let far = OURS.drive(&track, Link { delay: 400, ..BASE }, 1).unwrap();
        assert!(far.rms > near.rms && far.age > 400.0, "{far:?}");
    }

    #[test]
    fn a_fixed_size_fills_a_narrow_link() {
        let narrow = Link { rate: 0.8, ..BASE };
        let track = Track::square().shortened(3000.0);
        let age = |arm: Arm| arm.drive(&track, narrow, 1).unwrap().age;
        let [_, _, paper, fixed] = DATAGRAMS;
        assert!(age(fixed) > age(paper), "{} {}", age(fixed), age(paper));
    }
}
