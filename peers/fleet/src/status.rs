//! The channel in which every robot's newest state is, so that a page joins one channel.

use std::time::Duration;

use mom_client::{Delivery, Family, GuardState, Map, Parcel, Path};
use mom_device::State;
use tokio::time::Instant;

/// So often a robot that moves is told of there.
const PERIOD: Duration = Duration::from_secs(1);
/// News of a robot wait for so long since the last ones: one that starts and stops all the time is told of five times a second.
const GAP: Duration = Duration::from_millis(200);
/// What changes with each reply, and is no reason to tell.
const FLEETING: [&str; 5] = ["x", "y", "heading", "round-trip", "gap"];

/// Tells of one robot: when it is something else that it does, at once or 200 ms after the last news, and once a second while it only
/// goes on.
#[derive(Debug)]
pub struct StatusTeller {
    channel: Path,
    name: String,
    group: Option<String>,
    told: Option<(Map, Instant)>,
    /// Whether something was held back until its gap is over.
    held: bool,
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
            held: false,
        }
    }

    /// What is to be told now, if anything is.
    ///
    /// While a gap is not over, neither `state` nor `guard` is asked for.
    pub fn tell(
        &mut self,
        state: impl FnOnce() -> State,
        guard: impl FnOnce() -> Option<GuardState>,
        now: Instant,
    ) -> Option<Parcel> {
        self.held = self.told.as_ref().is_some_and(|(_, at)| now < *at + GAP);
        if self.held {
            return None;
        }
        let mut content = content(&state(), guard().as_ref());
        if let Some(group) = &self.group {
            content.set("group", group.as_str());
        }
        if let Some((told, at)) = &self.told {
            let same = *told == content;
            let alike = same || lasting(told) == lasting(&content);
            if same || (alike && now < *at + PERIOD) {
                return None;
            }
        }
        self.told = Some((content.clone(), now));
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
        let (_, at) = self.told.as_ref()?;
        match (self.held, moving) {
            (true, _) => Some(*at + GAP),
            (false, true) => Some(*at + PERIOD),
            (false, false) => None,
        }
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
            stopped: false,
            executing: None,
            waiting: 0,
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
            // News within the gap wait for its end.
            (1100, 4, false, false),
            (1199, 4, true, false),
            (1200, 4, false, true),
            (3000, 4, false, false),
            (3001, 5, false, true),
            (3100, 6, false, false),
            (4001, 6, false, true),
        ] {
            let parcel = status.tell(|| state(x, moving), || Some(guard.clone()), after(ms));
            assert_eq!(parcel.is_some(), told, "after {ms} ms");
            let held = [1100, 1199, 3100].contains(&ms);
            let due = status
                .due(moving)
                .map(|due| due.duration_since(begin).as_millis());
            assert_eq!(due.is_some(), held || moving, "after {ms} ms");
            assert!(!held || due.is_some_and(|due| due > ms.into()), "after {ms} ms");
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
