//! The channel in which every robot's newest state is, so that a page joins one channel.

use std::time::Duration;

use mom_client::{Delivery, Family, GuardState, Map, Parcel, Path};
use mom_device::State;
use tokio::time::Instant;

/// So often a robot that moves is told of there.
const PERIOD: Duration = Duration::from_secs(1);
/// One that starts and stops all the time is told of so often.
const GAP: Duration = Duration::from_millis(200);
/// Who was told of seldom may be told of so often at once.
const AT_ONCE: u32 = 4;
/// What changes with each reply, and is not reported by itself.
const FLEETING: [&str; 5] = ["x", "y", "heading", "round-trip", "gap"];

/// Tells of one robot: at once when it is something else that it does, though five times a second at most in the long
/// run, and once a second while it only goes on.
#[derive(Debug)]
pub struct StatusTeller {
    channel: Path,
    name: String,
    group: Option<String>,
    told: Option<(Map, Instant)>,
    /// When it is looked at again while the robot moves.
    again: Option<Instant>,
    /// When all that was told would have been told with a gap before each.
    paid: Option<Instant>,
    /// Until when something is held back.
    held: Option<Instant>,
}

impl StatusTeller {
    /// One for the robot of this number, in this channel, which may belong to a group.
    #[must_use]
    pub fn new(channel: Path, unit: u32, group: Option<String>) -> Self {
        Self {
            channel,
            // A name for each robot, as a newer message takes the place of an older one of its name.
            name: format!("robot-{unit}"),
            group,
            told: None,
            again: None,
            paid: None,
            held: None,
        }
    }

    /// What is to be told now, if anything is.
    ///
    /// While something is held back, neither `state` nor `guard` is asked for.
    pub fn tell(
        &mut self,
        state: impl FnOnce() -> State,
        guard: impl FnOnce() -> Option<GuardState>,
        now: Instant,
    ) -> Option<Parcel> {
        let next = self.paid.and_then(|paid| paid.checked_sub(GAP * (AT_ONCE - 1)));
        self.held = next.filter(|next| now < *next);
        if self.held.is_some() {
            return None;
        }
        let mut content = content(&state(), guard().as_ref());
        if let Some(group) = &self.group {
            content.set("group", group.as_str());
        }
        if let Some((told, at)) = &self.told {
            let same = *told == content;
            let alike = same || lasting(told) == lasting(&content);
            let next = *at + PERIOD;
            if same || (alike && now < next) {
                // One that moves and is the same for longer, as it presses against a wall, is not looked at all the time.
                self.again = Some(if now < next { next } else { now + PERIOD });
                return None;
            }
        }
        self.again = Some(now + PERIOD);
        self.told = Some((content.clone(), now));
        self.paid = Some(self.paid.map_or(now, |paid| paid.max(now)) + GAP);
        let mut parcel = Parcel::new(Family::Message, self.name.clone())
            .context(self.channel.clone())
            .content(content);
        parcel.delivery = Some(Delivery::Latest);
        parcel.echo = Some(false);
        Some(parcel)
    }

    /// When there may be something to tell that was held back, or that changes by itself while the robot moves.
    #[must_use]
    pub fn due(&self, moving: bool) -> Option<Instant> {
        self.held.or(self.again.filter(|_| moving))
    }
}

/// `{…position, …report, moving, stopped, token?, owner?, fence}`, and `group` beside it.
fn content(state: &State, guard: Option<&GuardState>) -> Map {
    let mut content = Map::new();
    for (key, value) in state.position.iter().chain(state.report.iter()) {
        content.set(key, value.clone());
    }
    content.set("moving", state.moving);
    content.set("stopped", state.stopped);
    if let Some(guard) = guard {
        content.set("token", guard.token.to_string());
    }
    if let Some(owner) = guard.and_then(|guard| guard.owner.as_deref()) {
        content.set("owner", owner);
    }
    let fence = guard.map_or(0, |guard| guard.fence);
    content.with("fence", i64::try_from(fence).unwrap_or(i64::MAX))
}

fn lasting(content: &Map) -> Vec<(&str, &mom_client::Value)> {
    content
        .iter()
        .filter(|(key, _)| !FLEETING.contains(key))
        .collect()
}

#[cfg(test)]
mod tests {
    use mom_client::Value;

    use super::*;

    fn state(x: i64, moving: bool) -> State {
        State {
            seq: 1,
            position: Map::new().with("x", x),
            report: Map::new().with("unit", 7).with("round-trip", x),
            moving,
            rest: None,
            reached: true,
            stopped: false,
            executing: None,
            waiting: 0,
        }
    }

    /// Otherwise a peer that waits until then would not wait at all.
    #[test]
    fn what_is_the_same_for_long_is_due_in_the_future() {
        let mut status = StatusTeller::new(Path::parse("/fleet/status").expect("a path"), 7, None);
        let begin = Instant::now();
        let after = |ms| begin + Duration::from_millis(ms);
        for (ms, x, told, due) in [
            (0, 1, true, 1000),
            (400, 1, false, 1000),
            (1000, 1, false, 2000),
            (1500, 1, false, 2500),
            (2500, 1, false, 3500),
            // It is free again: it was told of long ago.
            (2600, 2, true, 3600),
        ] {
            let parcel = status.tell(|| state(x, true), || None, after(ms));
            assert_eq!(parcel.is_some(), told, "after {ms} ms");
            assert_eq!(status.due(true), Some(after(due)), "after {ms} ms");
            assert_eq!(status.due(false), None, "after {ms} ms");
        }
    }

    #[test]
    fn what_goes_on_is_told_once_a_second_and_news_at_once() {
        let mut status = StatusTeller::new(
            Path::parse("/fleet/status").expect("a path"),
            7,
            Some("red".to_owned()),
        );
        let guard = GuardState {
            token: Path::parse("/fleet/7/token").expect("a path"),
            names: vec!["command".to_owned()],
            owner: Some("alice".to_owned()),
            fence: 9,
        };
        let begin = Instant::now();
        let after = |ms| begin + Duration::from_millis(ms);
        for (ms, x, moving, told) in [
            (0, 1, true, true),
            (10, 2, true, false),
            (999, 3, true, false),
            (1000, 3, true, true),
            (1100, 4, false, true),
            (3000, 4, false, false),
            (3001, 5, false, true),
            // The fourth of a row is told at once, and the fifth waits.
            (3010, 5, true, true),
            (3020, 5, false, true),
            (3030, 5, true, true),
            (3040, 5, false, false),
            (3200, 5, true, false),
            (3201, 5, false, true),
            (3210, 6, true, false),
            (3401, 6, true, true),
        ] {
            let parcel = status.tell(|| state(x, moving), || Some(guard.clone()), after(ms));
            assert_eq!(parcel.is_some(), told, "after {ms} ms");
            let due = status
                .due(moving)
                .map(|due| due.duration_since(begin).as_millis());
            let expected = match ms {
                3040 | 3200 => Some(3201),
                3210 => Some(3401),
                _ if !moving => None,
                _ if told => Some(u128::from(ms) + 1000),
                _ => Some(1000),
            };
            assert_eq!(due, expected, "after {ms} ms");
            if let Some(parcel) = parcel {
                assert_eq!(parcel.name(), "robot-7");
                let value = parcel.value();
                assert_eq!(value.get("x").and_then(Value::as_int), Some(x));
                assert_eq!(value.get("fence").and_then(Value::as_int), Some(9));
                for (key, text) in [("owner", "alice"), ("group", "red"), ("token", "/fleet/7/token")] {
                    assert_eq!(value.get(key).and_then(Value::as_str), Some(text));
                }
            }
        }
    }
}
