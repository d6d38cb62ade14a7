//! Fences rise over restarts without a store, too: a robot that heard of a fence never obeys an older one.

use std::path::Path;
use std::process::Output;

use mom_broker::{Broker, BrokerError, Clock, Config};
use mom_proto::codec::Form;
use mom_proto::{Family, Time};
use mom_tests::canary::fence_of;
use mom_tests::programs::{Running, program, project, text};
use mom_tests::raw::Raw;

const ROOM: &str = "[[contexts]]\npath = \"/key\"\nkind = \"token\"\nmanager = \"open\"\n";

/// A broker of the lab whose clock stands at this second.
async fn start(state: &Path, second: i64) -> Result<Broker, BrokerError> {
    let mut config = Config::lab();
    config.listen = vec!["127.0.0.1:0".into()];
    config.store.state = Some(state.to_owned());
    let clock = Clock::manual(Time::from_micros(second * 1_000_000).expect("a time"));
    Broker::start_at(config, clock).await
}

async fn grab(broker: &Broker) -> u64 {
    let mut alice = Raw::login(broker.local_addr(), Form::Binary, "alice").await;
    alice.join(&["/robot", "/robot/token"]).await;
    let granted = alice.ask_about(Family::Token, "grab", "/robot/token").await;
    fence_of(&granted.expect("nobody has it"))
}

/// Twice in a second, beside one that still runs, and by a clock that was set back.
#[tokio::test]
async fn fences_rise_over_restarts_within_a_second() {
    let folder = tempfile::tempdir().expect("a folder");
    let state = folder.path().join("mom");
    let mut highest = 0;
    let mut running = Vec::new();
    for second in [1_795_255_200, 1_795_255_200, 1_795_255_200, 1000, 1_795_255_100] {
        let broker = start(&state, second).await.expect("it starts");
        let fence = grab(&broker).await;
        assert!(fence > highest, "{fence} after {highest} at {second}");
        highest = fence;
        match running.len() {
            // Two brokers share the directory while both run.
            0 => running.push(broker),
            _ => broker.stop().await,
        }
    }
    for broker in running {
        broker.stop().await;
    }
    // By a clock that is right again they go on from it.
    let broker = start(&state, 1_895_255_200).await.expect("it starts");
    assert_eq!(grab(&broker).await >> 20, 1_895_255_200);
    broker.stop().await;
}

/// A number that cannot be read is not guessed.
#[tokio::test]
async fn a_damaged_epoch_does_not_start() {
    let folder = tempfile::tempdir().expect("a folder");
    for damage in ["", "17952\0\0\0", "-1", "99999999999999999999999"] {
        std::fs::write(folder.path().join("epoch"), damage).expect("written");
        let refused = start(folder.path(), 1_795_255_200).await.expect_err(damage);
        let said = refused.to_string();
        assert!(
            said.contains("/epoch: this is not the number") && said.contains("start again"),
            "{said}"
        );
    }
    std::fs::write(folder.path().join("epoch"), u64::MAX.to_string()).expect("written");
    let refused = start(folder.path(), 1_795_255_200)
        .await
        .expect_err("beyond all fences");
    assert!(refused.to_string().contains("beyond 2^53"), "{refused}");
}

/// The broker's program and `mom lab`, as two commands.
fn commands() -> [(&'static str, Vec<String>); 2] {
    let config = project().join("config/lab.toml").display().to_string();
    let args = |args: &[&str]| args.iter().map(|arg| (*arg).to_owned()).collect();
    [
        (
            "mom-broker",
            args(&["--config", &config, "--listen", "127.0.0.1:0"]),
        ),
        ("mom", args(&["lab", "--listen", "127.0.0.1:0"])),
    ]
}

fn run_in(name: &str, args: &[String], environment: &[(&str, &Path)]) -> Output {
    let mut command = std::process::Command::new(program(name));
    for name in ["STATE_DIRECTORY", "XDG_STATE_HOME", "HOME"] {
        command.env_remove(name);
    }
    command.args(args).envs(environment.iter().copied());
    command.output().expect("the program runs")
}

/// What is not said in the configuration is where the system keeps such things, and without a place nothing starts.
#[test]
fn the_programs_keep_the_epoch_by_default() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("file"), "").expect("written");
    for (name, args) in commands() {
        let nowhere = run_in(name, &args, &[]);
        let said = text(&nowhere.stderr);
        assert!(
            !nowhere.status.success() && said.contains("STATE_DIRECTORY"),
            "{said}"
        );
        let unwritable = run_in(name, &args, &[("XDG_STATE_HOME", &at("file"))]);
        let said = text(&unwritable.stderr);
        let words = [
            "file/mom: ",
            "Give it a directory that this user may write to",
            "[store]",
        ];
        assert!(!unwritable.status.success(), "{said}");
        assert!(words.iter().all(|word| said.contains(word)), "{said}");
        assert!(
            nowhere.stdout.is_empty() && unwritable.stdout.is_empty(),
            "neither listened"
        );

        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        let directories = format!("{}:{}", at(name).display(), at("other").display());
        let home = at("home").display().to_string();
        for (environment, place) in [
            (vec![("STATE_DIRECTORY", &*directories)], at(name)),
            (vec![("XDG_STATE_HOME", &*home)], at("home/mom")),
        ] {
            let running = Running::start(name, &args, &environment);
            running.line_with("tcp://");
            let epoch = std::fs::read_to_string(place.join("epoch")).expect("it is kept there");
            assert!(epoch.trim().parse::<u64>().is_ok(), "{epoch}");
            running.signal("TERM");
            running.wait();
        }
    }
}

/// The configuration goes first, relative to its file.
#[test]
fn the_configuration_names_the_directory() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("mom.toml");
    std::fs::write(&file, format!("[store]\nstate = \"kept\"\n{ROOM}")).expect("written");
    let config = file.display().to_string();
    let running = Running::start(
        "mom-broker",
        &["--config", &config, "--listen", "127.0.0.1:0"],
        &[],
    );
    running.line_with("tcp://");
    assert!(folder.path().join("kept/epoch").exists());
    running.signal("TERM");
    running.wait();
}
