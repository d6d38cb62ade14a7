//! What a shell offers to complete: the hub's contexts, and statements by the card of the device that is meant.

use std::any::TypeId;
use std::ffi::OsStr;
use std::time::Duration;
use std::{env, iter};

use clap::builder::StyledStr;
use clap::{ArgMatches, Command, CommandFactory, FromArgMatches as _};
use clap_complete::engine::{ArgValueCompleter, CompletionCandidate};
use mom_client::{CardVerb, Client, ContextInfo, ContextKind, Path};
use tokio::time::timeout;

use crate::cli::{Cli, GlobalArgs};
use crate::connect::{Stay, connect};

/// Who presses a key waits no longer for the hub.
const PATIENCE: Duration = Duration::from_millis(1500);

/// Contexts that are asked for; a shell shows no more in any useful way.
const MOST: usize = 500;

/// Commands whose path is that of a token.
const OF_TOKENS: [&str; 8] = [
    "accept", "break", "decline", "give", "grab", "inhibit", "request", "token",
];

/// The command line with what completes its arguments.
pub(crate) struct Completed;

impl CommandFactory for Completed {
    fn command() -> Command {
        with_completers(Cli::command())
    }

    fn command_for_update() -> Command {
        Self::command()
    }
}

/// What an argument names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Names {
    Context(Option<ContextKind>),
    Statements,
}

impl Names {
    fn of(command: &str, arg: &clap::Arg) -> Option<Names> {
        let only = |kind| Some(Names::Context(Some(kind)));
        match arg.get_id().as_str() {
            "path" | "paths" if OF_TOKENS.contains(&command) => only(ContextKind::Token),
            "token" | "guard" | "zones" => only(ContextKind::Token),
            "channel" | "robot" | "agent" => only(ContextKind::Channel),
            "session" => only(ContextKind::Session),
            "path" | "paths" => Some(Names::Context(None)),
            "script" if arg.get_value_parser().type_id() == TypeId::of::<String>() => Some(Names::Statements),
            _ => None,
        }
    }
}

fn with_completers(command: Command) -> Command {
    let name = command.get_name().to_owned();
    let with = |arg: clap::Arg| match Names::of(&name, &arg) {
        Some(names) => arg.add(ArgValueCompleter::new(move |word: &OsStr| complete(names, word))),
        None => arg,
    };
    command.mut_args(with).mut_subcommands(with_completers)
}

/// Nothing where the hub does not answer: a shell has no place for an error.
fn complete(names: Names, word: &OsStr) -> Vec<CompletionCandidate> {
    let Some((word, line)) = word.to_str().zip(typed()) else {
        return Vec::new();
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let Some((runtime, mut global)) = runtime.ok().zip(GlobalArgs::from_arg_matches(&line).ok()) else {
        return Vec::new();
    };
    // Nothing has failed that anybody was told of.
    global.report = false;
    // It would ask for the password in the middle of the line.
    let asks = global.key.is_none()
        && global.jwt.is_none()
        && !global.guest
        && env::var_os("MOM_PASSWORD").is_none();
    if asks {
        return Vec::new();
    }
    let asks = async {
        let client = connect(&global, Stay::Once).await.ok()?;
        let found = match names {
            Names::Context(kind) => contexts(&client, kind, word).await,
            Names::Statements => statements(&client, &device(&line)?, word).await,
        };
        client.close().await;
        Some(found)
    };
    let found = runtime.block_on(async { timeout(PATIENCE, asks).await });
    found.ok().flatten().unwrap_or_default()
}

/// What has been typed, as far as it makes sense: this program is started with it behind `--`.
fn typed() -> Option<ArgMatches> {
    let words = env::args_os().skip_while(|word| word != "--").skip(1);
    Cli::command()
        .ignore_errors(true)
        .try_get_matches_from(words)
        .ok()
}

/// The channel of the device that the command drives.
fn device(line: &ArgMatches) -> Option<String> {
    let innermost = iter::successors(Some(line), |matches| Some(matches.subcommand()?.1)).last()?;
    innermost.try_get_one::<String>("channel").ok()?.cloned()
}

/// The contexts whose paths begin so, or that lead there.
async fn contexts(client: &Client, kind: Option<ContextKind>, word: &str) -> Vec<CompletionCandidate> {
    let mut found = Vec::new();
    let mut sessions = vec![Path::root()];
    while let Some(session) = sessions.pop() {
        // Where this user may not look, nothing is offered.
        let mut below = client.list(session.as_str()).await.unwrap_or_default();
        below.retain(|context| {
            let path = context.path.as_str();
            path.starts_with(word) || word.starts_with(path)
        });
        let is_session = |context: &&ContextInfo| context.kind == ContextKind::Session;
        sessions.extend(
            below
                .iter()
                .filter(is_session)
                .map(|context| context.path.clone()),
        );
        found.extend(
            below
                .into_iter()
                .filter(|context| context.path.as_str().starts_with(word)),
        );
        if found.len() > MOST {
            break;
        }
    }
    found.retain(|context| kind.is_none_or(|kind| kind == context.kind));
    let shown = |context: &ContextInfo| {
        CompletionCandidate::new(context.path.as_str()).help(Some(StyledStr::from(context.kind.word())))
    };
    found.iter().map(shown).collect()
}

/// The statements that the last one of a script may become, behind those before it.
async fn statements(client: &Client, channel: &str, word: &str) -> Vec<CompletionCandidate> {
    let Ok(Some((_, card))) = client.card(channel).await else {
        return Vec::new();
    };
    let at = word.rfind(';').map_or(0, |at| at + 1);
    let begun = word[at..].trim_start();
    let before = &word[..word.len() - begun.len()];
    let verbs = card.verbs.iter().filter(|verb| verb.name.starts_with(begun));
    let shown = |verb: &CardVerb| {
        CompletionCandidate::new(format!("{before}{}", verb.name)).help(Some(StyledStr::from(format!(
            "{}  {}",
            verb.usage(),
            verb.does
        ))))
    };
    verbs.map(shown).collect()
}
