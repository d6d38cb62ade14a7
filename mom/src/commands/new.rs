//! `mom new device`: a folder with a device that runs.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use mom_client::Key;
use serde_json::json;

use super::keygen::write_new;
use crate::cli::{Language, NewCommand, NewDeviceArgs};
use crate::failure::{Doing as _, Failure};
use crate::output::Output;
use crate::output::style::{Tone, ink};

/// The name that stands in the templates.
const PLACEHOLDER: &str = "newbot";

/// A file of a template: where it goes, and what it holds.
type File = (&'static str, &'static str);

macro_rules! template {
    ($file:literal) => {
        include_str!(concat!("../../templates/device/", $file))
    };
}

const COMMON: &[File] = &[
    ("README.md", template!("common/README.md")),
    ("hub.toml", template!("common/hub.toml")),
    ("newbot.service", template!("common/newbot.service")),
    (".gitignore", template!("common/gitignore")),
];

/// What is particular to a language.
struct Kit {
    name: &'static str,
    files: &'static [File],
    /// The words in the templates, and what stands for them.
    words: &'static [(&'static str, &'static str)],
}

const PYTHON: Kit = Kit {
    name: "Python",
    files: &[
        ("robot.py", template!("python/robot.py")),
        ("driver.py", template!("python/driver.py")),
        ("test_robot.py", template!("python/test_robot.py")),
        ("requirements.txt", template!("python/requirements.txt")),
    ],
    words: &[
        ("MAIN-FILE", "robot.py"),
        ("DRIVER-FILE", "driver.py"),
        ("TEST-FILE", "test_robot.py"),
        ("TEST-COMMAND", ".venv/bin/python -m unittest"),
        (
            "INSTALL",
            "python3 -m venv .venv && .venv/bin/pip install -r requirements.txt",
        ),
        ("RUN", ".venv/bin/python robot.py"),
        ("EXEC-START", "/opt/newbot/.venv/bin/python robot.py"),
        ("HUB-ADDRESS", "mom://127.0.0.1:7666"),
    ],
};

const JAVASCRIPT: Kit = Kit {
    name: "JavaScript",
    files: &[
        ("robot.mjs", template!("javascript/robot.mjs")),
        ("driver.mjs", template!("javascript/driver.mjs")),
        ("robot.test.mjs", template!("javascript/robot.test.mjs")),
        ("package.json", template!("javascript/package.json")),
    ],
    words: &[
        ("MAIN-FILE", "robot.mjs"),
        ("DRIVER-FILE", "driver.mjs"),
        ("TEST-FILE", "robot.test.mjs"),
        ("TEST-COMMAND", "npm test"),
        ("INSTALL", "npm install"),
        ("RUN", "node robot.mjs"),
        ("EXEC-START", "/usr/bin/node robot.mjs"),
        ("HUB-ADDRESS", "mom://127.0.0.1:7666"),
    ],
};

const RUST: Kit = Kit {
    name: "Rust",
    files: &[
        ("src/main.rs", template!("rust/src/main.rs")),
        ("src/driver.rs", template!("rust/src/driver.rs")),
        ("tests/robot.rs", template!("rust/tests/robot.rs")),
        ("Cargo.toml", template!("rust/Cargo.toml.in")),
    ],
    words: &[
        ("MAIN-FILE", "src/main.rs"),
        ("DRIVER-FILE", "src/driver.rs"),
        ("TEST-FILE", "tests/robot.rs"),
        ("TEST-COMMAND", "cargo test"),
        ("INSTALL", "cargo build --release"),
        ("RUN", "cargo run --release"),
        ("EXEC-START", "/opt/newbot/target/release/newbot"),
        ("HUB-ADDRESS", "bin://127.0.0.1:7666"),
    ],
};

pub(crate) fn run(command: &NewCommand, output: Output) -> Result<(), Failure> {
    let NewCommand::Device(args) = command;
    device(args, output)
}

fn device(args: &NewDeviceArgs, output: Output) -> Result<(), Failure> {
    let folder = args.out.clone().unwrap_or_else(|| PathBuf::from(&args.name));
    let is_free = match fs::read_dir(&folder) {
        Ok(mut files) => files.next().is_none(),
        // Also one that leads nowhere.
        Err(_) => fs::symlink_metadata(&folder).is_err(),
    };
    if !is_free {
        return Err(Failure::usage(
            format!("{} exists, and is not an empty folder", folder.display()),
            "choose another folder with --out FOLDER",
        ));
    }
    let checkout = checkout(args)?;
    let kit = match args.lang {
        Language::Python => PYTHON,
        Language::Javascript => JAVASCRIPT,
        Language::Rust => RUST,
    };
    let clients = clients(args.lang, checkout.as_deref());
    let mut files = Vec::new();
    let mut write = |name: &str, text: &str, is_secret: bool| {
        let name = name.replace(PLACEHOLDER, &args.name);
        put(&folder.join(&name), text, is_secret).map_err(|error| {
            Failure::plain(format!("cannot write {}: {error}", folder.join(&name).display()))
        })?;
        files.push(name);
        Ok::<(), Failure>(())
    };
    for (name, text) in kit.files.iter().chain(COMMON) {
        let mut text = (*text).to_owned();
        for (word, is) in kit.words.iter().copied().chain([("LANGUAGE", kit.name)]) {
            text = text.replace(word, is);
        }
        for (word, is) in &clients {
            text = text.replace(word, is);
        }
        write(name, &text.replace(PLACEHOLDER, &args.name), false)?;
    }
    let key = Key::generate().doing("make a key")?;
    let password = password()?;
    write("newbot.key", &key.to_pem(), true)?;
    write("operator.password", &format!("{password}\n"), true)?;
    let hash = mom_broker::hash(&password).map_err(Failure::plain)?;
    let users = format!(
        "# The users of hub.toml: the device, by its key, and who drives it.\n\n\
         [[users]]\nname = \"{}\"\nkeys = [\"{}\"]\nlevel = 0\ngroups = [\"device\"]\n\n\
         [[users]]\nname = \"operator\"\npassword = \"{hash}\"\nlevel = 1\ngroups = []\n",
        args.name,
        key.public(),
    );
    write("users.toml", &users, true)?;
    let place = folder.display().to_string();
    let lines = || next_steps(&place, &kit, &args.name, checkout.is_some());
    output.tell(
        || json!({"folder": place, "language": kit.name, "files": files}),
        lines,
    )?;
    Ok(())
}

