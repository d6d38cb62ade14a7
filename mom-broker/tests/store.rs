//! The service's program on a store: fences over restarts, and directories with which it does not start.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use tempfile::TempDir;

const CONFIG: &str = "users = \"lab-users.toml\"\nroot = \"open\"\n[store]\npath = \"state\"\n\
    [[contexts]]\npath = \"/token\"\nkind = \"token\"\n";

fn configuration(folder: &TempDir) -> PathBuf {
    let users = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config/lab-users.toml");
    fs::copy(users, folder.path().join("lab-users.toml")).expect("copied");
    let file = folder.path().join("mom.toml");
    fs::write(&file, CONFIG).expect("written");
    file
}

fn program(file: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mom-broker"));
    command
        .env("XDG_STATE_HOME", env!("CARGO_TARGET_TMPDIR"))
        .env_remove("STATE_DIRECTORY")
        .env_remove("MOM_CONFIG")
        .env_remove("RUST_BACKTRACE");
    command
        .arg("--config")
        .arg(file)
        .args(["--listen", "127.0.0.1:0"]);
    command
}

/// A start that has to fail, and what it says.
fn refused(file: &Path) -> String {
    let Output {
        status,
        stdout,
        stderr,
    } = program(file).stdin(Stdio::null()).output().expect("it runs");
    let said = String::from_utf8_lossy(&stderr).into_owned();
    assert_eq!(status.code(), Some(1), "{said}");
    assert!(stdout.is_empty(), "it did not listen: {said}");
    said
}

/// Threat 30: neither a kill nor an end in order brings a fence down.
#[test]
fn fences_rise_over_restarts() {
    let folder = TempDir::new().expect("a folder");
    let file = configuration(&folder);
    let mut highest = 0;
    for round in 0..4 {
        let mut broker = Running::start(&file);
        for fence in broker.grab_twice() {
            assert!(fence > highest, "{fence} after {highest} in round {round}");
            highest = fence;
        }
        // The clock has not gone on by a second: without what is stored the next epoch were this one.
        match round % 2 {
            0 => broker.child.kill().expect("SIGKILL"),
            _ => broker.terminate(),
        }
        let status = broker.child.wait().expect("it ends");
        assert_eq!(status.code(), (round % 2 == 1).then_some(0));
    }
}

#[test]
fn two_brokers_do_not_share_a_store() {
    let folder = TempDir::new().expect("a folder");
    let file = configuration(&folder);
    let _broker = Running::start(&file);
    let said = refused(&file);
    assert!(said.contains("in use") && said.contains("state"), "{said}");
}

/// Threat 29: with a damaged store the broker does not start, and says what to do.
#[test]
fn a_damaged_store_does_not_start() {
    let folder = TempDir::new().expect("a folder");
    let file = configuration(&folder);
    let mut broker = Running::start(&file);
    broker.terminate();
    broker.child.wait().expect("it ends");
    let lane = folder.path().join("state/lane-1.redb");
    let whole = fs::read(&lane).expect("readable");
    fs::write(&lane, &whole[..whole.len() - 4096]).expect("written");
    let said = refused(&file);
    for words in ["lane-1.redb", "longest lease", "state away"] {
        assert!(said.contains(words), "{words} in {said}");
    }
    // Whatever the database makes of its pages, the first words are ours.
    for at in [4270, 16409, 20557, 21045, 25254, 27694] {
        let mut damaged = whole.clone();
        damaged[at] ^= 0x55;
        fs::write(&lane, damaged).expect("written");
        let said = refused(&file);
        assert!(
            said.contains("lane-1.redb") && !said.contains("panicked"),
            "{at}: {said}"
        );
    }
    fs::remove_file(&lane).expect("removed");
    for _ in 0..2 {
        let said = refused(&file);
        assert!(said.contains("lane-1.redb") && said.contains("lost"), "{said}");
    }
    // Its advice works.
    fs::remove_dir_all(folder.path().join("state")).expect("moved away");
    Running::start(&file);
}

#[test]
fn a_store_that_is_no_directory_does_not_start() {
    let folder = TempDir::new().expect("a folder");
    let file = configuration(&folder);
    fs::write(folder.path().join("state"), "x").expect("written");
    let said = refused(&file);
    assert!(said.contains("state") && said.contains("directory"), "{said}");
}

/// A broker program that is ended when the test is.
struct Running {
    child: Child,
    address: SocketAddr,
}

impl Running {
    fn start(file: &Path) -> Running {
        let mut child = program(file)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("it runs");
        let mut line = String::new();
        let out = child.stdout.as_mut().expect("piped");
        BufReader::new(out)
            .read_line(&mut line)
            .expect("it says where it listens");
        let address = line
            .split("tcp://")
            .nth(1)
            .and_then(|rest| rest.split(' ').next());
        let address = address.and_then(|address| address.parse().ok());
        Running {
            child,
            address: address.unwrap_or_else(|| panic!("{line:?}")),
        }
    }

    fn terminate(&mut self) {
        let pid = self.child.id().to_string();
        let killed = Command::new("kill")
            .args(["-TERM", &pid])
            .status()
            .expect("kill runs");
        assert!(killed.success());
    }

    /// The fences of two grants on one connection.
    fn grab_twice(&self) -> [u64; 2] {
        let mut stream = TcpStream::connect(self.address).expect("it listens");
        let patience = Some(Duration::from_secs(30));
        stream.set_read_timeout(patience).expect("a socket option");
        let mut ask = |id: u32, family: &str, name: &str, rest: &str| {
            let body =
                format!("<parcel><family>{family}</family><name>{name}</name><id>{id}</id>{rest}</parcel>");
            let head = format!(
                "Content-Type: application/xml\r\nContent-Length: {}\r\n\r\n",
                body.len()
            );
            stream.write_all((head + &body).as_bytes()).expect("written");
            let reference = format!("<reference type=\"int\">{id}</reference>");
            loop {
                let heard = hear(&mut stream);
                if heard.contains(&reference) {
                    assert!(heard.contains("<family>reply</family>"), "{heard}");
                    return heard;
                }
            }
        };
        let who = "<content type=\"map\"><name>alice</name><password>alice</password></content>";
        let token = "<context>/token</context>";
        ask(1, "login", "login", who);
        let first = ask(2, "token", "grab", token);
        ask(3, "token", "release", token);
        let second = ask(4, "token", "grab", token);
        [first, second].map(|granted| {
            let fence = granted.split("<fence type=\"int\">").nth(1);
            let fence = fence.and_then(|rest| rest.split('<').next());
            let fence = fence.and_then(|fence| fence.parse().ok());
            fence.unwrap_or_else(|| panic!("{granted}"))
        })
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The XML of the next parcel.
fn hear(stream: &mut TcpStream) -> String {
    let mut head = Vec::new();
    while !head.ends_with(b"\r\n\r\n") {
        let mut byte = [0];
        stream.read_exact(&mut byte).expect("a parcel");
        head.push(byte[0]);
    }
    let head = String::from_utf8_lossy(&head).into_owned();
    let length = head
        .lines()
        .find_map(|line| line.strip_prefix("Content-Length: "));
    let length = length.and_then(|length| length.parse().ok()).expect("its length");
    let mut body = vec![0; length];
    stream.read_exact(&mut body).expect("its body");
    String::from_utf8(body).expect("UTF-8")
}
