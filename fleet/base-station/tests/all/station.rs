//! The library's station.

use std::io::ErrorKind;
use std::time::Instant;

use mom_base_station::circuit::{End, Note, Options, Refusal, State};
use mom_base_station::fleet::{Fleet, Unit};
use mom_base_station::log::Entry;
use mom_base_station::play::play;
use mom_base_station::script::Script;
use mom_base_station::station::{SendError, Settings, Snapshot, Station};
use mom_brs::file::EXTENDED;
use mom_brs::{Command, Frame, PAPER};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpListener;
use tokio::sync::broadcast::Receiver;
use tokio::time::timeout;

use crate::robot::{PATIENCE, Robot, fleet};

fn station(ports: &[u16], circuit: Options) -> Station {
    let settings = Settings {
        circuit,
        ..Settings::default()
    };
    let fleet = Fleet::parse(&fleet(ports)).expect("a fleet");
    Station::new(&fleet, &PAPER, settings)
}

/// NULLs and attempts come quickly.
fn quick() -> Options {
    Options {
        null_period: 50_000,
        first_backoff: 1000,
        ..Options::default()
    }
}

async fn until(station: &Station, unit: Unit, mut is: impl FnMut(&Snapshot) -> bool) -> Snapshot {
    let mut changes = station.watch(unit).expect("a unit of the fleet");
    let is = timeout(PATIENCE, changes.wait_for(|snapshot| is(snapshot))).await;
    is.expect("it should have become so")
        .expect("the station is there")
        .clone()
}

async fn writable(station: &Station, unit: Unit) {
    until(station, unit, |snapshot| snapshot.state == State::Writable).await;
}

async fn next_note(changes: &mut Receiver<Entry>, is: impl Fn(&Note) -> bool) -> Note {
    let note = timeout(PATIENCE, async {
        loop {
            let entry = changes.recv().await.expect("nothing is missed");
            if is(&entry.note) {
                return entry.note;
            }
        }
    });
    note.await.expect("it should have happened")
}

async fn next_state(changes: &mut Receiver<Entry>) -> State {
    match next_note(changes, |note| matches!(note, Note::State(_))).await {
        Note::State(state) => state,
        other => panic!("{other:?}"),
    }
}

fn motor(left: i32, right: i32) -> Frame {
    Frame::new(&Command::MOTOR, &[left, right]).expect("two values")
}

fn status() -> Frame {
    Frame::new(&Command::STATUS, &[]).expect("no values")
}

#[tokio::test]
async fn it_connects_and_measures_the_round_trip_of_a_null() {
    let mut robot = Robot::start().await;
    let station = station(&[robot.port], Options::default());
    let mut changes = station.subscribe();
    let [before] = &station.snapshot()[..] else {
        panic!("one robot")
    };
    assert_eq!((before.state, before.round_trip), (State::Disconnected, None));
    station.connect_all();
    assert_eq!(next_state(&mut changes).await, State::Trying);
    assert_eq!(next_state(&mut changes).await, State::Connected);
    let reply = next_note(&mut changes, |note| matches!(note, Note::Received(..))).await;
    assert_eq!(next_state(&mut changes).await, State::Writable);
    let Note::Received(null, Some(round_trip)) = reply else {
        panic!("{reply:?}")
    };
    assert_eq!(null.to_string(), "00");
    assert!(round_trip > 0, "{round_trip}");
    assert_eq!(station.snapshot()[0].round_trip, Some(round_trip));
    assert_eq!([robot.line().await, robot.line().await], ["connected", "got 00"]);
    station.close().await;
    robot.until("closed").await;
}

#[tokio::test]
async fn nulls_leave_by_themselves_in_their_period() {
    let mut robot = Robot::start().await;
    let station = station(&[robot.port], quick());
    let begun = Instant::now();
    station.connect_all();
    robot.until("connected").await;
    for _ in 0..5 {
        assert_eq!(robot.line().await, "got 00");
    }
    assert!(
        begun.elapsed().as_millis() >= 4 * 50,
        "the first is at once, then there are four periods"
    );
}

