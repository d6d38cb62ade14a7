//! One parcel there and back between two peers, one at a time.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crate::driver::Topic;
use crate::{Error, Hub, Link, Message, Scan, Scanner, Template};

/// Round trips through one hub, in blocks, so that two hubs can take turns.
pub struct RoundTrips<'a> {
    hub: &'a Hub,
    near: End,
    /// The far peer's thread, and its socket to end it by.
    far: Option<(JoinHandle<Result<(), Error>>, TcpStream)>,
    next: u32,
    /// What each measured round trip took.
    pub delays: Delays,
    /// Processor time of the hub in all measured blocks.
    pub cpu: Option<Duration>,
}

impl<'a> RoundTrips<'a> {
    /// Connects both peers.
    ///
    /// # Errors
    /// A hub that refuses them.
    pub fn start(hub: &'a Hub, payload: usize) -> Result<RoundTrips<'a>, Error> {
        let mut far = End::new(hub, payload, Topic::Forth, Topic::Back)?;
        let far_stream = far
            .link
            .stream
            .try_clone()
            .map_err(Error::io("a second handle"))?;
        let idle = far.link.stream.set_read_timeout(None);
        // While the other hub has its turn, for as long as that takes.
        idle.map_err(Error::io("socket options"))?;
        let near = End::new(hub, payload, Topic::Back, Topic::Forth)?;
        Ok(RoundTrips {
            hub,
            near,
            far: Some((thread::spawn(move || far.answer_all()), far_stream)),
            next: 0,
            delays: Delays::default(),
            cpu: hub.cpu().map(|_| Duration::ZERO),
        })
    }

    /// Round trips that are not measured.
    ///
    /// # Errors
    /// As [`RoundTrips::block`].
    pub fn warm_up(&mut self, rounds: usize) -> Result<(), Error> {
        (0..rounds).try_for_each(|_| self.round().map(drop))
    }

    /// So many measured round trips.
    ///
    /// # Errors
    /// A parcel that does not come back, or another one that does.
    pub fn block(&mut self, rounds: usize) -> Result<(), Error> {
        let before = self.hub.cpu();
        for _ in 0..rounds {
            let delay = self.round()?;
            self.delays.add(delay);
        }
        let used = before.zip(self.hub.cpu());
        self.cpu = self
            .cpu
            .zip(used)
            .map(|(sum, (before, after))| sum + after.saturating_sub(before));
        Ok(())
    }

    fn round(&mut self) -> Result<Duration, Error> {
        let start = Instant::now();
        self.near.send(self.next)?;
        let got = self.near.receive()?;
        let delay = start.elapsed();
        match got {
            Some(got) if got == self.next => {
                self.next += 1;
                Ok(delay)
            }
            Some(got) => Err(Error::Order {
                expected: self.next,
                got,
            }),
            None => Err(Error::Unexpected("the end of the connection".to_owned())),
        }
    }
}

impl Drop for RoundTrips<'_> {
    fn drop(&mut self) {
        if let Some((thread, stream)) = self.far.take() {
            // It hears the end of its connection and is done; a link that failed before has told so already.
            let _ = stream.shutdown(Shutdown::Both);
            let _ = thread.join();
        }
    }
}

struct End {
    link: Link,
    template: Template,
    scanner: Box<dyn Scanner>,
    out: Vec<u8>,
    buffer: Vec<u8>,
    filled: usize,
}

impl End {
    fn new(hub: &Hub, payload: usize, hears: Topic, says: Topic) -> Result<End, Error> {
        let template = hub.driver.template(Message {
            topic: says,
            ..Message::forth(payload)
        })?;
        let mut link = hub.driver.connect(&[hears], &[says])?;
        let mut buffer = std::mem::take(&mut link.received);
        let filled = buffer.len();
        buffer.resize(filled + 2 * template.size() + 4096, 0);
        Ok(End {
            link,
            template,
            scanner: hub.driver.scanner(),
            out: Vec::new(),
            buffer,
            filled,
        })
    }

    fn send(&mut self, number: u32) -> Result<(), Error> {
        self.out.clear();
        self.template.append_all(number..number + 1, &mut self.out);
        self.link.stream.write_all(&self.out).map_err(Error::io("send"))
    }

    /// The number of the next parcel, or none at the end of the connection.
    fn receive(&mut self) -> Result<Option<u32>, Error> {
        loop {
            match self.scanner.scan(&self.buffer[..self.filled])? {
                Scan::Parcel(length, number) => {
                    self.take(length);
                    return Ok(Some(number));
                }
                Scan::Other(length) => self.take(length),
                Scan::Dropped(_, count) => return Err(Error::Unexpected(format!("dropped: {count}"))),
                Scan::Incomplete => {
                    let free = &mut self.buffer[self.filled..];
                    match self.link.stream.read(free).map_err(Error::io("receive"))? {
                        0 => return Ok(None),
                        length => self.filled += length,
                    }
                }
            }
        }
    }

    fn take(&mut self, length: usize) {
        self.buffer.copy_within(length..self.filled, 0);
        self.filled -= length;
    }

    fn answer_all(&mut self) -> Result<(), Error> {
        while let Some(number) = self.receive()? {
            self.send(number)?;
        }
        Ok(())
    }
}

/// The delays of many round trips.
#[derive(Clone, Debug, Default)]
pub struct Delays {
    nanos: Vec<u64>,
}

impl Delays {
    fn add(&mut self, delay: Duration) {
        self.nanos
            .push(u64::try_from(delay.as_nanos()).unwrap_or(u64::MAX));
    }

    /// Adds all of another.
    pub(crate) fn extend(&mut self, more: &Delays) {
        self.nanos.extend_from_slice(&more.nanos);
    }

    /// Those of several measurements.
    pub fn together(parts: &[Delays]) -> Delays {
        let mut all = Delays::default();
        parts.iter().for_each(|part| all.extend(part));
        all
    }

    /// Those that were taken elsewhere.
    pub fn of(delays: Vec<Duration>) -> Delays {
        let mut all = Delays::default();
        delays.into_iter().for_each(|delay| all.add(delay));
        all
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.nanos.len()
    }

    /// The delay in µs that this part of all round trips, from 0 to 1, did not exceed; 0 without any.
    pub fn quantile(&self, part: f64) -> f64 {
        let mut sorted = self.nanos.clone();
        sorted.sort_unstable();
        let last = sorted.len().saturating_sub(1);
        let index = (part * last as f64).round() as usize;
        sorted.get(index).map_or(0.0, |nanos| *nanos as f64 / 1000.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_of_the_sorted_delays() {
        let mut delays = Delays::default();
        assert_eq!(delays.quantile(0.5), 0.0);
        (1..=101)
            .rev()
            .for_each(|micros| delays.add(Duration::from_micros(micros)));
        assert_eq!(
            [0.0, 0.5, 0.99, 1.0].map(|part| delays.quantile(part)),
            [1.0, 51.0, 100.0, 101.0]
        );
    }
}
