//! M7: what a stop, and whatever else is urgent, takes to a receiver that is being sent an image, against the size of the chunks.

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, anyhow, ensure};
use bytes::Bytes;
use mom_client::{Channel, Client, Event, Value, event};
use mom_plots::{Axis, Plot, Series};
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::{sleep, timeout};

use super::far_hub::{FarHub, shape};
use super::{IMAGES, Section, Settings, quantile};
use mom_benches::broker_folder;

/// The channel of image and stops.
const CHANNEL: &str = "/bench";
/// Links, both ways alike: bits per second. All that stands here is an input.
const LINKS: [(&str, f64); 3] = [("64 kbit/s", 64e3), ("1 Mbit/s", 1e6), ("10 Mbit/s", 10e6)];
const DELAY: Duration = Duration::from_millis(50);
const IMAGE: usize = 10_000_000;
const CHUNKS: [usize; 6] = [1 << 10, 4 << 10, 16 << 10, 64 << 10, 256 << 10, 1 << 20];
/// Chunks that take longer on a link are left out: each value would take minutes.
const LONGEST_CHUNK: f64 = 2.5;
/// IP and TCP with time stamps in each packet of 1500 bytes.
const PAYLOAD: f64 = 1448.0 / 1500.0;
/// The chunk of the product on links below some 22 Mbit/s, by which the adaptive row has its place in the plot.
const LEAST_CHUNK: usize = 1 << 10;
/// A parcel that takes longer is lost.
const PATIENCE: Duration = Duration::from_secs(120);
/// The image has been under way for so long, and for two chunks, before the first stop: TCP knows the link then.
const BEGUN: Duration = Duration::from_secs(3);

/// What is on its way beside the stops.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Load {
    Nothing,
    /// One parcel, which the broker cuts as it likes.
    Adaptive,
    /// Cut into messages of this size, of which nothing is cut any more.
    Cut(usize),
}

/// The parcels whose way is measured.
const URGENT: [&str; 3] = [event::STOP, "urgent", event::UNSTOP];

/// Times in s beyond the link's delay, of each of [`URGENT`], sorted.
type Times = [Vec<f64>; 3];

/// What was measured on one link.
struct Row {
    load: Load,
    times: Times,
}

pub(super) fn run(settings: &Settings) -> Result<Section> {
    let rounds = if settings.quick { 3 } else { 20 };
    let links = if settings.quick { &LINKS[1..] } else { &LINKS[..] };
    let measured = std::thread::scope(|scope| {
        let each: Vec<_> = links
            .iter()
            .map(|(_, rate)| scope.spawn(move || measure_link(*rate, rounds, settings)))
            .collect();
        let joined = each.into_iter().map(|link| link.join());
        joined
            .map(|link| link.map_err(|_| anyhow!("a panic at a link"))?)
            .collect::<Result<Vec<_>>>()
    })?;
    Ok(Section {
        markdown: markdown(links, &measured, rounds),
        plots: vec![("experiment-stop-in-image.svg", plot(links, &measured))],
    })
}

/// The time that so many bytes take on a link.
fn serialisation(bytes: usize, rate: f64) -> f64 {
    bytes as f64 * 8.0 / (rate * PAYLOAD)
}

/// What is measured on a link of this rate.
fn loads(rate: f64) -> Vec<Load> {
    let chunks = CHUNKS
        .iter()
        .filter(|chunk| serialisation(**chunk, rate) <= LONGEST_CHUNK);
    let chunks = chunks.map(|chunk| Load::Cut(*chunk));
    [Load::Nothing, Load::Adaptive]
        .into_iter()
        .chain(chunks)
        .collect()
}

fn measure_link(rate: f64, rounds: usize, settings: &Settings) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for load in loads(rate) {
        let times =
            measure(rate, load, rounds, settings).with_context(|| format!("{load:?} at {rate} bit/s"))?;
        rows.push(Row { load, times });
    }
    Ok(rows)
}