/// A word as a shell reads it, whatever stands in it.
fn quoted(word: &str) -> String {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "/._-".contains(letter);
    match word.chars().all(is_plain) {
        true => word.to_owned(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}

/// What to do with it.
fn next_steps(place: &str, kit: &Kit, name: &str, has_checkout: bool) -> String {
    let word = |wanted: &str| {
        kit.words
            .iter()
            .find(|(word, _)| *word == wanted)
            .map_or("", |(_, is)| is)
    };
    let (install, run, test) = (word("INSTALL"), word("RUN"), word("TEST-COMMAND"));
    let place_name = ink(place, Tone::Strong);
    let published = match has_checkout {
        true => "",
        false => {
            "\nIts packages are those that are published; --from CHECKOUT takes them from a checkout of MOM."
        }
    };
    format!(
        "{place_name}/ has a robot on two wheels in {}, on simulated motors.

  cd {}
  {install}
  mom-broker --config hub.toml             the hub, until Ctrl-C; with the console: http://127.0.0.1:7666
  {run:<40} the robot, in another terminal

  export MOM_USER=operator MOM_PASSWORD=$(cat operator.password)
  mom card /{name}/robot
  echo 'drive 300; turn 90' | mom run --channel /{name}/robot --token /{name}/token -

  {test:<40} drives it and stops it through a hub of its own
{published}
README.md in it says what each file is, and what to do next.",
        kit.name,
        quoted(place)
    )
}

/// The checkout whose clients the device uses, if there is one.
fn checkout(args: &NewDeviceArgs) -> Result<Option<PathBuf>, Failure> {
    let is_checkout = |folder: &Path| folder.join("clients/python/pyproject.toml").is_file();
    if let Some(folder) = &args.from {
        let absolute = folder.canonicalize().ok().filter(|folder| is_checkout(folder));
        return absolute.map(Some).ok_or_else(|| {
            Failure::usage(
                format!(
                    "{} is not a checkout of MOM: clients/python is not there",
                    folder.display()
                ),
                "name the folder that has the README of MOM",
            )
        });
    }
    // target/debug/mom
    let program = std::env::current_exe().ok();
    let above = program.as_deref().and_then(|program| program.ancestors().nth(3));
    Ok(above.filter(|folder| is_checkout(folder)).map(Path::to_owned))
}

/// What stands in the templates for the client and where its documents are.
fn clients(language: Language, checkout: Option<&Path>) -> Vec<(&'static str, String)> {
    let docs = match checkout {
        Some(folder) => folder.display().to_string(),
        None => "mom".to_owned(),
    };
    let version = env!("CARGO_PKG_VERSION");
    let at = |below: &str| checkout.map(|folder| folder.join(below).display().to_string());
    let krate = |below: &str| match at(below) {
        // Quoted as TOML has it, whatever stands in the path.
        Some(path) => format!("{{ path = {path:?} }}"),
        None => format!("{version:?}"),
    };
    let mut words = vec![("DOCS", docs)];
    words.extend(match language {
        Language::Python => vec![(
            "CLIENT",
            match at("clients/python") {
                Some(path) => format!("mom-client[keys] @ file://{path}"),
                None => format!("mom-client[keys]~={version}"),
            },
        )],
        Language::Javascript => vec![(
            "CLIENT",
            at("clients/js").map_or_else(|| format!("~{version}"), |path| format!("file:{path}")),
        )],
        Language::Rust => vec![
            ("CLIENT", krate("mom-client")),
            ("DEVICE", krate("kit/device")),
            ("PROGRAM", krate("kit/program")),
        ],
    });
    words
}

/// Some 120 bits.
fn password() -> Result<String, Failure> {
    const LETTERS: &[u8; 32] = b"abcdefghijkmnpqrstuvwxyz23456789";
    let mut bytes = [0; 24];
    getrandom::fill(&mut bytes).map_err(|error| Failure::plain(format!("no random numbers: {error}")))?;
    Ok(bytes
        .iter()
        .map(|byte| char::from(LETTERS[usize::from(byte % 32)]))
        .collect())
}

fn put(file: &Path, text: &str, is_secret: bool) -> io::Result<()> {
    if let Some(folder) = file.parent() {
        fs::create_dir_all(folder)?;
    }
    match is_secret {
        true => write_new(file, text),
        false => fs::write(file, text),
    }
}
