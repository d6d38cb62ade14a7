//! W21: control while a file is transferred and a web server serves on the same machine.

use std::fmt::Write as _;
use std::fs;
use std::io::{self, Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, Result, bail};
use mom_benches::Process;
use mom_plots::{Axis, Plot, Series, quantiles};
use mom_radio::Loss;

use super::air::{Hosts, Run, SECOND, Style};
use super::percent;
use super::sockets::{Measured, measure};
use super::trips::RATES;
use crate::{IMAGES, Section, Settings};

const ROBOTS: u16 = 10;
/// For each row.
const TIME: Duration = Duration::from_secs(10);
/// Octets of the file that is transferred again and again.
const FILE: usize = 32 << 20;
/// Octets of the page that is fetched.
const PAGE: usize = 64 << 10;

/// What goes on beside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Beside {
    Nothing,
    File,
    Web,
    Both,
}

impl Beside {
    const ALL: [Beside; 4] = [Beside::Nothing, Beside::File, Beside::Web, Beside::Both];

    fn name(self) -> &'static str {
        match self {
            Beside::Nothing => "nothing",
            Beside::File => "file transfer",
            Beside::Web => "web server",
            Beside::Both => "both",
        }
    }
}

struct Row {
    beside: Beside,
    measured: Measured,
    /// MB/s that the file went at, and pages/s.
    file: f64,
    pages: f64,
}

pub(crate) fn run(settings: &Settings) -> Result<Section> {
    let time = if settings.quick {
        Duration::from_secs(1)
    } else {
        TIME
    };
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("data");
    fs::write(&file, vec![7; FILE])?;
    fs::write(folder.path().join("page.html"), vec![b'x'; PAGE])?;
    let mut rows = Vec::new();
    for beside in Beside::ALL {
        rows.push(under(beside, folder.path(), time, settings.seed)?);
    }
    Ok(Section {
        markdown: markdown(&rows, time, settings.seed),
        plots: vec![("experiment-fleet-beside.svg", plot(&rows))],
    })
}

fn under(beside: Beside, folder: &Path, time: Duration, seed: u64) -> Result<Row> {
    let done = AtomicBool::new(false);
    let (octets, pages) = (AtomicU64::new(0), AtomicU64::new(0));
    let file = matches!(beside, Beside::File | Beside::Both)
        .then(|| TcpListener::bind("127.0.0.1:0"))
        .transpose()?;
    let web = matches!(beside, Beside::Web | Beside::Both)
        .then(|| serve_pages(folder))
        .transpose()?;
    let measured = thread::scope(|scope| {
        let transfer = file.map(|listener| {
            let at = listener.local_addr();
            let (done, octets) = (&done, &octets);
            let send = scope.spawn(move || send_file(&listener, &folder.join("data"), done));
            let take = scope.spawn(move || take_file(at?, octets));
            [send, take]
        });
        let fetch = web.as_ref().map(|(_, port)| {
            let (done, pages, port) = (&done, &pages, *port);
            scope.spawn(move || fetch_pages(port, done, pages))
        });
        let measured = measure(ROBOTS, time, seed);
        done.store(true, Ordering::Relaxed);
        for thread in transfer.into_iter().flatten().chain(fetch) {
            match thread.join() {
                Ok(ended) => ended?,
                Err(_) => bail!("what went on beside broke down"),
            }
        }
        measured
    })?;
    let seconds = time.as_secs_f64();
    Ok(Row {
        beside,
        measured,
        file: octets.into_inner() as f64 / 1e6 / seconds,
        pages: pages.into_inner() as f64 / seconds,
    })
}

/// Sends a file over and over.
fn send_file(listener: &TcpListener, file: &Path, done: &AtomicBool) -> io::Result<()> {
    let (mut stream, _) = listener.accept()?;
    while !done.load(Ordering::Relaxed) {
        io::copy(&mut fs::File::open(file)?, &mut stream)?;
    }
    Ok(())
}

/// Takes it until it ends.
fn take_file(at: SocketAddr, octets: &AtomicU64) -> io::Result<()> {
    let mut stream = TcpStream::connect(at)?;
    let mut piece = vec![0; 64 << 10];
    loop {
        match stream.read(&mut piece)? {
            0 => return Ok(()),
            read => octets.fetch_add(read as u64, Ordering::Relaxed),
        };
    }
}

/// A web server for a folder, and its port.
fn serve_pages(folder: &Path) -> Result<(Process, u16)> {
    let log = folder.join("web.log");
    let port = || {
        let text = fs::read_to_string(&log).ok()?;
        let (_, rest) = text.split_once(" port ")?;
        rest.split_whitespace().next()?.parse::<u16>().ok()
    };
    let mut command = Command::new("python3");
    command
        .args(["-u", "-m", "http.server", "--bind", "127.0.0.1", "--directory"])
        .arg(folder)
        .arg("0");
    let process = Process::start_at(command, "", &log, |_| port().is_some())?;
    let port = port().context("the web server does not say its port")?;
    Ok((process, port))
}

