//! `mom-broker explain`: who may do what, and by which rule.

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Result, bail};
use mom_broker::{Config, Explanation, Supposed};
use mom_proto::nearest::nearest;
use mom_proto::{ContextKind, Path, Time, Value, Verb};

use super::words;

#[derive(clap::Args)]
pub(super) struct ExplainArgs {
    /// The configuration file.
    #[arg(long, short, env = "MOM_CONFIG")]
    config: PathBuf,
    /// The user who asks.
    #[arg(long)]
    user: String,
    /// The context; for create the new path.
    #[arg(long)]
    context: String,
    /// The verb, such as grab or send; without it all verbs of the context.
    #[arg(long)]
    verb: Option<String>,
    /// The name of the message, for send.
    #[arg(long)]
    message: Option<String>,
    /// The user who owns the token meanwhile; TOKEN=USER for another token, such as a zone that overlaps it. May be repeated.
    #[arg(long = "owner", value_name = "[TOKEN=]USER")]
    owners: Vec<String>,
    /// As if a member had invited the user there.
    #[arg(long)]
    invited: bool,
    /// As if it were this time, such as 2026-11-23T09:30:00Z.
    #[arg(long)]
    at: Option<Time>,
    /// The kind of the new context, for create: session, channel or token.
    #[arg(long)]
    kind: Option<String>,
    /// As if the user had this level; with it the users file need not know the user.
    #[arg(long, allow_negative_numbers = true)]
    level: Option<i32>,
    /// As if the user were in this group and no other; may be repeated.
    #[arg(long = "group")]
    groups: Vec<String>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ExplainArgs) -> Result<()> {
    let config = Config::load(&args.config)?;
    let context = Path::parse(&args.context)?;
    let owners: Result<Vec<(Path, String)>> =
        args.owners.iter().map(|owner| owned(owner, &context)).collect();
    let supposed = Supposed {
        user: args.user.clone(),
        level: args.level,
        groups: (!args.groups.is_empty()).then(|| args.groups.clone()),
        context,
        kind: args.kind.as_deref().map(kind).transpose()?,
        owners: owners?,
        invited: args.invited,
        at: args.at,
    };
    let mut out = std::io::stdout().lock();
    match &args.verb {
        Some(word) => {
            let verb = verb(word)?;
            let explained = config.explain(&supposed, verb, args.message.as_deref())?;
            match args.json {
                true => writeln!(out, "{}", serde_json::to_string_pretty(&explained)?)?,
                false => tell(&mut out, &explained, &supposed)?,
            }
        }
        None if args.message.is_some() => bail!("--message is for --verb send"),
        None => {
            let all = config.explain_all(&supposed)?;
            match args.json {
                true => writeln!(out, "{}", serde_json::to_string_pretty(&all)?)?,
                false => table(&mut out, &all, &supposed)?,
            }
        }
    }
    Ok(())
}

/// `bob`, of the context, or `/zone/left=bob`.
fn owned(text: &str, context: &Path) -> Result<(Path, String)> {
    match text.split_once('=').filter(|_| text.starts_with('/')) {
        Some((token, user)) => Ok((Path::parse(token)?, user.to_owned())),
        None => Ok((context.clone(), text.to_owned())),
    }
}

/// ` while bob owns it and carol owns /zone/left`.
fn meanwhile(supposed: &Supposed) -> String {
    let all: Vec<String> = supposed
        .owners
        .iter()
        .map(|(token, user)| match *token == supposed.context {
            true => format!("{user} owns it"),
            false => format!("{user} owns {token}"),
        })
        .collect();
    match all.is_empty() {
        true => String::new(),
        false => format!(" while {}", all.join(" and ")),
    }
}

fn verb(word: &str) -> Result<Verb> {
    let Some(verb) = Verb::from_word(word) else {
        let near = nearest(word, Verb::ALL.map(Verb::word));
        let hint = near.map(|near| format!(" (did you mean {near}?)"));
        bail!("there is no verb {word:?}{}", hint.unwrap_or_default());
    };
    Ok(verb)
}

fn kind(word: &str) -> Result<ContextKind> {
    match ContextKind::from_word(word) {
        Some(kind) => Ok(kind),
        None => bail!("{word:?} is not one of session, channel, token"),
    }
}

