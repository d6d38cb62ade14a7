//! The plots of what was measured.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use mom_plots::{Axis, Bar, Bars, Group, Plot, Series, plain};

use super::Examined;

/// Writes the plots into a folder, which is made; gives the files.
pub(crate) fn save(folder: &Path, hub: &str, examined: &[Examined]) -> io::Result<Vec<PathBuf>> {
    fs::create_dir_all(folder)?;
    let connect = connect(hub, examined);
    let plots = [
        ("connect.svg", connect),
        ("round-trip.svg", Some(round_trip(hub, examined))),
    ];
    let mut files = Vec::new();
    for (name, plot) in plots {
        if let Some(plot) = plot {
            let file = folder.join(name);
            fs::write(&file, plot)?;
            files.push(file);
        }
    }
    Ok(files)
}

fn millis(time: Duration) -> f64 {
    time.as_secs_f64() * 1000.0
}

fn connect(hub: &str, examined: &[Examined]) -> Option<String> {
    let groups = examined.iter().filter_map(|examined| {
        let measured = examined.outcome.as_ref().ok()?;
        let bar = |name, colour, time: Option<Duration>| {
            Some(Bar {
                name,
                colour,
                value: millis(time?),
            })
        };
        let bars = [
            bar("TCP", "#56b4e9", measured.step(|entry| entry.tcp)),
            bar("open", "#e69f00", measured.step(|entry| entry.open)),
            bar("first answer", "#009e73", measured.step(|entry| entry.answer)),
        ];
        Some(Group {
            name: examined.door.name,
            bars: bars.into_iter().flatten().collect(),
        })
    });
    let title = format!("The way in at {hub}, median in ms");
    let bars = Bars {
        title: &title,
        groups: groups.collect(),
    };
    bars.to_svg(plain)
}

fn round_trip(hub: &str, examined: &[Examined]) -> String {
    let plot = Plot::new(
        format!("Round trip of a ping against its size at {hub}: means, and each one"),
        Axis::log("bytes of padding in the ping; the pong is short"),
        Axis::log("ms"),
    );
    let open = examined.iter().filter_map(|examined| {
        let measured = examined.outcome.as_ref().ok()?;
        let means = measured
            .trips
            .iter()
            .map(|trips| (trips.size as f64, millis(trips.mean())));
        Some(Series::line(examined.door.name, means.collect()))
    });
    open.fold(plot, Plot::with)
        .mark_x(1000.0, "flat up to here (M60)")
        .to_svg()
}
