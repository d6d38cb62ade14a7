//! All attacks on one program, one after the other: its memory stays within its bound at every moment, and when all
//! have gone nothing is left.

use std::fs;
use std::net::SocketAddr;
use std::pin::pin;
use std::time::{Duration, Instant};

use mom_tests::attacks::{Attack, Attackers, configuration};
use mom_tests::canary::Canary;
use mom_tests::process::{files, resident, threads};
use mom_tests::programs::{PATIENCE, Running, project};
use tokio::task::spawn_blocking;
use tokio::time::sleep;

const MIB: usize = 1 << 20;

/// What may wait in the hub.
const MEMORY: usize = 128 * MIB;

/// The program itself, and what is being read.
const BESIDE: usize = 64 * MIB;

/// After so long the memory is given back.
const GIVEN_BACK: Duration = Duration::from_secs(15);

/// Time between two looks at the program's memory.
const LOOK: Duration = Duration::from_millis(10);

/// The runtime's threads for what blocks end after some seconds without work, and there may always be some.
const MORE_THREADS: usize = 4;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_attack_takes_more_memory_than_there_is_for_all() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = fs::read_to_string(configuration()).expect("it is there");
    let users = project().join("config/lab-users.toml");
    let text = text.replace(
        "../config/lab-users.toml",
        users.to_str().expect("a path in text"),
    );
    let file = folder.path().join("attacked.toml");
    fs::write(&file, format!("memory = {MEMORY}\n{text}")).expect("written");
    let started = spawn_blocking(move || Running::broker(&file)).await;
    let (broker, address) = started.expect("it starts");
    let address: SocketAddr = address.parse().expect("an address");
    let mut canary = Canary::start(address).await;
    canary.check().await;
    let before = (resident(&broker, "VmRSS"), threads(&broker), files(&broker));
    let allowed = MEMORY + MEMORY / 4 + BESIDE;
    for attack in Attack::ALL {
        let mut most = 0;
        let mut round = pin!(async {
            let mut attackers = Attackers::connect(attack, address).await;
            attackers.round().await;
            canary.check().await;
        });
        loop {
            tokio::select! {
                () = &mut round => break,
                () = sleep(LOOK) => most = resident(&broker, "VmRSS").max(most), // tidy: it looks again and again
            }
        }
        println!("{}: {} MiB at most", attack.word(), most / MIB);
        assert!(
            most <= allowed,
            "{}: {} of {} MiB",
            attack.word(),
            most / MIB,
            allowed / MIB
        );
    }
    let ended = Instant::now();
    let allowed = before.0 + before.0 / 10 * 3 + BESIDE;
    loop {
        canary.check().await;
        let now = resident(&broker, "VmRSS");
        if now <= allowed {
            break;
        }
        assert!(
            ended.elapsed() < GIVEN_BACK,
            "{} of {} MiB",
            now / MIB,
            allowed / MIB
        );
    }
    loop {
        canary.check().await;
        let (threads, files) = (threads(&broker), files(&broker));
        if threads <= before.1 + MORE_THREADS && files <= before.2 {
            break;
        }
        assert!(
            ended.elapsed() < PATIENCE,
            "{threads} threads, {files} files; before {before:?}"
        );
    }
    assert!(canary.stop().await > 0);
}
