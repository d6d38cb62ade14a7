//! Whether the controller sees, and is obeyed, well enough: where not, it goes carefully, and then it ends and says why.
//!
//! | what | carefully from | no motion from | ended after |
//! |---|---|---|---|
//! | the second newest picture of all cameras | [`OLD`] | [`OLDEST`] | [`BLIND`] of that |
//! | the newest picture of the hand, where pictures lead it | [`OLD`] | [`OLDEST`] | [`BLIND`] of that |
//! | a command whose begin the arm has not told | half as long again as they took, + [`LATE`] | the same | as long as they took, +
//! [`UNHEARD`] |
//! | an estimate that cannot be: of the delay, or of a camera | the first, and the second: all that was estimated is forgotten and measured
//! anew | | the third, unless pictures have fitted what the commands did since |
//!
//! *Carefully* means: 40 mm/s, one command at a time, and the next one only when pictures have shown the hand where the
//! last one has left it.

use std::collections::VecDeque;

use mom_drive::believed;

use crate::Micros;

/// Pictures of a regular link are younger, µs: a second on the way, and half a second between two.
pub const OLD: Micros = 1_650_000;
/// With older pictures nothing is moved, µs.
pub const OLDEST: Micros = 2_000_000;
/// So long nothing is moved before it ends, µs: the last command has ended by then.
pub const BLIND: Micros = 1_500_000;
/// A command that begins so much later than usual, µs, is late.
pub const LATE: Micros = 400_000;
/// One that begins so much later than usual, µs, is lost.
pub const UNHEARD: Micros = 1_800_000;
/// The longest usual time from a command to the arm's word that it has begun, µs.
const MOST_USUAL: Micros = 2_200_000;
/// So long it goes carefully after all is well again, µs.
const CAREFUL: Micros = 6_000_000;
/// So many estimates that cannot be end it.
const ABSURD: u32 = 3;
/// So many commands that did what the estimate says take one of them back.
const SOUND: u32 = 2;

/// What is known of pictures and commands.
#[derive(Debug, Clone, Default)]
pub(super) struct Sight {
    /// Of each camera's newest picture: when it was taken, and how well that is known.
    pictures: Vec<Option<(Micros, Micros)>>,
    /// The same of the newest picture of the hand.
    hand: Option<(Micros, Micros)>,
    /// Commands whose begin has not been told, and when they were sent.
    unheard: VecDeque<(u32, Micros)>,
    /// From a command to the arm's word.
    usual: Option<Micros>,
    round_trip: Micros,
    blind_since: Option<Micros>,
    /// Why it goes carefully, and until when.
    careful: Option<(String, Micros)>,
    absurd: u32,
    /// Commands, since the last such estimate, that did what the estimate says, and the newest of them.
    sound: (u32, u32),
}

/// What may be done.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Judgement {
    Move,
    Wait,
    End(String),
}

impl Sight {
    pub(super) fn picture(&mut self, camera: usize, taken: Micros, error: Micros, shows_hand: bool) {
        if self.pictures.len() <= camera {
            self.pictures.resize(camera + 1, None);
        }
        let picture = Some((taken, error));
        self.pictures[camera] = self.pictures[camera].max(picture);
        if shows_hand {
            self.hand = self.hand.max(picture);
        }
    }

    /// The round trip to the hub.
    pub(super) fn round_trip(&mut self, round_trip: Micros) {
        self.round_trip = round_trip;
    }

    pub(super) fn sent(&mut self, number: u32, at: Micros) {
        self.unheard.push_back((number, at));
    }

    /// The arm has said that it has begun this command, and with it all before it.
    pub(super) fn heard(&mut self, number: u32, now: Micros) {
        if let Some((_, sent)) = self.unheard.iter().find(|(known, _)| *known == number) {
            let took = (now - sent).clamp(0, MOST_USUAL);
            // A longer one counts at once, a shorter one little by little.
            let usual = self.usual.map_or(took, |usual| took.max(usual - usual / 10));
            self.usual = Some(usual);
        }
        self.unheard.retain(|(known, _)| *known > number);
    }

    /// What the arm was told is over, whatever became of it.
    pub(super) fn forget_commands(&mut self) {
        self.unheard.clear();
    }

    pub(super) fn is_unheard(&self) -> bool {
        !self.unheard.is_empty()
    }

    /// Something is not as it must be; it goes carefully for some time.
    pub(super) fn beware(&mut self, why: String, now: Micros) {
        self.careful = Some((why, now + CAREFUL));
    }

