//! `mom top`: who is connected to a hub, how, and what they own, as it changes.

mod rows;
mod sample;
mod view;

use std::io::{self, IsTerminal as _};
use std::time::Duration;

use mom_client::{Client, ClientError, ContextInfo, LinkState};
use mom_screen::{Screen, keys};
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval, sleep};

use self::sample::{Holds, Sample, TreeWalk};
use self::view::{HubLink, View};
use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::Output;
use mom_pages::Interrupt;

/// Owners of tokens and stops are asked for so often.
const HOLDS_EVERY: Duration = Duration::from_secs(3);

/// What the request is called where it fails.
const ASKING: &str = "ask for the statistics of / and its peers";

/// What comes from the hub.
enum News {
    Sample(Result<Sample, ClientError>),
    Holds(Holds),
}

pub(crate) async fn run(args: &cli::TopArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let live = !args.once && !output.is_json();
    if live && !io::stdout().is_terminal() {
        return Err(Failure::usage(
            "there is no terminal to draw on",
            "mom top --once prints the table, --json one object for each look",
        ));
    }
    let stay = match args.once {
        true => Stay::Once,
        false => Stay::Reconnecting,
    };
    let client = connect(global, stay).await?;
    let mut tops: Vec<ContextInfo> = Vec::new();
    for path in &args.paths {
        tops.push(client.lookup(path).await.doing(format!("look up {path}"))?);
    }
    let mut walk = TreeWalk::new(tops);
    let first = Sample::ask(&client).await.doing(ASKING)?;
    let hub = &global.hub;
    if args.once {
        let holds = walk.holds(&client).await;
        client.close().await;
        return Ok(output.tell(
            || rows::to_json(hub, &first, &holds, None),
            || rows::text(hub, &first, &holds),
        )?);
    }
    let mut interrupt = Interrupt::install()?;
    let news = follow(&client, walk, Duration::from_secs(args.every));
    match live {
        true => show(&client, View::new(hub, first), news, &mut interrupt).await?,
        false => tell(hub, first, news, &mut interrupt, output).await?,
    }
    client.close().await;
    Ok(())
}

/// Asks the hub again and again, apart for peers and for what the tree tells: a large one takes its time.
fn follow(client: &Client, mut walk: TreeWalk, every: Duration) -> mpsc::Receiver<News> {
    let (sender, receiver) = mpsc::channel(4);
    let (samples, told) = (sender.clone(), sender);
    let asks = client.clone();
    tokio::spawn(async move {
        let mut ticks = interval(every);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        // The first is at once, and the hub has been asked a moment ago.
        ticks.tick().await;
        loop {
            ticks.tick().await;
            let sample = Sample::ask(&asks).await;
            if samples.send(News::Sample(sample)).await.is_err() {
                return;
            }
        }
    });
    let asks = client.clone();
    tokio::spawn(async move {
        loop {
            let holds = walk.holds(&asks).await;
            if told.send(News::Holds(holds)).await.is_err() {
                return;
            }
            sleep(HOLDS_EVERY).await;
        }
    });
    receiver
}

/// A refusal that stays one ends the command; what is wrong with the connection does not.
fn refused(error: ClientError) -> Result<(), Failure> {
    match error {
        ClientError::Refused(error) if error.retry_in().is_none() => {
            Err(ClientError::Refused(error)).doing(ASKING)
        }
        ClientError::Closed(error) => Err(ClientError::Closed(error)).doing(ASKING),
        _ => Ok(()),
    }
}

/// One JSON object for each look.
async fn tell(
    hub: &str,
    first: Sample,
    mut news: mpsc::Receiver<News>,
    interrupt: &mut Interrupt,
    output: Output,
) -> Result<(), Failure> {
    let (mut holds, mut last) = (Holds::default(), first);
    loop {
        let next = tokio::select! {
            () = interrupt.wait() => return Ok(()),
            next = news.recv() => next,
        };
        match next {
            None => return Ok(()),
            Some(News::Holds(now)) => holds = now,
            Some(News::Sample(Err(error))) => refused(error)?,
            Some(News::Sample(Ok(sample))) => {
                let rates = sample.rates_since(&last);
                let json = || rows::to_json(hub, &sample, &holds, Some(rates));
                output.tell(json, String::new)?;
                last = sample;
            }
        }
    }
}

/// Draws until a key or a signal ends it.
async fn show(
    client: &Client,
    mut view: View,
    mut news: mpsc::Receiver<News>,
    interrupt: &mut Interrupt,
) -> Result<(), Failure> {
    let mut state = client.state();
    let mut screen = Screen::take()?;
    let mut keys = keys();
    // For how long a connection is lost changes without news.
    let mut seconds = interval(Duration::from_secs(1));
    loop {
        screen.terminal.draw(|frame| view.draw(frame))?;
        tokio::select! {
            () = interrupt.wait() => return Ok(()),
            Some(event) = keys.recv() => {
                if !view.on_event(&event?) {
                    return Ok(());
                }
            }
            Some(next) = news.recv() => match next {
                News::Holds(holds) => view.holds = holds,
                News::Sample(Ok(sample)) => view.update(sample),
                News::Sample(Err(error)) => refused(error)?,
            },
            Ok(()) = state.changed() => {
                view.link = match &*state.borrow_and_update() {
                    LinkState::Connected | LinkState::Stale { .. } => HubLink::Up,
                    LinkState::Trying { since, attempt } | LinkState::Resuming { since, attempt } => {
                        HubLink::Down { since: *since, attempt: *attempt }
                    }
                    LinkState::Closed(error) => return Err(ClientError::Closed(error.clone())).doing(ASKING),
                };
            }
            _ = seconds.tick() => {}
        }
    }
}

#[cfg(test)]
mod tests;
