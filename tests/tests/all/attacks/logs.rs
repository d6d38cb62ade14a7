//! Logs hold nobody up and fill no disk, whether they are read or not, and whatever a stranger says.

use std::fs::OpenOptions;
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::process::Stdio;

use mom_proto::codec::Form;
use mom_proto::{Code, Family, Map, Parcel};
use mom_tests::audit::AuditLog;
use mom_tests::canary::Canary;
use mom_tests::lab;
use mom_tests::login::password;
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

/// The audit log counts who comes and goes, and who is refused from wherever.
#[tokio::test]
async fn coming_and_going_fills_no_audit_log() {
    const LOGINS: u64 = 4000;
    const ADDRESSES: u64 = 400;
    let audit = AuditLog::new();
    let broker = lab::start_with(|config| {
        config.audit.path = Some(audit.path());
        config.login.guests = true;
    })
    .await;
    let address = broker.local_addr();
    let canary = Canary::start(address).await;
    let mut guest = Raw::connect(address, Form::Binary).await;
    for _ in 0..LOGINS / TOGETHER as u64 {
        let mut last = 0;
        for _ in 0..TOGETHER {
            let content = Map::new().with("guest", true);
            last = guest
                .post(Parcel::new(Family::Login, "login").content(content))
                .await;
        }
        guest.answer(last).await.expect("guests may come");
    }
    for number in 0..ADDRESSES {
        let from = Ipv4Addr::new(127, 0, (number / 200) as u8 + 1, (number % 200) as u8 + 1);
        let mut stranger = Raw::connect_from(from.into(), address, Form::Binary).await;
        let refused = password(&mut stranger, "nobody", "").await;
        refused.expect_err("nobody of this name");
    }
    canary.stop().await;
    broker.stop().await;
    let lines = audit.lines();
    let logins = [("what", "login"), ("user", "guest")];
    assert_eq!(lines.count(&logins), LOGINS);
    let refused = [("what", "refused"), ("verb", "login"), ("user", "unknown")];
    assert_eq!(lines.count(&refused), ADDRESSES);
    // A tenth of the lines, however slow the machine.
    let written = std::fs::read_to_string(audit.path()).expect("a file");
    assert!((written.lines().count() as u64) < LOGINS / 10, "{written}");
}

/// Who finds no place hears so and is not waited for.
#[tokio::test]
async fn who_finds_no_place_holds_up_nobody() {
    let broker = lab::start_with(|config| config.connections = 3).await;
    let mut canary = Canary::start(broker.local_addr()).await;
    let last = Raw::connect(broker.local_addr(), Form::Xml).await;
    let mut refused = Vec::new();
    for _ in 0..100 {
        refused.push(Raw::connect_small(broker.local_addr(), Form::Xml).await);
    }
    canary.check().await;
    // The newest has a place: the stranger before it has made way.
    refused.pop();
    for raw in &mut refused {
        assert_eq!(raw.last_error().await, Some(Code::TOO_MANY_CONNECTIONS));
    }
    drop(last);
    canary.stop().await;
    broker.stop().await;
}

async fn nobody_notices(stderr: Stdio) {
    // A line for each refusal, which is what is there to look for a fault.
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
