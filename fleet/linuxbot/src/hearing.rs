//! What a robot hears of its base station, without a connection and without a clock.

use mom_brs::{Direction, Faults, MOST_ASTRAY, Parser, SILENCE, Table};
use mom_wheels::WheelTime;

use crate::Robot;

/// One base station as its robot hears it: bytes become frames, and frames what the robot does.
#[derive(Debug)]
pub(crate) struct Hearing {
    parser: Parser,
    /// When the last bytes came.
    heard: WheelTime,
    /// When the last frame came that is not doubtful.
    understood: WheelTime,
}

/// More of what a base station says cannot be read than can, so that it may have said what the robot has to obey.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("it sent an invalid frame")]
pub(crate) struct Garbled;

impl Hearing {
    pub(crate) fn new(table: &'static Table, now: WheelTime) -> Self {
        Self {
            parser: Parser::new(table, Direction::Command),
            heard: now,
            understood: now,
        }
    }

    /// Bytes have come: has the robot do what they say, and adds its replies.
    pub(crate) fn hear(
        &mut self,
        bytes: &[u8],
        robot: &mut Robot,
        now: WheelTime,
        replies: &mut Vec<u8>,
    ) -> Result<(), Garbled> {
        self.advance(now)?;
        self.heard = now;
        for byte in bytes {
            let frame = self.parser.push(*byte);
            self.check()?;
            let Some(frame) = frame else { continue };
            let reply = match self.parser.astray() {
                0 => {
                    self.understood = now;
                    robot.take(&frame, now)
                }
                _ => robot.take_doubtful(&frame, now),
            };
            if let Some(reply) = reply {
                replies.extend_from_slice(reply.encode().as_bytes());
            }
        }
        Ok(())
    }

    /// Lets time pass: after a silence the next byte begins a code.
    pub(crate) fn advance(&mut self, now: WheelTime) -> Result<(), Garbled> {
        if self.silent_at().is_some_and(|silent| now >= silent) {
            self.parser.idle();
        }
        self.check()
    }

    /// When a silence has to be told, if nothing comes before.
    pub(crate) fn silent_at(&self) -> Option<WheelTime> {
        let silence = WheelTime::try_from(SILENCE.as_micros()).unwrap_or(WheelTime::MAX);
        self.parser.is_amid().then(|| self.heard.saturating_add(silence))
    }

    /// Nothing was read for a while, so that there is no saying how long the base station was silent.
    pub(crate) fn was_not_read(&mut self, now: WheelTime) {
        self.heard = now;
    }

    /// When the last bytes came.
    pub(crate) fn heard(&self) -> WheelTime {
        self.heard
    }

    /// When it was understood last.
    pub(crate) fn understood(&self) -> WheelTime {
        self.understood
    }

    /// What was wrong with what it said.
    pub(crate) fn faults(&self) -> Faults {
        self.parser.faults()
    }

