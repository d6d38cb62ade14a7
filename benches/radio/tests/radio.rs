//! The radio network as its users see it.

use std::collections::BTreeMap;

use mom_radio::{
    Access, Fate, Loss, MessageId, Micros, Outcome, PathLoss, Position, Radio, Reason, SendError, Settings,
    Station, Transport,
};
use proptest::prelude::*;

const SECOND: Micros = 1_000_000;

/// A network with stations in a row, so many m apart.
fn row(settings: Settings, stations: usize, apart: f64) -> (Radio, Vec<Station>) {
    let mut radio = Radio::new(settings);
    let stations = (0..stations)
        .map(|i| radio.add(Position::new(i as f64 * apart, 0.0)))
        .collect();
    (radio, stations)
}

/// All fates up to a time.
fn all(radio: &mut Radio, until: Micros) -> Vec<Outcome> {
    std::iter::from_fn(|| radio.poll(until)).collect()
}

fn only(radio: &mut Radio) -> Outcome {
    let outcomes = all(radio, 100 * SECOND);
    assert_eq!(outcomes.len(), 1, "{outcomes:?}");
    outcomes[0]
}

#[test]
fn an_idle_network_takes_a_frame_at_once_and_the_next_after_a_backoff() {
    let (mut radio, stations) = row(
        Settings {
            access: Access::Fair,
            ..Settings::default()
        },
        2,
        1.0,
    );
    for _ in 0..2 {
        radio
            .send(0, stations[0], stations[1], 14, Transport::Datagram)
            .unwrap();
    }
    let outcomes = all(&mut radio, SECOND);
    // (36 + 20 + 8 + 14) octets of 4 µs after 192 µs.
    assert_eq!(outcomes[0].at, 192 + 312);
    // SIFS, the acknowledgement, DIFS, the mean of 31 slots, and the same again.
    assert_eq!(outcomes[1].at, 504 + 10 + 304 + 50 + 310 + 504);
    assert_eq!(radio.counts().busy, 2 * (504 + 10 + 304));
}

/// Frames of this payload that get through in ten seconds from a queue that is never empty.
fn capacity(rate: u32, octets: u32) -> f64 {
    let settings = Settings {
        rate,
        access: Access::Fair,
        ..Settings::default()
    };
    let (mut radio, stations) = row(settings, 2, 1.0);
    let send = |radio: &mut Radio, now| {
        radio
            .send(now, stations[0], stations[1], octets, Transport::Datagram)
            .expect("it can be sent")
    };
    for _ in 0..10 {
        send(&mut radio, 0);
    }
    let mut delivered = 0.0;
    while let Some(outcome) = radio.poll(10 * SECOND) {
        delivered += 1.0;
        send(&mut radio, outcome.at);
    }
    delivered / 10.0
}

#[test]
fn the_capacity_is_that_computed_by_hand() {
    // 1 Mbit/s, 1472 octets in 1500 of IP: 50 + 310 + 192 + 12 288 + 10 + 304 = 13 154 µs, so 76.0 in a second: 0.90 Mbit/s.
    assert!((capacity(1_000_000, 1472) - 1e6 / 13_154.0).abs() < 0.2);
    // 2 Mbit/s: 50 + 310 + 192 + 6144 + 10 + 304 = 7010 µs: 142.7 in a second, 1.68 Mbit/s.
    assert!((capacity(2_000_000, 1472) - 1e6 / 7010.0).abs() < 0.2);
    // Short frames are overhead: 50 + 310 + 504 + 10 + 304 = 1178 µs, 849 in a second.
    assert!((capacity(2_000_000, 14) - 1e6 / 1178.0).abs() < 0.2);
}

