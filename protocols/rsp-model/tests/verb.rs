//! `mom rsp` and the helper of build scripts.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Parser as _;
use mom_rsp_model::Model;
use mom_rsp_model::generate::{self, Ends};
use mom_rsp_model::verb::{self, RspFailure, VerbArgs};
use serde_json::Value;

#[derive(Debug, clap::Parser)]
struct Cli {
    #[command(flatten)]
    verb: VerbArgs,
}

fn config(name: &str) -> String {
    let file = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../config")
        .join(name);
    file.display().to_string()
}

/// What it tells, or how it fails.
fn run(args: &[&str]) -> Result<Vec<(Value, String)>, RspFailure> {
    let cli = Cli::parse_from([&["rsp"], args].concat());
    let mut told = Vec::new();
    verb::run(&cli.verb, &mut |json, line| {
        told.push((json, line));
        Ok(())
    })?;
    Ok(told)
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    // What an earlier run left must not help.
    let _ = fs::remove_dir_all(&folder);
    folder
}

#[test]
fn check_says_what_the_packets_cost() {
    let told = run(&["check", &config("cubo.toml")]).unwrap();
    let [(json, line)] = told.as_slice() else {
        panic!("{told:?}");
    };
    let model = Model::read(&fs::read_to_string(config("cubo.toml")).unwrap()).unwrap();
    let hash: String = model.hash().iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(json["hash"], hash.as_str());
    assert_eq!(json["down"]["bytes"], 1999);
    assert_eq!(json["down"]["bytes_per_second"], 99_950);
    assert_eq!(json["up"]["bytes"], 700);
    assert!(
        line.contains(&hash) && line.contains("1999 B") && line.contains("20 ms"),
        "{line}"
    );
}

#[test]
fn generate_writes_what_is_asked_for() {
    let folder = folder("verb");
    let out = folder.display().to_string();
    let told = run(&["generate", &config("ir-robot.toml"), "--out", &out]).unwrap();
    assert_eq!(told.len(), 3);
    let model = Model::read(&fs::read_to_string(config("ir-robot.toml")).unwrap()).unwrap();
    let written = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
    assert_eq!(written("ir-robot.rs"), generate::rust(&model));
    assert_eq!(written("ir-robot.h"), generate::c(&model));
    assert_eq!(written("ir-robot.md"), generate::markdown(&model));

    let library = folder.join("c");
    let told = run(&[
        "generate",
        &config("ir-robot.toml"),
        "--c-library",
        &library.display().to_string(),
    ])
    .unwrap();
    assert_eq!(told.len(), generate::library().len());
    for (name, text) in generate::library() {
        assert_eq!(fs::read_to_string(library.join(name)).unwrap(), text);
    }

    let file = folder.join("only.rs").display().to_string();
    run(&[
        "generate",
        &config("ir-robot.toml"),
        "--rust",
        &file,
        "--ends",
        "robot",
    ])
    .unwrap();
    let robot = written("only.rs");
    assert_eq!(robot, generate::rust_for(&model, Ends::Robot));
    assert!(robot.contains("pub mod robot {") && !robot.contains("pub mod middle {"));
    let middle = generate::rust_for(&model, Ends::Middle);
    assert!(middle.contains("pub mod middle {") && !middle.contains("pub mod robot {"));
}

#[test]
fn import_makes_a_model_of_a_drawing() {
    let xmi = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/ir-robot.xmi");
    let told = run(&["import", &xmi.display().to_string()]).unwrap();
    let drawn = Model::read(&told[0].1).unwrap();
    let written = Model::read(&fs::read_to_string(config("ir-robot.toml")).unwrap()).unwrap();
    assert_eq!(drawn.hash(), written.hash());
}

#[test]
fn failures_say_which_file_and_where() {
    let failure = |args: &[&str]| match run(args) {
        Err(RspFailure::Failed { text, hint }) => (text, hint),
        other => panic!("{other:?}"),
    };
    let folder = folder("verb-failures");
    fs::create_dir_all(&folder).unwrap();
    let file = folder.join("x.toml").display().to_string();
    assert!(
        failure(&["check", &file])
            .0
            .starts_with(&format!("cannot read {file}: "))
    );
    let sensor = "id = 7\n[[element]]\nname = \"heat\"\nkind = \"sensor\"\ntype = \"u8\"\n";
    fs::write(&file, format!("nome = \"x\"\n{sensor}")).unwrap();
    assert_eq!(
        failure(&["check", &file]).0,
        format!("{file}: line 1, column 1: there is no key `nome`; did you mean `name`?")
    );
    fs::write(&file, format!("name = \"X\"\n{sensor}uint = \"K\"\n")).unwrap();
    assert_eq!(
        failure(&["check", &file]).0,
        format!(
            "{file}: 2 mistakes\n  line 1, column 8: `X` is not a name: lower-case letters and digits, a letter first, `-` between them, at most 48\n  \
             line 7, column 1: there is no key `uint`; did you mean `unit`?"
        )
    );
    let (text, hint) = failure(&["generate", &config("cubo.toml")]);
    assert_eq!(text, "nothing is to be written");
    assert!(hint.unwrap().contains("--out"));
    let nowhere = folder.join("no/such.rs").display().to_string();
    let (text, _) = failure(&["generate", &config("cubo.toml"), "--rust", &nowhere]);
    assert!(text.starts_with(&format!("cannot write {nowhere}: ")), "{text}");
}
