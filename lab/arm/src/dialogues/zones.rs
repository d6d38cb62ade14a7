//! Zones (M40): what is under way in one ends with its ownership, and nobody gets one in which the arm stands.

use super::stage::Stage;
use mom_client::{Map, Path, Value};

use super::stage::lab;
use crate::zone_keeper::ZoneNews;
use crate::zones::{Mount, Zones};

/// What a line `zone …` of a dialogue tells.
pub(super) fn news(words: &[&str]) -> ZoneNews {
    let path = |name: &str| Path::parse(&format!("/zone/{name}")).unwrap();
    match *words {
        ["zone", name] => ZoneNews::Added(path(name)),
        ["zone", name, "from", low, "to", high] => {
            let corner =
                |x: &str, y: f64, z: f64| Value::from([x.parse().unwrap(), y, z].map(Value::Double).to_vec());
            let zone = Map::new()
                .with("from", corner(low, -300.0, 0.0))
                .with("to", corner(high, 300.0, 450.0));
            ZoneNews::Told(path(name), Map::new().with("zone", zone).with("fence", 0))
        }
        ["zone", name, "is", owner, fence] => {
            let ZoneNews::Told(path, info) = news(&["zone", name, "from", "150", "to", "300"]) else {
                unreachable!("it tells");
            };
            let owner = owner.trim_end_matches("'s");
            let fence: i64 = fence.parse().unwrap();
            ZoneNews::Told(path, info.with("owner", owner).with("fence", fence))
        }
        ["zone", name, "grabbed", owner, fence] => {
            ZoneNews::Grabbed(path(name), owner.to_owned(), fence.parse().unwrap())
        }
        ["zone", name, "released", fence] => ZoneNews::Released(path(name), fence.parse().unwrap()),
        ["zone", name, "gone"] => ZoneNews::Removed(path(name)),
        ["zone", "-", "forgotten"] => ZoneNews::Forgotten,
        _ => panic!("no such news: {words:?}"),
    }
}

/// An arm with a zone at the right that alice owns.
fn stage() -> Stage {
    let mut stage = Stage::with(lab(), Zones::new(Mount::default()), |server| server);
    for line in [
        "zone right",
        "zone right from 150 to 300",
        "zone right grabbed alice 1",
    ] {
        stage.act(line);
    }
    stage
}

fn play(stage: &mut Stage, dialogue: &[(&str, &[&str])]) {
    for (line, expected) in dialogue {
        stage.act(line);
        assert_eq!(stage.heard(), *expected, "after `{line}`");
    }
}

#[test]
fn no_leg_leads_through_a_zone_of_another() {
    play(
        &mut stage(),
        &[
            (
                "bob command 1 5: move 200 0 300 0 0",
                &["status bob/1 error 0/0 zone-not-owned 5109"],
            ),
            (
                "bob command 2 5: move 0 0 250 0 0; wait 1",
                &["status bob/2 waiting 0/2", "status bob/2 executing 1/2"],
            ),
            (
                "after 3000",
                &[
                    "status bob/2 executing 2/2",
                    "state free",
                    "state free",
                    "status bob/2 finished 2/2",
                    "state free at rest",
                ],
            ),
            // Through the corner of the way, although neither end is in it.
            (
                "bob command 3 5: move 0 250 250 0 0; move 200 250 250 0 0",
                &["status bob/3 error 0/0 zone-not-owned 5109"],
            ),
            (
                "bob command 4 5: jog 150 0 0 0 0 1000",
                &["status bob/4 waiting 0/1", "status bob/4 executing 1/1"],
            ),
            (
                "after 900",
                &[
                    "state free moving",
                    "status bob/4 error 1/1 zone-not-owned 5109",
                    "state free moving",
                    "state free at rest",
                ],
            ),
        ],
    );
}

#[test]
fn what_is_under_way_in_a_zone_ends_when_it_is_lost() {
    for lost in [
        "zone right released 1",
        "zone right grabbed bob 2",
        "zone - forgotten",
    ] {
        let mut stage = stage();
        play(
            &mut stage,
            &[
                (
                    "alice command 1 5: move 250 0 300 0 0; grip close",
                    &["status alice/1 waiting 0/2", "status alice/1 executing 1/2"],
                ),
                ("after 100", &[]),
                (
                    lost,
                    &[
                        "state free moving",
                        "status alice/1 error 1/2 zone-not-owned 5109",
                    ],
                ),
            ],
        );
    }
    // One that leads elsewhere goes on.
    play(
        &mut stage(),
        &[
            (
                "alice command 1 5: move 0 -100 300 0 0",
                &["status alice/1 waiting 0/1", "status alice/1 executing 1/1"],
            ),
            ("zone right released 1", &[]),
            (
                "after 2000",
                &["state free", "status alice/1 finished 1/1", "state free at rest"],
            ),
        ],
    );
}

