//! What a device can do, as it says when it joins.

use mom_proto::{Map, Value};

use crate::stage::{Stage, of};
use crate::stops::{stage, told};

const JOIN: &str = "context join /lab/arm";

/// A card with so many statements.
fn card(verbs: usize) -> Map {
    let verb = |number| Map::new().with("name", format!("go{number}")).with("moves", true);
    let verbs: Vec<Value> = (0..verbs).map(|number| verb(number).into()).collect();
    Map::new()
        .with("card", 1)
        .with("name", "arm")
        .with("verbs", verbs)
}

fn joins(stage: &mut Stage, who: &str, card: Map) -> Vec<String> {
    let heard = stage.say_with(who, JOIN, "device", Map::new().with("card", card).into());
    of(&heard, &[who])
}

/// The card that alice is shown, and whose it is.
fn shown(stage: &mut Stage, device: Option<&str>) -> (Option<Value>, Option<Value>) {
    match device {
        None => stage.say_with("alice", "context info /lab/arm", "card", true.into()),
        Some(device) => stage.say(
            "alice",
            &format!("context info /lab/arm card=true device={device}"),
        ),
    };
    let info = told(stage);
    (info.get("card").cloned(), info.get("device").cloned())
}

#[test]
fn the_card_of_a_device_is_shown_to_who_may_look_at_its_channel() {
    let mut stage = stage();
    assert_eq!(shown(&mut stage, None), (None, None));
    assert_eq!(joins(&mut stage, "arm", card(2)), ["arm< ok"]);
    let own = (Some(card(2).into()), Some("arm".into()));
    assert_eq!(shown(&mut stage, None), own);
    assert_eq!(shown(&mut stage, Some("arm")), own);
    assert_eq!(shown(&mut stage, Some("other")), (None, None));
    // Only who asks for it is told.
    stage.say("alice", "context info /lab/arm");
    assert_eq!(told(&stage).get("card"), None);
    // It says something else now, and then nothing.
    joins(&mut stage, "arm", card(3));
    assert_eq!(shown(&mut stage, None).0, Some(card(3).into()));
    stage.say("arm", "context join /lab/arm device=true");
    assert_eq!(shown(&mut stage, None), (None, None));
    joins(&mut stage, "arm", card(1));
    stage.say("arm", "context leave /lab/arm");
    assert_eq!(shown(&mut stage, None), (None, None));
}

#[test]
fn a_wrong_card_is_refused_by_the_place_of_what_is_wrong() {
    let mut stage = stage();
    joins(&mut stage, "arm", card(1));
    let wrong = card(1).with(
        "verbs",
        vec![Map::new().with("name", "go").with("moves", 1).into()],
    );
    joins(&mut stage, "arm", wrong);
    let error = told(&stage);
    assert_eq!(
        error.get("slot").and_then(Value::as_str),
        Some("content/device/card/verbs/0/moves")
    );
    // The one before holds.
    assert_eq!(shown(&mut stage, None).0, Some(card(1).into()));
    let heard = joins(&mut stage, "arm", card(3000));
    assert!(heard[0].starts_with("arm< bad-content"), "{heard:?}");
    assert_eq!(
        told(&stage).get("slot").and_then(Value::as_str),
        Some("content/device/card")
    );
}

#[test]
fn the_cards_of_one_peer_take_so_much_room_at_most() {
    let mut stage = stage();
    let join = |stage: &mut Stage, number: usize, card: Map| {
        let path = format!("/lab/c{number}");
        let said = Map::new().with("card", card);
        let heard = stage.say_with("arm", &format!("context join {path}"), "device", said.into());
        of(&heard, &["arm"]).last().cloned().unwrap_or_default()
    };
    let full = || card(1000);
    let mut taken = 0;
    for number in 0..400 {
        stage.say("arm", &format!("context create /lab/c{number} kind=channel"));
        let heard = join(&mut stage, number, full());
        if heard != "arm< ok" {
            assert!(heard.starts_with("arm< full"), "{heard}");
            break;
        }
        taken += 1;
    }
    assert!((128..399).contains(&taken), "{taken}");
    // What is left, or said anew, makes room.
    assert_eq!(join(&mut stage, 0, full()), "arm< ok");
    stage.say("arm", "context leave /lab/c0");
    assert_eq!(join(&mut stage, taken, full()), "arm< ok");
    assert!(join(&mut stage, 0, full()).starts_with("arm< full"));
}
