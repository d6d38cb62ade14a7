//! What `mom new device` makes runs at once, and its own test passes: it drives the robot and stops it through a hub of its own.

use std::path::Path;
use std::process::{Command, Output, Stdio};

use mom_tests::programs::{example, program, project};

/// A device in this language, made by the program that one would install, in a folder.
fn made(language: &str, name: &str, folder: &Path) -> String {
    let mut mom = Command::new(program("mom"));
    mom.args(["new", "device", name, "--lang", language, "--from"])
        .arg(project())
        .arg("--out")
        .arg(folder);
    let output = mom.output().expect("it starts");
    said(&output, "mom new device")
}

/// What a program said, which has to end well.
fn said(output: &Output, what: &str) -> String {
    let (out, err) = (
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
    assert!(output.status.success(), "{what}: {out}\n{err}");
    format!("{out}{err}")
}

/// A program in that folder, to which those of the project are installed.
fn beside(program_name: impl AsRef<std::ffi::OsStr>, folder: &Path) -> Command {
    let installed = program("mom");
    let path = std::env::var("PATH").unwrap_or_default();
    let programs = installed.parent().expect("a folder").display();
    program("mom-broker");
    let mut command = Command::new(program_name);
    command
        .current_dir(folder)
        .env("PATH", format!("{programs}:{path}"))
        .env_remove("MOM_HUB")
        .stdin(Stdio::null());
    command
}

#[test]
fn a_new_device_in_python_passes_its_own_test() {
    let folder = tempfile::tempdir().expect("a folder");
    let told = made("python", "cart", folder.path());
    assert!(told.contains("python -m unittest"), "{told}");
    let mut test = beside(project().join("target/python/bin/python"), folder.path());
    test.args(["-m", "unittest", "-v"])
        .env("PYTHONPATH", project().join("clients/python/src"));
    let said = said(&test.output().expect("it starts"), "its test");
    assert!(said.contains("Ran 4 tests"), "{said}");
}

#[test]
fn a_new_device_in_javascript_passes_its_own_test() {
    let folder = tempfile::tempdir().expect("a folder");
    made("js", "cart", folder.path());
    let packages = folder.path().join("node_modules");
    std::fs::create_dir(&packages).expect("made");
    std::os::unix::fs::symlink(project().join("clients/js"), packages.join("mom-client")).expect("linked");
    let mut test = beside("node", folder.path());
    test.args(["--test", "--test-reporter=tap"]);
    let said = said(&test.output().expect("it starts"), "its test");
    assert!(said.contains("# pass 4"), "{said}");
}

/// The same sources are an example of this workspace: what follows builds nothing but the test.
#[test]
fn a_new_device_in_rust_passes_its_own_test() {
    let folder = tempfile::tempdir().expect("a folder");
    made("rust", "newbot", folder.path());
    for file in ["src/main.rs", "src/driver.rs"] {
        let of_example = project().join("mom/templates/device/rust").join(file);
        assert_eq!(
            std::fs::read(folder.path().join(file)).expect("written"),
            std::fs::read(of_example).expect("a template")
        );
    }
    let manifest = std::fs::read_to_string(folder.path().join("Cargo.toml")).expect("written");
    for package in ["mom-client", "kit/device", "kit/program"] {
        let path = format!("path = {:?}", project().join(package).display().to_string());
        assert!(manifest.contains(&path), "{manifest}");
    }
    let mut compile = beside("rustc", folder.path());
    compile
        .args([
            "--test",
            "--edition",
            "2024",
            "tests/robot.rs",
            "-o",
            "robot-test",
        ])
        .env("CARGO_BIN_EXE_newbot", example("mom-program", "newbot"));
    said(&compile.output().expect("it starts"), "rustc");
    let mut test = beside(folder.path().join("robot-test"), folder.path());
    said(&test.output().expect("it starts"), "its test");
}

#[test]
fn what_is_made_is_a_right_configuration_with_its_secrets_kept() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().expect("a folder");
    made("python", "lift-2", folder.path());
    let mut check = beside(program("mom-broker"), folder.path());
    let told = said(
        &check.args(["check", "hub.toml"]).output().expect("it starts"),
        "check",
    );
    assert!(told.contains("device: lift-2"), "{told}");
    for secret in ["lift-2.key", "operator.password", "users.toml"] {
        let metadata = std::fs::metadata(folder.path().join(secret)).expect("written");
        assert_eq!(metadata.permissions().mode() & 0o777, 0o600, "{secret}");
        if secret == "users.toml" {
            continue;
        }
        let ignored = std::fs::read_to_string(folder.path().join(".gitignore")).expect("written");
        assert!(ignored.lines().any(|line| line == secret), "{ignored}");
    }
    // Nothing of the template is left.
    for file in [
        "README.md",
        "robot.py",
        "hub.toml",
        "lift-2.service",
        "requirements.txt",
    ] {
        let text = std::fs::read_to_string(folder.path().join(file)).expect("written");
        for word in [
            "newbot",
            "MAIN-FILE",
            "HUB-ADDRESS",
            "EXEC-START",
            "CLIENT",
            "LANGUAGE",
            "INSTALL",
        ] {
            assert!(!text.contains(word), "{word} in {file}: {text}");
        }
    }
    // What is there is not written over.
    let again = Command::new(program("mom"))
        .args(["new", "device", "lift-2", "--out"])
        .arg(folder.path())
        .output()
        .expect("it starts");
    assert_eq!(again.status.code(), Some(2));
    for name in ["Lift", "2lift", "operator", "a/b", "mom-client", "build", ""] {
        let wrong = Command::new(program("mom"))
            .args(["new", "device", name])
            .output();
        assert_eq!(wrong.expect("it starts").status.code(), Some(2), "{name}");
    }
}
