//! Reserved slots. 2026-11-23 is a Monday.

use mom_proto::{Map, Time, Value, Verb};
use proptest::prelude::*;

use super::{Ask, GRAB, ask, build, check, of, short, text, words};
use crate::{Answer, Scope, Standing};

const HOUR: u64 = 3_600_000_000;

fn schedule(slots: Vec<Map>) -> Map {
    let slots: Vec<Value> = slots.into_iter().map(Value::from).collect();
    of("schedule").with("slots", slots)
}

fn slot(from: &str, to: &str, users: &[&str]) -> Map {
    let slot = Map::new().with("from", from).with("to", to);
    match users {
        [] => slot,
        users => slot.with("users", words(users)),
    }
}

fn at(wall: &str) -> Ask<'_> {
    Ask {
        wall,
        now: 10 * HOUR,
        ..GRAB
    }
}

fn by<'a>(user: &'a str, question: Ask<'a>) -> Ask<'a> {
    Ask { user, ..question }
}

/// Hours from the hub's time of the tables on.
fn hour(hours: u64) -> u64 {
    (10 + hours) * HOUR
}

#[test]
#[rustfmt::skip]
fn a_slot_is_for_those_it_lists() {
    let until = |hours| format!("allow until {}", hour(hours));
    let denied = |hours| format!("schedule/slot 1: denied at {}", hour(hours));
    let bob = |wall| by("bob", at(wall));
    check(
        schedule(vec![slot("2026-11-23T09:00:00Z", "2026-11-23T11:00:00Z", &["alice"])]),
        &[
            ("before it all may, up to it", bob("2026-11-23T07:00:00Z"), &until(2)),
            ("its user through it", at("2026-11-23T07:00:00Z"), &until(4)),
            ("at its begin its user", at("2026-11-23T09:00:00Z"), &until(2)),
            ("and no other", bob("2026-11-23T09:00:00Z"), &denied(2)),
            ("within it", bob("2026-11-23T10:00:00Z"), &denied(1)),
            ("at its end all may", bob("2026-11-23T11:00:00Z"), "allow"),
            ("its user like all", at("2026-11-23T11:00:00Z"), "allow"),
        ],
    );
    for (wall, expected) in [
        ("2026-11-23T08:59:59.999999Z", format!("allow until {}", 10 * HOUR + 1)),
        ("2026-11-23T10:59:59.999999Z", format!("schedule/slot 1: denied at {}", 10 * HOUR + 1)),
    ] {
        let spec = schedule(vec![slot("2026-11-23T09:00:00Z", "2026-11-23T11:00:00Z", &["alice"])]);
        assert_eq!(short(&ask(&mut *build(spec), &bob(wall))), expected, "{wall}");
    }
}

#[test]
#[rustfmt::skip]
fn slots_of_the_day_come_again_and_may_pass_midnight() {
    let night = slot("22:00", "02:00", &["alice"]).with("days", words(&["mon", "sun"])).with("name", "night");
    let denied = |hours| format!("schedule/night: denied at {}", hour(hours));
    let until = |hours| format!("allow until {}", hour(hours));
    let bob = |wall| by("bob", at(wall));
    check(
        schedule(vec![night]),
        &[
            ("sunday before", bob("2026-11-22T21:00:00Z"), &until(1)),
            ("sunday night", bob("2026-11-22T23:00:00Z"), &denied(3)),
            ("on into monday", bob("2026-11-23T01:00:00Z"), &denied(1)),
            ("it ends at two", bob("2026-11-23T02:00:00Z"), &until(20)),
            ("monday night", bob("2026-11-23T22:00:00Z"), &denied(4)),
            ("on into tuesday, which is not a day of it", bob("2026-11-24T01:00:00Z"), &denied(1)),
            ("tuesday night is free, up to sunday", bob("2026-11-24T22:00:00Z"), &until(5 * 24)),
            ("its user", at("2026-11-24T01:00:00Z"), &until(1)),
            ("long ago, before the epoch", bob("1969-12-28T23:00:00Z"), &denied(3)),
            ("and on into its monday", bob("1969-12-29T01:00:00Z"), &denied(1)),
        ],
    );
}

#[test]
fn the_same_day_of_next_week_is_the_next_one() {
    check(
        schedule(vec![
            slot("00:00", "01:00", &["alice"]).with("days", words(&["mon"])),
        ]),
        &[(
            "monday after it",
            by("bob", at("2026-11-23T02:00:00Z")),
            &format!("allow until {}", hour(7 * 24 - 2)),
        )],
    );
}