#[tokio::test]
async fn commands_arrive_byte_for_byte_and_in_order() {
    let mut robot = Robot::start().await;
    let station = station(&[robot.port], Options::default());
    station.connect_all();
    writable(&station, 1).await;
    for (left, right) in [(100, 100), (50, -50), (-1000, 1000)] {
        station.send(1, motor(left, right)).unwrap();
    }
    station
        .send(1, Frame::new(&Command::LEDS, &[5]).unwrap())
        .unwrap();
    for expected in ["06 00100 00100", "06 00050 -0050", "06 -1000 01000", "07 00005"] {
        assert_eq!(robot.command().await, expected);
    }
    assert_eq!(station.send(2, motor(1, 1)), Err(SendError::NoUnit(2)));
}

#[tokio::test]
async fn a_status_reply_is_read_even_in_pieces() {
    let mut robot = Robot::start().await;
    let station = station(&[robot.port], Options::default());
    station.connect_all();
    writable(&station, 1).await;
    let mut changes = station.subscribe();
    station.send(1, status()).unwrap();
    let reply = next_note(&mut changes, |note| matches!(note, Note::Received(..))).await;
    assert_eq!(
        reply,
        Note::Received(Frame::reply(&Command::STATUS, &[37]).unwrap(), None)
    );
    assert_eq!(
        until(&station, 1, |snapshot| snapshot.status.is_some())
            .await
            .status,
        Some(37)
    );
    robot.tell("say 04 000").await;
    robot.tell("say 12").await;
    until(&station, 1, |snapshot| snapshot.status == Some(12)).await;
}

#[tokio::test]
async fn a_connection_that_is_cut_is_tried_again_until_it_is_there() {
    let mut robot = Robot::start().await;
    let station = station(&[robot.port], quick());
    station.connect_all();
    writable(&station, 1).await;
    let mut changes = station.subscribe();
    robot.tell("cut").await;
    let ended = next_note(&mut changes, |note| matches!(note, Note::Ended(_))).await;
    assert_eq!(ended, Note::Ended(End::Closed));
    for expected in [State::Trying, State::Connected, State::Writable] {
        assert_eq!(next_state(&mut changes).await, expected);
    }
    station.send(1, motor(1, 2)).unwrap();
    assert_eq!(robot.command().await, "06 00001 00002");
}

#[tokio::test]
async fn a_robot_that_says_nothing_any_more_is_left_and_tried_again() {
    let mut robot = Robot::start().await;
    let station = station(&[robot.port], quick());
    station.connect_all();
    writable(&station, 1).await;
    let mut changes = station.subscribe();
    robot.tell("mute").await;
    let ended = next_note(&mut changes, |note| matches!(note, Note::Ended(_))).await;
    assert_eq!(ended, Note::Ended(End::Silent));
    robot.tell("unmute").await;
    writable(&station, 1).await;
}

#[tokio::test]
async fn a_robot_that_is_not_understood_is_left_and_tried_again() {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let port = listener.local_addr().expect("an address").port();
    let station = station(&[port], Options::default());
    station.connect_all();
    for _ in 0..2 {
        let (mut robot, _) = listener.accept().await.expect("the station connects");
        robot.write_all(b"00").await.expect("it reads");
        writable(&station, 1).await;
        robot.write_all(&[b'?'; 100]).await.expect("it reads");
        let ended = timeout(PATIENCE, robot.read_to_end(&mut Vec::new())).await;
        let error = ended.expect("it ends").expect_err("not in order");
        assert_eq!(error.kind(), ErrorKind::ConnectionReset);
    }
    let end = until(&station, 1, |snapshot| snapshot.last_end.is_some()).await;
    assert_eq!(end.last_end, Some(End::Astray));
    station.close().await;
}

