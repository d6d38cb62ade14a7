//! `mom doctor`: tries every door of a hub, says what blocks, and measures those that are open (M58-M60).

mod blocked;
mod doors;
mod examine;
mod plots;
mod report;

use std::net::IpAddr;

use mom_client::Address;

use self::blocked::Blocked;
use self::doors::{DOORS, DoorTried, Target};
use self::examine::{Effort, Measured};
use crate::cli::{self, GlobalArgs};
use crate::failure::Failure;
use crate::output::Output;

/// What is known of a door.
#[derive(Debug)]
pub(crate) struct Examined {
    door: &'static DoorTried,
    address: Address,
    /// The proxy that it goes through.
    proxy: Option<String>,
    outcome: Result<Measured, Blocked>,
}

impl Examined {
    /// Where the hub is, if that can be seen from here.
    fn at(&self) -> Option<IpAddr> {
        if self.proxy.is_some() {
            return None;
        }
        let measured = self.outcome.as_ref().ok()?;
        measured.entries.first().map(|entry| entry.at)
    }

    /// Whether passwords go through it: nobody in between could read them.
    fn takes_password(&self) -> bool {
        self.outcome.is_ok() && self.address.is_private()
    }
}

pub(crate) async fn run(args: &cli::DoctorArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let target = Target::read(args.host.as_deref().unwrap_or(&global.hub))?;
    let effort = if args.quick { Effort::QUICK } else { Effort::FULL };
    let hub = target.name();
    output.remark(format_args!("trying {} doors of {hub} ...", DOORS.len()));
    let mut examined = try_all(&target, effort).await?;
    for examined in &mut examined {
        if let Ok(measured) = &mut examined.outcome {
            output.remark(format_args!("measuring {} ...", examined.door.name));
            let entries = std::mem::take(&mut measured.entries);
            *measured = examine::measure(examined.door, &examined.address, effort).await;
            // A door that has closed since then was open all the same.
            if measured.entries.is_empty() {
                measured.entries = entries;
            }
        }
    }
    output.tell(
        || report::to_json(&hub, &examined),
        || report::table(&hub, &examined),
    )?;
    for advice in report::advice(&hub, &examined) {
        output.remark(advice);
    }
    match &args.save {
        Some(folder) => save(folder, &hub, &examined, output)?,
        None if examined.iter().any(|examined| examined.outcome.is_ok()) => {
            output.remark(format_args!("plots: mom doctor {hub} --save DIR"));
        }
        None => {}
    }
    match examined.iter().any(Examined::takes_password) {
        true => Ok(()),
        false => Err(Failure::plain(format!(
            "no door of {hub} that takes a password works: that needs TLS, or a hub on this machine"
        ))),
    }
}

/// Tries all doors at once: what blocks may take its time.
async fn try_all(target: &Target, effort: Effort) -> Result<Vec<Examined>, Failure> {
    let mut trials = Vec::new();
    for door in DOORS {
        let address = target.address(door)?;
        let trial = tokio::spawn(async move {
            let entered = examine::enter(door, &address, effort).await;
            Examined {
                door,
                // One that speaks no HTTP is what blocks.
                proxy: address.proxy().ok().flatten(),
                address,
                outcome: entered.map(|entry| Measured {
                    entries: vec![entry],
                    ..Measured::default()
                }),
            }
        });
        trials.push(trial);
    }
    let mut examined = Vec::new();
    for trial in trials {
        let tried = trial.await;
        examined.push(tried.map_err(|error| Failure::plain(format!("a door could not be tried: {error}")))?);
    }
    Ok(examined)
}

fn save(folder: &std::path::Path, hub: &str, examined: &[Examined], output: Output) -> Result<(), Failure> {
    let files = plots::save(folder, hub, examined).map_err(|error| {
        Failure::new(
            format!("cannot write plots into {}: {error}", folder.display()),
            "name a folder that you may write to: --save DIR",
        )
    })?;
    for file in files {
        output.remark(format_args!("written {}", file.display()));
    }
    Ok(())
}
