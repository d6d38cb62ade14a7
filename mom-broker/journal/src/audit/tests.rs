use std::fs;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, Sender, channel};

use mom_hub::Audit;
use mom_proto::{Code, Path};
use serde_json::Value as Json;
use tempfile::TempDir;

use super::*;

/// A disk that hangs until it is released; what it was given comes out at the other end.
struct Hanging {
    released: Receiver<()>,
    lines: Sender<String>,
}

impl LineSink for Hanging {
    fn append(&mut self, lines: &[Vec<u8>]) -> (usize, io::Result<()>) {
        // Released for good once the sender is gone.
        let _ = self.released.recv();
        for line in lines {
            let line = String::from_utf8(line.clone()).expect("JSON is text");
            let _ = self.lines.send(line);
        }
        (lines.len(), Ok(()))
    }

    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn clock() -> Clock {
    Clock::manual("2026-11-21T10:00:00Z".parse().expect("a time"))
}

fn created() -> Fact {
    Fact::new(clock().wall(), Audit::new("created"))
}

#[test]
fn a_hanging_disk_holds_nobody_up() {
    let (release, released) = channel();
    let (lines, written) = channel();
    let log = AuditLog::write_to(
        Hanging { released, lines },
        Kept::Memory(Arc::default()),
        clock(),
        0,
    )
    .expect("a thread");
    const TOLD: usize = QUEUE + 5000;
    for _ in 0..TOLD {
        log.note(created());
    }
    drop(release);
    drop(log);
    let written: Vec<Json> = written
        .iter()
        .map(|line| serde_json::from_str(&line).expect("JSON"))
        .collect();
    let lost: u64 = written.iter().filter_map(|line| line["count"].as_u64()).sum();
    let created = written.iter().filter(|line| line["what"] == "created").count();
    assert!(created >= QUEUE, "{created}");
    assert!(lost > 0);
    assert_eq!(created + usize::try_from(lost).expect("few"), TOLD);
    assert!(
        written.is_sorted_by_key(|line| line["seq"].as_u64()),
        "numbers rise"
    );
}

fn in_file() -> (TempDir, PathBuf, AuditLog) {
    let folder = TempDir::new().expect("a folder");
    let path = folder.path().join("audit.jsonl");
    let config = AuditConfig {
        path: Some(path.clone()),
        ..AuditConfig::default()
    };
    let log = AuditLog::start(&config, clock()).expect("a file");
    (folder, path, log)
}

#[tokio::test]
async fn the_facts_of_the_hub_are_written_with_what_the_broker_knows() {
    let (_folder, path, log) = in_file();
    log.arrived(PeerId(3), Some(IpAddr::from([192, 0, 2, 7])));
    let audit = |what| Audit {
        peer: Some("alice".into()),
        ..Audit::new(what)
    };
    let refused = Audit {
        verb: Some(Verb::Grab),
        context: Path::parse("/robot/token").ok(),
        code: Some(Code::HELD),
        ..audit("refused")
    };
    let created = Audit {
        fence: Some(1 << 20),
        ..audit("created")
    };
    let facts = [audit("login"), created, refused.clone(), refused.clone(), refused];
    let mut effects: Vec<Effect> = facts
        .into_iter()
        .map(|fact| Effect::Audit(Box::new(fact)))
        .collect();
    log.take(clock().wall(), Some(PeerId(3)), &mut effects, |_| {});
    log.left(PeerId(3));
    log.take(
        clock().wall(),
        Some(PeerId(3)),
        &mut [Effect::Audit(Box::new(audit("login")))],
        |_| {},
    );
    log.flush().await;
    let at = "\"at\":\"2026-11-21T10:00:00.000000Z\"";
    let refused = "\"what\":\"refused\",\"peer\":\"alice\",\"verb\":\"grab\",\"context\":\"/robot/token\",\"code\":\"held\"";
    assert_eq!(
        fs::read_to_string(path)
            .expect("a file")
            .lines()
            .collect::<Vec<_>>(),
        [
            format!("{{{at},\"seq\":1,\"what\":\"login\",\"peer\":\"alice\",\"from\":\"192.0.2.7\"}}"),
            format!("{{{at},\"seq\":2,\"what\":\"created\",\"peer\":\"alice\",\"fence\":1048576}}"),
            format!("{{{at},\"seq\":3,{refused}}}"),
            format!("{{{at},\"seq\":4,\"what\":\"login\",\"peer\":\"alice\"}}"),
            format!("{{{at},\"seq\":5,{refused},\"count\":2}}"),
        ]
    );
}

#[tokio::test]
async fn numbers_go_on_after_a_restart() {
    let (_folder, path, log) = in_file();
    log.note(created());
    log.flush().await;
    let config = AuditConfig {
        path: Some(path.clone()),
        ..AuditConfig::default()
    };
    assert!(AuditLog::start(&config, clock()).is_err(), "one writer at a time");
    // Its thread lets go of the file a moment after the log itself.
    drop(log);
    let log = loop {
        match AuditLog::start(&config, clock()) {
            Ok(log) => break log,
            Err(_) => std::thread::yield_now(),
        }
    };
    log.note(created());
    log.flush().await;
    let text = fs::read_to_string(path).expect("a file");
    assert!(text.contains("\"seq\":1,\"what\":\"created\""), "{text}");
    assert!(text.contains("\"seq\":2,\"what\":\"created\""), "{text}");
}