/// What a gateway says at once, before it hears the first of the notes that all of it has been written.
#[tokio::test]
async fn the_longest_way_goes_out_in_one_turn_and_nobody_misses_an_entry() {
    let mut robot = Robot::start().await;
    let station = station(&[robot.port], Options::default());
    station.connect_all();
    writable(&station, 1).await;
    let mut changes = station.subscribe_to(1).expect("a unit of the fleet");
    // One thread: nothing is written until all is said.
    let say = |name: &str, values: &[i32]| {
        let command = EXTENDED.command(name).expect("one of ours");
        let frame = Frame::new(command, values).expect("its values");
        station.send(1, frame).expect("it has its place");
    };
    say("motor", &[0, 0]);
    say("goto", &[0, 0]);
    (1..64).for_each(|x| say("via", &[x, 0]));
    say("pose", &[]);
    say("status", &[]);
    robot.until("got 06 00000 00000").await;
    let mut sent = 0;
    while sent < 67 {
        let entry = changes.try_recv().expect("nothing is missed");
        sent += usize::from(matches!(entry.note, Note::Sent(_)));
    }
}

/// A connection that is only closed would go on to deliver what was written, however late.
#[tokio::test]
async fn a_connection_that_is_given_up_is_reset() {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let port = listener.local_addr().expect("an address").port();
    let station = station(&[port], Options::default());
    station.connect_all();
    let (mut robot, _) = listener.accept().await.expect("the station connects");
    let mut null = [0; 2];
    robot.read_exact(&mut null).await.expect("a NULL");
    robot.write_all(b"00").await.expect("it reads");
    writable(&station, 1).await;
    station.give_up(1).expect("a unit of the fleet");
    let ended = timeout(PATIENCE, robot.read_to_end(&mut Vec::new())).await;
    let error = ended.expect("it ends").expect_err("not in order");
    assert_eq!(error.kind(), ErrorKind::ConnectionReset);
    let end = until(&station, 1, |snapshot| snapshot.last_end.is_some()).await;
    assert_eq!(end.last_end, Some(End::Silent));
    station.close().await;
}

#[tokio::test]
async fn where_nobody_listens_it_keeps_trying_and_tells_why() {
    let nobody = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = nobody.local_addr().unwrap().port();
    drop(nobody);
    let station = station(&[port], quick());
    station.connect_all();
    let snapshot = until(&station, 1, |snapshot| snapshot.last_end.is_some()).await;
    assert_eq!(snapshot.state, State::Trying);
    let text = snapshot.last_end.unwrap().to_string();
    assert!(text.starts_with("cannot connect: Connection refused"), "{text}");
}

#[tokio::test]
async fn a_robot_that_serves_somebody_else_is_connected_and_takes_no_commands() {
    // The operating system connects for any listener, served or not.
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let station = station(&[listener.local_addr().unwrap().port()], Options::default());
    station.connect_all();
    until(&station, 1, |snapshot| snapshot.state == State::Connected).await;
    let refusal = Refusal::NotWritable(State::Connected);
    assert_eq!(
        station.send(1, motor(1, 1)),
        Err(SendError::Refused { unit: 1, refusal })
    );
}

#[tokio::test]
async fn a_robot_that_floods_is_hung_up_and_harms_no_other_robot() {
    let (mut loud, robot) = (Robot::start().await, Robot::start().await);
    let station = station(&[loud.port, robot.port], Options::default());
    station.connect_all();
    writable(&station, 1).await;
    writable(&station, 2).await;
    loud.tell("chatter").await;
    let mut changes = station.subscribe_to(2).expect("a unit of the fleet");
    let is_status =
        |note: &Note| matches!(note, Note::Received(reply, _) if reply.command().name == "status");
    loop {
        station.send(2, status()).unwrap();
        next_note(&mut changes, is_status).await;
        let loud = station.snapshot().swap_remove(0);
        assert!(loud.faults.unasked < 4096, "{:?}", loud.faults);
        if loud.last_end == Some(End::Flooding) {
            break;
        }
    }
}

#[tokio::test]
async fn a_script_drives_two_robots_and_waits_for_a_reply() {
    let (mut one, mut two) = (Robot::start().await, Robot::start().await);
    let station = station(&[one.port, two.port], Options::default());
    station.connect_all();
    writable(&station, 1).await;
    writable(&station, 2).await;
    let text = "repeat 2; 1 motor 5 5; wait 1; end\n2 status; on 2 reply status\nall motor 0 0";
    let script = Script::parse(text, &[1, 2], &PAPER).unwrap();
    play(&station, script, |_, sent| assert!(sent.is_ok(), "{sent:?}"))
        .await
        .unwrap();
    for expected in ["06 00005 00005", "06 00005 00005", "06 00000 00000"] {
        assert_eq!(one.command().await, expected);
    }
    assert_eq!(
        [two.command().await, two.command().await],
        ["04", "06 00000 00000"]
    );
}

