//! What `mom-device` says where none of its programs is named.

use std::ffi::OsString;
use std::io;
use std::process::ExitCode;

use clap::builder::{PossibleValue, PossibleValuesParser};
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Arg, Command, CommandFactory};
use mom_nearest::nearest;

use crate::{OWN, PREFIX, PROGRAMS};

/// The command line of the choice alone.
struct Choice;

impl CommandFactory for Choice {
    fn command() -> Command {
        let names = PROGRAMS
            .iter()
            .map(|(name, what)| PossibleValue::new(word(name)).help(*what));
        Command::new(OWN)
            .version(env!("CARGO_PKG_VERSION"))
            .about("The programs of robots, cameras and agents: each also by a link of its name, such as mom-arm.")
            .after_help(list())
            .arg_required_else_help(true)
            .arg(
                Arg::new("program")
                    .value_name("PROGRAM")
                    .required(true)
                    .value_parser(PossibleValuesParser::new(names))
                    .hide_possible_values(true)
                    .help("Which of them, as listed below"),
            )
            .arg(
                Arg::new("options")
                    .value_name("OPTIONS")
                    .num_args(0..)
                    .trailing_var_arg(true)
                    .allow_hyphen_values(true)
                    .help("Its options: mom-device PROGRAM --help tells them"),
            )
    }

    fn command_for_update() -> Command {
        Choice::command()
    }
}

/// Writes the pages of this program if they are asked for.
pub(crate) fn pages(args: &[OsString]) -> Option<io::Result<()>> {
    mom_pages::asked::<Choice>(args)
}

/// Says which programs there are, or that there is none of this name.
pub(crate) fn tell(args: &[OsString]) -> ExitCode {
    let error = match Choice::command().try_get_matches_from(args) {
        Err(error) => error,
        // Behind `--`, as no program's name is.
        Ok(_) => Choice::command().error(ErrorKind::InvalidValue, "the program's name comes first"),
    };
    ExitCode::from(u8::try_from(said(error)).unwrap_or(1))
}

/// Writes it to where clap does, with the list where a name is wrong; the exit code.
fn said(mut error: clap::Error) -> i32 {
    if error.kind() == ErrorKind::InvalidValue {
        // The list says what each is.
        error.insert(ContextKind::ValidValue, ContextValue::Strings(Vec::new()));
        // As everywhere else; clap's own measure takes `amr` for `camera`.
        error.remove(ContextKind::SuggestedValue);
        let given = error.get(ContextKind::InvalidValue).map(ToString::to_string);
        let known = PROGRAMS.iter().map(|(name, _)| word(name));
        if let Some(meant) = given.and_then(|given| nearest(&given, known)) {
            error.insert(
                ContextKind::SuggestedValue,
                ContextValue::String(meant.to_owned()),
            );
        }
        // The exit code tells even where nothing can be written.
        let _ = error.print();
        let _ = io::Write::write_fmt(&mut io::stderr(), format_args!("\n{}\n", list()));
    } else {
        let _ = error.print();
    }
    error.exit_code()
}

fn word(name: &str) -> &str {
    name.strip_prefix(PREFIX).unwrap_or(name)
}

/// The programs, a line for each, and examples.
fn list() -> String {
    let mut text = String::from("Programs:\n");
    for (name, what) in PROGRAMS {
        text.push_str(&format!("  {:<13} {what}\n", word(name)));
    }
    text.push_str(
        "
Examples:
  MOM_PASSWORD=arm mom-device arm --hub bin://127.0.0.1:7666
  mom-device linuxbot --listen 0.0.0.0:4000 --allow 192.168.1.5
  mom-device base-station --help
  ln -s mom-device mom-arm      # mom-arm is then mom-device arm",
    );
    text
}
