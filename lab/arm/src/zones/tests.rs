//! Zones, legs and places.

use proptest::prelude::*;

use super::shape::MARGIN;
use super::*;

fn path(text: &str) -> Path {
    Path::parse(text).unwrap()
}

fn info(from: [f64; 3], to: [f64; 3], owner: Option<&str>, fence: i64) -> Map {
    let corner = |at: [f64; 3]| Value::from(at.map(Value::Double).to_vec());
    let zone = Map::new().with("from", corner(from)).with("to", corner(to));
    let info = Map::new().with("zone", zone).with("fence", fence);
    match owner {
        Some(owner) => info.with("owner", owner),
        None => info,
    }
}

/// Two halves of the table, and a column of air between them.
fn halves() -> Zones {
    let mut zones = Zones::new(Mount::default());
    for (name, from, to) in [("/zone/left", -300.0, -100.0), ("/zone/right", 100.0, 300.0)] {
        zones.add(path(name));
        let info = info([from, -300.0, 0.0], [to, 300.0, 450.0], Some("alice"), 1);
        zones.told(&path(name), &info);
    }
    zones
}

fn at(x: f64, z: f64) -> Pose {
    Pose::new(x, 0.0, z, 0.0, 0.0)
}

#[test]
fn a_leg_through_a_zone_is_refused_to_whom_does_not_own_it() {
    let zones = halves();
    let refused = |commander: Option<&str>, from: Pose, to: Pose| {
        let checked = zones.closed_to(commander).check_leg(&from, &to);
        checked.err().map(|error| error.text().to_owned())
    };
    assert_eq!(refused(Some("alice"), at(0.0, 100.0), at(200.0, 100.0)), None);
    let words = refused(Some("bob"), at(0.0, 100.0), at(200.0, 100.0)).expect("not his");
    assert!(
        words.contains("/zone/left") || words.contains("/zone/right"),
        "{words}"
    );
    assert!(words.contains("which alice owns, not bob"), "{words}");
    let words = refused(None, at(0.0, 100.0), at(200.0, 100.0)).expect("nobody's");
    assert!(words.ends_with("nobody owns the arm's token"), "{words}");
}

#[test]
fn the_forearm_counts_and_what_is_above_the_zone_does_not() {
    let mut zones = Zones::new(Mount::default());
    zones.add(path("/zone/left"));
    // The hand is 250 mm to the right of it; the forearm comes from the left, at about 400 mm.
    zones.told(
        &path("/zone/left"),
        &info([-300.0, -100.0, 0.0], [-150.0, 100.0, 450.0], None, 0),
    );
    assert!(zones.closed_to(Some("bob")).check(&at(100.0, 20.0)).is_err());
    zones.told(
        &path("/zone/left"),
        &info([-300.0, -100.0, 0.0], [-150.0, 100.0, 150.0], None, 0),
    );
    assert_eq!(zones.closed_to(Some("bob")).check(&at(100.0, 20.0)), Ok(()));
}

#[test]
fn a_zone_is_closed_until_all_is_known_of_it_and_after_it_is_lost() {
    let mut zones = Zones::new(Mount::default());
    let zone = path("/zone/right");
    let entered = |zones: &Zones| zones.closed_to(Some("alice")).check(&at(200.0, 100.0));
    assert_eq!(entered(&zones), Ok(()));
    zones.add(zone.clone());
    assert!(entered(&zones).is_err_and(|error| error.text().contains("does not know yet where")));
    assert!(zones.check_grant(&zone, &at(-200.0, 100.0)).is_err());
    let owned = info([100.0, -300.0, 0.0], [300.0, 300.0, 450.0], Some("alice"), 7);
    zones.told(&zone, &owned);
    assert_eq!(entered(&zones), Ok(()));
    zones.released(&zone, 7);
    assert!(entered(&zones).is_err_and(|error| error.text().ends_with("nobody does, so grab it first")));
    // An answer that was under way when it was released.
    zones.told(&zone, &owned);
    assert!(entered(&zones).is_err());
    zones.grabbed(&zone, "alice", 8);
    assert_eq!(entered(&zones), Ok(()));
    zones.released(&zone, 7);
    assert_eq!(entered(&zones), Ok(()));
    zones.forget();
    assert!(entered(&zones).is_err());
}

#[test]
fn the_zone_of_a_deleted_token_stays_closed_and_the_rest_open() {
    let mut zones = halves();
    let zone = path("/zone/right");
    let check = |zones: &Zones, x: f64| zones.closed_to(Some("alice")).check(&at(x, 100.0));
    zones.remove(&zone);
    // What was under way, and a link that is lost, open nothing.
    zones.grabbed(&zone, "alice", 9);
    zones.told(
        &zone,
        &info([100.0, -300.0, 0.0], [300.0, 300.0, 450.0], Some("alice"), 9),
    );
    zones.forget_one(&zone);
    let refusal = check(&zones, 200.0).expect_err("it is closed");
    assert!(refusal.text().contains("whose token was deleted"), "{refusal}");
    assert_eq!(check(&zones, -200.0), Ok(()));
    zones.add(zone.clone());
    assert!(check(&zones, 200.0).is_err(), "nobody owns the new one yet");
    zones.told(
        &zone,
        &info([100.0, -300.0, 0.0], [300.0, 300.0, 450.0], Some("alice"), 2),
    );
    assert_eq!(check(&zones, 200.0), Ok(()));
}

#[test]
fn a_pose_that_no_joints_can_hold_is_in_each_closed_zone() {
    let zones = halves();
    let outside = Pose::new(0.0, 2000.0, 100.0, 0.0, 0.0);
    let checked = zones.closed_to(Some("bob")).check(&outside);
    assert!(checked.is_err_and(|error| error.name() == ErrorName::ZoneNotOwned));
    assert_eq!(
        zones.closed_to(Some("alice")).check(&outside),
        Ok(()),
        "all are hers"
    );
    assert!(
        zones.check_grant(&path("/zone/right"), &outside).is_err(),
        "it may stand there"
    );
}

