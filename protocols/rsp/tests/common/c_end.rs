//! The library in C (`protocols/rsp-c`): compiled with the system's compiler, where there is one.

use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::{env, fs};

/// All that a compiler warns of is an error.
pub const STRICT: [&str; 6] = [
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Werror",
];
/// What is undefined or outside of an object ends a program.
pub const SANITIZED: [&str; 4] = [
    "-O1",
    "-g",
    "-fsanitize=address,undefined",
    "-fno-sanitize-recover=all",
];

/// The folder of the library.
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../rsp-c")
}

/// The library's C files.
pub fn sources() -> Vec<PathBuf> {
    files_of("c")
}

/// The library's headers.
pub fn headers() -> Vec<PathBuf> {
    files_of("h")
}

fn files_of(kind: &str) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = fs::read_dir(folder())
        .expect("the library")
        .map(|entry| entry.expect("a file").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == kind))
        .collect();
    files.sort();
    files
}

/// Says by name what a test leaves out; the test harness does not hold it back.
pub fn skip(what: &str, why: &str) {
    let _ = writeln!(std::io::stderr(), "skipped: {what}: {why}");
}

/// The compiler's name, where there is one.
pub fn compiler() -> Option<&'static str> {
    static NAME: OnceLock<Option<String>> = OnceLock::new();
    let found = NAME.get_or_init(|| {
        let name = env::var("CC").unwrap_or_else(|_| "cc".to_owned());
        let runs = compiles(&name, &[], "");
        if !runs {
            skip("what is in C", &format!("`{name}` makes no program here"));
        }
        runs.then_some(name)
    });
    found.as_deref()
}

/// Whether a compiler makes a program with these options.
pub fn compiles(compiler: &str, options: &[&str], before: &str) -> bool {
    let mut command = Command::new(compiler);
    command
        .args(options)
        .args(["-x", "c", "-o", "/dev/null", "-"])
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    let Ok(mut child) = command.spawn() else {
        return false;
    };
    let text = format!("{before}\nint main(void) {{ return 0; }}\n");
    let written = child
        .stdin
        .take()
        .map(|mut stdin| stdin.write_all(text.as_bytes()));
    written.is_some_and(|written| written.is_ok()) && child.wait().is_ok_and(|status| status.success())
}

/// The options that make a program stop at what is undefined or outside of an object; none where their library is missing.
pub fn sanitizers() -> &'static [&'static str] {
    static FOUND: OnceLock<bool> = OnceLock::new();
    let found = FOUND.get_or_init(|| {
        let has = compiler().is_some_and(|compiler| compiles(compiler, &SANITIZED, ""));
        if !has && compiler().is_some() {
            skip(
                "checks of addresses and undefined behaviour",
                "their library is not installed",
            );
        }
        has
    });
    if *found { &SANITIZED } else { &[] }
}

/// Compiles a program of these files, which may include these headers and the library's, with [`STRICT`] and [`SANITIZED`], and gives its
/// path; the same files are compiled once. `None` without a compiler.
///
/// # Panics
///
/// With what the compiler says, if it warns.
pub fn program(name: &str, inputs: &[PathBuf], included: &[PathBuf]) -> Option<PathBuf> {
    let compiler = compiler()?;
    let flags = [&STRICT[..], sanitizers()].concat();
    let mut hash = DefaultHasher::new();
    flags.hash(&mut hash);
    // What is included stands beside the sources of the library.
    for file in [inputs, included, &sources(), &headers()].concat() {
        fs::read(&file).expect("a source").hash(&mut hash);
    }
    let made = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{:016x}", hash.finish()));
    if made.exists() {
        return Some(made);
    }
    // Another test program may compile the same: what is there is whole.
    let begun = made.with_extension(format!("{}", std::process::id()));
    let compiled = Command::new(compiler)
        .args(&flags)
        .arg("-I")
        .arg(folder())
        .args(
            included
                .iter()
                .flat_map(|header| [Path::new("-I"), header.parent().expect("a folder")]),
        )
        .args(inputs)
        .arg("-lm")
        .arg("-o")
        .arg(&begun)
        .output()
        .expect("it ran before");
    let said = String::from_utf8_lossy(&compiled.stderr);
    assert!(compiled.status.success(), "{name}: {said}");
    fs::rename(&begun, &made).expect("the program");
    Some(made)
}

/// Runs a program in C on this input, and gives what it prints.
///
/// # Panics
///
/// If it fails, with what it says.
pub fn run(program: &Path, input: &str) -> String {
    run_on(program, input.as_bytes())
}

/// The same of a program that reads bytes.
pub fn run_on(program: &Path, input: &[u8]) -> String {
    let mut child = Command::new(program)
        .env("ASAN_OPTIONS", "detect_leaks=0")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it runs");
    let mut stdin = child.stdin.take().expect("an input");
    let ran = std::thread::scope(|scope| {
        scope.spawn(move || stdin.write_all(input));
        child.wait_with_output().expect("it ends")
    });
    let said = String::from_utf8_lossy(&ran.stderr);
    assert!(ran.status.success(), "{}: {said}", program.display());
    String::from_utf8(ran.stdout).expect("text")
}
