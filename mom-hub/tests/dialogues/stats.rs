//! Which channels a session tells the figures of, and whether it says that there are more.

use mom_hub::{Effect, Settings};
use mom_managers::{Manager, Question, Registry, Verdict};
use mom_proto::{Code, ContextKind, Value, Verb};

use crate::stage::{Stage, context};

/// Shows the figures of no channel.
#[derive(Debug)]
struct Discreet;

impl Manager for Discreet {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        match (question.verb, question.kind) {
            (Verb::Stats, ContextKind::Channel) => Verdict::deny(Code::DENIED, "discreet", "not these"),
            _ => Verdict::allow(),
        }
    }
}

/// How many channels a session of so many tells of, by their paths in order, and whether there may be more.
fn told(manager: &str, channels: usize) -> (usize, bool) {
    let mut registry = Registry::builtin();
    registry.add_kind("discreet", |_| Ok(Box::new(Discreet)));
    let mut contexts = vec![
        context("/lab", "session")
            .with("manager", manager)
            .with("presence", "none"),
    ];
    contexts.extend(
        (0..channels)
            .rev()
            .map(|number| context(&format!("/lab/{number:04}"), "channel")),
    );
    contexts.push(context("/lab/key", "token"));
    let mut stage = Stage::with(contexts, registry, Settings::default());
    stage.arrive("alice", 1);
    stage.say("alice", "context stats /lab");
    let stats = stage.effects.iter().find_map(|effect| match effect {
        Effect::Stats {
            parcel,
            channels,
            peers,
            ..
        } => Some((parcel.value(), channels, *peers)),
        _ => None,
    });
    let (content, told, peers) = stats.expect("an answer");
    assert!(!peers, "a session is not told peer by peer");
    let paths: Vec<_> = told
        .iter()
        .filter_map(|number| stage.hub.path(*number))
        .map(|path| path.name().to_owned())
        .collect();
    let first: Vec<_> = (0..told.len()).map(|number| format!("{number:04}")).collect();
    assert_eq!(paths, first);
    (told.len(), content.get("more") == Some(&Value::Bool(true)))
}

#[test]
fn a_session_tells_of_256_channels_at_most() {
    assert_eq!(told("open", 0), (0, false));
    assert_eq!(told("open", 256), (256, false));
    assert_eq!(told("open", 257), (256, true));
}

#[test]
fn a_session_looks_at_1024_contexts_at_most() {
    assert_eq!(told("discreet", 3), (0, false));
    assert_eq!(told("discreet", 1023), (0, false));
    assert_eq!(told("discreet", 1024), (0, true));
}

#[test]
fn a_channel_is_told_peer_by_peer_and_a_token_counts_nothing() {
    let contexts = vec![context("/arm", "channel"), context("/key", "token")];
    let mut stage = Stage::new(contexts);
    stage.arrive("alice", 1);
    stage.say("alice", "context stats /arm");
    let peers = stage.effects.iter().find_map(|effect| match effect {
        Effect::Stats { channels, peers, .. } => Some((channels.len(), *peers)),
        _ => None,
    });
    assert_eq!(peers, Some((1, true)));
    assert_eq!(stage.say("alice", "context stats /key"), ["alice< wrong-kind"]);
}