#[test]
fn a_frame_that_is_never_received_is_given_up_after_seven_attempts() {
    let (mut radio, stations) = row(
        Settings {
            loss: Loss::Flat(1.0),
            ..Settings::default()
        },
        2,
        1.0,
    );
    radio
        .send(0, stations[0], stations[1], 14, Transport::Datagram)
        .unwrap();
    let outcome = only(&mut radio);
    assert_eq!(outcome.fate, Fate::Lost(Reason::GivenUp));
    assert_eq!((radio.counts().attempts, radio.counts().given_up), (7, 1));
    // Seven exchanges, and six backoffs of up to 63, 127, 255, 511, 1023 and 1023 slots.
    let least = 7 * (504 + 314) + 6 * 50;
    let most = least + (63 + 127 + 255 + 511 + 1023 + 1023) * 20;
    assert!((least..=most).contains(&outcome.at), "{outcome:?}");
}

/// The mean time to arrive, of those that do, with that share of attempts lost.
fn mean_delay(share: f64) -> f64 {
    let settings = Settings {
        loss: Loss::Flat(share),
        ..Settings::default()
    };
    let (mut radio, stations) = row(settings, 2, 1.0);
    let mut took = Vec::new();
    for i in 0..2000 {
        radio
            .send(i * 100_000, stations[0], stations[1], 14, Transport::Datagram)
            .expect("it can be sent");
        let outcomes = all(&mut radio, (i + 1) * 100_000 - 1);
        took.extend(
            outcomes
                .iter()
                .filter(|one| one.is_delivered())
                .map(Outcome::took),
        );
    }
    took.iter().sum::<Micros>() as f64 / took.len() as f64
}

#[test]
fn repeated_attempts_delay_a_frame() {
    let delays = [0.0, 0.1, 0.2, 0.4].map(mean_delay);
    assert!((delays[0] - 504.0).abs() < 20.0, "{delays:?}");
    assert!(delays.is_sorted() && delays[3] > 2.0 * delays[0], "{delays:?}");
}

#[test]
fn fewer_frames_arrive_the_further_they_go() {
    let at = |distance: f64| {
        let settings = Settings {
            loss: Loss::Distance(PathLoss::default()),
            attempts: 1,
            ..Settings::default()
        };
        let (mut radio, stations) = row(settings, 2, distance);
        for i in 0..1000 {
            radio
                .send(i * 2000, stations[0], stations[1], 14, Transport::Datagram)
                .unwrap();
        }
        all(&mut radio, 3 * SECOND)
            .iter()
            .filter(|one| one.is_delivered())
            .count()
    };
    let arrived = [10.0, 60.0, 80.0, 100.0, 130.0, 400.0].map(at);
    assert_eq!(arrived[0], 1000, "{arrived:?}");
    assert!(arrived.is_sorted_by(|one, other| one >= other), "{arrived:?}");
    assert_eq!(arrived[5], 0, "{arrived:?}");
}

#[test]
fn stations_that_move_apart_lose_each_other() {
    let settings = Settings {
        loss: Loss::Distance(PathLoss::default()),
        ..Settings::default()
    };
    let (mut radio, stations) = row(settings, 2, 5.0);
    let fate = |radio: &mut Radio, now| {
        radio
            .send(now, stations[0], stations[1], 2, Transport::Datagram)
            .unwrap();
        radio.poll(now + SECOND).is_some_and(|one| one.is_delivered())
    };
    assert!(fate(&mut radio, 0));
    radio.place(stations[1], Position::new(5000.0, 0.0));
    assert!(!fate(&mut radio, 2 * SECOND));
    radio.place(stations[1], Position::new(0.0, 5.0));
    assert!(fate(&mut radio, 4 * SECOND));
    radio.set_in_reach(stations[1], false);
    assert!(!fate(&mut radio, 6 * SECOND));
}

#[test]
fn a_long_datagram_goes_in_fragments() {
    let fair = Settings {
        access: Access::Fair,
        ..Settings::default()
    };
    let (mut radio, stations) = row(fair, 2, 1.0);
    radio
        .send(0, stations[0], stations[1], 2040, Transport::Datagram)
        .unwrap();
    let outcome = only(&mut radio);
    assert_eq!(outcome.fate, Fate::Delivered { attempts: 2 });
    // 2048 octets with UDP's: 1480 and 568, each with 20 of IP and 36 around them, of 4 µs.
    let (first, second) = (192 + 1536 * 4, 192 + 624 * 4);
    assert_eq!(outcome.at, first + 10 + 304 + 50 + 310 + second);
    // 1472 is the last length that needs none; 1473 needs one of 1 octet.
    for (octets, frames) in [(1472, 1), (1473, 2), (2952, 2), (2953, 3)] {
        let (mut radio, stations) = row(Settings::default(), 2, 1.0);
        radio
            .send(0, stations[0], stations[1], octets, Transport::Datagram)
            .unwrap();
        assert_eq!(
            only(&mut radio).fate,
            Fate::Delivered { attempts: frames },
            "{octets}"
        );
    }
}

