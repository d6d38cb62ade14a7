//! `mom chat`: sends input lines and shows those of others.

use mom_client::{Channel, Event, Parcel, to_value};

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::input;
use crate::output::event::event_words;
use crate::output::record::OutputRecord;
use crate::output::style::{Tone, ink};
use crate::output::{Output, refusal_text, words};
use mom_pages::Interrupt;

/// The name of the messages (M39).
const CHAT: &str = "chat";

pub(crate) async fn run(args: &cli::ChatArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Reconnecting).await?;
    let mut interrupt = Interrupt::install()?;
    let channel = client
        .channel(&args.path)
        .await
        .doing(format!("join {}", args.path))?;
    let mut events = channel.events();
    if let Ok(members) = client.members(&args.path).await {
        let me = client.name();
        let others = members.iter().filter(|member| member.peer != me);
        let others: Vec<String> = others.map(|member| words::visible(&member.peer)).collect();
        let who = match others.is_empty() {
            true => "nobody else is".to_owned(),
            false => others.join(", "),
        };
        output.remark(ink(
            format_args!("{} as {me}; here: {who}; Ctrl-D ends", args.path),
            Tone::Faint,
        ));
    }
    let mut lines = input::lines();
    let mut refused = false;
    loop {
        tokio::select! {
            line = lines.recv() => match line {
                Some(line) => refused |= !say(&channel, &line?, output).await,
                None => break,
            },
            event = events.next() => match event {
                Some(event) => show(&args.path, &event, output)?,
                None => return Err(Failure::plain("the chat is closed")),
            },
            () = interrupt.wait() => break,
        }
    }
    // Messages that arrived while the last line was on its way.
    while let Some(event) = events.try_next() {
        show(&args.path, &event, output)?;
    }
    client.close().await;
    match refused {
        true => Err(Failure::Told),
        false => Ok(()),
    }
}

/// Sends a line; returns whether it was accepted.
async fn say(channel: &Channel, line: &str, output: Output) -> bool {
    if line.trim().is_empty() {
        return true;
    }
    if let Err(error) = to_value(line) {
        output.remark(refusal_text("not sent", &error));
        return false;
    }
    match channel
        .message(CHAT)
        .content(line)
        .no_echo()
        .send_acknowledged()
        .await
    {
        Ok(receipt) => {
            if receipt.delivered == 0 {
                output.remark(ink("  (nobody else is here)", Tone::Faint));
            }
            true
        }
        Err(error) => {
            match error.wire() {
                Some(error) => output.remark(refusal_text("not sent", error)),
                // It may have left before the connection was lost.
                None => output.remark(ink(format_args!("without a receipt: {error}"), Tone::Bad)),
            }
            false
        }
    }
}

fn show(path: &str, event: &Event, output: Output) -> std::io::Result<()> {
    output.tell(|| OutputRecord::of(path, event).json(), || human(path, event))
}

/// `alice: good morning`, `* bob joined (level 1)`
fn human(path: &str, event: &Event) -> String {
    match event {
        Event::Message(parcel) if parcel.name() == CHAT => said(parcel),
        Event::Message(_) | Event::Other(_) => OutputRecord::of(path, event).line(),
        other => ink(format_args!("* {}", event_words(other)), Tone::Notice),
    }
}

fn said(parcel: &Parcel) -> String {
    let sender = words::visible(parcel.sender.as_deref().unwrap_or("?"));
    let to_me = if parcel.address.is_some() { " (to you)" } else { "" };
    let history = words::history(parcel).map(|history| ink(format_args!(" ({history})"), Tone::Faint));
    format!(
        "{}{}{}: {}",
        ink(sender, Tone::Peer),
        ink(to_me, Tone::Faint),
        history.unwrap_or_default(),
        words::said(parcel)
    )
}

#[cfg(test)]
mod tests {
    use mom_client::{Family, Member};

    use super::*;

    #[test]
    fn lines_of_a_chat() {
        let mut parcel = Parcel::new(Family::Message, CHAT).content("good\u{9b} morning");
        parcel.sender = Some("bob".into());
        let addressed = Parcel {
            address: Some(vec!["alice".into()]),
            ..parcel.clone()
        };
        let mut old = parcel.clone();
        old.age = Some(90_000_000);
        old.extra.set(mom_client::HISTORY, true);
        let carol = Member {
            peer: "carol".to_owned(),
            user: "carol".to_owned(),
            level: 5,
            device: false,
        };
        for (event, line) in [
            (Event::Message(parcel), "bob: good\\u{9b} morning"),
            (Event::Message(addressed), "bob (to you): good\\u{9b} morning"),
            (
                Event::Message(old),
                "bob (history, at least 1 min 30 s old): good\\u{9b} morning",
            ),
            (Event::Joined(carol), "* carol joined (level 5)"),
        ] {
            assert_eq!(
                anstream::adapter::strip_str(&human("/chat", &event)).to_string(),
                line
            );
        }
    }
}
