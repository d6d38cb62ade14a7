//! `mom-broker what-if`: decides a recording again with another configuration.

use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use indicatif::{ProgressBar, ProgressStyle};
use mom_broker::{Config, Replay};
use serde_json::json;

/// Recordings from this size on show progress.
const LONG: u64 = 4 * 1024 * 1024;

/// Inputs between two updates of the progress bar.
const STRIDE: u64 = 1024;

/// The exit code if something differs.
const DIFFERS: u8 = 2;

#[derive(clap::Args)]
pub(super) struct WhatIfArgs {
    /// The configuration file to try.
    file: PathBuf,
    /// The recording of a broker ([record] in its configuration, or --record).
    #[arg(long, value_name = "RECORDED")]
    log: PathBuf,
    /// Print JSON lines.
    #[arg(long)]
    json: bool,
    /// Also list equal decisions by another rule.
    #[arg(long)]
    rules: bool,
}

/// Exits with 0 if nothing differs and 2 if something does.
pub(super) fn run(args: &WhatIfArgs) -> Result<ExitCode> {
    let config = Config::load(&args.file)?;
    let mut replay = config.replay(&args.log)?;
    if args.rules {
        replay.compare_rules();
    }
    let bar = progress(&replay);
    let mut out = io::BufWriter::new(io::stdout().lock());
    while let Some(differences) = replay.step()? {
        for mut difference in differences {
            difference.locate(|rule, context| {
                let place = config.locate_rule_from(rule, context)?;
                Some(place.to_string())
            });
            let line = match args.json {
                true => difference.to_json().to_string(),
                false => difference.to_string(),
            };
            // The bar and the lines may share a terminal.
            bar.suspend(|| writeln!(out, "{line}").and_then(|()| out.flush()))?;
        }
        if replay.summary().inputs % STRIDE == 0 {
            bar.set_position(replay.progress().0);
        }
    }
    bar.finish_and_clear();
    warn(&replay, args)?;
    let summary = replay.summary();
    match args.json {
        true => {
            let summary = json!({"summary": {"inputs": summary.inputs, "differ": summary.differ}});
            writeln!(out, "{summary}")?;
        }
        false => writeln!(
            out,
            "{} decided again by {}: {}",
            count(summary.inputs, "input"),
            args.file.display(),
            match summary.differ {
                0 => "nothing differs".to_owned(),
                1 => "1 decision differs".to_owned(),
                differ => format!("{differ} decisions differ"),
            }
        )?,
    }
    out.flush()?;
    Ok(match summary.differ {
        0 => ExitCode::SUCCESS,
        _ => ExitCode::from(DIFFERS),
    })
}

fn progress(replay: &Replay) -> ProgressBar {
    let (_, length) = replay.progress();
    if length < LONG || !io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{bar:40} {bytes} of {total_bytes}, {eta} left");
    ProgressBar::new(length).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// Reports why the comparison is incomplete.
fn warn(replay: &Replay, args: &WhatIfArgs) -> Result<()> {
    let mut err = io::stderr().lock();
    let log = args.log.display();
    let summary = replay.summary();
    if summary.torn {
        writeln!(err, "{log}: its last line is damaged and was left out")?;
    }
    if let Some(end) = summary.end.as_ref().filter(|end| *end != Replay::WHOLE) {
        writeln!(err, "{log}: the recording ends early: {end}")?;
    }
    if summary.configured > 0 {
        writeln!(
            err,
            "{log}: the configuration was changed {} while this was recorded; all of it is decided by {}",
            count(summary.configured, "time"),
            args.file.display()
        )?;
    }
    if !summary.unknown_users.is_empty() {
        writeln!(
            err,
            "{}: not among its users, and taken with the level and groups that they had: {}",
            args.file.display(),
            summary.unknown_users.join(", ")
        )?;
    }
    Ok(())
}

fn count(number: u64, word: &str) -> String {
    match number {
        1 => format!("1 {word}"),
        _ => format!("{number} {word}s"),
    }
}