#[test]
fn a_datagram_is_lost_if_one_of_its_fragments_is() {
    // Without repetition, half of the frames arrive: of two fragments both do in a quarter of the cases.
    let settings = Settings {
        loss: Loss::Flat(0.5),
        attempts: 1,
        ..Settings::default()
    };
    let (mut radio, stations) = row(settings, 2, 1.0);
    for i in 0..4000 {
        radio
            .send(i * 20_000, stations[0], stations[1], 2040, Transport::Datagram)
            .unwrap();
    }
    let outcomes = all(&mut radio, 100 * SECOND);
    let delivered = outcomes.iter().filter(|one| one.is_delivered()).count();
    assert_eq!(outcomes.len(), 4000);
    assert!((900..1100).contains(&delivered), "{delivered}");
}

#[test]
fn what_follows_a_lost_segment_waits_for_its_repetition() {
    let (mut radio, stations) = row(Settings::default(), 2, 1.0);
    let (base, robot) = (stations[0], stations[1]);
    radio.set_in_reach(robot, false);
    let lost = radio.send(0, base, robot, 14, Transport::Tcp).unwrap();
    assert_eq!(radio.poll(500_000), None);
    radio.set_in_reach(robot, true);
    let next = radio.send(500_000, base, robot, 14, Transport::Tcp).unwrap();
    let outcomes = all(&mut radio, 10 * SECOND);
    let order: Vec<MessageId> = outcomes.iter().map(|one| one.message).collect();
    assert_eq!(order, [lost, next]);
    // After the first timeout of a second, although the second one has long been there.
    assert!(
        outcomes
            .iter()
            .all(|one| (SECOND..SECOND + 2000).contains(&one.at)),
        "{outcomes:?}"
    );
    assert_eq!(radio.counts().repeated, 1);
    // A datagram in its place is lost for good, and delays nothing.
    let (mut radio, stations) = row(Settings::default(), 2, 1.0);
    radio.set_in_reach(stations[1], false);
    radio
        .send(0, stations[0], stations[1], 14, Transport::Datagram)
        .unwrap();
    assert_eq!(only(&mut radio).fate, Fate::Lost(Reason::GivenUp));
}

#[test]
fn acknowledgements_travel_with_replies_or_alone() {
    let (mut radio, stations) = row(Settings::default(), 2, 1.0);
    let (base, robot) = (stations[0], stations[1]);
    radio.send(0, base, robot, 2, Transport::Tcp).unwrap();
    let asked = radio.poll(SECOND).unwrap();
    radio.send(asked.at, robot, base, 2, Transport::Tcp).unwrap();
    let replied = radio.poll(SECOND).unwrap();
    assert_eq!(radio.counts().pure_acks, 0);
    assert_eq!(radio.poll(SECOND), None);
    // The reply's own, 200 ms later.
    assert_eq!((radio.counts().pure_acks, radio.counts().attempts), (1, 3));
    assert!(replied.at < 2500, "{replied:?}");
    assert_eq!(
        radio.counts().repeated,
        0,
        "all was acknowledged before the timeout"
    );
}

