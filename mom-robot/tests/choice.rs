//! How `mom-device` chooses its program: by the name that it is started by, or by its first argument.

use std::os::unix::fs::symlink;
use std::os::unix::process::CommandExt as _;
use std::process::{Command, Output};

/// All programs, and what each is.
const PROGRAMS: &[(&str, &str)] = &include!("../names.rs");

fn started_as(name: &str, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mom-device"));
    command
        .arg0(name)
        .args(args)
        .env_remove("MOM_FLEET")
        .env_remove("MOM_PASSWORD");
    command.output().expect("it starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// The words after `Usage:`.
fn usage(output: &Output) -> String {
    let all = text(&output.stdout) + &text(&output.stderr);
    let usage = all.lines().find_map(|line| line.strip_prefix("Usage: "));
    usage.unwrap_or_else(|| panic!("no usage: {all}")).to_owned()
}

#[test]
fn each_program_answers_to_its_link_and_to_its_word() {
    for (name, _) in PROGRAMS {
        let word = name.strip_prefix("mom-").expect("all begin so");
        let version = format!("{name} {}\n", env!("CARGO_PKG_VERSION"));
        for output in [
            started_as(name, &["--version"]),
            started_as(&format!("/usr/bin/{name}"), &["--version"]),
            started_as("mom-device", &[word, "--version"]),
        ] {
            assert!(output.status.success(), "{output:?}");
            assert_eq!(text(&output.stdout), version);
        }
        let linked = started_as(&format!("/usr/bin/{name}"), &["--help"]);
        assert!(
            linked.status.success() && usage(&linked).starts_with(&format!("{name} [OPTIONS]")),
            "{linked:?}"
        );
        let chosen = started_as("mom-device", &[word, "--help"]);
        let begins = format!("mom-device {word} [OPTIONS]");
        assert!(
            chosen.status.success() && usage(&chosen).starts_with(&begins),
            "{chosen:?}"
        );
        for wrong in [
            started_as(name, &["--nonsense"]),
            started_as("mom-device", &[word, "--nonsense"]),
        ] {
            assert_eq!(wrong.status.code(), Some(2), "{wrong:?}");
            assert!(text(&wrong.stderr).contains("'--nonsense'"), "{wrong:?}");
        }
    }
}

#[test]
fn a_real_link_is_the_program() {
    let folder = tempfile::tempdir().expect("a folder");
    let link = folder.path().join("mom-arm");
    symlink(env!("CARGO_BIN_EXE_mom-device"), &link).expect("a link");
    let output = Command::new(link)
        .env_remove("MOM_PASSWORD")
        .env_remove("RUST_BACKTRACE")
        .output()
        .expect("it starts");
    assert_eq!(output.status.code(), Some(1));
    let said = "Error: set MOM_PASSWORD, or name a file with --password-file or --key\n";
    assert_eq!(text(&output.stderr), said);
}

#[test]
fn without_a_program_all_of_them_are_told() {
    let all = |text: &str| {
        PROGRAMS
            .iter()
            .all(|(name, what)| text.contains(what) && text.contains(&name[4..]))
    };
    let none = started_as("mom-device", &[]);
    assert_eq!(none.status.code(), Some(2), "{none:?}");
    assert!(all(&text(&none.stderr)), "{none:?}");
    for help in ["--help", "-h"] {
        let help = started_as("mom-device", &[help]);
        assert!(help.status.success() && all(&text(&help.stdout)), "{help:?}");
        assert!(text(&help.stdout).contains("\nExamples:\n"), "{help:?}");
    }
    let version = started_as("mom-device", &["--version"]);
    assert_eq!(
        text(&version.stdout),
        format!("mom-device {}\n", env!("CARGO_PKG_VERSION"))
    );
    let wrong = started_as("mom-device", &["rovr", "--name", "a"]);
    let said = text(&wrong.stderr);
    assert_eq!(wrong.status.code(), Some(2), "{said}");
    assert!(
        said.contains("'rovr'") && said.contains("tip: a similar value exists: 'rover'") && all(&said),
        "{said}"
    );
    let other = started_as("mom-device", &["--nonsense"]);
    assert_eq!(other.status.code(), Some(2), "{other:?}");
    // Whatever it is renamed to.
    let renamed = started_as("/opt/robot", &["arm", "--version"]);
    assert!(
        renamed.status.success() && text(&renamed.stdout).starts_with("mom-arm "),
        "{renamed:?}"
    );
}

#[test]
fn each_program_writes_pages_of_its_own_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().to_str().expect("text");
    for name in PROGRAMS.iter().map(|(name, _)| *name).chain(["mom-device"]) {
        let written = started_as(name, &["--write-pages", path]);
        assert!(
            written.status.success() && written.stderr.is_empty(),
            "{written:?}"
        );
        for file in [
            format!("man/{name}.1"),
            format!("bash/{name}"),
            format!("zsh/_{name}"),
            format!("fish/{name}.fish"),
        ] {
            let written = std::fs::read_to_string(folder.path().join(&file)).expect("a page");
            assert!(written.contains(name), "{file}");
        }
    }
}
