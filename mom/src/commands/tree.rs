//! `mom tree`: the contexts, their members and owners.

use std::future::Future;
use std::pin::Pin;

use mom_client::{Client, ContextInfo, ContextKind, Map, Member, StopState, Value};
use serde_json::{Value as Json, json};

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::style::{Tone, ink, padded};
use crate::output::{Output, to_json, words};

/// The most members named beside a context; of the others only the number.
const NAMED: usize = 4;

/// A context with what is below it.
#[derive(Debug)]
struct TreeNode {
    info: ContextInfo,
    /// All that `info` tells; none where this user may not ask.
    facts: Option<Map>,
    /// Who is in it; none where this user may not ask.
    members: Option<Vec<Member>>,
    children: Vec<TreeNode>,
}

pub(crate) async fn run(args: &cli::TreeArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let top = client
        .lookup(&args.path)
        .await
        .doing(format!("look up {}", args.path))?;
    let node = grow(&client, top, args.depth.unwrap_or(usize::MAX)).await?;
    client.close().await;
    output.tell(|| node.json(), || node.lines().join("\n"))?;
    Ok(())
}

/// Asks for a context and all below it, so many levels deep.
fn grow(
    client: &Client,
    info: ContextInfo,
    depth: usize,
) -> Pin<Box<dyn Future<Output = Result<TreeNode, Failure>> + Send + '_>> {
    Box::pin(async move {
        let path = info.path.to_string();
        // A refusal leaves a gap in the tree; the rest is shown.
        let facts = client.info(&path).await.ok();
        let members = client.members(&path).await.ok();
        let mut children = Vec::new();
        if info.kind == ContextKind::Session && depth > 0 {
            for child in client.list(&path).await.doing(format!("list {path}"))? {
                children.push(grow(client, child, depth - 1).await?);
            }
        }
        Ok(TreeNode {
            info,
            facts,
            members,
            children,
        })
    })
}

impl TreeNode {
    fn json(&self) -> Json {
        let members = self
            .members
            .iter()
            .flatten()
            .map(|member| json!({"peer": member.peer, "user": member.user, "level": member.level}));
        json!({
            "path": self.info.path.as_str(),
            "kind": self.info.kind.word(),
            "number": self.info.number,
            "members": self.members.as_ref().map(|_| members.collect::<Vec<_>>()),
            "info": self.facts.as_ref().map(to_json),
            "children": self.children.iter().map(TreeNode::json).collect::<Vec<_>>(),
        })
    }

    /// One line per context, in four columns: the tree, the kind, who is there, what else is known.
    fn lines(&self) -> Vec<String> {
        let mut rows = Vec::new();
        self.push_rows("", "", &mut rows);
        let width = rows
            .iter()
            .map(|(branch, name, _)| letters(branch) + letters(name))
            .max()
            .unwrap_or(0);
        let members = rows
            .iter()
            .map(|(_, _, node)| letters(&node.who()))
            .max()
            .unwrap_or(0);
        rows.into_iter()
            .map(|(branch, name, node)| {
                let colour = match node.info.kind {
                    ContextKind::Session => Tone::Place,
                    ContextKind::Channel => Tone::Strong,
                    ContextKind::Token => Tone::Notice,
                };
                let line = format!(
                    "{}{}  {}  {}  {}",
                    ink(&branch, Tone::Faint),
                    padded(&name, width - letters(&branch), colour),
                    padded(node.info.kind.word(), 7, Tone::Faint),
                    padded(&node.who(), members, Tone::Peer),
                    node.note(),
                );
                line.trim_end().to_owned()
            })
            .collect()
    }

    fn push_rows<'a>(&'a self, own: &str, below: &str, rows: &mut Vec<(String, String, &'a TreeNode)>) {
        let name = match own.is_empty() {
            true => self.info.path.as_str(),
            false => self.info.path.name(),
        };
        rows.push((own.to_owned(), words::visible(name), self));
        for (position, child) in self.children.iter().enumerate() {
            let (branch, further) = match position + 1 == self.children.len() {
                true => ("└── ", "    "),
                false => ("├── ", "│   "),
            };
            child.push_rows(&format!("{below}{branch}"), &format!("{below}{further}"), rows);
        }
    }

    /// Who is in it: names, or how many.
    fn who(&self) -> String {
        match (&self.members, self.info.members) {
            (Some(members), _) if members.len() <= NAMED => {
                let names: Vec<String> = members
                    .iter()
                    .map(|member| words::visible(&member.peer))
                    .collect();
                names.join(" ")
            }
            (Some(members), _) => words::count(members.len() as u64, "member"),
            (None, Some(0) | None) => String::new(),
            (None, Some(count)) => words::count(count, "member"),
        }
    }

