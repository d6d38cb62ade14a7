//! `mom-device`: the programs of robots, cameras and agents as one, which is small as they share almost all of it. Started by a
//! link of one of their names it is that program; otherwise its first argument says which.

mod choice;

use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::process::{ExitCode, Termination as _};

/// The gateway of a thousand robots has a lot of small pieces of memory, and gives what is free back to the system.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// The prefix of the links.
const PREFIX: &str = "mom-";
/// This program's own name.
const OWN: &str = "mom-device";
/// All programs, and what each is.
const PROGRAMS: &[(&str, &str)] = &include!("../names.rs");

/// A program, which takes its arguments, of which the first is its name.
type Program = fn(Vec<OsString>) -> ExitCode;

fn main() -> ExitCode {
    let mut args: Vec<OsString> = std::env::args_os().collect();
    let link = args.first().and_then(|path| Path::new(path).file_name());
    if let Some(program) = link.and_then(OsStr::to_str).and_then(program) {
        return program(args);
    }
    if let Some(written) = choice::pages(&args) {
        return written.report();
    }
    // Not read by clap, which would take the options of that program for its own.
    if let Some((word, program)) = args.get(1).and_then(|word| word.to_str()).and_then(chosen) {
        // So it names itself in its help.
        let name = format!("{OWN} {word}");
        args.splice(..2, [name.into()]);
        return program(args);
    }
    choice::tell(&args)
}

/// The program that this word means, as the first argument.
fn chosen(word: &str) -> Option<(&str, Program)> {
    program(&format!("{PREFIX}{word}")).map(|program| (word, program))
}

/// The program of this name.
fn program(name: &str) -> Option<Program> {
    Some(match name {
        "mom-arm" => |args| mom_arm::program::run(args).report(),
        "mom-camera" => |args| mom_camera::program::run(args).report(),
        "mom-model" => |args| mom_model::program::run(args).report(),
        "mom-servo" => |args| mom_servo::program::run(args).report(),
        "mom-mcp" => |args| mom_mcp::program::run(args).report(),
        "mom-linuxbot" => |args| mom_linuxbot::program::run(args).report(),
        "mom-base-station" => mom_base_station::program::run,
        "mom-gateway" => |args| mom_gateway::program::run(args).report(),
        "mom-rover" => |args| mom_rover::program::run(args).report(),
        "mom-cubo" => |args| mom_cubo::program::run(args).report(),
        "mom-simulacrum" => |args| mom_simulacrum::program::run(args).report(),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_name_of_the_list_is_a_program() {
        for (name, _) in PROGRAMS {
            assert!(program(name).is_some(), "{name}");
        }
        for other in [OWN, "mom", "arm", ""] {
            assert!(program(other).is_none(), "{other}");
        }
    }
}