/// Fetches a page over and over, each time on a connection of its own.
fn fetch_pages(port: u16, done: &AtomicBool, pages: &AtomicU64) -> io::Result<()> {
    while !done.load(Ordering::Relaxed) {
        let mut stream = TcpStream::connect(("127.0.0.1", port))?;
        stream.write_all(b"GET /page.html HTTP/1.0\r\n\r\n")?;
        let mut page = Vec::new();
        stream.read_to_end(&mut page)?;
        if !page.starts_with(b"HTTP/1.0 200") || page.len() < PAGE {
            return Err(io::Error::other("the web server did not serve the page"));
        }
        pages.fetch_add(1, Ordering::Relaxed);
    }
    Ok(())
}

fn markdown(rows: &[Row], time: Duration, seed: u64) -> String {
    let mut text = format!(
        "The paper runs log-ins, FTP and a web server on the robots beside their control, and sees \"no observable delay or interruption\". Here {ROBOTS} robots on loopback are commanded ten times a second each, as in \
         [the section before](#ten-to-a-thousand-robots-over-real-sockets-w18-w23), for {} s, while the same machine transfers a file of {} MiB over and over at full speed, and a web server (`python3 -m http.server`) serves a page of {} KiB in a loop.\n\n\
         **Inputs:** none of them has a priority over the others; all ends are on this machine, so it does both ends' work, and there is no network that they share. The machine is shared with other work.\n\n\
         | beside the control | missed | due to reply, ms: p50 | p99 | most | round trip, ms: p50 | p99 | file, MB/s | pages/s |\n|---|---:|---:|---:|---:|---:|---:|---:|---:|\n",
        time.as_secs(),
        FILE >> 20,
        PAGE >> 10
    );
    for row in rows {
        let measured = &row.measured;
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "| {} | {} of {} ({:.2} %) | {:.2} | {:.2} | {:.1} | {:.2} | {:.2} | {:.0} | {:.0} |",
            row.beside.name(),
            measured.missed,
            measured.due,
            percent(measured.missed, measured.due),
            measured.took.at(0.5),
            measured.took.at(0.99),
            measured.took.at(1.0),
            measured.trips.at(0.5),
            measured.trips.at(0.99),
            row.file,
            row.pages,
        );
    }
    text += &over_the_radio(seed, time.as_secs() as i64);
    let _ = writeln!(
        text,
        "\n![Control beside other work](images/{IMAGES}-fleet-beside.svg)"
    );
    text
}

/// The same over the radio model, where what goes on beside takes air.
fn over_the_radio(seed: u64, seconds: i64) -> String {
    let mut text = format!(
        "\nThat is the processor's part of W21. Over [the radio model](radio.md) a file takes air as well: the first of the {ROBOTS} robots sends one to another station all the time, over a TCP of its own, for {seconds} s of virtual time; \
         what computers take is left out.\n\n\
         | over the radio | missed | due to reply, ms: p50 | p99 | most | file, Mbit/s | on the air |\n|---|---:|---:|---:|---:|---:|---:|\n"
    );
    for rate in RATES {
        for file in [false, true] {
            let run = Run {
                robots: ROBOTS.into(),
                rate,
                style: Style::Concurrent,
                commands: true,
                nulls: false,
                hosts: Hosts::default(),
                file,
                loss: Loss::None,
                time: seconds * SECOND,
                seed,
            };
            let came = run.simulate();
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "| {} Mbit/s, {} | {} of {} ({:.2} %) | {:.2} | {:.2} | {:.1} | {:.2} | {:.0} % |",
                rate / 1_000_000,
                if file { "file transfer" } else { "nothing beside" },
                came.missed,
                came.due,
                percent(came.missed, came.due),
                came.commands.at(0.5),
                came.commands.at(0.99),
                came.commands.at(1.0),
                came.file,
                100.0 * came.busy,
            );
        }
    }
    text += "\nThe paper's remark is about behaviours that run on the robot itself, which the first table bears out. Commands over the air are another matter: a station that always has a frame of 1500 octets to send takes the air for 7 ms at 2 Mbit/s \
             and 13 ms at 1 Mbit/s each time, and the base station gets a turn as often as that one does, however many robots it speaks for.\n";
    text
}

fn plot(rows: &[Row]) -> String {
    let plot = Plot::new(
        "Control beside other work (W21)",
        Axis::log("ms from due to reply"),
        Axis::linear("share of the commands"),
    );
    let plot = rows.iter().fold(plot, |plot, row| {
        plot.with(Series::steps(row.beside.name(), quantiles(&row.measured.took.0)))
    });
    plot.mark_x(100.0, "missed").to_svg()
}
