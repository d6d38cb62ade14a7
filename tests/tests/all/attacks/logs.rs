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
