//! A broker that may open fewer descriptors than its configuration has connections.

use std::fs;
use std::net::TcpStream;
use std::process::Command;

use mom_broker::hash;
use tempfile::TempDir;

use super::{Running, program};

const WELCOME: &str = "<family>reply</family><name>ok</name>";

/// The program where no process may open more files than this.
fn limited(files: usize) -> Command {
    let program = program();
    let mut command = Command::new("sh");
    let limit = format!("ulimit -n {files}; exec \"$0\" \"$@\"");
    command.args(["-c", &limit]).arg(program.get_program());
    for (key, value) in program.get_envs() {
        match value {
            Some(value) => command.env(key, value),
            None => command.env_remove(key),
        };
    }
    command
}

fn users(names: &[&str], hash: &str) -> String {
    let user = |name: &&str| format!("[[users]]\nname = \"{name}\"\npassword = \"{hash}\"\n");
    names.iter().map(user).collect()
}

/// A user removed from the users file while no descriptor was left is out as soon as there is one again, whether
/// the broker saw the change itself or was told of it.
#[test]
fn a_change_is_applied_once_descriptors_are_there_again() {
    let (folder, hash) = (TempDir::new().expect("a folder"), hash("secret").expect("a hash"));
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).expect("written");
    for (reload, signalled) in [("change", false), ("signal", true)] {
        write("users.toml", &users(&["ann", "ben"], &hash));
        let config =
            format!("users = \"users.toml\"\nreload = \"{reload}\"\n[limits]\nlogin-time = 600000\n");
        write("mom.toml", &config);
        let broker = Running::of_command(limited(64), &folder.path().join("mom.toml"));
        let warning = broker.logged("the configured connections exceed this process");
        assert!(warning.contains("connections=10000 descriptors=64"), "{warning}");
        // More than there are descriptors for: the system takes them, and the broker cannot.
        let crowd: Vec<TcpStream> = (0..80).map(|_| broker.connect()).collect();
        broker.logged("cannot accept");
        write("users.toml", &users(&["ann"], &hash));
        if signalled {
            broker.signal("-HUP");
        }
        let error = broker.logged("ERROR");
        assert!(
            error.contains("stays as it was until it can be read") && error.contains("Too many open files"),
            "{error}"
        );
        drop(crowd);
        let report = broker.logged("configuration: ");
        assert!(report.contains("removed users ben"), "{report}");
        assert!(broker.login("ann", "secret").contains(WELCOME));
        assert!(!broker.login("ben", "secret").contains(WELCOME));
    }
}

/// Said at the start and when the file is read again, and not where there is room.
#[test]
fn connections_beyond_the_descriptors_are_warned_of() {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("mom.toml");
    let write = |connections: usize| {
        let config = format!("reload = \"signal\"\nconnections = {connections}\n");
        fs::write(&file, config).expect("written");
    };
    write(100);
    let broker = Running::of_command(limited(200), &file);
    write(137);
    broker.signal("-HUP");
    let mut warned = broker.logged("limit of open files");
    assert!(warned.contains("connections=137 descriptors=200"), "{warned}");
    assert!(warned.contains("configure at most 136"), "{warned}");
    write(10_000);
    broker.signal("-HUP");
    warned = broker.logged("limit of open files");
    assert!(warned.contains("connections=10000"), "{warned}");
}