#[test]
fn a_closed_connection_loses_what_was_under_way_and_a_new_one_begins() {
    let (mut radio, stations) = row(Settings::default(), 2, 1.0);
    let (base, robot) = (stations[0], stations[1]);
    radio.set_in_reach(robot, false);
    for i in 0..6 {
        radio.send(i * 1000, base, robot, 14, Transport::Tcp).unwrap();
    }
    assert_eq!(radio.poll(SECOND / 2), None);
    radio.close(SECOND / 2, base, robot);
    let lost = all(&mut radio, 5 * SECOND);
    assert_eq!(lost.len(), 6);
    assert!(
        lost.iter().all(|one| one.fate == Fate::Lost(Reason::Closed)),
        "{lost:?}"
    );
    radio.set_in_reach(robot, true);
    radio.send(5 * SECOND, base, robot, 14, Transport::Tcp).unwrap();
    assert!(only(&mut radio).is_delivered());
}

#[test]
fn what_waits_together_goes_together() {
    let (mut radio, stations) = row(
        Settings {
            segments: 1,
            ..Settings::default()
        },
        2,
        1.0,
    );
    for _ in 0..6 {
        radio
            .send(0, stations[0], stations[1], 14, Transport::Tcp)
            .unwrap();
    }
    let arrived: Vec<Micros> = all(&mut radio, SECOND).iter().map(|one| one.at).collect();
    // The first alone; the others when it is acknowledged, 200 ms later, as one segment.
    assert_eq!(arrived.len(), 6);
    assert!(arrived[1] > 200_000 && arrived[1] < 204_000, "{arrived:?}");
    assert!(arrived[1..].iter().all(|at| *at == arrived[1]), "{arrived:?}");
    // Each has its acknowledgement, alone.
    assert_eq!(radio.counts().attempts, 4);
}

#[test]
fn what_cannot_be_sent_is_refused() {
    let (mut radio, stations) = row(Settings::default(), 2, 1.0);
    let (_, others) = row(Settings::default(), 3, 1.0);
    let (one, other) = (stations[0], stations[1]);
    let mut refused =
        |now, from, to, octets, transport| radio.send(now, from, to, octets, transport).unwrap_err();
    let stranger = others[2];
    assert_eq!(
        refused(0, one, stranger, 1, Transport::Tcp),
        SendError::NoStation(stranger)
    );
    assert_eq!(refused(0, one, one, 1, Transport::Tcp), SendError::ToItself(one));
    assert_eq!(
        refused(0, one, other, 65_508, Transport::Datagram),
        SendError::TooLong(65_508)
    );
    assert_eq!(radio.poll(10), None);
    let past = radio.send(9, one, other, 1, Transport::Tcp).unwrap_err();
    assert_eq!(past.to_string(), "9 µs is before 10 µs, which has passed");
}

#[test]
fn stations_that_send_at_once_collide_unless_access_is_fair() {
    for (access, collides) in [(Access::Random, true), (Access::Fair, false)] {
        let (mut radio, stations) = row(
            Settings {
                access,
                ..Settings::default()
            },
            5,
            1.0,
        );
        for from in &stations[1..] {
            radio
                .send(0, *from, stations[0], 14, Transport::Datagram)
                .unwrap();
        }
        let outcomes = all(&mut radio, SECOND);
        assert_eq!(outcomes.iter().filter(|one| one.is_delivered()).count(), 4);
        assert_eq!(radio.counts().collisions > 0, collides, "{access:?}");
    }
}