/// One answer as text.
fn tell(out: &mut impl Write, explained: &Explanation, supposed: &Supposed) -> Result<()> {
    let may = match explained.answer {
        "allow" => "may",
        "deny" => "may not",
        "ask" => "may, if those who are asked allow it,",
        _ => "has to wait to",
    };
    let what = match &explained.message {
        Some(name) if name == "*" => "send any other message to".to_owned(),
        Some(name) => format!("send {name} to"),
        None => explained.verb.to_owned(),
    };
    writeln!(
        out,
        "{} {may} {what} {}{}.",
        person(explained),
        explained.context,
        meanwhile(supposed)
    )?;
    if let Some(error) = &explained.error {
        let text = |key: &str| error.get(key).map(words).unwrap_or_default();
        writeln!(out, "  {} ({}): {}", text("name"), text("code"), text("text"))?;
        let details: Vec<String> = error
            .iter()
            .filter(|(key, _)| !matches!(*key, "name" | "code" | "text" | "rule"))
            .map(|(key, value)| detail(key, value))
            .collect();
        if !details.is_empty() {
            line(out, "told", &details.join(" "))?;
        }
    }
    let by = match (&explained.rule, &explained.place) {
        (Some(manager), _) if explained.uncovered => format!("none of {manager} covers it"),
        (Some(rule), _) => rule.clone(),
        (None, Some(_)) => format!("the manager {} as a whole", explained.manager),
        (None, None) => "the hub itself, regardless of managers".to_owned(),
    };
    line(out, "rule", &by)?;
    if let Some(place) = &explained.place {
        line(out, "stands at", &format!("{place}, {}", place.key))?;
    }
    let kind = explained.kind.unwrap_or("nothing there yet");
    let manager = format!("{} of {} ({kind})", explained.manager, explained.managed_at);
    line(out, "manager", &manager)?;
    if let Some(asks) = &explained.asks {
        let users = match asks.users.is_empty() {
            true => String::new(),
            false => format!(": {}", asks.users.join(", ")),
        };
        let seconds = asks.within.div_ceil(1000);
        line(out, "asks", &format!("{}{users}; within {seconds} s", asks.who))?;
    }
    if explained.displaces {
        let mut owners = supposed.owners.iter();
        let owner = owners.find(|(token, _)| *token == supposed.context);
        line(
            out,
            "takes it",
            &format!("from {}", owner.map_or("", |(_, user)| user)),
        )?;
    }
    if let Some(until) = explained.until {
        line(out, "until", &format!("{until}, whatever the lease"))?;
    }
    line(out, "holds", &explained.stands)?;
    if !explained.needs.is_empty() && explained.answer != "deny" {
        line(out, "needs", &explained.needs.join(", "))?;
    }
    Ok(())
}

fn line(out: &mut impl Write, what: &str, text: &str) -> Result<()> {
    Ok(writeln!(out, "  {what:<10} {text}")?)
}

fn detail(key: &str, value: &Value) -> String {
    format!("{key}={}", words(value))
}

fn person(explained: &Explanation) -> String {
    let groups: Vec<String> = explained
        .groups
        .iter()
        .map(|group| format!(", {group}"))
        .collect();
    format!(
        "{} (level {}{})",
        explained.user,
        explained.level,
        groups.concat()
    )
}

/// All answers about one context, one line each.
fn table(out: &mut impl Write, all: &[Explanation], supposed: &Supposed) -> Result<()> {
    let Some(first) = all.first() else { return Ok(()) };
    writeln!(
        out,
        "{} at {} ({}; managed by {} of {}){}",
        person(first),
        supposed.context,
        first.kind.unwrap_or("nothing there yet"),
        first.manager,
        first.managed_at,
        meanwhile(supposed).replacen(" while", ", while", 1)
    )?;
    let rows: Vec<[String; 4]> = all.iter().map(|one| row(one, supposed)).collect();
    let width = |column: usize| {
        let longest = rows.iter().map(|row| row[column].chars().count()).max();
        longest.unwrap_or_default()
    };
    let widths = [width(0), width(1), width(2)];
    for [what, answer, rule, place] in &rows {
        let text = format!(
            "  {what:<a$}  {answer:<b$}  {rule:<c$}  {place}",
            a = widths[0],
            b = widths[1],
            c = widths[2]
        );
        writeln!(out, "{}", text.trim_end())?;
    }
    if first.kind.is_some() {
        writeln!(out, "  leave, release, decline, uninhibit: never refused")?;
    }
    Ok(())
}

fn row(explained: &Explanation, supposed: &Supposed) -> [String; 4] {
    let what = match &explained.message {
        Some(name) if name == "*" => "send (any other)".to_owned(),
        Some(name) => format!("send {name}"),
        None if explained.context != supposed.context.as_str() => {
            format!("{} {}", explained.verb, explained.context)
        }
        None => explained.verb.to_owned(),
    };
    let answer = match explained.answer {
        "allow" => "yes",
        "deny" => "no",
        other => other,
    };
    // Of what the hub wants besides, only what one may not have: everybody who may join can be a member.
    let owning = explained.needs.iter().find(|need| need.starts_with("ownership"));
    let answer = match owning.filter(|_| explained.answer == "allow") {
        Some(owning) => format!("{answer}, with {owning}"),
        None => answer.to_owned(),
    };
    let error = explained.error.as_ref().and_then(|error| error.get("text"));
    let rule = match (&explained.rule, &explained.place) {
        (Some(manager), _) if explained.uncovered => format!("{manager} (no rule)"),
        (Some(rule), _) => rule.clone(),
        (None, Some(_)) => explained.manager.clone(),
        (None, None) => error.map(words).unwrap_or_default(),
    };
    let place = explained.place.as_ref().map(ToString::to_string);
    [what, answer, rule, place.unwrap_or_default()]
}