    /// An estimate came out that cannot be.
    pub(super) fn doubt(&mut self, why: String, now: Micros) {
        self.absurd += 1;
        self.sound.0 = 0;
        self.beware(why, now);
    }

    /// Pictures have shown the resting hand where this command should have taken it. Doubts fade with that, once the delay is measured
    /// anew: a hand that goes carefully tells nothing of it.
    pub(super) fn trust(&mut self, command: u32) {
        if self.absurd == 0 || self.careful.is_some() || command == self.sound.1 {
            return;
        }
        self.sound = (self.sound.0 + 1, command);
        if self.sound.0 >= SOUND {
            self.sound.0 = 0;
            self.absurd -= 1;
        }
    }

    /// Why it goes carefully, if it does.
    pub(super) fn careful(&self) -> Option<&str> {
        self.careful.as_ref().map(|(why, _)| why.as_str())
    }

    /// How old a picture may be at most.
    fn age(&self, (taken, error): (Micros, Micros), now: Micros) -> Micros {
        believed(now - taken, error, self.round_trip)
    }

    /// The age of the pictures by which it goes: two cameras have to see, where there are two.
    pub(super) fn pictures_age(&self, now: Micros) -> Option<Micros> {
        let mut ages: Vec<Micros> = self
            .pictures
            .iter()
            .flatten()
            .map(|picture| self.age(*picture, now))
            .collect();
        ages.sort_unstable();
        ages.get(1).or(ages.first()).copied()
    }

    /// What may be done now; `led` by pictures of the hand, or so far and no further.
    pub(super) fn judge(&mut self, led: bool, now: Micros) -> Judgement {
        if self.careful.as_ref().is_some_and(|(_, until)| now > *until) {
            self.careful = None;
        }
        if let Some((why, _)) = self.careful.as_ref().filter(|_| self.absurd >= ABSURD) {
            return Judgement::End(format!("estimate: {why}"));
        }
        let commands = self.judge_commands(now);
        let sight = self.judge_pictures(led, now);
        match (commands, sight) {
            (end @ Judgement::End(_), _) | (_, end @ Judgement::End(_)) => end,
            (Judgement::Move, Judgement::Move) => Judgement::Move,
            _ => Judgement::Wait,
        }
    }

    fn judge_commands(&mut self, now: Micros) -> Judgement {
        let Some((_, sent)) = self.unheard.front() else {
            return Judgement::Move;
        };
        let (waited, usual) = (now - sent, self.usual.unwrap_or(MOST_USUAL));
        let lost = usual + UNHEARD;
        if waited > lost {
            return Judgement::End(format!(
                "control: the arm has not begun a command within {}, {} is the limit",
                seconds(waited),
                seconds(lost)
            ));
        }
        match waited > usual + usual / 2 + LATE {
            true => {
                self.beware(format!("a command has not begun for {}", seconds(waited)), now);
                Judgement::Wait
            }
            false => Judgement::Move,
        }
    }

    fn judge_pictures(&mut self, led: bool, now: Micros) -> Judgement {
        let hand = self.hand.filter(|_| led).map(|hand| self.age(hand, now));
        let (what, age) = match (self.pictures_age(now), hand) {
            (Some(all), Some(hand)) if hand > all => ("pictures of the hand are", hand),
            (Some(all), _) => (self.few(now), all),
            // Before the first one nothing is moved.
            (None, _) => return Judgement::Move,
        };
        if age > OLD {
            self.beware(format!("{what} {} old", seconds(age)), now);
        }
        if age <= OLDEST {
            self.blind_since = None;
            return Judgement::Move;
        }
        let since = *self.blind_since.get_or_insert(now);
        match now - since >= BLIND {
            true => Judgement::End(format!(
                "sight: {what} {} old, {} is the limit",
                seconds(age),
                seconds(OLDEST)
            )),
            false => Judgement::Wait,
        }
    }

    /// Whether all pictures are old, or all but those of one camera.
    fn few(&self, now: Micros) -> &'static str {
        let newest = self
            .pictures
            .iter()
            .flatten()
            .map(|picture| self.age(*picture, now))
            .min();
        match newest.is_some_and(|age| age <= OLD) && self.pictures.len() > 1 {
            true => "pictures of all cameras but one are",
            false => "pictures are",
        }
    }
}

