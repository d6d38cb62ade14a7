//! Logs hold nobody up and fill no disk, whoever reads them or not, and whatever a stranger says.

use std::fs::OpenOptions;
use std::io;
use std::net::SocketAddr;
use std::process::Stdio;

use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel};
use mom_tests::canary::Canary;
use mom_tests::raw::Raw;
use mom_tests::service::Home;

/// Logins that are under way together.
const TOGETHER: usize = 100;

/// The lab, with a broker that closes nobody for its bad logins, and keys that stand before its tables.
fn home(keys: &str) -> Home {
    let home = Home::new("[login]\nattempts = 1000000\n");
    home.write_config(&format!("{keys}\n{}", home.config()));
    home
}

/// Logs in with bad content so often.
async fn storm(address: SocketAddr, logins: usize) {
    let mut raw = Raw::connect(address, Form::Binary).await;
    for _ in 0..logins / TOGETHER {
        for _ in 0..TOGETHER {
            let content = Map::new().with("nonsense", true);
            raw.post(Parcel::new(Family::Login, "login").content(content))
                .await;
        }
        for _ in 0..TOGETHER {
            raw.next_error().await;
        }
    }
}

/// A stranger who fails as fast as it can writes a few lines, and one that says how many there were.
#[tokio::test]
async fn what_a_stranger_repeats_is_counted() {
    const LOGINS: usize = 10_000;
    let home = home("");
    let service = home.start().await;
    let canary = Canary::start(service.address()).await;
    storm(service.address(), LOGINS).await;
    for _ in 0..100 {
        let mut raw = Raw::connect(service.address(), Form::Xml).await;
        raw.send(b"nonsense\r\n\r\n").await;
        raw.read_to_end().await;
    }
    canary.stop().await;
    assert!(service.terminate().await.success());
    let log = home.log();
    assert!(log.len() < 16 * 1024, "{} bytes", log.len());
    let more = |line: &str| {
        let (_, of) = line.split_once("login refused (")?;
        let (_, count) = of.split_once("): ")?;
        count.split(' ').next()?.parse::<usize>().ok()
    };
    let counted: usize = log.lines().filter_map(more).sum();
    let written = log
        .lines()
        .filter(|line| line.contains("login refused peer="))
        .count();
    assert_eq!(counted + written, LOGINS, "{log}");
}

async fn nobody_notices(stderr: Stdio) {
    // A line for each refusal, which is what somebody has who looks for a fault.
    let home = home("log = \"info,mom_broker=debug\"");
    let service = home.start_logging(&[], stderr).await;
    let mut canary = Canary::start(service.address()).await;
    storm(service.address(), 4000).await;
    canary.check().await;
    canary.stop().await;
    assert!(service.terminate().await.success());
}

#[tokio::test]
async fn a_log_that_nobody_reads_holds_nobody_up() {
    let (reader, writer) = io::pipe().expect("a pipe");
    nobody_notices(writer.into()).await;
    drop(reader);
}

#[tokio::test]
async fn a_log_that_nobody_can_read_holds_nobody_up() {
    let (reader, writer) = io::pipe().expect("a pipe");
    drop(reader);
    nobody_notices(writer.into()).await;
}

#[cfg(target_os = "linux")]
#[tokio::test]
async fn a_log_on_a_full_disk_holds_nobody_up() {
    let full = OpenOptions::new().write(true).open("/dev/full");
    nobody_notices(full.expect("a device").into()).await;
}
