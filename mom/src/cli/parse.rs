//! Reads the command line, with the path of the hub's address.

use std::ffi::OsString;

use clap::{Command, CommandFactory as _, FromArgMatches as _};
use mom_client::Address;

use super::Cli;

/// Arguments that name the one place which a command is about.
const PLACES: [&str; 4] = ["path", "paths", "channel", "session"];

/// Reads the command line. A path in the hub's address, as in bin://lab/robot/arm, is that of a command which is given none.
pub(crate) fn parse() -> Cli {
    let lenient = Cli::command().ignore_errors(true).try_get_matches();
    let hub = lenient
        .ok()
        .and_then(|found| found.get_one::<String>("hub").cloned());
    // A wrong address is told by what connects to it; other commands do not need it.
    let path = hub.and_then(|hub| hub.parse::<Address>().ok()?.path);
    let mut command = match path {
        Some(path) => with_path(Cli::command(), path.as_str()),
        None => Cli::command(),
    };
    let cli = command
        .try_get_matches_from_mut(asks_a_device(std::env::args_os()))
        .and_then(|matches| Cli::from_arg_matches(&matches));
    cli.unwrap_or_else(|error| error.format(&mut command).exit())
}

/// `mom help /robot/arm` asks the device, as `mom card /robot/arm` does: no command has such a name. Elsewhere the word is not the command.
fn asks_a_device(args: impl Iterator<Item = OsString>) -> Vec<OsString> {
    let mut args: Vec<OsString> = args.collect();
    if let [_, help, path, ..] = &mut args[..]
        && help == "help"
        && path.to_string_lossy().starts_with('/')
    {
        *help = "card".into();
    }
    args
}

/// The same commands, about this place if none is given.
fn with_path(command: Command, path: &str) -> Command {
    // Defaults live as long as the program.
    let path: &'static str = path.to_owned().leak();
    command.mut_subcommands(|command| {
        // What follows its path is required, so the path cannot be left out.
        if command.get_name() == "send" {
            return command;
        }
        command.mut_args(|argument| match PLACES.contains(&argument.get_id().as_str()) {
            true => argument.required(false).default_value(path),
            false => argument,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::super::{Command as Verb, RunArgs, SnapArgs, TreeArgs, WatchArgs};
    use super::*;

    fn read(line: &[&str]) -> Result<Cli, clap::Error> {
        let line = [&["mom"], line].concat();
        let matches = with_path(Cli::command(), "/robot").try_get_matches_from(line)?;
        Cli::from_arg_matches(&matches)
    }

    #[test]
    fn help_on_a_path_is_the_card_of_a_device_and_the_word_in_a_message_is_not() {
        let asked = |line: &str| {
            let words = asks_a_device(line.split(' ').map(OsString::from));
            words.join(" ".as_ref()).into_string().expect("it was text")
        };
        for (line, expected) in [
            ("mom help /robot/arm --json", "mom card /robot/arm --json"),
            ("mom help run", "mom help run"),
            ("mom help", "mom help"),
            ("mom send /chat help /robot/arm", "mom send /chat help /robot/arm"),
        ] {
            assert_eq!(asked(line), expected);
        }
    }

    #[test]
    fn the_path_of_the_address_is_that_of_a_command_without_one() {
        with_path(Cli::command(), "/robot").debug_assert();
        for (line, expected) in [
            (&["tree"][..], "/robot"),
            (&["tree", "/"], "/"),
            (&["watch"], "/robot"),
            (&["watch", "/chat"], "/chat"),
            (&["run", "file"], "/robot"),
            (&["snap"], "/robot"),
        ] {
            let told = match read(line).expect("right").command {
                Verb::Tree(TreeArgs { path, .. }) => path,
                Verb::Watch(WatchArgs { paths, .. }) => paths.join(" "),
                Verb::Run(RunArgs { channel, .. }) => channel,
                Verb::Snap(SnapArgs { session, .. }) => session,
                other => panic!("{other:?}"),
            };
            assert_eq!(told, expected, "{line:?}");
        }
        for line in [&["grab"][..], &["give", "bob"], &["create", "token"], &["token"]] {
            assert!(read(line).is_ok(), "{line:?}");
        }
        assert!(read(&["send", "chat"]).is_err());
    }
}