    /// An error if it is to be hung up.
    pub(crate) fn check(&self) -> Result<(), Garbled> {
        match self.parser.astray() > MOST_ASTRAY {
            true => Err(Garbled),
            false => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use mom_brs::file::EXTENDED;
    use mom_wheels::{Chassis, Simulated};
    use proptest::prelude::*;

    use super::*;
    use crate::Rules;

    const MS: WheelTime = 1000;
    const SILENT: WheelTime = 200 * MS;
    const STOP: &[u8] = b"06 00000 00000";

    /// A robot of the paper that drives at full speed, and its base station.
    fn driving(rules: Rules) -> (Robot, Hearing) {
        let mut robot = Robot::new(Box::new(Simulated::linuxbot()), Chassis::LINUXBOT, rules);
        let mut hearing = Hearing::new(&EXTENDED, 0);
        hear(&mut hearing, &mut robot, b"06 01000 01000", 0);
        (robot, hearing)
    }

    /// What the server does: a base station that is garbled is hung up, and the robot stands. Whether it was.
    fn hear(hearing: &mut Hearing, robot: &mut Robot, bytes: &[u8], now: WheelTime) -> bool {
        let heard = hearing.hear(bytes, robot, now, &mut Vec::new());
        if heard.is_err() {
            robot.halt(now);
        }
        heard.is_err()
    }

    fn moves(robot: &mut Robot, now: WheelTime) -> bool {
        robot.status(now).expect("it can be read").moving
    }

    /// Frames, and pieces of them that are wrong by a digit.
    fn bytes() -> impl Strategy<Value = Vec<u8>> {
        let piece = prop::sample::select(vec![
            &b"0"[..],
            b"1",
            b"6",
            b" ",
            b"-",
            b"x",
            b"\n",
            b"00",
            b"04",
            b"12",
            b"55",
            b"90",
            b"06",
            b"10",
            b" 00100",
            b" -0050",
            b"06 01000 01000",
            b"06 01000 010000",
            b"006 00100 00100",
            b"10 04000 02500",
            b"11 01000 01000",
            b"07 00255",
            b"55 00001 00002",
        ]);
        prop_oneof![
            3 => prop::collection::vec(piece, 0..12).prop_map(|pieces| pieces.concat()),
            1 => prop::collection::vec(any::<u8>(), 0..120),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

        /// After any bytes and a silence a stop is obeyed, also in the paper, and also if it comes in pieces.
        #[test]
        fn after_any_bytes_and_a_silence_a_stop_is_obeyed(
            said in prop::collection::vec((bytes(), 0..400 * MS), 0..6), cut in 0..=STOP.len(), paper: bool,
        ) {
            let (mut robot, mut hearing) = driving(if paper { Rules::PAPER } else { Rules::default() });
            let mut now = 0;
            for (bytes, later) in said {
                now += later;
                if hear(&mut hearing, &mut robot, &bytes, now) {
                    prop_assert!(!moves(&mut robot, now), "who is hung up has no robot that moves");
                    return Ok(());
                }
            }
            now += SILENT;
            let (first, rest) = STOP.split_at(cut);
            let gone = hear(&mut hearing, &mut robot, first, now) || hear(&mut hearing, &mut robot, rest, now + 50 * MS);
            prop_assert!(!moves(&mut robot, now + 50 * MS), "{gone} {hearing:?}");
        }

        /// After any bytes, and without any silence: of so many stops one is obeyed.
        #[test]
        fn after_any_bytes_few_stops_are_needed(bytes in bytes(), paper: bool) {
            let (mut robot, mut hearing) = driving(if paper { Rules::PAPER } else { Rules::default() });
            let mut gone = hear(&mut hearing, &mut robot, &bytes, 10 * MS);
            for stop in 1..=2 {
                gone = gone || hear(&mut hearing, &mut robot, STOP, (10 + stop) * MS);
            }
            prop_assert!(!moves(&mut robot, 20 * MS), "{hearing:?}");
        }

        /// Of a base station that is never understood the watchdog stops it, whatever comes how often.
        #[test]
        fn who_is_not_understood_does_not_feed_the_watchdog(
            piece in prop::sample::select(vec![&b"006 00000 00001"[..], b"x", b"\n", b"006 00001 0000", b"55 00001", b"9"]),
            between in 1..300 * MS,
        ) {
            let (mut robot, mut hearing) = driving(Rules::default());
            let mut now = 0;
            // One word more is understood at most: the `00` of the first piece.
            while now < 800 * MS + between {
                now += between;
                robot.advance(now);
                if hear(&mut hearing, &mut robot, piece, now) {
                    break;
                }
            }
            robot.advance(now);
            prop_assert!(!moves(&mut robot, now), "{hearing:?}");
        }
    }

    #[test]
    fn a_digit_too_many_hides_no_more_than_one_stop() {
        for between in [1, 50, 100, 199, 200, 300] {
            let (mut robot, mut hearing) = driving(Rules::PAPER);
            hear(&mut hearing, &mut robot, b"06 01000 010000", MS);
            let mut now = MS;
            for _ in 0..2 {
                now += between * MS;
                assert!(!hear(&mut hearing, &mut robot, STOP, now));
            }
            assert!(!moves(&mut robot, now), "stops {between} ms apart");
        }
    }

    #[test]
    fn line_ends_and_what_is_not_read_for_a_while_are_no_reason_to_hang_up() {
        let (mut robot, mut hearing) = driving(Rules::default());
        for at in 1..1000 {
            assert!(!hear(&mut hearing, &mut robot, b"00\r\n", at * 100 * MS));
        }
        assert!(hearing.understood() == 99_900 * MS && moves(&mut robot, 99_900 * MS));
        // Half a frame waits for the other half, however long nothing was read.
        let begun = 100_000 * MS;
        hear(&mut hearing, &mut robot, b"06 00000 ", begun);
        hearing.was_not_read(begun + 450 * MS);
        hear(&mut hearing, &mut robot, b"00000", begun + 451 * MS);
        assert!(!moves(&mut robot, begun + 451 * MS));
    }
}