/// One broker and one link for each load: nothing is left over from the one before.
fn measure(rate: f64, load: Load, rounds: usize, settings: &Settings) -> Result<Times> {
    let folder = broker_folder()?;
    let config = folder.path().join("mom.toml");
    let text = std::fs::read_to_string(&config)?;
    let limits = "[limits]\nparcel = 16000000\noutbox = 32000000\nburst = 64000000\n";
    let text = text.replace("log = \"warn\"", "log = \"error\"");
    std::fs::write(&config, text.replace("[limits]\n", limits))?;
    let hub = FarHub::new(Some(shape(rate, DELAY)), folder, settings)?;
    // In XML nothing is cut, so a message is a chunk.
    let scheme = if matches!(load, Load::Cut(_)) {
        "tcp"
    } else {
        "bin"
    };
    let address = hub.address(scheme);
    let (arrived, arrivals) = mpsc::unbounded_channel();
    let (had, has) = watch::channel(0);
    let (over, end) = oneshot::channel();
    let near = async {
        let times = send_all(&address, rate, load, rounds, settings.seed, arrivals, has).await;
        // The receiver may have failed before.
        let _ = over.send(());
        times
    };
    let (times, ()) = hub.at_both(near, receive(&address, arrived, had, end))?;
    Ok(times)
}

/// What has arrived at the robot.
struct Arrival {
    name: String,
    at: Instant,
    /// The number of a stop.
    stop: Option<Value>,
}

/// The robot: says when what arrives, and how many parts of images it has.
async fn receive(
    address: &str,
    arrived: mpsc::UnboundedSender<Arrival>,
    had: watch::Sender<usize>,
    mut end: oneshot::Receiver<()>,
) -> Result<()> {
    let client = guest(address).await?;
    let channel = client.channel(CHANNEL).await?;
    let mut events = channel.events();
    let arrival = |name: &str, stop| Arrival {
        name: name.to_owned(),
        at: Instant::now(),
        stop,
    };
    arrived.send(arrival("ready", None))?;
    loop {
        let event = tokio::select! {
            event = events.next() => event,
            _ = &mut end => return Ok(()),
        };
        match event.context("the link ended")? {
            Event::Message(parcel) if parcel.name() == "image" => had.send_modify(|had| *had += 1),
            Event::Message(parcel) => {
                arrived.send(arrival(parcel.name(), parcel.extra.get("stop").cloned()))?;
            }
            _ => {}
        }
    }
}

async fn guest(address: &str) -> Result<Client> {
    let builder = Client::builder(address).guest().no_reconnect();
    Ok(builder.request_timeout(PATIENCE).connect().await?)
}

async fn send_all(
    address: &str,
    rate: f64,
    load: Load,
    rounds: usize,
    seed: u64,
    mut arrivals: mpsc::UnboundedReceiver<Arrival>,
    has: watch::Receiver<usize>,
) -> Result<Times> {
    heard(&mut arrivals, "ready").await?;
    // Another peer sends the image: a stop must not wait in its sender's queue.
    let (camera, operator) = (guest(address).await?, guest(address).await?);
    let (images, stops) = (camera.channel(CHANNEL).await?, operator.channel(CHANNEL).await?);
    let feeding = tokio::spawn(feed(images, load, window(load, rate), has.clone()));
    let mut random = fastrand::Rng::with_seed(seed);
    // After a stop was heard a chunk has just ended; the next one comes in any moment of a chunk.
    let chunk = match load {
        Load::Cut(chunk) => chunk,
        Load::Nothing | Load::Adaptive => LEAST_CHUNK,
    };
    let most = serialisation(chunk, rate).max(0.03);
    sleep(BEGUN + Duration::from_secs_f64(2.0 * serialisation(chunk, rate))).await;
    let mut times = Times::default();
    let mut newest = None;
    for _ in 0..rounds {
        for (name, times) in URGENT.iter().zip(&mut times) {
            sleep(Duration::from_secs_f64(random.f64() * most)).await;
            let message = stops.message(name).no_echo();
            let message = match *name {
                "urgent" => message.priority(50),
                event::UNSTOP => message.slot("stop", newest.clone().unwrap_or_default()),
                _ => message,
            };
            let begin = Instant::now();
            message.send().await?;
            let arrival = heard(&mut arrivals, name).await?;
            newest = arrival.stop.or(newest);
            times.push((arrival.at - begin).saturating_sub(DELAY).as_secs_f64());
        }
    }
    ensure!(
        !feeding.is_finished() || load == Load::Nothing,
        "the image was not sent"
    );
    feeding.abort();
    for times in &mut times {
        times.sort_by(f64::total_cmp);
    }
    Ok(times)
}

