//! `mom new`: what a developer begins with.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

/// `mom new`
#[derive(Subcommand, Debug)]
pub(crate) enum NewCommand {
    /// Make a folder with a device that runs: its program, simulated motors, a hub to try it at, a test
    #[command(after_help = DEVICE)]
    Device(NewDeviceArgs),
}

/// `mom new device`
#[derive(Args, Debug)]
pub(crate) struct NewDeviceArgs {
    /// What it is called: its user, its session /NAME, its folder
    #[arg(value_name = "NAME", value_parser = name)]
    pub(crate) name: String,
    /// The language of its program
    #[arg(long, value_enum, default_value_t = Language::Python)]
    pub(crate) lang: Language,
    /// The folder, instead of one of its name
    #[arg(long, value_name = "FOLDER")]
    pub(crate) out: Option<PathBuf>,
    /// A checkout of MOM whose client it uses; without it, the one that this program was built in, or else the published packages
    #[arg(long, value_name = "FOLDER")]
    pub(crate) from: Option<PathBuf>,
}

/// A language that has the kit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Language {
    /// Python 3.9 or later
    Python,
    /// JavaScript in Node 20 or later
    #[value(alias = "js")]
    Javascript,
    /// Rust
    Rust,
}

pub(super) const NEW: &str = "\
Examples:
  mom new device cart                      in Python, in the folder cart
  mom new device --help                    what else can be said";

const DEVICE: &str = "\
Examples:
  mom new device cart                      in Python, in the folder cart
  mom new device cart --lang rust --out robots/cart
  mom new device lift --lang js --from ~/mom

It drives on simulated motors at once; README.md in the folder says how to run it, and what to do next.";

/// A name that is a user, a part of a path, and a package.
fn name(text: &str) -> Result<String, String> {
    let is_right = text.len() <= 32
        && text.starts_with(|first: char| first.is_ascii_lowercase())
        && text
            .chars()
            .all(|letter| letter.is_ascii_lowercase() || letter.is_ascii_digit() || letter == '-');
    match (is_right, text) {
        (
            _,
            "operator" | "token" | "house" | "device" | "test" | "build" | "deps" | "examples"
            | "incremental",
        ) => Err(format!("`{text}` has a meaning of its own in what is made")),
        _ if text == "mom" || text.starts_with("mom-") => {
            Err("names that begin with `mom-` are those of MOM's own packages".to_owned())
        }
        (true, _) => Ok(text.to_owned()),
        (false, _) => Err("a name has 1 to 32 of a-z, 0-9 and -, and begins with a letter".to_owned()),
    }
}
