//! A running broker goes by a new configuration at once, whole or not at all, and says so.

use std::fs;
use std::io::Read;
use std::net::TcpStream;
use std::path::PathBuf;
use std::time::Duration;

use mom_broker::{Broker, Config, hash};
use mom_proto::{Limit, Value};
use tempfile::TempDir;

use super::{Running, hear, program, run, say, say_login};

const WELCOME: &str = "<family>reply</family><name>ok</name>";

/// A folder with a configuration and its users.
struct Files {
    folder: TempDir,
    hash: String,
}

impl Files {
    fn new(config: &str, users: &[(&str, i32)]) -> Files {
        let files = Files {
            folder: TempDir::new().expect("a folder"),
            hash: hash("secret").expect("a hash"),
        };
        files.write("mom.toml", &format!("users = \"users.toml\"\n{config}"));
        files.write("users.toml", &files.users(users));
        files
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).expect("written");
    }

    fn users(&self, users: &[(&str, i32)]) -> String {
        let user = |(name, level): &(&str, i32)| {
            format!(
                "[[users]]\nname = \"{name}\"\npassword = \"{}\"\nlevel = {level}\n",
                self.hash
            )
        };
        users.iter().map(user).collect()
    }

    fn start(&self) -> Running {
        Running::of(&self.path("mom.toml"))
    }
}

fn logs_in(broker: &Running, user: &str) -> bool {
    broker.login(user, "secret").contains(WELCOME)
}

/// A connection of a user that stays.
fn stay(broker: &Running, user: &str) -> TcpStream {
    let mut peer = broker.connect();
    say_login(&mut peer, user, "secret");
    let reply = hear(&mut peer);
    assert!(reply.contains(WELCOME), "{reply}");
    peer
}

/// What comes up to something with these words.
fn hear_until(peer: &mut TcpStream, words: &str) -> String {
    loop {
        let heard = hear(peer);
        if heard.contains(words) {
            return heard;
        }
    }
}

#[test]
fn sighup_reads_the_files_again() {
    let files = Files::new("reload = \"signal\"\nroot = \"open\"\n", &[("ann", 1), ("cy", 1)]);
    let broker = files.start();
    let (mut ann, mut cy) = (stay(&broker, "ann"), stay(&broker, "cy"));
    assert!(!logs_in(&broker, "ben"));

    files.write("users.toml", &files.users(&[("ben", 1), ("cy", 7)]));
    broker.signal("-HUP");
    let report = broker.logged("configuration: ");
    assert!(
        report.contains("new users ben; removed users ann; changed users cy"),
        "{report}"
    );
    assert!(logs_in(&broker, "ben"));
    assert!(!logs_in(&broker, "ann"), "removed for new logins");
    // … and for the connected peer: it is told why, and closed.
    let told = hear_until(&mut ann, "<family>error</family>");
    assert!(told.contains("<name>revoked</name>"), "{told}");
    assert_eq!(ann.read_to_end(&mut Vec::new()).expect("closed in order"), 0);
    say(&mut cy, "context", "members", "/", "");
    let members = hear_until(&mut cy, "<family>reply</family>");
    assert!(
        members.contains("<level type=\"int\">7</level>"),
        "the new level: {members}"
    );
}

#[test]
fn a_wrong_file_changes_nothing_and_is_told() {
    let files = Files::new("reload = \"signal\"\n", &[("ann", 1)]);
    let broker = files.start();
    let users = files.path("users.toml");
    files.write("users.toml", &(files.users(&[("ben", 1)]) + "level = \"high\"\n"));
    broker.signal("-HUP");
    let error = broker.logged("ERROR");
    assert!(
        error.contains(&format!("{}:5: level: ", users.display())),
        "{error}"
    );
    assert!(error.contains("the configuration stays as it was"), "{error}");
    assert!(logs_in(&broker, "ann") && !logs_in(&broker, "ben"));

    // Nothing of a wrong file holds, not even what is right in it.
    files.write("users.toml", &files.users(&[("ben", 1)]));
    files.write("mom.toml", "users = \"users.toml\"\nroot = \"opne\"\n");
    broker.signal("-HUP");
    let error = broker.logged("ERROR");
    assert!(error.contains("mom.toml:2: root: "), "{error}");
    assert!(logs_in(&broker, "ann") && !logs_in(&broker, "ben"));

    fs::remove_file(files.path("mom.toml")).expect("removed");
    broker.signal("-HUP");
    assert!(broker.logged("ERROR").contains("cannot be read"));
    assert!(logs_in(&broker, "ann"));
}

