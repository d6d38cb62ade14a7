//! How much code a robot needs: the generated end of CUBO's model, without cipher and audio, as for a microcontroller (S1, S25).
#![cfg(all(target_os = "linux", target_arch = "x86_64"))]

use std::fs;
use std::path::Path;
use std::process::Command;

use mom_rsp_model::Model;
use mom_rsp_model::generate::{Ends, rust_for};

/// The goal is 16 KiB of code, which the compiler of today keeps by 1 %; another one may need a little more.
const CODE: usize = 17 * 1024;
/// The most bytes of constants: what there is, and a little more, so that growth is seen.
const CONSTANTS: usize = 3 * 1024;

const MANIFEST: &str = r#"
[package]
name = "footprint"
edition = "2024"

[dependencies]
mom-rsp = { path = "RSP" }

[profile.release]
opt-level = "z"
lto = true
codegen-units = 1
panic = "abort"
strip = true

[workspace]
"#;

/// All that a robot's program calls, and the four functions that a system's library has.
const PROGRAM: &str = r#"
#![no_std]
#![no_main]

#[allow(dead_code, reason = "what nobody calls is not in the program either")]
mod cubo {
    include!("cubo.rs");
}

use core::hint::black_box;
use cubo::robot::{self, Body, Dispatch, PACKET, Robot};
use cubo::units::{MmPerS, Percent};

struct Motors;

impl Body for Motors {
    fn random(&mut self, bytes: &mut [u8]) { black_box(bytes); }
    fn set_left_wheel(&mut self, value: MmPerS) { black_box(value); }
    fn set_right_wheel(&mut self, value: MmPerS) { black_box(value); }
    fn set_joints(&mut self, value: cubo::elements::Joints) { black_box(value); }
    fn set_lips(&mut self, value: Percent) { black_box(value); }
    fn set_speaker(&mut self, bytes: &[u8]) { black_box(bytes); }
    fn run_gesture(&mut self, value: u8) { black_box(value); }
}

#[unsafe(no_mangle)]
pub extern "C" fn _start() -> ! {
    let mut packet = [0; PACKET];
    let Ok(mut end) = Robot::<8>::new(&cubo::LAYOUT, Default::default()) else { loop {} };
    loop {
        let now = black_box(0);
        if let Some(datagram) = packet.get_mut(..black_box(34)) {
            let _ = black_box(end.receive(now, datagram, &mut Dispatch(&mut Motors)));
        }
        let _ = black_box(robot::tell_pose(&mut end, black_box(Default::default())));
        let _ = black_box(robot::tell_posture(&mut end, black_box(Default::default())));
        let _ = black_box(robot::tell_surroundings(&mut end, black_box(Default::default())));
        let _ = black_box(robot::raise_message_recorded(&mut end, black_box(Default::default())));
        let _ = black_box(robot::raise_service_button(&mut end));
        while let Some(length) = end.poll(now, &mut packet, &mut Dispatch(&mut Motors)) {
            black_box(packet.get(..length));
        }
    }
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! { loop {} }

#[unsafe(no_mangle)]
pub unsafe extern "C" fn memcpy(to: *mut u8, from: *const u8, count: usize) -> *mut u8 {
    for at in 0..count { unsafe { to.add(at).write_volatile(from.add(at).read()) } }
    to
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn memmove(to: *mut u8, from: *const u8, count: usize) -> *mut u8 {
    for at in 0..count {
        let at = if (to as usize) < from as usize { at } else { count - 1 - at };
        unsafe { to.add(at).write_volatile(from.add(at).read()) }
    }
    to
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn memset(to: *mut u8, byte: i32, count: usize) -> *mut u8 {
    for at in 0..count { unsafe { to.add(at).write_volatile(byte as u8) } }
    to
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn memcmp(one: *const u8, other: *const u8, count: usize) -> i32 {
    for at in 0..count {
        let (one, other) = unsafe { (one.add(at).read_volatile(), other.add(at).read()) };
        if one != other { return i32::from(one) - i32::from(other); }
    }
    0
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcmp(one: *const u8, other: *const u8, count: usize) -> i32 {
    unsafe { memcmp(one, other, count) }
}
"#;

#[test]
fn the_robots_end_of_cubo_stays_small() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let text = fs::read_to_string(root.join("config/cubo.toml")).unwrap();
    let model = Model::read(&text).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir(path("src")).unwrap();
    let rsp = root.join("protocols/rsp").canonicalize().unwrap();
    fs::write(path("Cargo.toml"), MANIFEST.replace("RSP", rsp.to_str().unwrap())).unwrap();
    // The versions that the workspace has, so that nothing is fetched.
    fs::copy(root.join("Cargo.lock"), path("Cargo.lock")).unwrap();
    fs::write(path("src/main.rs"), PROGRAM).unwrap();
    fs::write(path("src/cubo.rs"), rust_for(&model, Ends::Robot)).unwrap();
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let built = Command::new(cargo)
        .args(["build", "--quiet", "--release", "--target-dir"])
        .arg(path("target"))
        .current_dir(folder.path())
        .env(
            "RUSTFLAGS",
            "-C link-arg=-nostartfiles -C link-arg=-nostdlib -C link-arg=-static -C relocation-model=static",
        )
        .output()
        .unwrap();
    assert!(
        built.status.success(),
        "{}",
        String::from_utf8_lossy(&built.stderr)
    );
    let sizes = Command::new("size")
        .args(["-A", "-d"])
        .arg(path("target/release/footprint"))
        .output()
        .unwrap();
    let sizes = String::from_utf8(sizes.stdout).unwrap();
    let section = |name: &str| {
        let line = sizes
            .lines()
            .find(|line| line.split_whitespace().next() == Some(name));
        line.and_then(|line| line.split_whitespace().nth(1)?.parse::<usize>().ok())
    };
    let code = section(".text").unwrap_or_else(|| panic!("there is code: {sizes}"));
    let constants = section(".rodata").unwrap_or(0);
    println!("{code} B of code and {constants} B of constants");
    // All of it is there: nobody's end is so small.
    assert!(code > 8 * 1024, "{sizes}");
    assert!(
        code <= CODE && constants <= CONSTANTS,
        "{code} and {constants} B: {sizes}"
    );
}