async fn heard(arrivals: &mut mpsc::UnboundedReceiver<Arrival>, name: &str) -> Result<Arrival> {
    let arrival = timeout(PATIENCE, arrivals.recv()).await;
    let arrival = arrival
        .with_context(|| format!("{name} is lost"))?
        .context("the receiver ended")?;
    ensure!(arrival.name == name, "{} instead of {name}", arrival.name);
    Ok(arrival)
}

/// How many parts of images are sent and not there yet, so that the link is always full and the broker's queue never.
fn window(load: Load, rate: f64) -> usize {
    match load {
        Load::Cut(chunk) => {
            let round_trip = rate / 8.0 * 2.0 * DELAY.as_secs_f64();
            4 + (2.0 * round_trip / chunk as f64) as usize
        }
        // The next one is there when one ends.
        Load::Nothing | Load::Adaptive => 2,
    }
}

/// The camera.
async fn feed(channel: Channel, load: Load, window: usize, mut has: watch::Receiver<usize>) -> Result<()> {
    let content = match load {
        Load::Nothing => return Ok(()),
        Load::Adaptive => Value::from(Bytes::from(vec![0; IMAGE])),
        Load::Cut(chunk) => Value::from("x".repeat(chunk)),
    };
    let mut sent = 0;
    loop {
        while sent < *has.borrow_and_update() + window {
            channel
                .message("image")
                .content(content.clone())
                .no_echo()
                .send()
                .await?;
            sent += 1;
        }
        has.changed().await?;
    }
}

impl Load {
    fn name(self) -> String {
        match self {
            Load::Nothing => "no image".to_owned(),
            Load::Adaptive => "image, adaptive chunks".to_owned(),
            Load::Cut(chunk) => format!("image in chunks of {} KiB", chunk >> 10),
        }
    }

    /// The least that something urgent may have to wait for, in s.
    fn floor(self, rate: f64) -> Option<f64> {
        match self {
            Load::Nothing => None,
            Load::Adaptive => Some(serialisation(LEAST_CHUNK, rate)),
            Load::Cut(chunk) => Some(serialisation(chunk, rate)),
        }
    }
}

/// p50, p99 and the worst.
fn shown(times: &[f64]) -> String {
    let times = [0.5, 0.99, 1.0].map(|share| 1000.0 * quantile(times, share));
    times.map(|time| format!("{time:.0}")).join(" / ")
}

fn markdown(links: &[(&str, f64)], measured: &[Vec<Row>], rounds: usize) -> String {
    let mut text = format!(
        "A robot at the far end of a link is being sent an image of {} MB. A peer beside the broker sends it, {rounds} times each, in random moments, a stop, \
         a message of priority 50 and an `unstop` (which goes as replies and events do: the control lane). The table has p50 / p99 / the worst of the time until the robot has it, \
         without the link's own delay; *floor* is the time of one chunk at the link's rate, and the image as a whole would be {}. The first 3 s of each image are left out.\n\n\
         **Inputs:** the links, both ways alike, with {} ms one way, nothing lost, a queue of 4 s at the bottleneck, emulated by a packet relay between two network \
         namespaces; the chunks. The broker chooses its chunks itself: a sixth of what may be under way beyond what fills the link, 1 KiB at least, which is \
         what all three links have (*adaptive*). To vary the chunk, the sender cuts the image into messages of its size and the robot is connected in \
         XML, in which the broker cuts nothing; headers of some 150 B come on top. Chunks that take longer than {LONGEST_CHUNK} s are left out.\n\n",
        IMAGE / 1_000_000,
        links
            .iter()
            .map(|(name, rate)| format!("{:.0} s at {name}", serialisation(IMAGE, *rate)))
            .collect::<Vec<_>>()
            .join(", "),
        DELAY.as_millis(),
    );
    text += "| ms | floor | stop | priority 50 | control |\n|---|---:|---:|---:|---:|\n";
    for ((name, rate), rows) in links.iter().zip(measured) {
        for row in rows {
            let floor = row.load.floor(*rate);
            let floor = floor.map_or_else(String::new, |floor| format!("{:.1}", 1000.0 * floor));
            let [stop, urgent, control] = row.times.each_ref().map(|times| shown(times));
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "| {name}, {} | {floor} | {stop} | {urgent} | {control} |",
                row.load.name()
            );
        }
    }
    let segments = links
        .iter()
        .map(|(name, rate)| format!("{:.1} ms at {name}", 1000.0 * serialisation(2 * 1448, *rate)));
    let _ = writeln!(
        text,
        "\nWhat the kernel was given is overtaken by nothing: the rest of a chunk, and what has to be under way so that the link stays full and acknowledgements come in time, \
         which on a slow link is two segments beyond the round trip ({}). A chunk that is shorter than those wins nothing more; each longer one costs its own time. A stop leaves as soon as the \
         kernel takes it; the others wait until the network has room.",
        segments.collect::<Vec<_>>().join(", ")
    );
    let _ = writeln!(text, "\n![Stops in an image](images/{IMAGES}-stop-in-image.svg)");
    text
}