#[test]
fn what_needs_a_restart_is_named_and_the_rest_holds() {
    let files = Files::new("reload = \"signal\"\n", &[("ann", 1)]);
    let broker = files.start();
    let config = "users = \"users.toml\"\nconnections = 7\nlisten = [\"127.0.0.1:1\"]\nroot = \"open\"\nlog = \"error\"\n[limits]\ndepth = 9\ngone = 60000\n";
    files.write("mom.toml", config);
    broker.signal("-HUP");
    let report = broker.logged("configuration: ");
    // It listens where the command line says, so that key is not different.
    assert!(
        report.contains(
            "changed log, reload, root, limits.gone; not before a restart connections, limits.depth"
        ),
        "{report}"
    );
    assert!(broker.logged("WARN").contains("key=\"connections\""));
    assert!(broker.logged("WARN").contains("key=\"limits.depth\""));
    let mut ann = stay(&broker, "ann");
    say(&mut ann, "context", "list", "/", "");
    assert!(hear(&mut ann).contains(WELCOME), "the root is open now");

    // What is logged has changed too: the signal is news, and only errors are logged. A thread of its own writes
    // audit lines to the log, so that of the first change may come late.
    files.write("mom.toml", "wrong");
    broker.signal("-HUP");
    let next = loop {
        let line = broker.log.recv_timeout(Duration::from_secs(30)).expect("a line");
        if !line.contains(" audit: ") {
            break line;
        }
    };
    assert!(next.contains("ERROR"), "{next}");
}

/// A disk that was full, or a copy that was interrupted, closes no broker and takes no users from it.
#[test]
fn an_empty_or_cut_file_is_refused_by_name() {
    let files = Files::new(
        "reload = \"signal\"\nroot = \"open\"\n",
        &[("ann", 1), ("ben", 1)],
    );
    let broker = files.start();
    let (config, users) = (files.path("mom.toml"), files.path("users.toml"));
    let whole = |file: &PathBuf| fs::read_to_string(file).expect("readable");
    let (whole_config, whole_users) = (whole(&config), whole(&users));
    let cut = |text: &str, words: &str| text[..text.find(words).expect("in it")].to_owned();
    let close = "if the broker is to be closed, write root = \"closed\"";
    for (file, text, why) in [
        (&config, String::new(), close),
        (&config, "# mom\n\n".to_owned(), close),
        (&config, cut(&whole_config, "\nroot"), "was cut off after "),
        (
            &users,
            String::new(),
            "if there are to be no users, write users = []",
        ),
        (&users, cut(&whole_users, "\nlevel"), "was cut off after "),
    ] {
        let before = whole(file);
        fs::write(file, &text).expect("written");
        broker.signal("-HUP");
        let error = broker.logged("ERROR");
        let name = file.display().to_string();
        assert!(error.contains(&name) && error.contains(why), "{text:?}: {error}");
        assert!(error.contains("the configuration stays as it was"), "{error}");
        assert!(logs_in(&broker, "ann") && logs_in(&broker, "ben"), "{text:?}");
        fs::write(file, before).expect("written");
    }
    // What is meant is done: the last user goes, the last line without its end, then all.
    files.write("users.toml", &files.users(&[("ann", 1)]));
    files.write("mom.toml", whole_config.trim_end());
    broker.signal("-HUP");
    assert!(broker.logged("configuration: ").contains("removed users ben"));
    files.write("users.toml", "users = []\n");
    broker.signal("-HUP");
    assert!(broker.logged("configuration: ").contains("removed users ann"));
}

/// All ways in which people and programs change a file.
#[test]
fn a_change_is_seen_however_it_is_made() {
    let files = Files::new("", &[("ann", 1)]);
    let broker = files.start();
    let mut ann = stay(&broker, "ann");

    // In place.
    files.write("users.toml", &files.users(&[("ann", 1), ("ben", 1)]));
    assert!(broker.logged("configuration: ").contains("new users ben"));
    // By rename, as editors do and our own program.
    let mut passwd = program();
    passwd
        .args(["passwd", "cy", "--users"])
        .arg(files.path("users.toml"));
    assert!(run(passwd.env("MOM_PASSWORD", "secret")).status.success());
    assert!(broker.logged("configuration: ").contains("new users cy"));
    // Another file than before.
    files.write("others.toml", &files.users(&[("ann", 1)]));
    files.write("mom.toml", "users = \"others.toml\"\nroot = \"open\"\n");
    let report = broker.logged("configuration: ");
    assert!(report.contains("removed users ben, cy; changed root"), "{report}");
    say(&mut ann, "context", "list", "/", "");
    assert!(hear(&mut ann).contains(WELCOME), "who is there goes by it too");
    files.write("others.toml", &files.users(&[("ann", 1), ("di", 1)]));
    assert!(broker.logged("configuration: ").contains("new users di"));
    // Half of it first.
    files.write("mom.toml", "users = \"others.toml\"\nroot = \"clo");
    assert!(broker.logged("ERROR").contains("mom.toml:2: "));
    files.write("mom.toml", "users = \"others.toml\"\nroot = \"closed\"\n");
    assert!(broker.logged("configuration: ").contains("changed root"));
    // From here on only at a signal. What another broker sees of its own, this one would have seen too.
    files.write(
        "mom.toml",
        "users = \"others.toml\"\nroot = \"closed\"\nreload = \"signal\"\n",
    );
    assert!(broker.logged("configuration: ").contains("changed reload"));
    files.write("beside.toml", "users = \"others.toml\"\n");
    let beside = Running::of(&files.path("beside.toml"));
    files.write("others.toml", &files.users(&[("ann", 1)]));
    assert!(beside.logged("configuration: ").contains("removed users di"));
    broker.signal("-HUP");
    assert!(broker.logged("reading").contains("SIGHUP"));
    assert!(broker.logged("configuration: ").contains("removed users di"));
}

