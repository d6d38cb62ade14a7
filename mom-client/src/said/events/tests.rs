//! Reading events.

use super::*;

fn check(name: &str, content: Map, expected: impl FnOnce(Parcel) -> Event) {
    let path = Path::parse("/robot/token").unwrap();
    let parcel = Parcel::new(Family::Event, name).context(path).content(content);
    assert_eq!(Event::from_parcel(parcel.clone()), expected(parcel), "{name}");
}

#[test]
fn events_are_read() {
    let path = || Path::parse("/robot/token").unwrap();
    let alice = || {
        Map::new()
            .with("peer", "ally")
            .with("user", "alice")
            .with("level", 1)
    };
    let member = || Member {
        peer: "ally".to_owned(),
        user: "alice".to_owned(),
        level: 1,
        device: false,
    };
    check("joined", alice(), |_| Event::Joined(member()));
    check("left", alice(), |_| Event::Left(member()));
    check("joined", Map::new().with("count", 201), |_| Event::Count(201));
    check("deleted", Map::new(), |_| Event::Deleted { path: path() });
    let created = Map::new()
        .with("path", "/robot/arm")
        .with("kind", "channel")
        .with("number", 7);
    check("created", created, |_| {
        Event::Created(ContextInfo {
            path: Path::parse("/robot/arm").unwrap(),
            kind: ContextKind::Channel,
            number: 7,
            members: None,
            stop: None,
        })
    });
    let grabbed = Map::new()
        .with("owner", "ally")
        .with("level", 1)
        .with("fence", 3)
        .with("lease", 50);
    check("grabbed", grabbed, |_| Event::Grabbed {
        owner: "ally".to_owned(),
        level: 1,
        fence: 3,
        lease: Some(Duration::from_millis(50)),
        path: path(),
    });
    let released = Map::new()
        .with("owner", "ally")
        .with("reason", "preempted")
        .with("by", "carol")
        .with("fence", 3);
    check("released", released, |_| Event::Released {
        owner: "ally".to_owned(),
        reason: "preempted".to_owned(),
        by: Some("carol".to_owned()),
        fence: 3,
        path: path(),
    });
    check(
        "dropped",
        Map::new().with("reason", "expired").with("count", 4),
        |parcel| Event::Dropped {
            reason: "expired".to_owned(),
            count: 4,
            parcel,
        },
    );
}

#[test]
fn events_of_handing_over_are_read() {
    let path = || Path::parse("/robot/token").unwrap();
    let seconds = Duration::from_secs;
    let bob = || {
        Map::new()
            .with("peer", "bob")
            .with("user", "bob")
            .with("level", 1)
    };
    check(
        "requested",
        bob().with("within", 30_000).with("text", "please"),
        |_| Event::Requested {
            member: Member {
                peer: "bob".to_owned(),
                user: "bob".to_owned(),
                level: 1,
                device: false,
            },
            within: seconds(30),
            text: Some("please".to_owned()),
            path: path(),
        },
    );
    let offer = Map::new()
        .with("by", "ally")
        .with("to", "bob")
        .with("level", 1)
        .with("within", 10_000)
        .with("fence", 3)
        .with("for", 60_000);
    check("offer", offer, |_| Event::Offer {
        by: "ally".to_owned(),
        to: "bob".to_owned(),
        level: 1,
        within: seconds(10),
        fence: 3,
        time: Some(seconds(60)),
        commands: None,
        path: path(),
    });
    let lapsed = Map::new()
        .with("what", "offer")
        .with("by", "ally")
        .with("to", "bob")
        .with("reason", "timed-out");
    check("lapsed", lapsed, |_| Event::Lapsed {
        what: "offer".to_owned(),
        by: "ally".to_owned(),
        to: "bob".to_owned(),
        reason: "timed-out".to_owned(),
        path: path(),
    });
    check(
        "queued",
        Map::new().with("place", 2).with("expected", 5000),
        |_| Event::Queued {
            place: 2,
            expected: Some(seconds(5)),
            path: path(),
        },
    );
}

#[test]
fn events_about_peers_and_shared_holds_are_read() {
    let path = || Path::parse("/robot/token").unwrap();
    let holders = || {
        Map::new()
            .with("peer", "bob")
            .with("holders", vec!["ally".into()])
    };
    check("inhibited", holders(), |_| Event::Inhibited {
        peer: "bob".to_owned(),
        holders: vec!["ally".to_owned()],
        path: path(),
    });
    check("uninhibited", holders().with("reason", "left"), |_| {
        Event::Uninhibited {
            peer: "bob".to_owned(),
            holders: vec!["ally".to_owned()],
            reason: "left".to_owned(),
            path: path(),
        }
    });
    // Without a path of its own it is about the context in which it is told.
    check(
        "invited",
        Map::new().with("by", "ally").with("kind", "from later"),
        |_| Event::Invited {
            by: "ally".to_owned(),
            kind: None,
            path: path(),
        },
    );
    check("expelled", Map::new().with("peer", "bob"), |_| Event::Expelled {
        peer: "bob".to_owned(),
        by: None,
        text: None,
        path: path(),
    });
}

#[test]
fn what_is_not_understood_stays_a_parcel() {
    for (name, content) in [
        ("from-the-future", Map::new()),
        ("joined", Map::new().with("peer", 3)),
        ("grabbed", Map::new().with("owner", "ally").with("fence", -1)),
        ("released", Map::new().with("fence", 3)),
        ("dropped", Map::new()),
        ("requested", Map::new().with("within", 1)),
        ("offer", Map::new().with("by", "ally")),
        ("lapsed", Map::new()),
        ("queued", Map::new().with("place", "first")),
        ("inhibited", Map::new()),
        ("uninhibited", Map::new()),
        ("invited", Map::new()),
        ("expelled", Map::new()),
    ] {
        check(name, content, Event::Other);
    }
}
