//! `mom give`: grabs a token and gives it to another peer.

use mom_client::{Client, Given, Lapsed, Token, TokenGuard};
use serde_json::json;

use super::grab::grab;
use super::hold::{tell_lost, tell_released};
use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::style::{Tone, ink};
use crate::output::{Output, words};
use mom_pages::Interrupt;

pub(crate) async fn run(args: &cli::GiveArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let mut interrupt = Interrupt::install()?;
    let path = &args.path;
    let token = client.token(path).await.doing(format!("join {path}"))?;
    // The owner is not interrupted for a peer that is not there.
    let result = match look_for(&client, &token, &args.peer).await {
        Ok(()) => give(args, &token, &mut interrupt, output).await,
        absent => absent,
    };
    client.close().await;
    result
}

async fn give(
    args: &cli::GiveArgs,
    token: &Token,
    interrupt: &mut Interrupt,
    output: Output,
) -> Result<(), Failure> {
    let (peer, path) = (args.peer.as_str(), args.path.as_str());
    let guard = grab(token, args.wait, interrupt, output).await?;
    let given = offer(args, &guard).await;
    let mut given = match given {
        Ok(given) => given,
        Err(failure) => return end(guard, Err(failure), output).await,
    };
    let extent = words::extent(args.time, args.commands);
    output.tell(
        || json!({"state": "offered", "path": path, "to": peer}),
        || format!("offered {path} to {}{extent}", words::visible(peer)),
    )?;
    let accepted = tokio::select! {
        accepted = given.accepted() => accepted.map_err(|lapsed| lapsed_failure(path, &lapsed)),
        () = interrupt.wait() => Err(Failure::plain("interrupted; the token is released, and the offer with it")),
    };
    if let Err(failure) = accepted {
        return end(guard, Err(failure), output).await;
    }
    output.tell(
        || json!({"state": "given", "path": path, "to": peer}),
        || {
            let head = ink(format_args!("{} has {path}", words::visible(peer)), Tone::Good);
            format!("{head}{extent}")
        },
    )?;
    match args.time.is_some() || args.commands.is_some() {
        true => wait_for_return(given, path, interrupt, output).await,
        false => Ok(()),
    }
}

/// Fails if the peer is known not to be where the token is; the hub looks again when it is offered.
async fn look_for(client: &Client, token: &Token, peer: &str) -> Result<(), Failure> {
    let Some(above) = token.path().parent() else {
        return Ok(());
    };
    match client.members(above.as_str()).await {
        Ok(members) if !members.is_empty() && !members.iter().any(|member| member.peer == peer) => {
            Err(Failure::new(
                format!("{} is not in {above}; nothing was grabbed", words::visible(peer)),
                format!("see who is there: mom tree {above}"),
            ))
        }
        // Who may not ask hears it from the hub.
        _ => Ok(()),
    }
}

async fn offer(args: &cli::GiveArgs, guard: &TokenGuard) -> Result<Given, Failure> {
    let mut give = guard.give(&args.peer);
    if let Some(time) = args.time {
        give = give.time(time);
    }
    if let Some(commands) = args.commands {
        give = give.commands(commands);
    }
    if let Some(within) = args.within {
        give = give.within(within);
    }
    give.await.doing(format!("give {} to {}", args.path, args.peer))
}

/// The token has returned, and is released.
async fn wait_for_return(
    given: Given,
    path: &str,
    interrupt: &mut Interrupt,
    output: Output,
) -> Result<(), Failure> {
    output.remark(ink(
        "it returns by itself; after Ctrl-C it becomes free then",
        Tone::Faint,
    ));
    let returned = tokio::select! {
        returned = given.returned() => returned,
        () = interrupt.wait() => return Ok(()),
    };
    match returned {
        Ok(guard) => {
            let fence = guard.fence();
            output.tell(
                || json!({"state": "returned", "path": path, "fence": fence}),
                || format!("{path} is back"),
            )?;
            end(guard, Ok(()), output).await
        }
        Err(lost) => tell_lost(path, &lost, output),
    }
}

/// Gives the token back, whatever came of it.
async fn end(guard: TokenGuard, result: Result<(), Failure>, output: Output) -> Result<(), Failure> {
    let path = guard.path().to_string();
    if !guard.is_lost() {
        guard.release().await.doing(format!("release {path}"))?;
        tell_released(&path, output)?;
    }
    result
}

fn lapsed_failure(path: &str, lapsed: &Lapsed) -> Failure {
    let to = words::visible(&lapsed.to);
    match lapsed.reason.as_str() {
        "declined" => Failure::plain(format!("{to} does not want {path}")),
        "timed-out" => Failure::new(
            format!("{to} did not take {path} in time"),
            format!("give it more time with --within; it takes it with: mom accept {path}"),
        ),
        "left" => Failure::plain(format!("{to} is gone")),
        "lost" => Failure::plain(format!("{path} was lost before {to} took it")),
        reason => Failure::plain(format!(
            "the offer to {to} came to nothing: {}",
            words::visible(reason)
        )),
    }
}
