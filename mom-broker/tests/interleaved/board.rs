//! The switchboard with its hub: messages by a channel's route, while the route changes under them.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use mom_hub::{ContextSpec, Hub, Input, PeerId, Settings, User};
use mom_journal::{AuditConfig, ConfigFile, RecordConfig, Tap};
use mom_managers::Registry;
use mom_net::Reader;
use mom_proto::{Family, Limit, Limits, Map, Parcel, Path, from_value};

use super::{clock, explore, hear, heard, link, on, said};
use crate::traffic::channel::Sender;
use crate::traffic::encodings::Bounds;
use crate::traffic::outbox::Outbox;
use crate::traffic::switchboard::{Handled, Keeping, Switchboard, Touched, flush};

/// A switchboard, and who is at it.
pub(super) struct Lab {
    pub(super) board: Arc<Switchboard>,
    /// Kept as the connections' tasks keep them.
    pub(super) outboxes: Vec<Arc<Outbox>>,
}

pub(super) fn path(text: &str) -> Path {
    Path::parse(text).expect("a path")
}

/// A session, a token in it that a higher level takes at once, a channel whose commands it guards, and one in which
/// senders wait for room.
fn contexts() -> Vec<ContextSpec> {
    let context = |path: &str, kind: &str| {
        Map::new()
            .with("path", path)
            .with("kind", kind)
            .with("presence", "none")
    };
    let manager = Map::new().with("kind", "level-or-lease");
    let names = vec!["command".into()];
    let guard = Map::new().with("token", "/lab/key").with("names", names);
    let all = [
        context("/lab", "session"),
        context("/lab/key", "token").with("manager", manager),
        context("/lab/arm", "channel").with("guard", guard),
        context("/lab/bulk", "channel").with("overflow", "wait"),
        Map::new()
            .with("path", "/lab/stand")
            .with("kind", "channel")
            .with("presence", "all"),
    ];
    all.into_iter()
        .map(|spec| from_value(spec.into()).expect("a context"))
        .collect()
}

impl Lab {
    pub(super) fn new() -> Lab {
        let settings = Settings::default();
        let registry = Registry::builtin();
        let hub = Hub::new(settings.clone(), registry, &"open".into(), &contexts()).expect("a hub");
        let bounds = Bounds {
            depth: 32,
            parcel: Limit::At(1 << 20),
        };
        let journal = (&AuditConfig::default(), &RecordConfig::default());
        let tap = Tap::start(journal, ConfigFile::default(), &settings, &clock()).expect("it writes nothing");
        Lab {
            board: Arc::new(Switchboard::new(hub, clock(), bounds, Keeping::default(), tap)),
            outboxes: Vec::new(),
        }
    }

    /// A peer logs in and joins the channel; what was said to it so far is forgotten.
    pub(super) fn enter(&mut self, name: &str, level: i32) -> (PeerId, Reader) {
        let peer = self.board.next_peer();
        let (outbox, mut reader) = link(peer, 0);
        self.board.add_outbox(&outbox);
        self.outboxes.push(outbox);
        let user = User {
            name: name.to_owned(),
            level,
            groups: Vec::new(),
            details: Map::new(),
        };
        let login = Input::Login {
            peer,
            user,
            nickname: None,
            id: None,
        };
        let mut touched = Touched::new();
        self.board.decide(login, &mut touched);
        flush(&mut touched);
        for context in ["/lab", "/lab/arm"] {
            ask(&self.board, peer, Family::Context, "join", context);
        }
        heard(&mut reader);
        (peer, reader)
    }
}

/// A request, as a session carries it out.
pub(super) fn ask(board: &Switchboard, peer: PeerId, family: Family, name: &str, context: &str) {
    let parcel = Box::new(Parcel::new(family, name).context(path(context)).id(1000));
    let mut touched = Touched::new();
    board.decide(
        Input::Request {
            peer,
            parcel,
            clock: None,
        },
        &mut touched,
    );
    flush(&mut touched);
}

/// A message to the robot's channel; whether it was taken in.
fn say(board: &Switchboard, peer: PeerId, name: &str, id: u64) -> bool {
    say_to(board, peer, said(name, id).context(path("/lab/arm")))
}

/// A message, as a session carries it out; whether it was taken in.
pub(super) fn say_to(board: &Switchboard, peer: PeerId, parcel: Parcel) -> bool {
    let mut touched = Touched::new();
    let limits = Limits::default();
    let sender = Sender {
        peer,
        clock: &|_| None,
        late: false,
    };
    let mut sent = board.message(&sender, &limits, Box::new(parcel), &mut touched);
    loop {
        flush(&mut touched);
        match sent {
            Ok(Handled::Done) => return true,
            Ok(Handled::Waits(held)) => {
                shuttle::future::block_on(held.ready(&board.clock));
                sent = board.resume(&sender, &limits, *held, &mut touched);
            }
            Err(_) => return false,
        }
    }
}

