//! `mom watch`: what happens in contexts, one line per parcel.

use mom_client::{Client, ContextInfo, ContextKind, Event, Events, LinkState, Path, Thinning};
use tokio::sync::mpsc;

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::Output;
use crate::output::record::OutputRecord;
use crate::output::style::{Tone, ink};
use mom_pages::Interrupt;

/// Events on their way from the contexts to the one place that writes them.
const WAITING: usize = 64;

pub(crate) async fn run(args: &cli::WatchArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Reconnecting).await?;
    let mut interrupt = Interrupt::install()?;
    let mut contexts = Vec::new();
    for path in &args.paths {
        let info = client.lookup(path).await.doing(format!("look up {path}"))?;
        add(&client, info, args.recursive, &mut contexts).await?;
    }
    let thinning = Thinning {
        newest: args.newest,
        rate: args.rate,
    };
    let mut happenings = subscribe(&client, &contexts, thinning).await?;
    let what = match &contexts[..] {
        [one] => one.path.to_string(),
        many => format!("{} contexts", many.len()),
    };
    output.remark(ink(
        format_args!("watching {what} as {}; Ctrl-C ends", client.name()),
        Tone::Faint,
    ));
    let mut left = args.count;
    while left != Some(0) {
        let happening = tokio::select! {
            happening = happenings.recv() => happening,
            () = interrupt.wait() => break,
        };
        let Some((context, event)) = happening else {
            return Err(ended(&client));
        };
        if args.messages && is_news(&event) {
            continue;
        }
        let record = OutputRecord::of(&context, &event);
        output.tell(|| record.json(), || record.line())?;
        left = left.map(|left| left - 1);
    }
    client.close().await;
    Ok(())
}

/// A context, and with `recursive` all below it, each once, parents first.
async fn add(
    client: &Client,
    info: ContextInfo,
    recursive: bool,
    contexts: &mut Vec<ContextInfo>,
) -> Result<(), Failure> {
    let mut next = vec![info];
    while let Some(info) = next.pop() {
        if recursive && info.kind == ContextKind::Session {
            let children = client
                .list(info.path.as_str())
                .await
                .doing(format!("list {}", info.path))?;
            next.extend(children.into_iter().rev());
        }
        if !contexts.iter().any(|known| known.path == info.path) {
            contexts.push(info);
        }
    }
    Ok(())
}

/// Joins the contexts; what happens there comes out of one end, each thing once.
async fn subscribe(
    client: &Client,
    contexts: &[ContextInfo],
    thinning: Thinning,
) -> Result<mpsc::Receiver<(String, Event)>, Failure> {
    let (sender, receiver) = mpsc::channel(WAITING);
    for (index, info) in contexts.iter().enumerate() {
        let mut events = events(client, info, thinning).await?;
        let (sender, context) = (sender.clone(), info.path.clone());
        let watched: Vec<Path> = contexts.iter().map(|context| context.path.clone()).collect();
        tokio::spawn(async move {
            while let Some(event) = events.next().await {
                let elsewhere = match &event {
                    // The link is one for all contexts.
                    Event::LinkDown | Event::Resumed => index > 0,
                    // Also told to the channels that the token guards.
                    Event::Grabbed { path, .. } | Event::Released { path, .. } => {
                        *path != context && watched.contains(path)
                    }
                    _ => false,
                };
                if !elsewhere && sender.send((context.to_string(), event)).await.is_err() {
                    break;
                }
            }
        });
    }
    Ok(receiver)
}

/// Joins a context, a channel with thinning; its events keep it joined.
pub(super) async fn events(
    client: &Client,
    info: &ContextInfo,
    thinning: Thinning,
) -> Result<Events, Failure> {
    let path = info.path.as_str();
    let what = format!("join {path}");
    Ok(match info.kind {
        ContextKind::Session => client.session(path).await.doing(what)?.events(),
        ContextKind::Channel => {
            let channel = client.channel_thinned(path, thinning).await;
            channel.doing(what)?.events()
        }
        ContextKind::Token => client.token(path).await.doing(what)?.events(),
    })
}

/// Whether `--messages` leaves this event out; problems are always shown.
fn is_news(event: &Event) -> bool {
    !matches!(
        event,
        Event::Message(_)
            | Event::Lagged(_)
            | Event::LinkDown
            | Event::Resumed
            | Event::Rejoined
            | Event::Refused(..)
    )
}

/// Why the events have ended.
fn ended(client: &Client) -> Failure {
    match &*client.state().borrow() {
        LinkState::Closed(Some(error)) => Failure::Refused {
            what: "the hub closed the connection".to_owned(),
            error: error.clone(),
        },
        LinkState::Closed(None) => Failure::plain("the connection to the hub is closed"),
        _ => Failure::plain("the watched contexts are gone"),
    }
}