fn plot(links: &[(&str, f64)], measured: &[Vec<Row>]) -> String {
    let plot = Plot::new(
        "The worst stop while an image is under way, against the chunk (M7)",
        Axis::log("KiB of a chunk"),
        Axis::log("ms beyond the link's delay"),
    );
    let plot = links
        .iter()
        .zip(measured)
        .fold(plot, |plot, ((name, rate), rows)| {
            let cut = |value: fn(&Row, f64) -> f64| -> Vec<(f64, f64)> {
                let points = rows.iter().filter_map(|row| match row.load {
                    Load::Cut(chunk) => Some(((chunk >> 10) as f64, 1000.0 * value(row, *rate))),
                    Load::Nothing | Load::Adaptive => None,
                });
                points.collect()
            };
            plot.with(Series::line(*name, cut(|row, _| quantile(&row.times[0], 1.0))))
                .with(Series::line(
                    format!("{name}, a chunk's time"),
                    cut(|row, rate| row.load.floor(rate).unwrap_or(f64::NAN)),
                ))
        });
    let adaptive = measured.iter().flatten().filter(|row| row.load == Load::Adaptive);
    let adaptive = adaptive.map(|row| ((LEAST_CHUNK >> 10) as f64, 1000.0 * quantile(&row.times[0], 1.0)));
    plot.with(Series::points("the broker's own chunks", adaptive.collect()))
        .to_svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chunk_takes_its_time() {
        assert!((serialisation(1448, 12e3) - 1.0).abs() < 1e-9);
        let rates = LINKS.map(|(_, rate)| loads(rate).len());
        assert_eq!(rates, [5, 7, 8], "no image, adaptive, and what is short enough");
    }

    #[test]
    fn the_window_fills_the_link() {
        // 125 000 bytes are under way there and back.
        assert_eq!(window(Load::Cut(1 << 20), 10e6), 4);
        assert!(window(Load::Cut(1 << 10), 10e6) * 1024 > 2 * 125_000);
        assert_eq!(window(Load::Adaptive, 64e3), 2);
    }

    #[test]
    fn the_table_has_a_row_for_each_load() {
        let times = || [vec![0.010, 0.020], vec![0.011], vec![0.012]];
        let rows = |rate| {
            let loads = loads(rate).into_iter();
            loads.map(|load| Row { load, times: times() }).collect::<Vec<_>>()
        };
        let measured: Vec<_> = LINKS.map(|(_, rate)| rows(rate)).into_iter().collect();
        let text = markdown(&LINKS, &measured, 2);
        assert!(
            text.contains(
                "| 1 Mbit/s, image in chunks of 4 KiB | 33.9 | 10 / 20 / 20 | 11 / 11 / 11 | 12 / 12 / 12 |"
            ),
            "{text}"
        );
        assert!(
            text.contains("| 64 kbit/s, no image |  | 10 / 20 / 20 |"),
            "{text}"
        );
        let plot = plot(&LINKS, &measured);
        assert!(plot.contains("10 Mbit/s, a chunk"), "{plot}");
    }
}