/// Which share of attempts collides among stations that always have something to send: 32 slots, doubled five times, by the fixed
/// point of Bianchi's model (*Performance analysis of the IEEE 802.11 distributed coordination function*, 2000).
fn expected_collisions(stations: i32) -> f64 {
    let excess = |p: f64| {
        let doubled: f64 = (0..5).map(|i| (2.0 * p).powi(i)).sum();
        let tau = 2.0 / (1.0 + 32.0 + p * 32.0 * doubled);
        1.0 - (1.0 - tau).powi(stations - 1) - p
    };
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let middle = (low + high) / 2.0;
        if excess(middle) > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

#[test]
fn collisions_are_as_many_as_in_bianchis_model() {
    for count in [2, 5, 10, 20] {
        let (mut radio, stations) = row(Settings::default(), count + 1, 1.0);
        for from in &stations[1..] {
            for _ in 0..2 {
                radio
                    .send(0, *from, stations[0], 500, Transport::Datagram)
                    .unwrap();
            }
        }
        let mut delivered = 0.0;
        while let Some(outcome) = radio.poll(60 * SECOND) {
            delivered += f64::from(u8::from(outcome.is_delivered()));
            radio
                .send(outcome.at, outcome.from, stations[0], 500, Transport::Datagram)
                .unwrap();
        }
        let share = 1.0 - delivered / radio.counts().attempts as f64;
        let expected = expected_collisions(count as i32);
        assert!((share - expected).abs() < 0.03, "{count}: {share} {expected}");
    }
}

#[test]
fn a_full_queue_drops() {
    let (mut radio, stations) = row(
        Settings {
            queue: 3,
            ..Settings::default()
        },
        2,
        1.0,
    );
    for _ in 0..5 {
        radio
            .send(0, stations[0], stations[1], 14, Transport::Datagram)
            .unwrap();
    }
    let outcomes = all(&mut radio, SECOND);
    let lost = outcomes
        .iter()
        .filter(|one| one.fate == Fate::Lost(Reason::Overflow))
        .count();
    assert_eq!((outcomes.len(), lost, radio.counts().overflows), (5, 2, 2));
}

/// One message of a random run: when, from, to, octets, whether over TCP.
type Step = (Micros, usize, usize, u32, bool);

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = (0..20_000i64, 0..5usize, 0..4usize, 0..4000u32, any::<bool>());
    proptest::collection::vec(step, 0..60)
}

/// Runs it, and gives all that came of it, and in which order TCP messages were sent.
fn run(settings: Settings, steps: &[Step]) -> (Vec<Outcome>, Vec<MessageId>, Radio) {
    let (mut radio, stations) = row(settings, 5, 1.0);
    let (mut now, mut sent) = (0, Vec::new());
    let mut outcomes = Vec::new();
    for (after, from, to, octets, tcp) in steps {
        now += after;
        outcomes.extend(all(&mut radio, now));
        // One frame may have begun just now.
        assert!(
            radio.counts().busy <= now + radio.settings().exchange_time(1500),
            "the air is full"
        );
        let to = if to >= from { to + 1 } else { *to };
        let transport = if *tcp { Transport::Tcp } else { Transport::Datagram };
        sent.push(
            radio
                .send(now, stations[*from], stations[to], *octets, transport)
                .expect("it can be sent"),
        );
    }
    outcomes.extend(all(&mut radio, now + 100_000 * SECOND));
    (outcomes, sent, radio)
}

proptest! {
    #[test]
    fn each_message_is_delivered_once_or_lost(steps in steps(), seed in any::<u64>(), loss in 0.0..0.6f64, fair in any::<bool>()) {
        let access = if fair { Access::Fair } else { Access::Random };
        let settings = Settings { seed, access, loss: Loss::Flat(loss), attempts: 3, ..Settings::default() };
        let (outcomes, mut sent, radio) = run(settings.clone(), &steps);
        let mut told: Vec<MessageId> = outcomes.iter().map(|one| one.message).collect();
        told.sort_unstable();
        sent.sort_unstable();
        prop_assert_eq!(&told, &sent);
        prop_assert_eq!((radio.under_way(), radio.next_event()), (0, None));
        prop_assert!(outcomes.is_sorted_by_key(|one| one.at));
        // TCP loses nothing, and keeps the order of each way.
        let mut last = BTreeMap::new();
        for one in &outcomes {
            let (.., octets, tcp) = steps[sent.binary_search(&one.message).unwrap()];
            if tcp {
                prop_assert!(one.is_delivered());
                let before = last.insert((one.from, one.to), one.message);
                prop_assert!(before < Some(one.message));
            }
            if one.is_delivered() {
                prop_assert!(one.took() >= settings.frame_time(octets.min(1460)), "no faster than its first frame");
            }
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_events(steps in steps(), seed in any::<u64>()) {
        let settings = Settings { seed, loss: Loss::Flat(0.2), ..Settings::default() };
        prop_assert_eq!(run(settings.clone(), &steps).0, run(settings, &steps).0);
    }
}
