//! Two gateways of one fleet: a robot has one base station at a time, and its channel one device.

use std::fs::File;
use std::path::Path;
use std::process::Stdio;

use mom_tests::faulty::{Fault, FaultyNetwork};
use mom_tests::programs::{PATIENCE, Running, project, run, text};

use crate::fleet_file::{logged, tables};

/// Has the robot do something, once it is within reach of the gateway that has its channel.
fn obeys(hub: &str) {
    let user = [("MOM_HUB", hub), ("MOM_USER", "alice"), ("MOM_PASSWORD", "alice")];
    let until = std::time::Instant::now() + PATIENCE;
    loop {
        let output = run("mom", &["fleet", "send", "1", "leds 1"], &user);
        if output.status.success() {
            return;
        }
        let said = text(&output.stdout) + &text(&output.stderr);
        assert!(std::time::Instant::now() < until, "{said}");
        // One that did not answer was stopped, and the stop holds for the gateway that has it now.
        run("mom", &["unstop", "/fleet/1/robot"], &user);
    }
}

/// `mom fleet list` tells what the gateway says that has the robot, and not what the one before it said last.
fn moves_in_the_list(hub: &str) {
    let user = [("MOM_HUB", hub), ("MOM_USER", "alice"), ("MOM_PASSWORD", "alice")];
    let driving = Running::start("mom", &["fleet", "send", "1", "motor 100 -100 60000"], &user);
    let until = std::time::Instant::now() + PATIENCE;
    loop {
        let output = run("mom", &["--json", "fleet", "list"], &user);
        let said = text(&output.stdout);
        // Or alice~2, where the list's own peer came first.
        if said.contains("\"moving\":true") && said.contains("\"owner\":\"alice") {
            break;
        }
        assert!(
            std::time::Instant::now() < until,
            "{said}{}",
            text(&output.stderr)
        );
    }
    driving.signal("INT");
    driving.wait();
}

#[test]
fn a_gateway_without_a_place_in_the_channels_leaves_the_robots_to_the_other() {
    let folder = tempfile::tempdir().expect("a folder");
    let fleet = folder.path().join("fleet.toml");
    let fleet = fleet.to_str().expect("a path in text");
    let _robot = Running::start(
        "mom-linuxbot",
        &["--robots", "1", "--write-fleet", fleet, "--listen", "127.0.0.1:0"],
        &[],
    );
    let (_broker, address) = Running::broker(&project().join("config/fleet.toml"));
    let hub = format!("bin://{address}");
    let gateway = |state: &Path| {
        let state = state.to_str().expect("a path in text");
        Running::start(
            "mom-gateway",
            &["--fleet", fleet, "--hub", &hub, "--manager", "robot-token"],
            &[("MOM_PASSWORD", "gateway"), ("XDG_STATE_HOME", state)],
        )
    };
    let (own, other) = (folder.path().join("own"), folder.path().join("other"));
    let first = gateway(&own);
    obeys(&hub);
    // The same program, started once more: the first is put out, and hangs up.
    let second = gateway(&own);
    obeys(&hub);
    moves_in_the_list(&hub);
    // A spare one waits until there is a place, and takes nothing before.
    let spare = gateway(&other);
    obeys(&hub);
    for ended in [first, second] {
        ended.signal("KILL");
        ended.wait();
        obeys(&hub);
    }
    drop(spare);
}

/// Its link is cut, and the one to the robot is not: the hub gives its places away after the grace, and a robot takes one base station.
#[test]
fn a_gateway_that_has_lost_the_hub_leaves_the_robots_to_the_other() {
    let folder = tempfile::tempdir().expect("a folder");
    let fleet = folder.path().join("fleet.toml");
    let fleet = fleet.to_str().expect("a path in text");
    let _robot = Running::start(
        "mom-linuxbot",
        &["--robots", "1", "--write-fleet", fleet, "--listen", "127.0.0.1:0"],
        &[],
    );
    // The same hub, with a grace that a test can wait for.
    let lab = project().join("config");
    let config = std::fs::read_to_string(lab.join("fleet.toml")).expect("its configuration");
    let users = format!("users = \"{}\"", lab.join("lab-users.toml").display());
    let config = config.replace("users = \"lab-users.toml\"", &users) + "\n[limits]\ngrace = 1000\n";
    let file = folder.path().join("hub.toml");
    std::fs::write(&file, config).expect("it is written");
    let (_broker, address) = Running::broker(&file);
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let far = address.parse().expect("an address");
    let network = runtime.block_on(FaultyNetwork::to(far, |_| Fault::default()));
    let hub = format!("bin://{address}");
    let gateway = |hub: &str| {
        Running::start(
            "mom-gateway",
            &[
                "--fleet",
                fleet,
                "--hub",
                hub,
                "--manager",
                "robot-token",
                "--heartbeat",
                "100",
            ],
            &[("MOM_PASSWORD", "gateway")],
        )
    };
    let _first = gateway(&format!("bin://{}", network.address));
    obeys(&hub);
    let spare = gateway(&hub);
    network.freeze(true);
    obeys(&hub);
    // It takes the robot again when it is back in the robot's channel.
    network.freeze(false);
    spare.signal("KILL");
    spare.wait();
    obeys(&hub);
}

/// A robot that comes by a new file has its channel from a hub, which may be away when the program is to end.
#[test]
fn a_gateway_whose_hub_is_away_ends_though_a_new_file_is_being_taken_over() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| {
        folder
            .path()
            .join(name)
            .to_str()
            .expect("a path in text")
            .to_owned()
    };
    let (all, fleet, log) = (at("all.toml"), at("fleet.toml"), folder.path().join("log"));
    let robots = ["--robots", "5", "--write-fleet", &all, "--listen", "127.0.0.1:0"];
    let _robots = Running::start("mom-linuxbot", &robots, &[]);
    let tables = tables(&all);
    std::fs::write(&fleet, &tables[0]).expect("it is written");
    let (broker, address) = Running::broker(&project().join("config/fleet.toml"));
    let hub = format!("bin://{address}");
    let gateway = Running::start_with(
        "mom-gateway",
        &["--fleet", &fleet, "--hub", &hub, "--manager", "robot-token"],
        &[("MOM_PASSWORD", "gateway")],
        Stdio::from(File::create(&log).expect("a log")),
    );
    logged(&log, "all robots are connected");
    drop(broker);
    std::fs::write(&fleet, tables[..2].concat()).expect("it is written");
    gateway.signal("HUP");
    logged(&log, "the fleet's file is taken over");
    gateway.signal("TERM");
    assert_eq!(gateway.wait().code(), Some(0));
}