fn seconds(micros: Micros) -> String {
    format!("{:.1} s", micros as f64 / 1e6)
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: Micros = 1_000_000;

    /// Two cameras that have seen the hand at this time.
    fn seen(at: Micros) -> Sight {
        let mut sight = Sight::default();
        sight.picture(0, at, 0, true);
        sight.picture(1, at, 0, true);
        sight
    }

    #[test]
    fn old_pictures_slow_it_then_hold_it_then_end_it() {
        let mut sight = seen(0);
        assert_eq!((sight.judge(true, S), sight.careful()), (Judgement::Move, None));
        assert_eq!(sight.judge(true, OLD + 1), Judgement::Move);
        assert_eq!(sight.careful(), Some("pictures are 1.7 s old"));
        assert_eq!(sight.judge(true, OLDEST + 1), Judgement::Wait);
        let Judgement::End(why) = sight.judge(true, OLDEST + 1 + BLIND) else {
            panic!("it is blind for too long");
        };
        assert_eq!(why, "sight: pictures are 3.5 s old, 2.0 s is the limit");
        // One camera is not enough where there are two.
        let mut sight = seen(0);
        sight.picture(0, 4 * S, 0, true);
        assert_eq!(sight.judge(true, 4 * S), Judgement::Wait);
        let Judgement::End(why) = sight.judge(true, 4 * S + BLIND) else {
            panic!("it is blind for too long");
        };
        assert_eq!(
            why,
            "sight: pictures of all cameras but one are 5.5 s old, 2.0 s is the limit"
        );
        // Pictures that do not show the hand lead nowhere.
        let mut sight = seen(0);
        sight.picture(0, 3 * S, 0, false);
        sight.picture(1, 3 * S, 0, false);
        assert_eq!(sight.judge(false, 3 * S), Judgement::Move);
        assert_eq!(sight.judge(true, 3 * S), Judgement::Wait);
    }

    #[test]
    fn an_age_that_cannot_be_is_not_believed() {
        let mut sight = Sight::default();
        sight.round_trip(400_000);
        sight.picture(0, 10 * S, 0, true);
        assert_eq!(sight.pictures_age(10 * S), Some(400_000));
        assert_eq!(sight.pictures_age(9 * S), Some(400_000), "from the future");
        sight.picture(0, 11 * S, 3 * S, true);
        assert_eq!(sight.judge(true, 12 * S), Judgement::Wait, "1 s ± 3 s");
    }

    #[test]
    fn commands_that_the_arm_does_not_begin_hold_it_and_end_it() {
        let mut sight = seen(0);
        sight.sent(1, 0);
        sight.heard(1, 100_000);
        sight.sent(2, S);
        assert_eq!(sight.judge(true, S + 500_000), Judgement::Move);
        assert_eq!(
            (sight.judge(true, S + 600_000), sight.careful()),
            (Judgement::Wait, Some("a command has not begun for 0.6 s"))
        );
        let Judgement::End(why) = sight.judge(true, 3 * S) else {
            panic!("nothing is heard of it");
        };
        assert_eq!(
            why,
            "control: the arm has not begun a command within 2.0 s, 1.9 s is the limit"
        );
        // The word of a later one tells of it, too.
        let mut sight = seen(0);
        sight.sent(2, 0);
        sight.sent(3, 100_000);
        sight.heard(3, 200_000);
        assert!(!sight.is_unheard());
    }

    #[test]
    fn the_third_estimate_that_cannot_be_ends_it_unless_commands_did_what_they_should() {
        let absurd = || "camera 1 is turned by 24 degrees".to_owned();
        let mut sight = seen(0);
        for round in 0..2 {
            sight.doubt(absurd(), round);
            assert_eq!(sight.judge(true, 10), Judgement::Move);
        }
        let mut certain = sight.clone();
        sight.doubt(absurd(), 2);
        let end = Judgement::End(format!("estimate: {}", absurd()));
        assert_eq!(sight.judge(true, 10), end);

        // As long as it goes carefully, that proves nothing; nor does one command twice.
        certain.trust(1);
        certain.trust(2);
        let later = 2 + CAREFUL;
        certain.picture(0, later, 0, true);
        certain.picture(1, later, 0, true);
        assert_eq!(
            (certain.judge(true, later), certain.careful()),
            (Judgement::Move, None)
        );
        certain.trust(3);
        certain.trust(3);
        assert_eq!(certain.absurd, 2);
        certain.trust(4);
        assert_eq!(certain.absurd, 1);
        certain.doubt(absurd(), later);
        assert_eq!(certain.judge(true, later), Judgement::Move);
    }
}
