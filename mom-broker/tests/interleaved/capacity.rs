//! Senders that wait for a receiver without capacity, while it reads, leaves, is closed, or another of them goes.
//!
//! The clock stands still, so a sender that nobody calls waits forever, and shows.

use std::sync::Arc;

use mom_hub::PeerId;
use mom_net::Reader;
use mom_proto::{Code, ContextNumber, Family, Limit, Limits, WireError};

use super::board::{Lab, ask, messages, path, say_to};
use super::{explore, hear, heard, on, said, write};
use crate::traffic::channel::Sender;
use crate::traffic::channel::control;
use crate::traffic::encodings::Encodings;
use crate::traffic::memory::Memory;
use crate::traffic::outbox::{LoginFacts, Origin, Outbox};
use crate::traffic::switchboard::{Handled, Switchboard, Touched};

const BULK: &str = "/lab/bulk";

/// Of a message in this process, with its place in the queue.
const SIZE: usize = 256 + 64;

/// Two senders, and a robot for which three of their messages may wait.
struct Scene {
    lab: Lab,
    alice: PeerId,
    bob: PeerId,
    robot: Arc<Outbox>,
    to_robot: Reader,
    /// What those hear who do not matter here.
    _others: [Reader; 2],
}

impl Scene {
    fn new() -> Scene {
        let mut lab = Lab::new();
        let (alice, to_alice) = lab.enter("alice", 1);
        let (bob, to_bob) = lab.enter("bob", 1);
        let (robot, mut to_robot) = lab.enter("robot", 1);
        for peer in [alice, bob, robot] {
            ask(&lab.board, peer, Family::Context, "join", BULK);
        }
        heard(&mut to_robot);
        let robot = Arc::clone(&lab.outboxes[2]);
        fill(&robot);
        let account = Memory::default().account(&"robot".into());
        let limits = Limits {
            outbox: 6 * SIZE,
            burst: 6 * SIZE,
            parcel: Limit::Unlimited,
            ..Limits::default()
        };
        let login = LoginFacts {
            from: None,
            tls: false,
            since: lab.board.clock.wall(),
            visit: false,
        };
        robot.admit(&limits, "robot".into(), account, login);
        Scene {
            lab,
            alice,
            bob,
            robot,
            to_robot,
            _others: [to_alice, to_bob],
        }
    }

    /// Both say so many, each in a thread of its own; how many of each were taken in.
    fn all_speak(&self, count: u64) -> Vec<shuttle::thread::JoinHandle<usize>> {
        let speak = |peer| {
            on(&self.lab.board, move |board| {
                (0..count).filter(|id| say(board, peer, *id)).count()
            })
        };
        [self.alice, self.bob].map(speak).into()
    }
}

/// The link takes two more and then waits for its reader.
fn fill(outbox: &Outbox) {
    for id in 0..62 {
        let origin = Origin {
            context: ContextNumber(1),
            sender: PeerId(0),
            name: "filling".into(),
        };
        let encodings = Encodings::new(said("filling", id), std::iter::once(None));
        outbox.push(control(
            Family::Reply,
            encodings.expect("no form needed"),
            origin,
            None,
        ));
    }
    outbox.flush();
}

fn say(board: &Switchboard, peer: PeerId, id: u64) -> bool {
    let mut parcel = said("state", id).context(path(BULK));
    parcel.echo = Some(false);
    say_to(board, peer, parcel)
}

/// Each waits its turn, none is refused, and each sender's messages stay in their order.
#[test]
fn who_waits_gets_through_when_the_receiver_reads() {
    explore(|| {
        let mut scene = Scene::new();
        let writer = write(&scene.robot);
        let senders = scene.all_speak(5);
        let mut all = Vec::new();
        while all.len() < 10 {
            let parcel = hear(&mut scene.to_robot).expect("it is not closed");
            all.extend(messages(&[*parcel], "state"));
        }
        for sender in senders {
            assert_eq!(sender.join().expect("all is said"), 5);
        }
        for sender in ["alice", "bob"] {
            let ids = all.iter().filter(|(name, _)| name == sender).map(|(_, id)| *id);
            assert_eq!(ids.collect::<Vec<_>>(), [0, 1, 2, 3, 4], "{all:?}");
        }
        scene.robot.close(None, None, true);
        shuttle::future::block_on(writer).expect("the writer ends");
        scene.lab.board.check();
    });
}