    /// The stop of a channel that concerns devices: it has some, or is meant to.
    fn stop(&self) -> Option<StopState> {
        let guarded = self
            .facts
            .as_ref()
            .is_some_and(|facts| facts.get("guard").is_some());
        let devices = self.members.iter().flatten().any(|member| member.device);
        self.info.stop.clone().filter(|_| guarded || devices)
    }

    /// Who owns a token, what guards a channel, who has stopped it.
    fn note(&self) -> String {
        let Some(facts) = &self.facts else {
            return String::new();
        };
        match self.info.kind {
            ContextKind::Session => String::new(),
            ContextKind::Token => owner(facts),
            ContextKind::Channel => {
                let guard = facts.get("guard").and_then(Value::as_map);
                let guard = guard.and_then(guarded);
                let stop = self.stop().map(|stop| ink(words::stopped_by(&stop), Tone::Bad));
                let notes: Vec<String> = stop.into_iter().chain(guard).collect();
                notes.join("  ")
            }
        }
    }
}

/// Who holds a token, and for how long still.
fn owner(facts: &Map) -> String {
    let Some(owner) = facts.get("owner").and_then(Value::as_str) else {
        return ink("free", Tone::Good);
    };
    let mut text = format!("held by {}", words::visible(owner));
    if let Some(level) = facts.get("owner-level").and_then(Value::as_int) {
        text.push_str(&format!(" (level {level})"));
    }
    match words::millis(facts.get("lease-left")) {
        Some(left) if left.is_zero() => text.push_str(", lease expired"),
        Some(left) => text.push_str(&format!(", {} of its lease left", words::duration(left))),
        None => {}
    }
    ink(text, Tone::Notice)
}

fn guarded(guard: &Map) -> Option<String> {
    let names: Vec<String> = guard
        .get("names")?
        .as_list()?
        .iter()
        .filter_map(Value::as_str)
        .map(words::visible)
        .collect();
    let token = guard.get("token")?.as_str()?;
    Some(ink(
        format_args!("{} guarded by {token}", names.join(" ")),
        Tone::Faint,
    ))
}

fn letters(text: &str) -> usize {
    text.chars().count()
}

#[cfg(test)]
mod tests {
    use mom_client::Path;

    use super::*;

    fn node(
        path: &str,
        kind: ContextKind,
        facts: Map,
        members: &[&str],
        children: Vec<TreeNode>,
    ) -> TreeNode {
        let member = |peer: &&str| Member {
            peer: (*peer).to_owned(),
            user: (*peer).to_owned(),
            level: 1,
            device: false,
        };
        TreeNode {
            info: ContextInfo {
                path: Path::parse(path).unwrap(),
                kind,
                number: 1,
                members: None,
                stop: None,
            },
            facts: Some(facts),
            members: Some(members.iter().map(member).collect()),
            children,
        }
    }

    fn lab() -> TreeNode {
        use ContextKind::{Channel, Session, Token};
        let guard = Map::new().with(
            "guard",
            Map::new()
                .with("token", "/robot/token")
                .with("names", vec!["command".into()]),
        );
        let held = Map::new()
            .with("owner", "alice")
            .with("owner-level", 1)
            .with("lease-left", 178_000);
        let arm = node("/robot/arm", Channel, guard, &["arm", "alice"], vec![]);
        let token = node("/robot/token", Token, held, &["alice"], vec![]);
        let robot = node(
            "/robot",
            Session,
            Map::new(),
            &["a", "b", "c", "d", "e"],
            vec![arm, token],
        );
        let chat = node("/chat", Channel, Map::new(), &[], vec![]);
        let spare = node("/spare", Token, Map::new(), &[], vec![]);
        node("/", Session, Map::new(), &["alice"], vec![chat, robot, spare])
    }

    #[test]
    fn the_picture() {
        let picture = lab().lines().join("\n");
        assert_eq!(
            anstream::adapter::strip_str(&picture).to_string(),
            "\
/              session  alice
├── chat       channel
├── robot      session  5 members
│   ├── arm    channel  arm alice  command guarded by /robot/token
│   └── token  token    alice      held by alice (level 1), 2 min 58 s of its lease left
└── spare      token               free"
        );
    }

    #[test]
    fn a_part_begins_with_its_path() {
        let mut part = lab();
        let robot = part.children.remove(1);
        assert!(
            anstream::adapter::strip_str(&robot.lines()[0])
                .to_string()
                .starts_with("/robot ")
        );
    }

    #[test]
    fn the_json_form() {
        let json = lab().json();
        assert_eq!(json["children"][1]["children"][1]["path"], "/robot/token");
        assert_eq!(json["children"][1]["children"][1]["info"]["lease-left"], 178_000);
        assert_eq!(json["children"][1]["children"][0]["members"][0]["peer"], "arm");
        assert_eq!(json["children"][0]["kind"], "channel");
    }
}