#[test]
fn an_answer_to_a_message_at_the_edge_of_an_instant_stands_up_to_the_next() {
    let once = slot("2026-11-23T09:00:00Z", "2026-11-23T10:00:00Z", &["alice"]);
    let mut manager = build(schedule(vec![once]).with("verbs", words(&["send"])));
    let send = |wall| Ask {
        verb: Verb::Send,
        message: Some("say"),
        ..at(wall)
    };
    for (wall, until) in [
        ("2026-11-23T08:00:00Z", Some(hour(1))),
        ("2026-11-23T09:00:00Z", Some(hour(1))),
        ("2026-11-23T10:00:00Z", None),
    ] {
        let stands = Standing::Stands {
            scope: Scope::AnyName,
            until,
            rate: None,
            max_age: None,
        };
        assert_eq!(ask(&mut *manager, &send(wall)).standing, stands, "{wall}");
    }
}

#[test]
fn a_whole_day_ends_at_midnight() {
    let bob = |wall| by("bob", at(wall));
    let monday = slot("00:00", "24:00", &["alice"]).with("days", words(&["mon"]));
    check(
        schedule(vec![monday]),
        &[
            (
                "sunday",
                bob("2026-11-22T23:00:00Z"),
                &format!("allow until {}", hour(1)),
            ),
            (
                "monday",
                bob("2026-11-23T00:00:00Z"),
                &format!("schedule/slot 1: denied at {}", hour(24)),
            ),
            (
                "a week later",
                bob("2026-11-24T00:00:00Z"),
                &format!("allow until {}", hour(6 * 24)),
            ),
        ],
    );
}

#[test]
#[rustfmt::skip]
fn outside_of_all_slots_nobody_may_where_the_file_says_so() {
    let bob = |wall| by("bob", at(wall));
    check(
        schedule(vec![slot("09:00", "10:00", &["alice"]), slot("12:00", "13:00", &["bob"])])
            .with("free", "deny"),
        &[
            ("in nobody's slot", bob("2026-11-23T08:00:00Z"), &format!("schedule: denied at {}", hour(4))),
            ("in another's", bob("2026-11-23T09:00:00Z"), &format!("schedule/slot 1: denied at {}", hour(3))),
            ("in one's own", bob("2026-11-23T12:30:00Z"), &format!("allow until {}", 10 * HOUR + HOUR / 2)),
            ("after it", bob("2026-11-23T13:00:00Z"), &format!("schedule: denied at {}", hour(23))),
            ("without a slot", by("carol", at("2026-11-23T13:00:00Z")), "schedule: denied"),
        ],
    );
    // A slot that lists nobody is for all: the hours of the house.
    check(
        schedule(vec![slot("08:00", "18:00", &[])]).with("free", "deny"),
        &[
            ("open", at("2026-11-23T08:00:00Z"), &format!("allow until {}", hour(10))),
            ("closed", at("2026-11-23T19:00:00Z"), &format!("schedule: denied at {}", hour(13))),
        ],
    );
}

#[test]
fn slots_one_after_the_other_are_one() {
    let slots = || {
        schedule(vec![
            slot("09:00", "10:00", &["alice"]),
            slot("10:00", "11:00", &["alice", "bob"]),
            slot("10:30", "12:00", &["bob"]),
        ])
    };
    check(
        slots(),
        &[
            (
                "through both",
                at("2026-11-23T09:00:00Z"),
                &format!("allow until {}", hour(2)),
            ),
            (
                "in both",
                by("bob", at("2026-11-23T10:45:00Z")),
                &format!("allow until {}", 11 * HOUR + HOUR / 4),
            ),
            (
                "a slot may overlap",
                by("carol", at("2026-11-23T09:00:00Z")),
                &format!("schedule/slot 1: denied at {}", hour(3)),
            ),
        ],
    );
    // Day and night without end: the grant is a long one, not an endless one.
    let always = schedule(vec![slot("00:00", "24:00", &["alice"])]);
    assert_eq!(
        short(&ask(&mut *build(always), &at("2026-11-23T00:00:00Z"))),
        format!("allow until {}", hour(64 * 24))
    );
}

#[test]
#[rustfmt::skip]
fn whoever_has_a_slot_displaces_whoever_has_none() {
    let owner = |user, level| Ask { owner: Some((user, level, false)), ..at("2026-11-23T09:00:00Z") };
    let until = hour(1);
    let (displace, allow) = (format!("displace until {until}"), format!("allow until {until}"));
    let of_class = |group| Ask { owner_groups: group, ..owner("dora", 1) };
    let slots = schedule(vec![
        slot("09:00", "10:00", &["alice", "bob"]).with("groups", words(&["class"])),
        slot("09:00", "10:00", &[]).with("min-level", 5),
        slot("11:00", "12:00", &["carol"]),
    ]);
    check(
        slots,
        &[
            ("one without a slot", owner("dora", 1), &displace),
            ("one whose slot is later", owner("carol", 1), &displace),
            ("not one of the same slot", owner("bob", 1), &allow),
            ("nor one of its group", of_class(&["class"]), &allow),
            ("but one of another group", of_class(&["staff"]), &displace),
            ("nor one of another slot now", owner("dora", 5), &allow),
            ("oneself is in nobody's way", Ask { owner: Some(("alice", 1, true)), ..owner("x", 1) }, &allow),
            ("only by a grab", Ask { verb: Verb::Accept, ..owner("dora", 1) }, &allow),
        ],
    );
}

