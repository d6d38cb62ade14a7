//! Both real ends of the protocol, and a modelled link between them, in virtual time.

use std::time::Duration;

use anyhow::{Result, anyhow};
use fastrand::Rng;
use mom_cubo::model::LAYOUT;
use mom_rsp::middle::{Middle, Settings};
use mom_rsp::robot::{self, Body, Robot};
use mom_rsp::{Dropped, Layout, Refused};
use mom_tests::network::{Line, Shape};

/// The bytes of an IPv4 packet over Ethernet, and of its header and UDP's.
const MTU: usize = 1500;
const IP: usize = 20;
const UDP: usize = 8;
/// What IP carries in one packet of a datagram.
const PART: usize = MTU - IP;

/// The IP packets of a datagram of so many bytes (S27).
pub(super) fn ip_packets(datagram: usize) -> usize {
    (UDP + datagram).div_ceil(PART)
}

/// The bytes of a datagram's IP packets.
pub(super) fn ip_bytes(datagram: usize) -> usize {
    UDP + datagram + IP * ip_packets(datagram)
}

/// What datagrams have been under way in one direction.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Count {
    pub(super) sent: u64,
    /// Bytes of their IP packets.
    pub(super) bytes: u64,
    pub(super) arrived: u64,
}

/// One direction: UDP over IP, each packet of which may be lost by itself, over a line of a rate, a delay, jitter and a queue.
pub(super) struct Way {
    line: Line,
    number: u32,
    /// The datagram that is put together: its number, its parts, its bytes. Lines keep the order, so one is enough.
    whole: (u32, usize, Vec<u8>),
    pub(super) count: Count,
}

impl Way {
    pub(super) fn new(shape: Shape, seed: u64) -> Way {
        Way {
            line: Line::new(shape, seed),
            number: 0,
            whole: (0, 0, Vec::new()),
            count: Count::default(),
        }
    }

    /// Sends a datagram at this time, µs.
    pub(super) fn send(&mut self, datagram: &[u8], now: u64) {
        self.number += 1;
        self.count.sent += 1;
        self.count.bytes += ip_bytes(datagram.len()) as u64;
        let whole = [&[0; UDP], datagram].concat();
        let parts = ip_packets(datagram.len());
        for part in whole.chunks(PART) {
            // The header's fields that are needed here: which datagram, and how many parts it has.
            let mut packet = vec![0; IP];
            packet.splice(
                ..8,
                [self.number.to_be_bytes(), (parts as u32).to_be_bytes()].concat(),
            );
            packet.extend_from_slice(part);
            self.line.offer(packet, Duration::from_micros(now));
        }
    }

    /// When the next IP packet arrives, µs.
    pub(super) fn due(&self) -> Option<u64> {
        Some(self.line.due()?.as_nanos().div_ceil(1000) as u64)
    }

    /// A datagram all of whose parts have arrived.
    pub(super) fn arrived(&mut self, now: u64) -> Option<Vec<u8>> {
        while let Some(packet) = self.line.arrived(Duration::from_micros(now)) {
            let (head, part) = packet.split_first_chunk::<IP>()?;
            let [n0, n1, n2, n3, p0, p1, p2, p3, ..] = *head;
            let number = u32::from_be_bytes([n0, n1, n2, n3]);
            let parts = u32::from_be_bytes([p0, p1, p2, p3]) as usize;
            if self.whole.0 != number {
                self.whole = (number, 0, Vec::new());
            }
            self.whole.1 += 1;
            self.whole.2.extend_from_slice(part);
            if self.whole.1 == parts {
                self.count.arrived += 1;
                return Some(self.whole.2.split_off(UDP));
            }
        }
        None
    }
}

/// A robot's end of any model.
pub(super) trait End {
    fn receive(&mut self, now: u64, datagram: &mut [u8], body: &mut impl Body) -> Result<(), Dropped>;
    fn poll(&mut self, now: u64, out: &mut [u8], body: &mut impl Body) -> Option<usize>;
    fn wake(&self) -> Option<u64>;
    fn set(&mut self, element: u8, value: &[u8]) -> Result<(), Refused>;
    fn raise(&mut self, element: u8, data: &[u8]) -> Result<(), Refused>;
}

impl<const E: usize, const V: usize, const B: usize, const S: usize> End for Robot<'_, E, V, B, S> {
    fn receive(&mut self, now: u64, datagram: &mut [u8], body: &mut impl Body) -> Result<(), Dropped> {
        self.receive(now, datagram, body)
    }

    fn poll(&mut self, now: u64, out: &mut [u8], body: &mut impl Body) -> Option<usize> {
        self.poll(now, out, body)
    }

    fn wake(&self) -> Option<u64> {
        self.wake()
    }

    fn set(&mut self, element: u8, value: &[u8]) -> Result<(), Refused> {
        self.set(element, value)
    }

    fn raise(&mut self, element: u8, data: &[u8]) -> Result<(), Refused> {
        self.raise(element, data)
    }
}

