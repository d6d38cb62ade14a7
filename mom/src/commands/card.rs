//! `mom card`: what a device can do, by its own card.

use mom_client::{Card, OnLoss, to_value};

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::style::{Tone, ink};
use crate::output::{Output, to_json, words};

pub(crate) async fn run(args: &cli::CardArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let path = &args.channel;
    let card = client
        .card(path)
        .await
        .doing(format!("read the card of the device in {path}"));
    client.close().await;
    let Some((peer, card)) = card? else {
        return Err(Failure::new(
            format!("no device in {path} says what it can do"),
            format!("mom tree {path} shows who is there; a device of an earlier version has no card"),
        ));
    };
    let json = to_value(&card).map_err(|error| Failure::plain(error.to_string()))?;
    output.tell(|| to_json(&json), || picture(path, &peer, &card))?;
    Ok(())
}

/// The card, a line for each statement and each field.
fn picture(path: &str, peer: &str, card: &Card) -> String {
    let shown = |text: &str| words::visible(text).to_string();
    let mut lines = vec![format!(
        "{}  {} ({})",
        ink(path, Tone::Strong),
        shown(&card.name),
        shown(peer)
    )];
    if !card.does.is_empty() {
        lines.push(format!("  {}", shown(&card.does)));
    }
    let verbs: Vec<(String, String)> = card
        .verbs
        .iter()
        .map(|verb| {
            let marks = [
                (verb.relative, "relative"),
                (verb.velocity, "alone in its script"),
                (verb.last, "at the end of its script"),
                (!verb.moves, "moves nothing"),
            ];
            let marks = marks.iter().filter(|(is, _)| *is).map(|(_, mark)| *mark);
            let does = std::iter::once(&*verb.does)
                .filter(|does| !does.is_empty())
                .chain(marks);
            (shown(&verb.usage()), shown(&does.collect::<Vec<_>>().join("; ")))
        })
        .chain([(
            "wait ms".to_owned(),
            "Waits, 0 to 60000 ms; moves nothing".to_owned(),
        )])
        .collect();
    lines.extend(table("statements", &verbs));
    let fields: Vec<(String, String)> = card
        .state
        .iter()
        .map(|field| {
            let unit = if field.unit.is_empty() {
                String::new()
            } else {
                format!(", {}", field.unit)
            };
            (shown(&format!("{}{unit}", field.name)), shown(&field.does))
        })
        .collect();
    if !fields.is_empty() {
        lines.extend(table("state", &fields));
    }
    if let Some(ms) = card.stops_within {
        lines.push(format!("  stands within {ms} ms of a stop"));
    }
    if card.on_loss == OnLoss::GoOn {
        lines.push("  goes on with its order when its link is lost".to_owned());
    }
    if !card.cameras.is_empty() {
        lines.push(format!("  seen by {}", shown(&card.cameras.join(", "))));
    }
    lines.join("\n")
}

/// Rows of two columns under a title.
fn table(title: &str, rows: &[(String, String)]) -> Vec<String> {
    let width = rows
        .iter()
        .map(|(left, _)| left.chars().count())
        .max()
        .unwrap_or_default();
    let row = |(left, right): &(String, String)| format!("    {left:width$}  {right}").trim_end().to_owned();
    let title = format!("  {}", ink(title, Tone::Faint));
    std::iter::once(title).chain(rows.iter().map(row)).collect()
}