#[test]
fn a_refusal_says_who_has_it_until_when() {
    let slots = schedule(vec![
        slot("09:00", "10:00", &["alice", "bob", "erik", "fred"]).with("groups", words(&["class"])),
        slot("10:00", "11:00", &[]).with("min-level", 5),
        slot("2026-11-23T11:30:00.5Z", "2026-11-23T12:00:00.5Z", &["dora"]),
    ]);
    for (free, wall, expected) in [
        (
            "allow",
            "2026-11-23T09:30:00Z",
            "/robot/token is reserved for alice, bob, erik and 1 more and the group class until 2026-11-23T10:00:00Z; you may from 2026-11-23T11:00:00Z on",
        ),
        (
            "allow",
            "2026-11-23T10:30:00Z",
            "/robot/token is reserved for levels from 5 until 2026-11-23T11:00:00Z; you may from 2026-11-23T11:00:00Z on",
        ),
        (
            "deny",
            "2026-11-23T11:10:00Z",
            "/robot/token is reserved for nobody now; you may from 2026-11-23T11:30:00.500000Z on",
        ),
        (
            "deny",
            "2026-11-23T13:00:00Z",
            "/robot/token is reserved for nobody now; no later slot is yours",
        ),
    ] {
        let mut manager = build(slots.clone().with("free", free));
        assert_eq!(
            text(&ask(&mut *manager, &by("dora", at(wall)))),
            expected,
            "{wall}"
        );
    }
}

#[test]
#[rustfmt::skip]
fn verbs_are_those_of_the_file_and_messages_change_with_the_slots() {
    let spec = || schedule(vec![slot("09:00", "10:00", &["alice"])]).with("verbs", words(&["send", "stop"]));
    let send = |user, verb, message, wall| Ask { verb, message: Some(message), ..by(user, at(wall)) };
    let stands = |hours| Standing::Stands { scope: Scope::AnyName, until: Some(hour(hours)), rate: None, max_age: None };
    let always = crate::Verdict::allow_always().standing;
    for (question, allowed, standing) in [
        (send("bob", Verb::Send, "say", "2026-11-23T08:00:00Z"), true, stands(1)),
        (send("bob", Verb::Send, "say", "2026-11-23T09:00:00Z"), false, stands(1)),
        (send("alice", Verb::Send, "say", "2026-11-23T09:00:00Z"), true, stands(1)),
        (send("bob", Verb::Stop, "stop", "2026-11-23T09:00:00Z"), false, stands(1)),
        (send("bob", Verb::Unstop, "unstop", "2026-11-23T09:00:00Z"), true, always),
        (by("bob", at("2026-11-23T09:00:00Z")), true, always),
    ] {
        let verdict = ask(&mut *build(spec()), &question);
        assert_eq!((verdict.is_allow(), verdict.standing), (allowed, standing), "{question:?}");
    }
    let all = schedule(vec![slot("09:00", "10:00", &["alice"])]).with("verbs", words(&["*"]));
    let stop = send("bob", Verb::Stop, "stop", "2026-11-23T09:00:00Z");
    assert!(ask(&mut *build(all), &stop).is_allow(), "a stop is refused only where it is listed");
}

/// A slot of the model: hours of the day, days of the week, and who.
#[derive(Clone, Debug)]
struct Model {
    from: u64,
    length: u64,
    days: [bool; 7],
    users: Vec<&'static str>,
}

const DAYS: [&str; 7] = ["mon", "tue", "wed", "thu", "fri", "sat", "sun"];
const WEEK: u64 = 7 * 24 * HOUR;
/// Monday 2026-11-23, 00:00.
const MONDAY: i64 = 1_795_392_000_000_000;

impl Model {
    fn spec(&self) -> Map {
        let clock = |hours: u64| format!("{hours:02}:00");
        let to = match self.from + self.length {
            to if to > 24 => to - 24,
            to => to,
        };
        let days: Vec<&str> = (0..7)
            .filter(|day| self.days[*day])
            .map(|day| DAYS[day])
            .collect();
        slot(&clock(self.from), &clock(to), &self.users).with("days", words(&days))
    }

