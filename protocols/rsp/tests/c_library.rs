//! The library in C by itself: its cipher, that it is C99 for all targets that are here, and how large it is.

mod common;

use std::path::Path;
use std::process::Command;

use common::c_end::{STRICT, compiler, compiles, folder, program, run, skip, sources};

/// Targets of microcontrollers: the compiler, and its options.
const TARGETS: [(&str, &[&str]); 4] = [
    ("arm-none-eabi-gcc", &["-mcpu=cortex-m4", "-mthumb"]),
    ("riscv64-unknown-elf-gcc", &["-march=rv32imac", "-mabi=ilp32"]),
    ("xtensa-esp32-elf-gcc", &[]),
    ("avr-gcc", &["-mmcu=atmega2560"]),
];

/// The most bytes of code and constants of the whole library with its cipher, at -Os on x86-64: what there is, and a little more.
const CODE: usize = 22 * 1024;

#[test]
fn the_portable_cipher_is_that_of_the_standards() {
    let Some(program) = program("c-crypto", &[folder().join("tests/crypto.c")], &[]) else {
        return;
    };
    // Vectors, and each bit of a sealed packet changed.
    assert_eq!(run(&program, ""), "867 checked\n");
}

/// Compiles all of the library into a folder; the objects.
fn objects(compiler: &str, options: &[&str], into: &str) -> Vec<std::path::PathBuf> {
    let to = Path::new(env!("CARGO_TARGET_TMPDIR")).join(into);
    std::fs::create_dir_all(&to).expect("a folder");
    let compile = |source: std::path::PathBuf| {
        let object = to.join(source.file_stem().expect("a name")).with_extension("o");
        let compiled = Command::new(compiler)
            .args(STRICT)
            .args(["-Wshadow", "-Wcast-qual", "-Wstrict-prototypes", "-Os", "-c"])
            .args(options)
            .arg(&source)
            .arg("-o")
            .arg(&object)
            .output()
            .expect("it is there");
        let said = String::from_utf8_lossy(&compiled.stderr);
        assert!(compiled.status.success(), "{}: {said}", source.display());
        object
    };
    sources().into_iter().map(compile).collect()
}

#[test]
fn it_is_small() {
    let Some(compiler) = compiler() else {
        return;
    };
    let objects = objects(compiler, &[], "c-host");
    let Ok(sizes) = Command::new("size").args(objects).output() else {
        return skip("the size of the library in C", "`size` is not installed");
    };
    let sizes = String::from_utf8_lossy(&sizes.stdout).into_owned();
    let texts = sizes
        .lines()
        .skip(1)
        .filter_map(|line| line.split_whitespace().next()?.parse::<usize>().ok());
    let code: usize = texts.sum();
    println!("{code} B of code and constants\n{sizes}");
    if cfg!(target_arch = "x86_64") {
        assert!((8 * 1024..=CODE).contains(&code), "{sizes}");
    }
}

#[test]
fn it_compiles_for_microcontrollers() {
    for (compiler, options) in TARGETS {
        let with = [options, &["-c"]].concat();
        if !compiles(compiler, &with, "#include <string.h>\n#include <stdint.h>") {
            skip(
                "a build of the library in C",
                &format!("`{compiler}` with its C library is not installed"),
            );
            continue;
        }
        objects(compiler, options, &format!("c-{compiler}"));
    }
    // A word of 32 bits, where the host's compiler has the library for it.
    if let Some(compiler) = compiler() {
        match compiles(
            compiler,
            &["-m32", "-c"],
            "#include <string.h>\n#include <stdint.h>",
        ) {
            true => drop(objects(compiler, &["-m32"], "c-32")),
            false => skip(
                "a build of the library in C with `-m32`",
                "its C library is not installed",
            ),
        }
    }
}
