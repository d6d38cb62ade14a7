use super::*;
use crate::{Map, to_value};

fn arm() -> Map {
    let arg = |name: &str| Map::new().with("name", name).with("type", "number");
    let travel = arg("z")
        .with("unit", "mm")
        .with("min", 0)
        .with("max", Value::Double(450.5));
    let speed = arg("speed").with("unit", "mm/s").with("default", 50);
    let go = Map::new()
        .with("name", "move")
        .with("does", "Moves the hand in a straight line")
        .with("args", vec![travel.into(), speed.into()])
        .with("moves", true);
    let grip = Map::new()
        .with("name", "grip")
        .with(
            "args",
            vec![
                arg("width")
                    .with("choices", vec!["open".into(), "close".into()])
                    .into(),
            ],
        )
        .with("moves", true);
    let field = Map::new()
        .with("name", "pose.x")
        .with("type", "number")
        .with("unit", "mm");
    Map::new()
        .with("card", 1)
        .with("name", "arm")
        .with("verbs", vec![go.into(), grip.into()])
        .with("state", vec![field.into()])
        .with("stops-within", 1000)
        .with("cameras", vec!["/camera/x".into()])
}

#[test]
fn a_card_is_read_and_written() {
    let value: Value = arm().into();
    let card = Card::read(&value).expect("a card");
    let usages: Vec<String> = card.verbs.iter().map(CardVerb::usage).collect();
    assert_eq!(usages, ["move z/mm [speed/mm/s]", "grip open|close|width"]);
    assert_eq!(card.verbs[0].args[0].max, Some(450.5));
    let again = to_value(&card).expect("it can be written");
    assert_eq!(Card::read(&again), Ok(card));
}

#[test]
fn what_is_wrong_is_told_with_its_place() {
    let verb = |key: &str, value: Value| {
        let verb = Map::new().with("name", "go").with("moves", true).with(key, value);
        arm().with("verbs", vec![verb.into()])
    };
    let arg = |map: Map| verb("args", vec![map.with("name", "x").into()].into());
    for (card, at) in [
        (Map::new(), "/card"),
        (arm().with("card", 2), "/card"),
        (arm().with("name", "a b"), "/name"),
        (arm().with("verb", 1), "/verb"),
        (arm().with("verbs", 1), "/verbs"),
        (arm().with("on-loss", "explode"), "/on-loss"),
        (arm().with("cameras", vec!["camera".into()]), "/cameras/0"),
        (verb("moves", "yes".into()), "/verbs/0/moves"),
        (verb("name", "wait".into()), "/verbs/0/name"),
        (verb("repeats", 1.into()), "/verbs/0/repeats"),
        (arg(Map::new()), "/verbs/0/args/0/type"),
        (
            arg(Map::new().with("type", "word").with("unit", "mm")),
            "/verbs/0/args/0",
        ),
        (
            arg(Map::new().with("type", "whole").with("min", 2).with("max", 1)),
            "/verbs/0/args/0/min",
        ),
        (
            arg(Map::new()
                .with("type", "number")
                .with("max", 1)
                .with("default", 5)),
            "/verbs/0/args/0/default",
        ),
        (
            arg(Map::new().with("type", "word").with("default", "a\u{9b}b")),
            "/verbs/0/args/0/default",
        ),
    ] {
        let error = Card::read(&card.clone().into()).expect_err(at);
        let slot = error.get("slot").and_then(Value::as_str).unwrap_or_default();
        assert_eq!(
            slot,
            format!("content/device/card{at}"),
            "{card:?}: {}",
            error.text
        );
        assert_eq!(error.code, Code::BAD_CONTENT);
    }
}

#[test]
fn one_statement_has_one_entry_and_what_may_be_left_out_comes_last() {
    let go = Map::new().with("name", "go").with("moves", true);
    let twice = arm().with("verbs", vec![go.clone().into(), go.clone().into()]);
    assert!(Card::read(&twice.into()).is_err());
    let arg = Map::new().with("name", "x").with("type", "number");
    let args = vec![arg.clone().with("default", 1).into(), arg.into()];
    let card = arm().with("verbs", vec![go.with("args", args).into()]);
    assert!(Card::read(&card.into()).is_err());
}
