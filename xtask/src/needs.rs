//! What the tasks need beside the code: one table, and how to get what is missing.

use std::process::{Command, Stdio};

use anyhow::{Result, bail};

use crate::clients::PYTHON;
use crate::command::{program, shows, succeeds};
use crate::{console, javascript, node};

/// The folder of `PYTHON`.
const PYTHON_FOLDER: &str = "target/python";

/// One thing that a task needs.
#[derive(Clone, Copy)]
pub(crate) struct Need {
    /// Its name as people know it.
    what: &'static str,
    /// A command that ends well where it is there: program, arguments.
    detect: (&'static str, &'static [&'static str]),
    /// Where it comes from.
    source: Source,
    /// What it is needed for.
    why: &'static str,
}

/// Where a need comes from. A new kind of package is one variant here and one arm in `commands`.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Source {
    /// A package of Debian and its relatives.
    Debian(&'static str),
    /// A program of crates.io.
    Crate(&'static str),
    /// A component of the installed Rust toolchain.
    Rustup(&'static str),
    /// Packages of PyPI, into a folder of their own below `target`.
    PyPi(&'static [&'static str]),
    /// The packages of npm that the lock file in this folder names.
    Npm(&'static str),
    /// A Node of our own below `target`, as packages of npm.
    Node(&'static [&'static str]),
    /// Nothing that should be installed behind one's back; the text says how to get it.
    ByHand(&'static str),
}

const CARGO: Need = Need {
    what: "cargo",
    detect: ("cargo", &["--version"]),
    source: Source::ByHand("install Rust with rustup, see https://rustup.rs"),
    why: "builds everything",
};

/// The packages of the client in Python, and of its tests; the tests find them in `PYTHON`.
const PYTHON_PACKAGES: &[&str] = &[
    "msgpack",
    "websockets",
    "cryptography",
    "pytest",
    "pytest-asyncio",
    "mypy",
    "pdoc",
    "build",
    "hatchling",
];

const NODEJS: Need = Need {
    what: "nodejs",
    detect: ("node", &["--version"]),
    source: Source::Debian("nodejs"),
    why: "runs what builds and tests the console and the client in JavaScript",
};

const NPM: Need = Need {
    what: "npm",
    detect: ("npm", &["--version"]),
    source: Source::Debian("npm"),
    why: "gets the packages of the console and of the client in JavaScript",
};

/// Debian 12 has an older one.
const NODE: Need = Need {
    what: "Node 20.19, 22.12 or newer",
    detect: ("node", &["-e", node::IS_RECENT]),
    source: Source::Node(node::PACKAGES),
    why: "what builds the console does not run in an older one",
};

/// What building the console needs; in this order, as one brings the next.
pub(crate) const FOR_CONSOLE: &[Need] = &[
    NODEJS,
    NPM,
    NODE,
    Need {
        what: "packages for console",
        detect: ("npm", &["ls", "--prefix", console::FOLDER]),
        source: Source::Npm(console::FOLDER),
        why: "the console is built and tested with them",
    },
];

/// What the tests of the clients in other languages need; in this order, as one brings the next.
pub(crate) const FOR_CLIENTS: &[Need] = &[
    Need {
        what: "python3-venv",
        detect: ("python3", &["-c", "import ensurepip, venv"]),
        source: Source::Debian("python3-venv"),
        why: "the packages for the client in Python get a folder of their own",
    },
    Need {
        what: "packages for clients/python",
        detect: (
            PYTHON,
            &[
                "-c",
                "import msgpack, websockets, cryptography, pytest, pytest_asyncio, mypy, pdoc, build, hatchling",
            ],
        ),
        source: Source::PyPi(PYTHON_PACKAGES),
        why: "the client in Python and its tests",
    },
    NODEJS,
    NPM,
    NODE,
    Need {
        what: "packages for clients/js",
        detect: ("npm", &["ls", "--prefix", javascript::FOLDER]),
        source: Source::Npm(javascript::FOLDER),
        why: "the client in JavaScript and its tests",
    },
];

const GIT: Need = Need {
    what: "git",
    detect: ("git", &["--version"]),
    source: Source::Debian("git"),
    why: "the checkout is a git repository",
};

/// What `cargo xtask test` needs.
pub(crate) const FOR_TESTS: &[Need] = &[
    CARGO,
    Need {
        what: "python3",
        detect: ("python3", &["--version"]),
        source: Source::Debian("python3"),
        why: "a test's peer is written in Python with nothing but a socket",
    },
    GIT,
    Need {
        what: "systemd",
        detect: ("systemd-analyze", &["--version"]),
        source: Source::Debian("systemd"),
        why: "a test has it judge the unit of the broker; it need not run",
    },
    Need {
        what: "adduser",
        detect: ("test", &["-x", "/usr/sbin/adduser"]),
        source: Source::Debian("adduser"),
        why: "the package makes its user with it, on a copy of this machine",
    },
    Need {
        what: "debootstrap",
        detect: ("test", &["-x", "/usr/sbin/debootstrap"]),
        source: Source::Debian("debootstrap"),
        why: "a test carries out the steps of the container file on it",
    },
    Need {
        what: "faketime",
        detect: ("faketime", &["--version"]),
        source: Source::Debian("faketime"),
        why: "a test moves the wall clock of a broker, and nobody else's",
    },
    Need {
        what: "squid",
        detect: ("test", &["-x", "/usr/sbin/squid"]),
        source: Source::Debian("squid"),
        why: "tests go through an HTTP proxy, which they start themselves",
    },
    Need {
        what: "tinyproxy",
        detect: ("test", &["-x", "/usr/bin/tinyproxy"]),
        source: Source::Debian("tinyproxy"),
        why: "tests go through an HTTP proxy, which they start themselves",
    },
    Need {
        what: "chromium",
        detect: ("chromium", &["--version"]),
        source: Source::Debian("chromium"),
        why: "a page of the tests' own is a peer in a browser, and the console's tests open it there",
    },
];

/// What `cargo xtask test` needs, in all.
pub(crate) const FOR_ALL_TESTS: &[&[Need]] = &[FOR_TESTS, FOR_CLIENTS, FOR_CONSOLE];

/// What `cargo xtask ci` needs, in all.
pub(crate) const FOR_ALL_OF_CI: &[&[Need]] = &[FOR_CI, FOR_TESTS, FOR_CLIENTS, FOR_CONSOLE, FOR_INSTRUCTIONS];

const fn debian(program: &'static str, args: &'static [&'static str], package: &'static str) -> Need {
    Need {
        what: package,
        detect: (program, args),
        source: Source::Debian(package),
        why: "MOM is measured beside it, or with it",
    }
}

/// It has no option that ends well; its folder of plug-ins is not needed.
const MOSQUITTO: Need = debian(
    "sh",
    &["-c", "command -v mosquitto || test -x /usr/sbin/mosquitto"],
    "mosquitto",
);

const PIP: Need = debian("python3", &["-m", "pip", "--version"], "python3-pip");

/// What `cargo xtask bench-doors` needs of Debian's packages.
pub(crate) const FOR_DOORS: &[Need] = &[MOSQUITTO, PIP];

/// What `cargo xtask bench-peers` needs of Debian's packages. Services are not started by being installed: each
/// measurement starts its own.
pub(crate) const FOR_PEERS: &[Need] = &[
    debian("redis-server", &["--version"], "redis-server"),
    MOSQUITTO,
    debian("sh", &["-c", "command -v prosody"], "prosody"),
    debian("ip", &["-V"], "iproute2"),
    PIP,
];

/// What `cargo xtask dist` needs. The others of its programs are on each Debian, and none is needed elsewhere.
pub(crate) const FOR_DIST: &[Need] = &[
    CARGO,
    GIT,
    Need {
        what: "binutils",
        detect: ("objcopy", &["--version"]),
        source: Source::Debian("binutils"),
        why: "parts the programs from their debug info, and tells what they are linked with",
    },
    Need {
        what: "dpkg",
        detect: ("dpkg-deb", &["--version"]),
        source: Source::ByHand("pack on Debian or a relative of it"),
        why: "makes the package",
    },
];

/// What `cargo xtask instructions` needs.
pub(crate) const FOR_INSTRUCTIONS: &[Need] = &[Need {
    what: "valgrind",
    detect: ("valgrind", &["--version"]),
    source: Source::Debian("valgrind"),
    why: "counts the instructions of the hot path",
}];

/// What `cargo xtask mutants` needs.
pub(crate) const FOR_MUTANTS: &[Need] = &[Need {
    what: "cargo-mutants",
    detect: ("cargo", &["mutants", "--version"]),
    source: Source::Crate("cargo-mutants"),
    why: "changes the code and runs the tests",
}];

/// What the other steps of `cargo xtask ci` need.
pub(crate) const FOR_CI: &[Need] = &[
    CARGO,
    Need {
        what: "rustfmt",
        detect: ("cargo", &["fmt", "--version"]),
        source: Source::Rustup("rustfmt"),
        why: "checks the format",
    },
    Need {
        what: "clippy",
        detect: ("cargo", &["clippy", "--version"]),
        source: Source::Rustup("clippy"),
        why: "checks the lints",
    },
];

/// As [`ensure`], of several tables at once.
pub(crate) fn ensure_all(tables: &[&[Need]], install: bool, task: &str) -> Result<()> {
    ensure(&union(tables), install, task)
}

/// Each need once, where it stands first.
fn union(tables: &[&[Need]]) -> Vec<Need> {
    let mut all: Vec<Need> = Vec::new();
    for need in tables.iter().copied().flatten() {
        if all.iter().all(|known| known.what != need.what) {
            all.push(*need);
        }
    }
    all
}

/// Looks for every need. What is missing is installed if `install` says so; else the error holds the commands to type.
pub(crate) fn ensure(needs: &[Need], install: bool, task: &str) -> Result<()> {
    let missing = |needs: &[Need]| {
        needs
            .iter()
            .copied()
            .filter(|need| !is_there(need))
            .collect::<Vec<_>>()
    };
    let absent = missing(needs);
    if absent.is_empty() {
        return Ok(());
    }
    if !install {
        bail!(advice(&absent, &prefix(), task));
    }
    for need in &absent {
        println!("missing: {} ({})", need.what, need.why);
    }
    let mut done: Vec<Vec<String>> = Vec::new();
    for need in &absent {
        // What was installed for another may have brought it.
        if is_there(need) {
            continue;
        }
        for words in commands(&[*need], &prefix()) {
            if !done.contains(&words) {
                install_by(&words, task)?;
                done.push(words);
            }
        }
    }
    if let Some(need) = missing(&absent).first() {
        match need.source {
            Source::ByHand(how) => bail!("{} is missing: {how}, then run `{task}` again", need.what),
            _ => bail!(
                "{} was installed, but `{} {}` still fails: run it by hand to see why",
                need.what,
                need.detect.0,
                need.detect.1.join(" ")
            ),
        }
    }
    println!(
        "installed: {}",
        absent.iter().map(|need| need.what).collect::<Vec<_>>().join(", ")
    );
    Ok(())
}

/// Runs a command that installs something.
fn install_by(words: &[String], task: &str) -> Result<()> {
    println!("install: {}", words.join(" "));
    let mut command = program(&words[0]);
    // A package must not stop to ask: CI has no one to answer.
    command
        .args(&words[1..])
        .stdin(Stdio::null())
        .env("DEBIAN_FRONTEND", "noninteractive")
        // A service that is installed is not started where this is a run level of one user.
        .env("RUNLEVEL", "1");
    if !shows(&mut command)? {
        bail!(
            "`{}` failed; run it by hand to see why, then run `{task}` again",
            words.join(" ")
        );
    }
    Ok(())
}

fn is_there(need: &Need) -> bool {
    succeeds(need.detect.0, need.detect.1)
}

/// What has to stand before a command that only root may run.
fn prefix() -> Vec<String> {
    let is_root = Command::new("id")
        .arg("-u")
        .output()
        .is_ok_and(|out| String::from_utf8_lossy(&out.stdout).trim() == "0");
    if is_root || !succeeds("sudo", &["--version"]) {
        Vec::new()
    } else {
        vec!["sudo".to_owned()]
    }
}

/// The commands that install `needs`; the package index is updated once, before the first Debian package.
fn commands(needs: &[Need], prefix: &[String]) -> Vec<Vec<String>> {
    let words = |prefix: &[String], text: &[&str]| {
        prefix
            .iter()
            .cloned()
            .chain(text.iter().map(|word| (*word).to_owned()))
            .collect::<Vec<_>>()
    };
    let mut all = Vec::new();
    for need in needs {
        match need.source {
            Source::Debian(package) => {
                let update = words(prefix, &["apt-get", "update"]);
                if !all.contains(&update) {
                    all.push(update);
                }
                all.push(words(prefix, &["apt-get", "install", "-y", package]));
            }
            Source::Crate(name) => all.push(words(&[], &["cargo", "install", "--locked", name])),
            Source::PyPi(packages) => {
                all.push(words(&[], &["python3", "-m", "venv", PYTHON_FOLDER]));
                let install = words(&[], &[PYTHON, "-m", "pip", "install", "--quiet"]);
                all.push(words(&install, packages));
            }
            Source::Node(packages) => {
                // Nothing of it has to run to be installed.
                let quiet = ["--ignore-scripts", "--no-audit", "--no-fund"];
                let install = words(&[], &["npm", "install", "--prefix", node::FOLDER]);
                all.push(words(&words(&install, &quiet), packages));
            }
            Source::Npm(folder) => all.push(words(&[], &["npm", "ci", "--prefix", folder])),
            Source::Rustup(component) => all.push(words(&[], &["rustup", "component", "add", component])),
            Source::ByHand(_) => {}
        }
    }
    all
}

/// What to do about missing needs, in the words that can be typed.
fn advice(missing: &[Need], prefix: &[String], task: &str) -> String {
    let mut text = String::from("something that this task needs is missing");
    for need in missing {
        text.push_str(&format!("\n  {}: {}", need.what, need.why));
        if let Source::ByHand(how) = need.source {
            text.push_str(&format!("; {how}"));
        }
    }
    let commands = commands(missing, prefix);
    if !commands.is_empty() {
        let typed = commands
            .iter()
            .map(|words| words.join(" "))
            .collect::<Vec<_>>()
            .join(" && ");
        text.push_str(&format!(
            "\nto install it:\n  {typed}\nor let this do it:\n  {task} --install"
        ));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_need_is_named_once_in_the_order_of_the_tables() {
        let whats = union(FOR_ALL_TESTS)
            .iter()
            .map(|need| need.what)
            .collect::<Vec<_>>();
        for what in [
            NODEJS.what,
            NPM.what,
            "packages for console",
            "packages for clients/js",
        ] {
            assert_eq!(whats.iter().filter(|one| **one == what).count(), 1, "{what}");
        }
        let place = |what| whats.iter().position(|one| *one == what);
        assert!(place(NPM.what) < place("packages for console"), "{whats:?}");
    }

    const fn absent(what: &'static str, source: Source) -> Need {
        Need {
            what,
            detect: ("no-such-program-anywhere", &[]),
            source,
            why: "for the test",
        }
    }

    #[test]
    fn what_is_there_is_not_asked_for() {
        ensure(&[CARGO], false, "cargo xtask test").unwrap();
    }

    #[test]
    fn what_is_missing_is_named_with_the_command_that_installs_it() {
        let needs = [absent("python3", Source::Debian("python3")), CARGO];
        let error = ensure(&needs, false, "cargo xtask test").unwrap_err().to_string();
        assert!(error.contains("python3: for the test"), "{error}");
        assert!(error.contains("apt-get update && "), "{error}");
        assert!(error.contains("apt-get install -y python3"), "{error}");
        assert!(error.contains("cargo xtask test --install"), "{error}");
        assert!(!error.contains("builds everything"), "{error}");
    }

    #[test]
    fn what_has_to_be_got_by_hand_fails_even_with_install() {
        let needs = [absent("cargo", Source::ByHand("install Rust"))];
        let error = ensure(&needs, true, "cargo xtask test").unwrap_err().to_string();
        assert!(
            error.contains("install Rust") && !error.contains("--install"),
            "{error}"
        );
    }

    #[test]
    fn the_index_is_updated_once_and_before_the_packages() {
        let needs = [
            absent("a", Source::Debian("pkg-a")),
            absent("c", Source::Rustup("clippy")),
            absent("b", Source::Debian("pkg-b")),
            absent("d", Source::Crate("cargo-d")),
            absent("e", Source::PyPi(&["e", "f"])),
            absent("g", Source::Node(&["node-g@22"])),
            absent("h", Source::Npm("console")),
        ];
        let typed: Vec<_> = commands(&needs, &["sudo".to_owned()])
            .iter()
            .map(|words| words.join(" "))
            .collect();
        assert_eq!(
            typed,
            [
                "sudo apt-get update",
                "sudo apt-get install -y pkg-a",
                "rustup component add clippy",
                "sudo apt-get install -y pkg-b",
                "cargo install --locked cargo-d",
                "python3 -m venv target/python",
                "target/python/bin/python -m pip install --quiet e f",
                "npm install --prefix target/node --ignore-scripts --no-audit --no-fund node-g@22",
                "npm ci --prefix console",
            ]
        );
    }
}