/// Sender and id of the messages of one name.
pub(super) fn messages(parcels: &[Parcel], name: &str) -> Vec<(String, u64)> {
    let told = |parcel: &Parcel| {
        let sender = parcel.sender.as_deref().unwrap_or_default().to_owned();
        (sender, parcel.id.unwrap_or_default())
    };
    let named = |parcel: &&Parcel| parcel.is(Family::Message, name);
    parcels.iter().filter(named).map(told).collect()
}

/// M27: one order for all receivers.
#[test]
fn all_receivers_hear_one_order() {
    explore(|| {
        let mut lab = Lab::new();
        let mut readers = Vec::new();
        let mut peers = Vec::new();
        for name in ["alice", "bob", "robot"] {
            let (peer, reader) = lab.enter(name, 1);
            peers.push(peer);
            readers.push(reader);
        }
        let senders: Vec<_> = peers[..2]
            .iter()
            .map(|peer| {
                let peer = *peer;
                on(&lab.board, move |board| {
                    (0..3).for_each(|id| assert!(say(board, peer, "state", id)));
                })
            })
            .collect();
        senders
            .into_iter()
            .for_each(|sender| sender.join().expect("it spoke"));
        let all: Vec<_> = readers
            .iter_mut()
            .map(|reader| messages(&heard(reader), "state"))
            .collect();
        assert_eq!(all[0].len(), 6, "{all:?}");
        assert!(all.iter().all(|one| *one == all[0]), "{all:?}");
        for sender in ["alice", "bob"] {
            let ids = all[0]
                .iter()
                .filter(|(name, _)| name == sender)
                .map(|(_, id)| *id);
            assert_eq!(ids.collect::<Vec<_>>(), [0, 1, 2]);
        }
        lab.board.check();
    });
}

/// A member that is told of a peer may answer at once, though the route may not have the new one yet: a device says how it stands.
#[test]
fn who_has_just_joined_hears_what_is_said_to_it() {
    explore(|| {
        let mut lab = Lab::new();
        let (robot, mut to_robot) = lab.enter("robot", 1);
        let (alice, _to_alice) = lab.enter("alice", 1);
        let (bob, mut to_bob) = lab.enter("bob", 1);
        for peer in [robot, alice] {
            ask(&lab.board, peer, Family::Context, "join", "/lab/stand");
        }
        let stand = || path("/lab/stand");
        // So that a verdict stands for its states, and the hub is not asked.
        assert!(say_to(&lab.board, robot, said("state", 1).context(stand())));
        heard(&mut to_robot);
        let joins = on(&lab.board, move |board| {
            ask(board, bob, Family::Context, "join", "/lab/stand");
        });
        // What she says has all that waits for the robot written.
        let speaks = on(&lab.board, move |board| {
            assert!(say_to(board, alice, said("noise", 1).context(stand())));
        });
        let told = |parcel: &Parcel| parcel.is(Family::Event, "joined");
        while !told(&hear(&mut to_robot).expect("it is told")) {}
        let mut state = said("state", 7).context(stand());
        state.address = Some(vec!["bob".into()]);
        assert!(say_to(&lab.board, robot, state));
        joins.join().expect("he joined");
        speaks.join().expect("she spoke");
        let state = messages(&heard(&mut to_bob), "state");
        assert_eq!(state, [("robot".to_owned(), 7)]);
        lab.board.check();
    });
}

/// Design §4, §6: the route is swapped before any effect of its input leaves. What the old owner begins to say
/// after that is refused, and no receiver hears the two owners mixed.
#[test]
fn a_robot_never_hears_two_owners() {
    explore(|| {
        let mut lab = Lab::new();
        let (alice, _to_alice) = lab.enter("alice", 1);
        let (bob, _to_bob) = lab.enter("bob", 5);
        let (_, mut to_robot) = lab.enter("robot", 1);
        ask(&lab.board, alice, Family::Token, "grab", "/lab/key");
        assert!(say(&lab.board, alice, "command", 100), "she owns it");
        heard(&mut to_robot);
        // Of the test itself, not of what is tested: no step of shuttle's.
        let taken = Arc::new(AtomicBool::new(false));
        let old = on(&lab.board, {
            let taken = Arc::clone(&taken);
            move |board| {
                let say = |id| {
                    let late = taken.load(Ordering::SeqCst);
                    say(board, alice, "command", id);
                    late.then_some(id)
                };
                (0..4).filter_map(say).collect::<Vec<u64>>()
            }
        });
        let new = on(&lab.board, move |board| {
            ask(board, bob, Family::Token, "grab", "/lab/key");
            taken.store(true, Ordering::SeqCst);
            say(board, bob, "command", 200)
        });
        let late = old.join().expect("alice spoke");
        assert!(new.join().expect("bob spoke"), "he owns it");
        let parcels = heard(&mut to_robot);
        let commands = messages(&parcels, "command");
        let of_alice: Vec<u64> = commands
            .iter()
            .filter(|(sender, _)| sender == "alice")
            .map(|(_, id)| *id)
            .collect();
        assert!(
            late.iter().all(|id| !of_alice.contains(id)),
            "{late:?} {commands:?}"
        );
        assert!(of_alice.is_sorted(), "{commands:?}");
        assert_eq!(commands.last(), Some(&("bob".to_owned(), 200)), "{commands:?}");
        let at = |family, name| parcels.iter().position(|parcel| parcel.is(family, name));
        let safe = at(Family::Message, "halt").expect("the safe state comes");
        let released = at(Family::Event, "released").expect("the change is told");
        assert!(safe < released, "safe state before the word");
        let after = messages(&parcels[safe..], "command");
        assert_eq!(
            after,
            [("bob".to_owned(), 200)],
            "nothing of the old owner after it"
        );
        lab.board.check();
    });
}

