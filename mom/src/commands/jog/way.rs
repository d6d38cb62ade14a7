//! How far a hand has got that was to move for a time, and why not farther.

use std::time::Duration;

use mom_arm::{Pose, Velocity};
use mom_client::{Event, WireError};

use super::state_in;
use crate::failure::Failure;
use crate::output::{Output, words};

/// mm and degrees that may be missing, and the part of the way: a hand that starts and stops takes its time.
const MISSING: f64 = 3.0;
const PART: f64 = 0.15;

/// The way of a hand.
#[derive(Debug)]
pub(super) struct Way {
    /// mm and degrees.
    wanted: [f64; 5],
    begin: Option<Pose>,
    /// Commands that were said, and those that the hub refused.
    pub(super) said: u32,
    refused: u32,
    /// Why the last of them was refused.
    why: Option<WireError>,
}

impl Way {
    /// That of a velocity which holds for a time.
    pub(super) fn new(velocity: Velocity, time: Duration) -> Way {
        Way {
            wanted: velocity.numbers().map(|speed| speed * time.as_secs_f64()),
            begin: None,
            said: 0,
            refused: 0,
            why: None,
        }
    }

    /// Takes in what has come of it.
    pub(super) fn see(&mut self, event: &Event) {
        if let Event::Refused(error, _) = event {
            self.refused += 1;
            self.why = Some(error.clone());
        }
        self.begin = self.begin.or_else(|| state_in(event).map(|state| state.pose));
    }

    /// Forgets what was refused before the time that counts.
    pub(super) fn begin_anew(&mut self) {
        (self.said, self.refused, self.why) = (0, 0, None);
    }

    /// Fails where the hub has refused what is missing of the way; remarks what is missing for another reason.
    pub(super) fn end(&self, pose: &Pose, output: Output) -> Result<(), Failure> {
        let Some(missing) = self.missing(pose) else {
            return Ok(());
        };
        match &self.why {
            Some(error) => Err(Failure::new(
                format!(
                    "{missing}: the hub refused at least {} of {} ({})",
                    self.refused,
                    words::count(self.said.into(), "command"),
                    words::visible(&error.to_string())
                ),
                "over a line this slow, tell the arm where to go: mom run",
            )),
            None => {
                output.remark(format_args!(
                    "{missing}: the hand slows down before the workspace's edge and where its joints end"
                ));
                Ok(())
            }
        }
    }

    /// `moved 5 of 50 mm`, if much is missing.
    fn missing(&self, pose: &Pose) -> Option<String> {
        let begin = self.begin.as_ref()?;
        let moved = [
            pose.x - begin.x,
            pose.y - begin.y,
            pose.z - begin.z,
            pose.spin - begin.spin,
            pose.tilt - begin.tilt,
        ];
        let length = |way: &[f64; 5]| [way[0].hypot(way[1]).hypot(way[2]), way[3].hypot(way[4])];
        let parts = length(&moved).into_iter().zip(length(&self.wanted));
        let missing = parts
            .zip(["mm", "degrees"])
            .filter_map(|((moved, wanted), unit)| {
                let is_missing = wanted - moved > MISSING.max(wanted * PART);
                is_missing.then(|| format!("moved {moved:.0} of {wanted:.0} {unit}"))
            });
        let missing: Vec<String> = missing.collect();
        (!missing.is_empty()).then(|| missing.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use mom_arm::pose;
    use mom_client::Code;

    use super::*;

    fn way(numbers: [f64; 5]) -> Way {
        Way {
            begin: Some(at(10.0, 0.0)),
            said: 13,
            ..Way::new(Velocity::of(numbers), Duration::from_secs(1))
        }
    }

    fn at(x: f64, spin: f64) -> Pose {
        Pose {
            x,
            spin,
            ..pose::HOME
        }
    }

    #[test]
    fn what_is_missing_is_said() {
        for (wanted, pose, said) in [
            ([50.0, 0.0, 0.0, 0.0, 0.0], at(60.4, 0.0), None),
            ([50.0, 0.0, 0.0, 0.0, 0.0], at(55.0, 0.0), None),
            (
                [50.0, 0.0, 0.0, 0.0, 0.0],
                at(15.0, 0.0),
                Some("moved 5 of 50 mm"),
            ),
            (
                [50.0, 0.0, 0.0, 30.0, 0.0],
                at(10.0, 0.0),
                Some("moved 0 of 50 mm, moved 0 of 30 degrees"),
            ),
            ([2.0, 0.0, 0.0, 0.0, 0.0], at(10.0, 0.0), None),
        ] {
            assert_eq!(way(wanted).missing(&pose).as_deref(), said, "{wanted:?}");
        }
    }

    #[test]
    fn what_the_hub_refused_is_a_failure() {
        let mut way = way([50.0, 0.0, 0.0, 0.0, 0.0]);
        let output = Output::new(false);
        assert!(way.end(&at(15.0, 0.0), output).is_ok(), "at an edge");
        let late = WireError::new(Code::EXPIRED, "it has expired");
        for _ in 0..12 {
            way.see(&Event::Refused(late.clone(), None));
        }
        let failed = way.end(&at(15.0, 0.0), output).expect_err("it was refused");
        assert_eq!(
            failed.to_string(),
            "moved 5 of 50 mm: the hub refused at least 12 of 13 commands (expired: it has expired)"
        );
        assert!(way.end(&at(60.0, 0.0), output).is_ok(), "all of the way");
        way.begin_anew();
        assert!(
            way.end(&at(15.0, 0.0), output).is_ok(),
            "before the time that counts"
        );
    }
}
