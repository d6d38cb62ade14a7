//! Peers that are there and say nothing: what each costs in memory.

use std::io::Read;

use mom_benches::{Error, Hub, Link, Message, Scan, Scanner, Topic, connect_all};

use crate::metric::{Metric, Sample};

/// Connected before the memory is first read, so that what a program needs once is not counted.
const FIRST: usize = 20;

/// Lets so many peers join one topic, and looks how much the hub has grown; then everybody must hear one parcel.
///
/// # Errors
/// A hub that takes fewer, or that one of them does not hear.
pub fn idle(hub: &Hub, peers: usize) -> Result<Sample, Error> {
    let process = hub.process.as_ref();
    let memory = || process.and_then(|process| process.memory());
    let mut links = connect_all(hub, Topic::Forth, FIRST.min(peers))?;
    let before = memory();
    links.extend(connect_all(hub, Topic::Forth, peers)?);
    let after = memory();
    let cpu = hub.cpu();
    let mut sender = hub.driver.connect(&[], &[Topic::Forth])?;
    let mut bytes = Vec::new();
    let template = hub.driver.template(Message::forth(64))?;
    template.append_all(0..1, &mut bytes);
    sender.write(&bytes)?;
    for link in &mut links {
        hear_one(link, &mut *hub.driver.scanner())?;
    }
    let mut sample = Sample::new();
    if let Some((before, after)) = before.zip(after) {
        let grown = after.saturating_sub(before) as f64;
        sample.insert(Metric::Memory, grown / peers as f64 / 1024.0);
    }
    if let Some((before, after)) = cpu.zip(hub.cpu()) {
        let used = after.saturating_sub(before).as_secs_f64();
        sample.insert(Metric::Cpu, used / (links.len() as f64 / 1e6));
    }
    Ok(sample)
}

fn hear_one(link: &mut Link, scanner: &mut dyn Scanner) -> Result<(), Error> {
    let mut at = 0;
    loop {
        match scanner.scan(&link.received[at..])? {
            Scan::Parcel(_, 0) => return Ok(()),
            Scan::Parcel(_, got) => return Err(Error::Order { expected: 0, got }),
            Scan::Other(length) => at += length,
            Scan::Dropped(_, count) => return Err(Error::Unexpected(format!("dropped: {count}"))),
            Scan::Incomplete => {
                let mut chunk = [0; 4096];
                let length = link.stream.read(&mut chunk).map_err(Error::io("read"))?;
                if length == 0 {
                    return Err(Error::Unexpected("the end of a connection".to_owned()));
                }
                link.received.extend_from_slice(&chunk[..length]);
            }
        }
    }
}

/// Lets this process and its children open as many files as the system allows; gives how many that is.
pub fn raise_files() -> u64 {
    crate::files::raise()
}