/// What is said to a channel by one thread while another ends something: the ids that began after that end.
fn say_meanwhile(
    lab: &Lab,
    (speaker, context): (PeerId, &'static str),
    end: impl FnOnce(&Switchboard) + Send + 'static,
) -> Vec<u64> {
    // Of the test itself, not of what is tested: no step of shuttle's.
    let ended = Arc::new(AtomicBool::new(false));
    let speaks = on(&lab.board, {
        let ended = Arc::clone(&ended);
        move |board| {
            let say = |id| {
                let late = ended.load(Ordering::SeqCst);
                say_to(board, speaker, said("state", id).context(path(context)));
                late.then_some(id)
            };
            (0..4).filter_map(say).collect()
        }
    });
    let ends = on(&lab.board, move |board| {
        end(board);
        ended.store(true, Ordering::SeqCst);
    });
    ends.join().expect("it ended");
    speaks.join().expect("all is said")
}

/// A message may be overtaken by the answer to the one who leaves, but none is taken in for it after that.
#[test]
fn who_has_left_hears_nothing_more() {
    explore(|| {
        let mut lab = Lab::new();
        let (alice, _to_alice) = lab.enter("alice", 1);
        let (bob, mut to_bob) = lab.enter("bob", 1);
        let (_, mut to_robot) = lab.enter("robot", 1);
        let late = say_meanwhile(&lab, (alice, "/lab/arm"), move |board| {
            ask(board, bob, Family::Context, "leave", "/lab/arm");
        });
        let to_bob = messages(&heard(&mut to_bob), "state");
        let all = messages(&heard(&mut to_robot), "state");
        assert_eq!(all.len(), 4);
        assert_eq!(to_bob, all[..to_bob.len()], "until then he hears all");
        assert!(to_bob.len() + late.len() <= 4, "{to_bob:?}, late {late:?}");
        lab.board.check();
    });
}

/// A reader that found the channel just before it was deleted gets what it would get after.
#[test]
fn a_deleted_channel_delivers_nothing() {
    explore(|| {
        let mut lab = Lab::new();
        let (alice, _to_alice) = lab.enter("alice", 1);
        let (bob, mut to_bob) = lab.enter("bob", 1);
        let parcel = Parcel::new(Family::Context, "create")
            .context(path("/lab/more"))
            .content(Map::new().with("kind", "channel").with("presence", "none"));
        let mut touched = Touched::new();
        let parcel = Box::new(parcel);
        lab.board.decide(
            Input::Request {
                peer: bob,
                parcel,
                clock: None,
            },
            &mut touched,
        );
        flush(&mut touched);
        for outbox in &lab.outboxes {
            ask(&lab.board, outbox.peer, Family::Context, "join", "/lab/more");
        }
        say_to(&lab.board, alice, said("state", 9).context(path("/lab/more")));
        assert_eq!(
            messages(&heard(&mut to_bob), "state").len(),
            1,
            "its verdict stands"
        );
        let late = say_meanwhile(&lab, (alice, "/lab/more"), move |board| {
            ask(board, bob, Family::Context, "delete", "/lab/more");
        });
        let parcels = heard(&mut to_bob);
        let deleted = |parcel: &Parcel| parcel.is(Family::Event, "deleted");
        assert!(parcels.iter().any(deleted), "the end is told");
        let all = messages(&parcels, "state");
        assert!(all.len() + late.len() <= 4, "{all:?}, late {late:?}");
        assert!(all.iter().map(|(_, id)| *id).eq(0..all.len() as u64), "{all:?}");
        lab.board.check();
    });
}

/// A peer that comes while the broker stops is told so, and the stop waits for all to be gone.
#[test]
fn nobody_slips_in_while_the_broker_stops() {
    explore(|| {
        let mut lab = Lab::new();
        let (_, _to_alice) = lab.enter("alice", 1);
        let alice = Arc::clone(&lab.outboxes[0]);
        let comes = on(&lab.board, |board| {
            let (outbox, reader) = link(board.next_peer(), 0);
            board.add_outbox(&outbox);
            (outbox, reader)
        });
        let stops = on(&lab.board, Switchboard::shut_down);
        let (late, _to_late) = comes.join().expect("it came");
        stops.join().expect("it stops");
        assert!(late.is_closed() && alice.is_closed());
        let leave = [alice, late].map(|outbox| on(&lab.board, move |board| board.remove_outbox(&outbox)));
        shuttle::future::block_on(lab.board.wait_empty());
        leave.into_iter().for_each(|peer| peer.join().expect("it left"));
    });
}