#[tokio::test]
async fn a_script_that_says_more_than_may_wait_waits_itself() {
    let mut robot = Robot::start().await;
    let station = station(&[robot.port], Options::default());
    station.connect_all();
    writable(&station, 1).await;
    let text = "repeat 500; 1 leds 1; 1 null; end; 1 leds 2";
    let script = Script::parse(text, &[1], &PAPER).unwrap();
    play(&station, script, |_, sent| assert!(sent.is_ok(), "{sent:?}"))
        .await
        .unwrap();
    for _ in 0..500 {
        assert_eq!(robot.command().await, "07 00001");
    }
    assert_eq!(robot.command().await, "07 00002");
}

#[tokio::test]
async fn to_halt_stops_only_the_robots_that_were_set_in_motion() {
    let (mut one, mut two) = (Robot::start().await, Robot::start().await);
    let station = station(&[one.port, two.port], Options::default());
    station.connect_all();
    writable(&station, 1).await;
    writable(&station, 2).await;
    station.send(1, motor(7, 7)).unwrap();
    assert_eq!(station.halt().await, [] as [Unit; 0]);
    station.close().await;
    let mut commands = Vec::new();
    loop {
        match one.line().await.as_str() {
            "closed" => break,
            "connected" | "got 00" => {}
            other => commands.push(other.to_owned()),
        }
    }
    assert_eq!(commands.last().map(String::as_str), Some("got 06 00000 00000"));
    assert_eq!(
        [two.line().await, two.line().await, two.line().await],
        ["connected", "got 00", "closed"]
    );
}

#[tokio::test]
async fn a_robot_that_was_set_in_motion_and_is_lost_is_named_by_halt() {
    let mut robot = Robot::start().await;
    let station = station(&[robot.port], Options::default());
    station.connect_all();
    writable(&station, 1).await;
    station.send(1, motor(7, 7)).unwrap();
    assert_eq!(robot.command().await, "06 00007 00007");
    drop(robot);
    until(&station, 1, |snapshot| snapshot.state == State::Trying).await;
    assert_eq!(station.halt().await, [1]);
}

#[tokio::test]
async fn a_robot_whose_connection_has_just_broken_hears_its_stop_on_the_next_one() {
    let mut robot = Robot::start().await;
    let station = station(&[robot.port], Options::default());
    station.connect_all();
    writable(&station, 1).await;
    station.send(1, motor(7, 7)).unwrap();
    assert_eq!(robot.command().await, "06 00007 00007");
    robot.tell("cut").await;
    until(&station, 1, |snapshot| snapshot.state == State::Trying).await;
    // It waits for no pause between two attempts.
    assert_eq!(station.halt().await, [] as [Unit; 0]);
    assert_eq!(robot.command().await, "06 00000 00000");
}

#[tokio::test]
async fn to_part_from_a_robot_stops_it_first_and_tells_where_that_is_not_known() {
    let mut robot = Robot::start().await;
    let station = station(&[robot.port], Options::default());
    station.connect_all();
    writable(&station, 1).await;
    station.send(1, motor(7, 7)).unwrap();
    assert_eq!(robot.command().await, "06 00007 00007");
    assert!(station.part(1).await.unwrap());
    assert_eq!(robot.command().await, "06 00000 00000");
    until(&station, 1, |snapshot| snapshot.state == State::Disconnected).await;
    // It stands, so there is nothing to wait for.
    assert!(station.part(1).await.unwrap());
    station.connect(1).unwrap();
    writable(&station, 1).await;
    station.send(1, motor(7, 7)).unwrap();
    assert_eq!(robot.command().await, "06 00007 00007");
    robot.tell("mute").await;
    assert!(!station.part(1).await.unwrap());
}

