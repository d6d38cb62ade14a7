//! `cargo xtask long`: what takes too long for each change: the broker's threads in many orders, the measurements' own
//! tests, properties with new seeds, random logs by the thousand, minutes of random load, a thousand lost connections
//! on each door, minutes of large messages that wait between short heartbeats, minutes of a thousand robots, a million
//! packets of a mirrored one, two thousand trials of the motion oracle, and lives in virtual time.

use std::path::Path;
use std::process::Command;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Result;

use crate::command::{cargo, line, shows};
use crate::{measuring, shuttle, simulate};

/// Packets of each direction: a million of both.
const MILLION_OF_BOTH: &str = "500000";

/// Trials of the motion oracle for each of five devices.
const TRIALS_OF_EACH: &str = "400";

/// ms between signs of life: the least that a login may ask for.
const SHORTEST_BEAT: &str = "100";

/// Builds and runs them one after the other; whether all went well.
pub(crate) fn run(root: &Path, minutes: u64) -> Result<bool> {
    let mut ok = shuttle::run(root, None, None)? & measuring::run(root, false)?;
    // Other lives each time.
    let seed = SystemTime::now().duration_since(UNIX_EPOCH)?.as_secs();
    let simulated = ["--minutes", &minutes.to_string(), "--seed", &seed.to_string()].map(str::to_owned);
    ok &= simulate::run(root, &simulated)?;
    for mut step in steps(root, minutes) {
        println!("$ {}", line(&step));
        ok &= shows(&mut step)?;
    }
    Ok(ok)
}

fn steps(root: &Path, minutes: u64) -> [Command; 8] {
    let test = |package: &str, name: &str| {
        let mut test = cargo(root);
        test.args([
            "test",
            "--locked",
            "--release",
            "--package",
            package,
            "--test",
            name,
        ]);
        test
    };
    // CI has a fixed seed.
    let mut properties = cargo(root);
    properties.args([
        "test",
        "--locked",
        "--workspace",
        "--exclude",
        "mom-tests",
        "--lib",
    ]);
    let mut logs = test("mom-hub", "random");
    logs.env("MOM_CASES", "5000").env("MOM_STEPS", "200");
    logs.args(["--", "--nocapture"]);
    let mut load = test("mom-tests", "all");
    load.env("MOM_LOAD_SECONDS", (minutes * 60).to_string());
    load.args(["random_load", "--", "--nocapture"]);
    let mut losses = test("mom-tests", "all");
    losses
        .env("MOM_LOSSES", "1000")
        .env("MOM_PATIENCE_SECONDS", "3600");
    losses.args(["link::survive", "--", "--nocapture"]);
    let mut beats = test("mom-tests", "all");
    beats
        .env("MOM_HEARTBEAT_MS", SHORTEST_BEAT)
        .env("MOM_HEARTBEAT_SECONDS", (minutes * 60).to_string());
    beats.args(["heartbeat::large_messages", "--", "--nocapture"]);
    let mut swarm = test("mom-tests", "all");
    swarm
        .env("MOM_ROBOTS", "1000")
        .env("MOM_FLEET_SECONDS", (minutes * 60).to_string());
    swarm.args(["swarm", "--", "--nocapture"]);
    let mut packets = test("mom-tests", "all");
    packets.env("MOM_PACKETS", MILLION_OF_BOTH);
    packets.args(["endurance", "--", "--nocapture"]);
    let mut motions = test("mom-tests", "all");
    motions.env("MOM_ORACLE_TRIALS", TRIALS_OF_EACH);
    motions.args(["oracle", "--", "--nocapture"]);
    [properties, logs, load, losses, beats, swarm, packets, motions]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_load_lasts_as_long_as_is_said() {
        let [_, _, load, _, beats, swarm, _, _] = steps(Path::new("."), 10);
        for (step, key, name) in [
            (load, "MOM_LOAD_SECONDS", "random_load"),
            (beats, "MOM_HEARTBEAT_SECONDS", "heartbeat"),
            (swarm, "MOM_FLEET_SECONDS", "swarm"),
        ] {
            let seconds = step.get_envs().find(|(found, _)| *found == key);
            let seconds = seconds
                .and_then(|(_, value)| value)
                .and_then(|value| value.to_str());
            assert_eq!(seconds, Some("600"));
            assert!(line(&step).contains(name), "{}", line(&step));
        }
    }
}