/// The programs at both ends, and an observer. All functions but those of [`Body`] may do nothing.
pub(super) trait Scene: Body {
    /// The middle's program has a turn: something may have arrived, and its end will send what is due.
    fn at_middle(&mut self, now: u64, middle: &mut Middle<'_>);

    /// The robot's program has a turn.
    fn at_robot(&mut self, now: u64, end: &mut impl End) {
        let _ = (now, end);
    }

    /// The middle's end sends a datagram. Nothing is sent if this says so: it is lost at once.
    fn leaves_middle(&mut self, now: u64, datagram: &[u8]) -> bool {
        let _ = (now, datagram);
        true
    }

    /// The robot's end sends a datagram; as above.
    fn leaves_robot(&mut self, now: u64, datagram: &[u8]) -> bool {
        let _ = (now, datagram);
        true
    }

    /// A datagram has arrived at the robot, before its end takes it.
    fn reaches_robot(&mut self, now: u64, datagram: &[u8]) {
        let _ = (now, datagram);
    }

    /// A datagram has arrived at the middle, before its end takes it.
    fn reaches_middle(&mut self, now: u64, datagram: &[u8]) {
        let _ = (now, datagram);
    }

    /// Datagrams of the middle that were held back, and go on now.
    fn late(&mut self, now: u64) -> Vec<Vec<u8>> {
        let _ = now;
        Vec::new()
    }

    /// When one of the programs wants a turn, whatever happens on the link.
    fn wake(&self) -> Option<u64> {
        None
    }
}

/// Both ends with their programs, and the link.
pub(super) struct World<E, S> {
    pub(super) now: u64,
    pub(super) middle: Middle<'static>,
    pub(super) end: E,
    pub(super) scene: S,
    pub(super) down: Way,
    pub(super) up: Way,
    out: Vec<u8>,
}

impl<E: End, S: Scene> World<E, S> {
    /// A world whose middle asks for a session at once. Its time begins at 1 s.
    pub(super) fn new(middle: Middle<'static>, end: E, scene: S, shape: Shape, seed: u64) -> World<E, S> {
        let mut world = World {
            now: 1_000_000,
            middle,
            end,
            scene,
            down: Way::new(shape, seed),
            up: Way::new(shape, !seed),
            out: vec![0; LARGEST],
        };
        world.middle.start(world.now);
        world
    }

    /// Lets time pass.
    pub(super) fn run_until(&mut self, until: u64) {
        while self.step(until) {}
    }

    /// Goes to the next time at which something happens, if that is before `until`.
    pub(super) fn step(&mut self, until: u64) -> bool {
        let next = [
            self.middle.wake(),
            self.end.wake(),
            self.down.due(),
            self.up.due(),
            self.scene.wake(),
        ];
        let next = next.into_iter().flatten().min().unwrap_or(until);
        // Time never stands still, whatever an end wants.
        let next = next.max(self.now + 1);
        if next > until {
            self.now = until;
            return false;
        }
        self.now = next;
        self.turn();
        true
    }

    fn turn(&mut self) {
        let now = self.now;
        while let Some(mut datagram) = self.down.arrived(now) {
            self.scene.reaches_robot(now, &datagram);
            // What it drops it counts.
            let _ = self.end.receive(now, &mut datagram, &mut self.scene);
        }
        while let Some(mut datagram) = self.up.arrived(now) {
            self.scene.reaches_middle(now, &datagram);
            let _ = self.middle.receive(now, &mut datagram);
        }
        self.scene.at_middle(now, &mut self.middle);
        for datagram in self.scene.late(now) {
            self.down.send(&datagram, now);
        }
        while let Some(datagram) = self.middle.poll(now) {
            if self.scene.leaves_middle(now, datagram) {
                self.down.send(datagram, now);
            }
        }
        self.scene.at_robot(now, &mut self.end);
        while let Some(length) = self.end.poll(now, &mut self.out, &mut self.scene) {
            let datagram = self.out.get(..length).unwrap_or_default();
            if self.scene.leaves_robot(now, datagram) {
                self.up.send(datagram, now);
            }
        }
    }
}

/// The largest packet of the models here.
const LARGEST: usize = LAYOUT.largest();

/// A middle's end whose nonces follow from a seed.
pub(super) fn middle(
    layout: &'static Layout<'static>,
    settings: Settings,
    seed: u64,
) -> Result<Middle<'static>> {
    let mut random = Rng::with_seed(seed);
    let fill = move |bytes: &mut [u8]| random.fill(bytes);
    Middle::new(layout, settings, fill).map_err(|fault| anyhow!("the middle's end: {fault}"))
}

/// CUBO's end.
pub(super) fn cubo(settings: robot::Settings) -> Result<mom_cubo::End> {
    mom_cubo::End::new(&LAYOUT, settings).map_err(|fault| anyhow!("the robot's end: {fault}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_datagram_of_two_ip_packets_arrives_whole_or_not_at_all() {
        assert_eq!(
            [0, 34, 1472, 1473, 1992].map(|bytes| (ip_packets(bytes), ip_bytes(bytes))),
            [(1, 28), (1, 62), (1, 1500), (2, 1521), (2, 2040)]
        );
        let shape = Shape {
            loss: 0.3,
            ..Shape::mbit(100.0, Duration::from_millis(5))
        };
        let mut way = Way::new(shape, 7);
        let mut arrived = Vec::new();
        for number in 0..1000_u64 {
            let size = if number % 2 == 0 { 1992 } else { 34 };
            way.send(&vec![number as u8; size], number * 20_000);
            while let Some(datagram) = way.arrived(number * 20_000 + 10_000) {
                assert_eq!(datagram, vec![number as u8; size]);
                arrived.push(size);
            }
        }
        let share = |of: usize| arrived.iter().filter(|size| **size == of).count() as f64 / 500.0;
        assert!((share(34) - 0.7).abs() < 0.06, "{}", share(34));
        assert!((share(1992) - 0.49).abs() < 0.06, "{}", share(1992));
        assert_eq!(way.count.arrived, arrived.len() as u64);
    }
}
