//! What is generated from the two models, and from two that are for tests alone, stands in `golden`, where everybody can look at it; `tests/typed.rs` compiles the Rust.
//!
//! After a change that is meant, `MOM_GOLDEN=write cargo test -p mom-rsp-model --test golden` writes it anew.

use std::path::Path;
use std::process::{Command, Stdio};
use std::{env, fs};

use mom_rsp_model::{Model, generate};

const MODELS: [(&str, &str); 4] = [
    ("cubo", include_str!("../../../config/cubo.toml")),
    ("ir-robot", include_str!("../../../config/ir-robot.toml")),
    ("kinds", include_str!("golden/kinds.toml")),
    ("bare", include_str!("golden/bare.toml")),
];

#[test]
fn what_is_generated_is_what_stands_there() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    for (index, (name, text)) in MODELS.into_iter().enumerate() {
        let model = Model::read(text).unwrap();
        let made = [
            ("rs.txt", generate::rust(&model)),
            ("h", generate::c(&model)),
            ("md", generate::markdown(&model)),
        ];
        // Of the models for tests only the Rust is compiled from here.
        let count = if index < 2 { 3 } else { 1 };
        for (ending, made) in made.into_iter().take(count) {
            let file = folder.join(format!("{name}.{ending}"));
            if env::var_os("MOM_GOLDEN").is_some() {
                fs::write(&file, &made).unwrap();
            }
            let stands = fs::read_to_string(&file).unwrap();
            assert!(
                stands == made,
                "{} differs from what is generated",
                file.display()
            );
        }
    }
}

/// Generated Rust is read by people: it is written as rustfmt would write it.
#[test]
fn generated_rust_is_formatted() {
    for (name, text) in MODELS.into_iter().take(2) {
        let made = generate::rust(&Model::read(text).unwrap());
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
        let file = folder.join(format!("format-{name}.rs"));
        fs::write(&file, &made).unwrap();
        let formatted = Command::new("rustfmt")
            .args(["--edition", "2024", "--check", "--config-path", "/dev/null"])
            .arg(&file)
            .stdin(Stdio::null())
            .output()
            .expect("rustfmt comes with the toolchain");
        assert!(
            formatted.status.success(),
            "{}",
            String::from_utf8_lossy(&formatted.stdout)
        );
    }
}
