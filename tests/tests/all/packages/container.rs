//! The container file: each of its steps is carried out on a Debian of the tests' own, as podman would.

use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;

use mom_tests::machine::{ADDRESS, Machine};
use mom_tests::programs::{Running, project, text};

use super::{PASSWORD, machine};

/// The files of this image, made once and kept: the Debian that it is made of. An error = its mirror cannot be reached.
fn base(image: &str) -> io::Result<PathBuf> {
    assert_eq!(image, "docker.io/library/debian:12-slim");
    let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join("debian-12");
    if kept.is_dir() {
        return Ok(kept);
    }
    let made = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR"))?;
    let new = made.path().join("new");
    let mut debootstrap = Command::new("debootstrap");
    debootstrap.args(["--variant=minbase", "bookworm"]).arg(&new);
    let output = debootstrap.output().expect("debootstrap is installed");
    let said = text(&output.stdout) + &text(&output.stderr);
    if !output.status.success() && said.contains("Failed getting release") {
        return Err(io::Error::other(said));
    }
    assert!(output.status.success(), "{said}");
    // Another test program may have been faster.
    let _ = std::fs::rename(&new, &kept);
    Ok(kept)
}

/// What the file says so far.
struct Image {
    machine: Machine,
    environment: Vec<(String, String)>,
    user: String,
    entry: Vec<String>,
    command: Vec<String>,
    volumes: Vec<String>,
    exposed: Vec<String>,
}

fn list(text: &str) -> Vec<String> {
    let list: serde_json::Value = serde_json::from_str(text).expect("a list in JSON");
    let words = list.as_array().expect("a list").iter();
    words
        .map(|word| word.as_str().expect("text").to_owned())
        .collect()
}

impl Image {
    /// Carries out the steps of the file.
    fn build(steps: &[(&str, &str)]) -> io::Result<Image> {
        let [("FROM", image), steps @ ..] = steps else {
            panic!("{steps:?} begin with no image")
        };
        // Who may make no machine may not run debootstrap either.
        drop(Machine::start(Path::new("/"))?);
        let mut image = Image {
            machine: machine(&base(image)?)?,
            environment: Vec::new(),
            user: "root".to_owned(),
            entry: Vec::new(),
            command: Vec::new(),
            volumes: Vec::new(),
            exposed: Vec::new(),
        };
        for (step, words) in steps {
            match *step {
                "COPY" => image.copy(words),
                "RUN" => {
                    let output = image.run(&image.user, &["sh", "-c", words]).output();
                    let output = output.expect("it runs");
                    assert!(output.status.success(), "{words}: {}", text(&output.stdout));
                }
                "ENV" => {
                    let pairs = words.split(' ').map(|pair| pair.split_once('=').expect("a pair"));
                    let pairs = pairs.map(|(name, value)| (name.to_owned(), value.to_owned()));
                    image.environment.extend(pairs);
                }
                "USER" => image.user = (*words).to_owned(),
                "ENTRYPOINT" => image.entry = list(words),
                "CMD" => image.command = list(words),
                "VOLUME" => image.volumes = list(words),
                "EXPOSE" => image.exposed.push((*words).to_owned()),
                other => panic!("teach the test what {other} does"),
            }
        }
        Ok(image)
    }

    /// From the folder of the file, where the package is.
    fn copy(&self, words: &str) {
        let (from, to) = words.split_once(' ').expect("from, to");
        assert_eq!(from, "mom_*.deb");
        self.machine.sh(&format!("cp /mnt/mom.deb {to}"), &[]);
    }

    /// A program in the container; its log goes to its output.
    fn run(&self, user: &str, words: &[&str]) -> Command {
        let group = self.machine.sh(&format!("id -g {user}"), &[]);
        let mut command = self.machine.command("setpriv");
        command.args([&format!("--reuid={user}"), &format!("--regid={}", group.trim())]);
        command
            .args(["--init-groups", "sh", "-c", "exec \"$@\" 2>&1", "sh"])
            .args(words);
        command.envs(self.environment.iter().map(|(name, value)| (name, value)));
        command
    }

    /// What the container runs when it is started with these words.
    fn start(&self, user: &str, words: &[String]) -> Command {
        let words: Vec<&str> = self.entry.iter().chain(words).map(String::as_str).collect();
        self.run(user, &words)
    }
}

/// The instructions of the file, with their words.
fn steps(file: &str) -> Vec<(&str, &str)> {
    let lines = file
        .lines()
        .filter(|line| !line.is_empty() && !line.starts_with('#'));
    lines
        .map(|line| line.split_once(' ').expect("a word, and more"))
        .collect()
}

#[test]
fn the_container_takes_its_first_user_from_outside() {
    let file = std::fs::read_to_string(project().join("packages/Containerfile")).expect("it is there");
    let image = match Image::build(&steps(&file)) {
        Ok(image) => image,
        Err(error) => return eprintln!("left out: no Debian of the tests' own here: {error}"),
    };
    let state = image
        .environment
        .iter()
        .find(|(name, _)| name == "STATE_DIRECTORY");
    let state = &state.expect("where its state is").1;
    assert_eq!(image.volumes, ["/etc/mom", state], "what has to outlive it");
    assert_eq!(image.exposed, ["7666"]);
    assert_ne!(image.user, "root");

    // As the head of the file says.
    let file: String = file.lines().filter_map(|line| line.strip_prefix('#')).collect();
    let words = "passwd alice --group admin --users /etc/mom/users.toml";
    assert!(file.contains(words), "{file}");
    let words: Vec<String> = words.split(' ').map(str::to_owned).collect();
    let mut passwd = image.start("root", &words);
    let made = passwd.envs(PASSWORD).output().expect("it runs");
    assert!(made.status.success(), "{}", text(&made.stdout));

    let broker = Running::of("mom-broker", &mut image.start(&image.user, &image.command));
    let pin = broker.line_with("sha256:");
    let pin: String = pin
        .split("sha256:")
        .nth(1)
        .expect("it is there")
        .chars()
        .take(64)
        .collect();
    let tree = |hub: String| {
        let mut mom = image.machine.command("mom");
        mom.args(["--hub", &hub, "--user", "alice", "tree"])
            .envs(PASSWORD);
        mom.output().expect("it runs")
    };
    let plain = tree(format!("bin://{ADDRESS}:7666"));
    assert!(
        !plain.status.success() && text(&plain.stderr).contains("TLS"),
        "{plain:?}"
    );
    let safe = tree(format!("bins://{ADDRESS}:7666?pin=sha256:{pin}"));
    assert!(safe.status.success(), "{}", text(&safe.stderr));
    // As a container is stopped.
    broker.signal("TERM");
    assert_eq!(broker.wait().code(), Some(0));
}
