//! `mom explain`: who may do what, by which rule, and in which line of the hub's configuration that stands.

use mom_client::{Family, Map, Parcel, Path, Value};

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::style::{Tone, ink};
use crate::output::{Output, to_json, words};

pub(crate) async fn run(args: &cli::ExplainArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let path = Path::parse(&args.path).map_err(|error| {
        Failure::usage(
            error.text,
            "paths look like /robot/arm; `mom tree` shows those that exist",
        )
    })?;
    let content = content(args)?;
    let client = connect(global, Stay::Once).await?;
    let parcel = Parcel::new(Family::Context, "explain")
        .context(path)
        .content(content);
    let reply = client.request(parcel).await;
    let reply = reply.doing(format!("explain {}", args.path))?.value();
    client.close().await;
    output.tell(|| to_json(&reply), || shown(&reply))?;
    Ok(())
}

fn content(args: &cli::ExplainArgs) -> Result<Map, Failure> {
    let mut content = Map::new();
    let texts = [
        ("verb", &args.verb),
        ("message", &args.message),
        ("kind", &args.kind),
        ("peer", &args.peer),
    ];
    for (key, text) in texts {
        if let Some(text) = text {
            content.set(key, text.as_str());
        }
    }
    match (&args.about[..], &args.verb) {
        ([], _) => {}
        ([user], _) => content.set("user", user.as_str()),
        (_, Some(_)) => {
            return Err(Failure::usage(
                "one verb is explained about one user",
                "leave the verb out, or name one --about",
            ));
        }
        (users, None) => {
            let users = users.iter().map(|user| Value::from(user.as_str()));
            content.set("users", users.collect::<Vec<_>>());
        }
    }
    Ok(content)
}

fn shown(reply: &Value) -> String {
    match reply.get("users").and_then(Value::as_list) {
        None => one(reply),
        Some(users) => {
            let tables: Vec<String> = users.iter().map(|user| table(user, reply)).collect();
            tables.join("\n")
        }
    }
}

fn text(value: &Value, key: &str) -> Option<String> {
    value.get(key).and_then(Value::as_str).map(words::visible)
}

/// `bob (level 1, people)`
fn person(value: &Value) -> String {
    let groups = value.get("groups").and_then(Value::as_list).unwrap_or_default();
    let groups = groups.iter().filter_map(Value::as_str).map(words::visible);
    let level = value.get("level").and_then(Value::as_int).unwrap_or_default();
    let about: Vec<String> = std::iter::once(format!("level {level}")).chain(groups).collect();
    let user = text(value, "user").unwrap_or_default();
    let peer = text(value, "peer").filter(|peer| *peer != user);
    let peer = peer.map(|peer| format!(" as {peer}")).unwrap_or_default();
    format!("{}{peer} ({})", ink(user, Tone::Peer), about.join(", "))
}

/// One answer.
fn one(reply: &Value) -> String {
    let may = match text(reply, "answer").as_deref() {
        Some("allow") => ink("may", Tone::Good),
        Some("ask") => ink("may, if those who are asked allow it,", Tone::Notice),
        Some("wait") => ink("has to wait to", Tone::Notice),
        _ => ink("may not", Tone::Bad),
    };
    let what = match text(reply, "message") {
        Some(name) if name == "*" => "send any other message to".to_owned(),
        Some(name) => format!("send {name} to"),
        None => text(reply, "verb").unwrap_or_default(),
    };
    let context = ink(text(reply, "context").unwrap_or_default(), Tone::Place);
    let mut lines = vec![format!("{} {may} {what} {context}", person(reply))];
    let mut fact = |label: &str, fact: Option<String>| {
        lines.extend(fact.map(|fact| format!("  {}  {fact}", ink(format_args!("{label:<7}"), Tone::Faint))));
    };
    let code = text(reply, "code")
        .map(|code| format!(" ({code})"))
        .unwrap_or_default();
    fact("why", text(reply, "text").map(|text| format!("{text}{code}")));
    fact("rule", Some(rule(reply)));
    fact("line", place(reply));
    let at = text(reply, "managed-at").unwrap_or_default();
    fact(
        "manager",
        text(reply, "manager").map(|manager| format!("{manager} of {at}")),
    );
    let owner = text(reply, "owner").or_else(|| text(reply, "guard-owner"));
    fact("owner", owner);
    fact(
        "retry",
        words::millis(reply.get("retry-after")).map(|time| format!("in {}", words::duration(time))),
    );
    let needs = reply.get("needs").and_then(Value::as_list).unwrap_or_default();
    let needs: Vec<String> = needs
        .iter()
        .filter_map(Value::as_str)
        .map(words::visible)
        .collect();
    fact("needs", (!needs.is_empty()).then(|| needs.join(", ")));
    fact("holds", text(reply, "stands"));
    lines.join("\n")
}