/// What is written may lie in a network, or before a program that is frozen: only what the robot has read stops it.
#[tokio::test]
async fn a_robot_that_answers_nothing_more_is_named_by_halt() {
    let (mut one, two) = (Robot::start().await, Robot::start().await);
    let station = station(&[one.port, two.port], Options::default());
    station.connect_all();
    writable(&station, 1).await;
    writable(&station, 2).await;
    station.send(1, motor(7, 7)).unwrap();
    station.send(2, motor(7, 7)).unwrap();
    assert_eq!(one.command().await, "06 00007 00007");
    one.tell("mute").await;
    assert_eq!(station.halt().await, [1]);
    assert_eq!(one.command().await, "06 00000 00000");
}

#[tokio::test]
async fn a_stop_that_was_not_read_is_said_again_and_its_robot_named() {
    let mut one = Robot::start().await;
    let station = station(&[one.port], Options::default());
    station.connect_all();
    writable(&station, 1).await;
    station.send(1, motor(7, 7)).unwrap();
    assert_eq!(one.command().await, "06 00007 00007");
    one.tell("mute").await;
    station.send(1, motor(0, 0)).unwrap();
    assert_eq!(one.command().await, "06 00000 00000");
    assert_eq!(station.halt().await, [1]);
    assert_eq!(one.command().await, "06 00000 00000");
}

#[tokio::test]
async fn two_hundred_robots_are_connected_by_one_station() {
    let listener = TcpListener::bind("0.0.0.0:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    let robots = tokio::spawn(async move {
        let mut robots = Vec::new();
        while let Ok((robot, _)) = listener.accept().await {
            robots.push(tokio::spawn(async move {
                let (mut from, mut to) = robot.into_split();
                // NULL is echoed.
                let _ = tokio::io::copy(&mut from, &mut to).await;
            }));
        }
    });
    let robot = |unit| format!("[[robot]]\nunit = {unit}\naddress = \"127.0.7.{unit}:{port}\"\n");
    let text: String = (1..=200).map(robot).collect();
    let station = Station::new(&Fleet::parse(&text).unwrap(), &PAPER, Settings::default());
    station.connect_all();
    for unit in 1..=200 {
        writable(&station, unit).await;
    }
    assert!(
        station
            .snapshot()
            .iter()
            .all(|snapshot| snapshot.round_trip.is_some())
    );
    robots.abort();
}

/// What a robot heard until that happened, without NULLs.
async fn heard(robot: &mut Robot, end: &str) -> Vec<String> {
    let mut heard = Vec::new();
    loop {
        match robot.line().await.as_str() {
            line if line == end => return heard,
            "got 00" => {}
            other => heard.push(other.to_owned()),
        }
    }
}

#[tokio::test]
async fn a_robot_is_taken_out_and_another_takes_its_unit_while_the_others_drive() {
    let (mut one, mut two) = (Robot::start().await, Robot::start().await);
    let mut three = Robot::start().await;
    let station = station(&[one.port, two.port], Options::default());
    station.connect_all();
    for (unit, robot) in [(1, &mut one), (2, &mut two)] {
        writable(&station, unit).await;
        station.send(unit, motor(7, 7)).unwrap();
        assert_eq!(heard(robot, "got 06 00007 00007").await, ["connected"]);
    }
    assert!(station.remove(1).await.unwrap(), "its stop was written");
    assert_eq!(heard(&mut one, "closed").await, ["got 06 00000 00000"]);
    assert_eq!(station.remove(1).await, Err(SendError::NoUnit(1)));
    assert_eq!(station.connect(1), Err(SendError::NoUnit(1)));
    // Another robot under its unit; there is one robot of each.
    let other = Fleet::parse(&fleet(&[three.port])).unwrap();
    let [robot] = other.robots() else {
        panic!("one robot")
    };
    assert!(station.add(robot));
    assert!(!station.add(robot));
    station.connect(1).unwrap();
    writable(&station, 1).await;
    station.send(1, motor(9, 9)).unwrap();
    assert_eq!(three.command().await, "06 00009 00009");
    // The other one drove all the time, on the same connection.
    station.send(2, motor(8, 8)).unwrap();
    assert_eq!(heard(&mut two, "got 06 00008 00008").await, [""; 0]);
}