#[test]
fn a_change_behind_a_link_is_seen() {
    let files = Files::new("", &[("ann", 1)]);
    // A deployment: the next release lies in another folder, and a link is turned to it.
    let (first, second) = (files.path("1"), files.path("2"));
    for folder in [&first, &second] {
        fs::create_dir(folder).expect("a folder");
    }
    fs::write(first.join("mom.toml"), "root = \"closed\"\n").expect("written");
    fs::write(second.join("mom.toml"), "root = \"open\"\n").expect("written");
    let (now, next) = (files.path("now"), files.path("next"));
    std::os::unix::fs::symlink(&first, &now).expect("a link");
    let broker = Running::of(&now.join("mom.toml"));
    std::os::unix::fs::symlink(&second, &next).expect("a link");
    fs::rename(&next, &now).expect("turned");
    assert!(broker.logged("configuration: ").contains("changed root"));
}

#[test]
fn what_is_written_again_as_it_was_is_no_change() {
    let files = Files::new("", &[("ann", 1)]);
    let broker = files.start();
    let same = fs::read_to_string(files.path("mom.toml")).expect("readable");
    fs::remove_file(files.path("mom.toml")).expect("removed");
    files.write("mom.toml", &same);
    // Whatever was seen of that, the next line about it is of the real change.
    files.write("users.toml", &files.users(&[("ben", 1)]));
    broker.logged("reading it again");
    let report = broker.logged("configuration: ");
    assert!(report.contains("new users ben"), "{report}");
}

/// The lab on a free port.
fn free_lab() -> Config {
    let mut config = Config::lab();
    config.listen = vec!["127.0.0.1:0".into()];
    config
}

fn connect(broker: &Broker) -> TcpStream {
    let stream = TcpStream::connect(broker.local_addr()).expect("it listens");
    let patience = Some(Duration::from_secs(30));
    stream.set_read_timeout(patience).expect("a socket option");
    stream
}

#[tokio::test(flavor = "multi_thread")]
async fn a_program_can_do_it_too() {
    let broker = Broker::start(free_lab()).await.expect("started");
    let mut alice = connect(&broker);
    say_login(&mut alice, "alice", "alice");
    assert!(hear(&mut alice).contains(WELCOME));

    assert!(
        broker.reload(free_lab()).expect("right").is_empty(),
        "the same changes nothing"
    );

    let mut config = free_lab();
    config.root = Value::from("nobody");
    config.users.clear();
    let error = broker.reload(config).expect_err("no such manager");
    assert!(error.to_string().contains("nobody"), "{error}");
    let mut bob = connect(&broker);
    say_login(&mut bob, "bob", "bob");
    assert!(hear(&mut bob).contains(WELCOME), "the users are as they were");

    let mut config = free_lab();
    config.limits.before_login = 64;
    config.limits.parcel = Limit::At(9);
    config.users.retain(|user| user.name != "bob");
    config.users[0].level = 4;
    let report = broker.reload(config).expect("right");
    assert_eq!(report.keys, ["limits.before-login"]);
    assert_eq!(report.needs_restart, ["limits.parcel"]);
    assert_eq!(
        (&*report.users.removed, &*report.users.changed),
        (&["bob".to_owned()][..], &["alice".to_owned()][..])
    );
    assert_eq!(report.peers, 2, "alice and bob are there");
    broker.check();
    // Who is there keeps what it was told; who comes now has less room.
    say(&mut alice, "context", "list", "/", "");
    assert!(hear_until(&mut alice, "<family>reply</family>").contains(WELCOME));
    let mut eve = connect(&broker);
    say_login(&mut eve, "alice", "alice");
    assert!(hear(&mut eve).contains("<name>too-large</name>"));
    broker.stop().await;
}