/// A receiver that is a hindrance no more, because it has left or is closed, is not waited for.
#[test]
fn nobody_waits_for_who_is_gone() {
    explore(|| {
        let scene = Scene::new();
        let senders = scene.all_speak(6);
        let robot = Arc::clone(&scene.robot);
        let leaves = on(&scene.lab.board, move |board| {
            ask(board, robot.peer, Family::Context, "leave", BULK);
        });
        for sender in senders {
            assert_eq!(sender.join().expect("all is said"), 6);
        }
        leaves.join().expect("it left");
    });
    explore(|| {
        let scene = Scene::new();
        let senders = scene.all_speak(6);
        let robot = Arc::clone(&scene.robot);
        let closes = on(&scene.lab.board, move |board| {
            board.close(
                &robot,
                Some(WireError::new(Code::REVOKED, "it may not be here any more")),
            );
        });
        for sender in senders {
            assert_eq!(sender.join().expect("all is said"), 6);
        }
        closes.join().expect("it closed");
    });
}

/// A sender whose connection ends while it waits makes way for who waits behind it.
#[test]
fn who_goes_makes_way() {
    explore(|| {
        let mut scene = Scene::new();
        let writer = write(&scene.robot);
        let alice = scene.alice;
        let goes = on(&scene.lab.board, move |board| {
            let mut parcel = said("state", 0).context(path(BULK));
            parcel.echo = Some(false);
            let (limits, mut touched) = (Limits::default(), Touched::new());
            let sender = Sender {
                peer: alice,
                clock: &|_| None,
                late: false,
            };
            let mut waited = 0;
            for _ in 0..6 {
                let sent = board.message(&sender, &limits, Box::new(parcel.clone()), &mut touched);
                crate::traffic::switchboard::flush(&mut touched);
                // Dropped, as the task of a connection drops it.
                waited += usize::from(matches!(sent, Ok(Handled::Waits(_))));
            }
            waited
        });
        let bob = scene.bob;
        let stays = on(&scene.lab.board, move |board| {
            (0..5).filter(|id| say(board, bob, *id)).count()
        });
        let mut of_bob = 0;
        while of_bob < 5 {
            let parcel = hear(&mut scene.to_robot).expect("it is not closed");
            of_bob += messages(&[*parcel], "state")
                .iter()
                .filter(|(name, _)| name == "bob")
                .count();
        }
        assert_eq!(stays.join().expect("all is said"), 5);
        assert!(goes.join().expect("it tried") <= 6);
        scene.robot.close(None, None, true);
        shuttle::future::block_on(writer).expect("the writer ends");
        // Whatever waits was given up, so nobody is waited for.
        assert!(!scene.robot.is_awaited(), "a place is left behind");
    });
}

/// A stop has its own lane: whatever else waits for the receiver, it is taken in at once.
#[test]
fn a_stop_does_not_wait() {
    explore(|| {
        let mut scene = Scene::new();
        let alice = scene.alice;
        let speaks = on(&scene.lab.board, move |board| {
            (0..6).filter(|id| say(board, alice, *id)).count()
        });
        // Without a writer and without a reader, nothing makes room.
        let bob = scene.bob;
        let stops = on(&scene.lab.board, move |board| {
            say_to(board, bob, said("stop", 7).context(path(BULK)))
        });
        assert!(stops.join().expect("it is said"), "a stop was refused");
        let writer = write(&scene.robot);
        let mut names = Vec::new();
        while names.iter().filter(|name| *name == "state").count() < 6 || !names.contains(&"stop".to_owned())
        {
            names.push(
                hear(&mut scene.to_robot)
                    .expect("it is not closed")
                    .name()
                    .to_owned(),
            );
        }
        assert_eq!(speaks.join().expect("all is said"), 6);
        scene.robot.close(None, None, true);
        shuttle::future::block_on(writer).expect("the writer ends");
    });
}