#[test]
fn nobody_but_the_commander_is_granted_the_zone_where_the_arm_stands() {
    // The one that is granted is closed to the arm from then on.
    let mut other = stage();
    other.guard("alice", "5");
    assert_eq!(other.grant("/zone/right", "bob"), Ok(()));
    let mut stage = stage();
    stage.guard("alice", "5");
    assert!(
        stage
            .grant("/zone/left", "bob")
            .is_err_and(|why| why.contains("does not know the zone"))
    );
    stage.act("alice command 1 5: move 250 0 300 0 0");
    stage.act("after 3000");
    stage.act("zone right released 1");
    let why = stage.grant("/zone/right", "bob").unwrap_err();
    assert!(why.starts_with("the arm stands in /zone/right"), "{why}");
    assert_eq!(stage.grant("/zone/right", "alice"), Ok(()));
    stage.heard();
    // It does not move there, not even its jaws, until the zone's owner says so.
    play(
        &mut stage,
        &[
            (
                "alice command 2 5: grip close",
                &[
                    "status alice/2 waiting 0/1",
                    "status alice/2 executing 1/1",
                    "state free moving",
                    "status alice/2 error 1/1 zone-not-owned 5109",
                ],
            ),
            (
                "alice command 3 5: home",
                &["status alice/3 error 0/0 zone-not-owned 5109"],
            ),
            ("zone right grabbed alice 2", &[]),
            (
                "alice command 4 5: home",
                &["status alice/4 waiting 0/1", "status alice/4 executing 1/1"],
            ),
        ],
    );
}

#[test]
fn the_commander_is_whoever_owns_the_token_now() {
    let mut stage = stage();
    play(
        &mut stage,
        &[
            (
                "alice command 1 5: move 250 0 300 0 0; wait 10000",
                &["status alice/1 waiting 0/2", "status alice/1 executing 1/2"],
            ),
            (
                "grabbed 6",
                &[
                    "state free moving, fence 6",
                    "status alice/1 error 1/2 halted 5101",
                ],
            ),
            (
                "bob command 1 6: move 200 0 300 0 0",
                &["status bob/1 error 0/0 zone-not-owned 5109"],
            ),
        ],
    );
}

#[test]
fn what_was_said_about_a_grant_is_kept() {
    let mut stage = stage();
    stage.guard("alice", "5");
    // She owns the zone and drives: what has begun may lead there.
    stage.act("alice command 1 5: move 0 0 250 0 0; wait 100");
    assert!(
        stage
            .grant("/zone/right", "bob")
            .is_err_and(|why| why.contains("is being driven"))
    );
    stage.act("after 3000");
    assert_eq!(stage.grant("/zone/right", "bob"), Ok(()));
    stage.heard();
    let refused = ["status alice/2 error 0/0 zone-not-owned 5109"];
    play(
        &mut stage,
        &[
            ("alice command 2 5: move 250 0 300 0 0", &refused),
            // Nothing came of it: an answer that was under way tells so, and the next one.
            ("zone right is alice's 1", &[]),
            ("alice command 2 5: move 250 0 300 0 0", &refused),
            ("zone right is alice's 1", &[]),
            (
                "alice command 3 5: move 250 0 300 0 0",
                &["status alice/3 waiting 0/1", "status alice/3 executing 1/1"],
            ),
        ],
    );
}

#[test]
fn where_the_arm_may_stay_it_may_also_leave() {
    for x in [30, 60, 75, 80, 90, 100] {
        let mut stage = stage();
        stage.guard("alice", "5");
        stage.act(&format!("alice command 1 5: move {x} 0 300 0 0"));
        stage.act("after 3000");
        stage.act("zone right released 1");
        stage.heard();
        stage.act("alice command 2 5: home");
        let left = stage.heard().iter().any(|line| line.contains("executing"));
        assert_eq!(stage.grant("/zone/right", "bob").is_ok(), left, "at {x}");
    }
}