    /// Whether a time since some Monday is in it, by laying the week out on a line.
    fn contains(&self, since: u64) -> bool {
        let of_week = since % WEEK;
        (0..7).filter(|day| self.days[*day as usize]).any(|day: u64| {
            let begin = (day * 24 + self.from) * HOUR;
            let end = begin + self.length * HOUR;
            (begin..end).contains(&of_week) || (begin..end).contains(&(of_week + WEEK))
        })
    }

    fn lists(&self, user: &str) -> bool {
        self.users.is_empty() || self.users.contains(&user)
    }
}

/// Whether a user may, and whether by a slot.
fn may(slots: &[Model], free: bool, user: &str, since: u64) -> (bool, bool) {
    let mut reserved = slots.iter().filter(|slot| slot.contains(since)).peekable();
    let any = reserved.peek().is_some();
    let own = reserved.any(|slot| slot.lists(user));
    (own || !any && free, own)
}

fn models() -> impl Strategy<Value = Vec<Model>> {
    let users = prop::sample::select(vec![
        vec!["alice"],
        vec!["bob"],
        vec!["alice", "bob"],
        vec!["carol"],
        vec![],
    ]);
    let days = prop::array::uniform7(any::<bool>()).prop_filter("a day", |days| days.contains(&true));
    let model =
        (0_u64..24, 1_u64..=24, days, users).prop_filter_map("a form", |(from, length, days, users)| {
            // A slot from a later hour to the same of the next day has no form; a whole day begins at midnight.
            let valid = length < 24 || from == 0;
            valid.then_some(Model {
                from,
                length,
                days,
                users,
            })
        });
    prop::collection::vec(model, 1..5)
}

proptest! {
    /// At any instant exactly those may that the slots say; a grant lasts while they may, and a refusal names the
    /// first instant at which they may.
    #[test]
    fn at_any_instant_those_may_whose_slot_it_is(
        slots in models(),
        free in any::<bool>(),
        hour_of_week in 0_u64..7 * 24,
        edge in prop::sample::select(vec![0_u64, 1, HOUR / 2, HOUR - 1]),
        user in prop::sample::select(vec!["alice", "bob", "dora"]),
    ) {
        let since = hour_of_week * HOUR + edge;
        let wall = Time::from_micros(MONDAY + i64::try_from(since).expect("small")).expect("in range").to_string();
        let spec = schedule(slots.iter().map(Model::spec).collect()).with("free", if free { "allow" } else { "deny" });
        let verdict = ask(&mut *build(spec), &Ask { user, wall: &wall, now: since, ..GRAB });
        let (allowed, own) = may(&slots, free, user, since);
        prop_assert_eq!(verdict.is_allow(), allowed);
        // Slots begin and end at whole hours, so what holds at these instants holds between them.
        let instants = |to: u64| (hour_of_week + 1..=to.div_ceil(HOUR)).map(|hour| hour * HOUR).take_while(move |at| *at < to);
        match verdict.answer {
            Answer::Allow(grant) => {
                let until = grant.until.unwrap_or(since + 2 * WEEK);
                prop_assert!(until > since);
                for at in instants(until) {
                    prop_assert!(may(&slots, free, user, at).0, "granted until {until}, but not at {at}");
                }
                match grant.until {
                    None => prop_assert!(!own),
                    // A slot's end ends the grant, if the slot is not one of more than can be followed.
                    Some(until) if until < since + 12 * 24 * HOUR => {
                        prop_assert!(!may(&slots, free, user, until).1, "the slot goes on at {until}");
                    }
                    Some(_) => prop_assert!(own || slots.iter().any(|slot| slot.lists(user))),
                }
            }
            Answer::Deny(denial) => {
                let earliest = denial.earliest.unwrap_or(since + 2 * WEEK);
                for at in instants(earliest) {
                    prop_assert!(!may(&slots, free, user, at).0, "refused until {earliest}, but not at {at}");
                }
                if let Some(earliest) = denial.earliest {
                    prop_assert!(may(&slots, free, user, earliest).0);
                }
            }
            other => prop_assert!(false, "{other:?}"),
        }
    }
}

#[test]
#[rustfmt::skip]
fn a_slot_begins_and_ends_at_any_minute() {
    let until = |time: u64| format!("allow until {}", 10 * HOUR + time);
    let minute = HOUR / 60;
    let bob = |wall| by("bob", at(wall));
    check(
        schedule(vec![slot("07:35", "18:09", &["alice"])]),
        &[
            ("before it", bob("2026-11-23T07:34:00Z"), &until(minute)),
            ("at its begin", bob("2026-11-23T07:35:00Z"), &format!("schedule/slot 1: denied at {}", 10 * HOUR + 634 * minute)),
            ("its user", at("2026-11-23T18:08:00Z"), &until(minute)),
        ],
    );
}