fn rule(answer: &Value) -> String {
    let uncovered = answer.get("uncovered").and_then(Value::as_bool) == Some(true);
    match (
        text(answer, "rule"),
        text(answer, "line").is_some() || answer.get("line").is_some(),
    ) {
        (Some(rule), _) if uncovered => format!("none of {rule} covers it"),
        (Some(rule), _) => rule,
        (None, true) => format!(
            "the manager {} as a whole",
            text(answer, "manager").unwrap_or_default()
        ),
        (None, false) => "the hub itself, regardless of managers".to_owned(),
    }
}

/// `lab.toml:77`
fn place(answer: &Value) -> Option<String> {
    let line = answer.get("line").and_then(Value::as_int)?;
    Some(format!("{}:{line}", text(answer, "file")?))
}

/// All answers about one user.
fn table(user: &Value, reply: &Value) -> String {
    let context = text(reply, "context").unwrap_or_default();
    let kind = text(reply, "kind").unwrap_or_default();
    let manager = text(reply, "manager").unwrap_or_default();
    let at = text(reply, "managed-at").unwrap_or_default();
    let head = format!(
        "{} at {} ({kind}; managed by {manager} of {at})",
        person(user),
        ink(&context, Tone::Place)
    );
    let of = |key: &str| {
        user.get(key)
            .and_then(Value::as_map)
            .into_iter()
            .flat_map(Map::iter)
    };
    let verbs = of("verbs").map(|(verb, answer)| (verb.to_owned(), answer));
    let messages = of("messages").map(|(name, answer)| match name {
        "*" => ("send (any other)".to_owned(), answer),
        name => (format!("send {}", words::visible(name)), answer),
    });
    let rows: Vec<[String; 4]> = verbs
        .chain(messages)
        .map(|(what, answer)| {
            let may = match text(answer, "answer").as_deref() {
                Some("allow") => "yes".to_owned(),
                Some("deny") | None => "no".to_owned(),
                Some(other) => other.to_owned(),
            };
            let guard = text(answer, "guard").filter(|_| may == "yes");
            let may = guard.map_or_else(|| may.clone(), |guard| format!("{may}, with {guard}"));
            let why = match text(answer, "rule").is_some() || answer.get("line").is_some() {
                true => rule(answer),
                false => text(answer, "text").unwrap_or_default(),
            };
            [what, may, why, place(answer).unwrap_or_default()]
        })
        .collect();
    let width = |column: usize| {
        let widths = rows.iter().map(|row| row[column].chars().count());
        widths.max().unwrap_or_default()
    };
    let (what, may, why) = (width(0), width(1), width(2));
    let mut lines = vec![head];
    for row in &rows {
        let line = format!(
            "  {:<what$}  {:<may$}  {:<why$}  {}",
            row[0], row[1], row[2], row[3]
        );
        lines.push(line.trim_end().to_owned());
    }
    lines.push("  leave, release, decline, uninhibit: never refused".to_owned());
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_and_one_answer() {
        let grab = Map::new()
            .with("allow", false)
            .with("answer", "deny")
            .with("rule", "lab")
            .with("uncovered", true)
            .with("file", "lab.toml")
            .with("line", 14);
        let join = Map::new()
            .with("allow", true)
            .with("answer", "allow")
            .with("rule", "lab/people");
        let user = Map::new()
            .with("user", "bob")
            .with("level", 1)
            .with("groups", Vec::<Value>::new())
            .with("verbs", Map::new().with("grab", grab.clone()).with("join", join));
        let reply = Map::new()
            .with("context", "/robot/token")
            .with("kind", "token")
            .with("manager", "lab")
            .with("managed-at", "/")
            .with("users", vec![Value::from(user.clone())]);
        let plain = |reply: Map| anstream::adapter::strip_str(&shown(&reply.into())).to_string();
        assert_eq!(
            plain(reply),
            "bob (level 1) at /robot/token (token; managed by lab of /)\n  \
             grab  no   none of lab covers it  lab.toml:14\n  \
             join  yes  lab/people\n  \
             leave, release, decline, uninhibit: never refused"
        );
        let mut one = user.with("verb", "grab").with("context", "/robot/token");
        one.remove("verbs");
        grab.iter().for_each(|(key, value)| one.set(key, value.clone()));
        assert_eq!(
            plain(one.with("text", "bob may not").with("code", "denied")),
            "bob (level 1) may not grab /robot/token\n  why      bob may not (denied)\n  \
             rule     none of lab covers it\n  line     lab.toml:14"
        );
    }
}