#[test]
fn nobody_is_granted_the_zone_in_which_the_arm_stands() {
    let zones = halves();
    let why = zones
        .check_grant(&path("/zone/right"), &at(200.0, 100.0))
        .unwrap_err();
    assert!(why.starts_with("the arm stands in /zone/right"), "{why}");
    assert_eq!(
        zones.check_grant(&path("/zone/right"), &at(-200.0, 100.0)),
        Ok(())
    );
    assert!(
        zones
            .check_grant(&path("/zone/other"), &at(-200.0, 100.0))
            .is_err()
    );
}

#[test]
fn a_mount_is_three_numbers() {
    assert_eq!(
        "500, 0,180".parse(),
        Ok(Mount {
            x: 500.0,
            y: 0.0,
            yaw: 180.0
        })
    );
    for bad in ["", "1,2", "1,2,3,4", "1,2,nan", "1,x,3,4", "1e9,0,0"] {
        assert!(bad.parse::<Mount>().is_err(), "{bad}");
    }
    let place = Mount {
        x: 500.0,
        y: 0.0,
        yaw: 180.0,
    }
    .place([200.0, 50.0, 7.0]);
    assert!((place[0] - 300.0).abs() < 1e-9 && (place[1] + 50.0).abs() < 1e-9 && place[2] == 7.0);
}

#[test]
fn a_place_in_a_zone_of_ones_own_is_ones_own() {
    let mut zones = Zones::new(Mount::default());
    let told = |zones: &mut Zones, name: &str, from: f64, to: f64, owner: Option<&str>| {
        zones.add(path(name));
        zones.told(
            &path(name),
            &info([from, -400.0, 0.0], [to, 400.0, 800.0], owner, 1),
        );
    };
    told(&mut zones, "/zone/table", -900.0, 900.0, None);
    told(&mut zones, "/zone/left", -900.0, 0.0, Some("alice"));
    told(&mut zones, "/zone/right", 0.0, 900.0, None);
    let entered = |zones: &Zones, x: f64| zones.closed_to(Some("alice")).check(&at(x, 200.0));
    assert_eq!(entered(&zones, -200.0), Ok(()));
    // It is in the whole table's zone too; the one that is missing is named.
    let words = entered(&zones, 10.0).unwrap_err();
    assert!(
        words
            .text()
            .contains("in the zone /zone/right, which alice does not own"),
        "{words}"
    );
    told(&mut zones, "/zone/right", 0.0, 900.0, Some("alice"));
    // Two of her own side by side cover what is between them.
    assert_eq!(entered(&zones, 10.0), Ok(()));
    assert!(zones.closed_to(Some("bob")).check(&at(10.0, 200.0)).is_err());
}

proptest! {
    /// A box is covered exactly if each point of it is in one of the others; points are looked for on a grid.
    #[test]
    fn boxes_cover_what_none_of_its_points_is_outside(
        corners in proptest::collection::vec((0..5_i32, 0..5_i32, 0..5_i32, 1..5_i32, 1..5_i32, 1..5_i32), 1..6),
    ) {
        let boxes: Vec<ZoneBox> = corners.iter().map(|&(x, y, z, a, b, c)| ZoneBox {
            from: [x, y, z].map(f64::from),
            to: [x + a, y + b, z + c].map(f64::from),
        }).collect();
        let within = |bounds: &ZoneBox, at: Xyz| (0..3).all(|axis| bounds.from[axis] < at[axis] && at[axis] < bounds.to[axis]);
        let whole = boxes[0];
        let mut cells = (0..1000).map(|n| [n / 100, n / 10 % 10, n % 10].map(|k| f64::from(k) + 0.5));
        let covered = cells.all(|at| !within(&whole, at) || boxes[1..].iter().any(|bounds| within(bounds, at)));
        prop_assert_eq!(whole.is_covered(&boxes[1..]), covered);
    }

    /// Between two poses that were checked the arm comes nearer to a zone that the leg was found to keep out of by no more
    /// than the margin.
    #[test]
    fn a_leg_that_is_allowed_keeps_out(
        a in proptest::array::uniform5(-1.0..1.0_f64), b in proptest::array::uniform5(-1.0..1.0_f64),
        from in proptest::array::uniform3(-1.0..0.5_f64), size in proptest::array::uniform3(0.1..0.8_f64),
        yaw in -180.0..180.0_f64, parts in proptest::collection::vec(0.0..1.0_f64, 20),
    ) {
        let pose = |v: [f64; 5]| Pose::new(v[0] * 250.0, v[1] * 250.0, 225.0 + v[2] * 200.0, v[3] * 90.0, v[4] * 20.0);
        let (a, b) = (pose(a), pose(b));
        let corner = [from[0] * 300.0, from[1] * 300.0, from[2] * 225.0 + 225.0];
        let bounds = ZoneBox { from: corner, to: std::array::from_fn(|axis| corner[axis] + size[axis] * 300.0) };
        let mount = Mount { x: 0.0, y: 0.0, yaw };
        let zones = vec![ClosedZone { name: path("/zone"), bounds: Some(bounds), owner: None, gone: false }];
        let closed = Closed { mount, zones, ..Closed::default() };
        let inner = ZoneBox { from: bounds.from.map(|at| at + MARGIN), to: bounds.to.map(|at| at - MARGIN) };
        if closed.check_leg(&a, &b).is_ok() {
            for part in parts {
                prop_assert!(!inner.holds(&mount, &a.between(&b, part)));
            }
        }
    }
}
