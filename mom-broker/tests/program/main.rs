//! The service's program: check, passwd, explain, wrong files, new ones while it runs, and its end.

mod descriptors;
mod explain;
#[cfg(feature = "otlp")]
mod otlp;
mod reload;

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use tempfile::TempDir;

const CONTEXT: &str = "log = \"info\"\n[[contexts]]\npath = \"/a\"\nkind = \"channel\"\n";

fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mom-broker"));
    command
        .env("XDG_STATE_HOME", env!("CARGO_TARGET_TMPDIR"))
        .env_remove("STATE_DIRECTORY")
        .env_remove("MOM_CONFIG")
        .env_remove("MOM_PASSWORD");
    command
}

fn lab() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../config/lab.toml")
}

fn run(command: &mut Command) -> Output {
    command.stdin(Stdio::null()).output().expect("the program runs")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn a_wrong_file_does_not_start() {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("mom.toml");
    for (content, words) in [
        (Some("listne = []\n"), ":1: listne: "),
        (Some("[limits]\ngone = 1\n"), ":2: limits.gone: "),
        (Some("users = \"nobody.toml\"\n"), ":1: users: "),
        (Some("listen = [\"127.0.0.1:x\"]\n"), ":1: listen[0]: a port is "),
        (
            Some("listen = [\"256.0.0.1:7666\"]\n"),
            "\"256.0.0.1\" is not an address of this machine",
        ),
        (None, "cannot be read"),
    ] {
        match content {
            Some(content) => fs::write(&file, content).expect("written"),
            None => fs::remove_file(&file).expect("removed"),
        }
        let refused = run(program().arg("--config").arg(&file));
        assert_eq!(refused.status.code(), Some(1), "{content:?}");
        let said = text(&refused.stderr);
        assert!(said.contains(words), "{words} in {said}");
        assert!(refused.stdout.is_empty(), "it did not listen: {content:?}");
    }
}

#[test]
fn two_brokers_do_not_share_an_address() {
    let broker = Running::start();
    let second = run(program()
        .arg("--config")
        .arg(lab())
        .arg("--listen")
        .arg(broker.address.to_string()));
    assert_eq!(second.status.code(), Some(1));
    let said = text(&second.stderr);
    assert!(
        said.contains("cannot listen") && said.contains("--listen"),
        "{said}"
    );
}

#[test]
fn passwd_changes_the_users_file_in_place() {
    let folder = TempDir::new().expect("a folder");
    let users = folder.path().join("users.toml");
    let before = "# staff, by hand\n[[users]]\nname = \"ann\" # the boss\npassword = \"x\"\nlevel = 5\ngroups = [\"staff\"]\n";
    fs::write(&users, before).expect("written");
    let passwd = |user: &str, password: &str| {
        let mut command = program();
        command.args(["passwd", user, "--users"]).arg(&users);
        run(command.env("MOM_PASSWORD", password))
    };
    assert!(passwd("ann", "secret").status.success());
    assert!(passwd("ben", "other").status.success());
    let after = fs::read_to_string(&users).expect("readable");
    for kept in [
        "# staff, by hand\n",
        "name = \"ann\" # the boss\n",
        "level = 5\ngroups = [\"staff\"]\n",
        "name = \"ben\"",
    ] {
        assert!(after.contains(kept), "{kept:?} in {after}");
    }
    assert!(
        !after.contains("\"x\"") && !after.contains("secret") && !after.contains("other"),
        "{after}"
    );

    // The hash is one that logs in, and only with its password.
    let file = folder.path().join("mom.toml");
    fs::write(&file, "users = \"users.toml\"\nlisten = [\"127.0.0.1:0\"]\n").expect("written");
    let broker = Running::of(&file);
    assert!(broker.login("ann", "secret").contains("<family>reply</family>"));
    assert!(broker.login("ben", "other").contains("<family>reply</family>"));
    assert!(broker.login("ben", "secret").contains("bad-login"));

    for (user, password, words) in [("an/n", "p", "an/n"), ("hub", "p", "hub"), ("ann", "", "empty")] {
        let refused = passwd(user, password);
        assert_eq!(refused.status.code(), Some(1), "{user:?}");
        assert!(text(&refused.stderr).contains(words), "{refused:?}");
    }
    assert_eq!(
        fs::read_to_string(&users).expect("readable"),
        after,
        "a refusal changes nothing"
    );

    let printed = run(program().args(["passwd", "cy"]).env("MOM_PASSWORD", "p"));
    assert!(
        text(&printed.stdout).starts_with("[[users]]\nname = \"cy\"\npassword = \"$argon2id$"),
        "{printed:?}"
    );
}

#[test]
fn sigterm_tells_the_peers_and_exits_with_0() {
    let mut broker = Running::start();
    let mut peers: Vec<TcpStream> = (0..5).map(|_| broker.connect()).collect();
    for peer in &mut peers[..3] {
        say_login(peer, "alice", "alice");
        assert!(hear(peer).contains("<family>reply</family>"));
    }
    // One that has not logged in, and one that has not even said how it speaks. Once its ping is answered the
    // broker knows of the former.
    let ping = "<parcel><family>time</family><name>ping</name><id>1</id></parcel>";
    let head = format!(
        "Content-Type: application/xml\r\nContent-Length: {}\r\n\r\n",
        ping.len()
    );
    peers[3].write_all((head + ping).as_bytes()).expect("written");
    assert!(hear(&mut peers[3]).contains("<name>pong</name>"));
    let begin = Instant::now();
    broker.signal("-TERM");
    for peer in &mut peers[..4] {
        assert!(hear(peer).contains("<name>shutdown</name>"));
        let mut rest = Vec::new();
        assert_eq!(
            peer.read_to_end(&mut rest).expect("closed in order"),
            0,
            "{rest:?}"
        );
    }
    let status = broker.child.wait().expect("it ends");
    assert_eq!(status.code(), Some(0));
    assert!(begin.elapsed() < Duration::from_secs(10), "{:?}", begin.elapsed());
}

/// Threat 4, from outside: a stranger costs what it may send before login, and no more.
#[test]
fn strangers_cost_little_memory() {
    const STRANGERS: usize = 200;
    let broker = Running::start();
    let before = broker.resident();
    let mut strangers = Vec::new();
    for _ in 0..STRANGERS {
        let mut stranger = broker.connect();
        let head = "Content-Type: application/xml\r\nContent-Length: 16384\r\n\r\n<parcel>";
        stranger.write_all(head.as_bytes()).expect("written");
        stranger.write_all(&[b' '; 16_000]).expect("written");
        strangers.push(stranger);
    }
    // An answer now was read after all of them.
    assert!(broker.login("alice", "alice").contains("<family>reply</family>"));
    let grown = broker.resident().saturating_sub(before);
    assert!(
        grown < STRANGERS * 256 * 1024,
        "{grown} bytes for {STRANGERS} strangers"
    );
}

/// A broker program that is ended when the test is.
struct Running {
    child: Child,
    address: SocketAddr,
    log: mpsc::Receiver<String>,
}

impl Running {
    fn start() -> Running {
        Running::of(&lab())
    }

    fn of(file: &Path) -> Running {
        Running::of_command(program(), file)
    }

    /// The same by a command to which the arguments are appended.
    fn of_command(mut command: Command, file: &Path) -> Running {
        command
            .arg("--config")
            .arg(file)
            .args(["--listen", "127.0.0.1:0"]);
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program runs");
        let (lines, log) = mpsc::channel();
        let said = BufReader::new(child.stderr.take().expect("piped"));
        std::thread::spawn(move || {
            for line in said.lines().map_while(Result::ok) {
                // A test that is over reads no more.
                let _ = lines.send(line);
            }
        });
        let mut line = String::new();
        let out = child.stdout.as_mut().expect("piped");
        BufReader::new(out)
            .read_line(&mut line)
            .expect("it says where it listens");
        let address = line
            .split("tcp://")
            .nth(1)
            .and_then(|rest| rest.split(' ').next());
        let address = address
            .and_then(|address| address.parse().ok())
            .unwrap_or_else(|| panic!("{line:?}"));
        Running { child, address, log }
    }

    /// The next line of the log that holds these words.
    fn logged(&self, words: &str) -> String {
        let mut before = Vec::new();
        loop {
            match self.log.recv_timeout(Duration::from_secs(30)) {
                Ok(line) if line.contains(words) => return line,
                Ok(line) => before.push(line),
                Err(error) => panic!("{words:?} is not logged ({error}) after {before:#?}"),
            }
        }
    }

    fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        let sent = Command::new("kill").args([name, &pid]).status();
        assert!(sent.expect("kill runs").success());
    }

    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).expect("it listens");
        stream
            .set_read_timeout(Some(Duration::from_secs(30)))
            .expect("a socket option");
        stream
    }

    fn login(&self, user: &str, password: &str) -> String {
        let mut stream = self.connect();
        say_login(&mut stream, user, password);
        hear(&mut stream)
    }

    /// Bytes of memory that the process has in use.
    fn resident(&self) -> usize {
        let statm = fs::read_to_string(format!("/proc/{}/statm", self.child.id())).expect("Linux tells");
        let pages: usize = statm
            .split(' ')
            .nth(1)
            .and_then(|pages| pages.parse().ok())
            .expect("a number");
        pages * 4096
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn say_login(stream: &mut TcpStream, user: &str, password: &str) {
    let content = format!("<name>{user}</name><password>{password}</password>");
    say(stream, "login", "login", "/", &content);
}

fn say(stream: &mut TcpStream, family: &str, name: &str, context: &str, content: &str) {
    let body = format!(
        "<parcel><family>{family}</family><name>{name}</name><id>1</id><context>{context}</context>\
         <content type=\"map\">{content}</content></parcel>"
    );
    let head = format!(
        "Content-Type: application/xml\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    stream.write_all((head + &body).as_bytes()).expect("written");
}

/// The XML of the next parcel.
fn hear(stream: &mut TcpStream) -> String {
    let mut head = Vec::new();
    while !head.ends_with(b"\r\n\r\n") {
        let mut byte = [0];
        stream.read_exact(&mut byte).expect("a parcel");
        head.push(byte[0]);
    }
    let head = text(&head);
    let length = head
        .lines()
        .find_map(|line| line.strip_prefix("Content-Length: "));
    let length = length.and_then(|length| length.parse().ok()).expect("its length");
    let mut body = vec![0; length];
    stream.read_exact(&mut body).expect("its body");
    text(&body)
}
