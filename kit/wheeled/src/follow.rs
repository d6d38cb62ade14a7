//! Following a leader along its trail, as a pure function of its poses, one's own, and the time (W22).

use std::collections::VecDeque;
use std::sync::Arc;

use mom_wheels::pilot::Point;
use mom_wheels::{Chassis, Motors, Pose, WheelTime};

/// µs: a leader is lost when its newest pose may be older than this, its error included.
pub const LIMIT: WheelTime = 500_000;
/// mm between two points of a trail.
const STEP: f64 = 50.0;
/// mm: a point is passed when the robot is as near as this.
const PASSED: f64 = 60.0;
/// mm along the trail to the point that it steers for. By so much it may cut a corner, and by [`PASSED`] more where the trail turns back.
const SIGHT: f64 = 150.0;
/// mm: nearer to its place than this it stands.
const CLOSE: f64 = 20.0;
/// mm between two poses, beyond which nobody knows where the leader drove.
const HOLE: f64 = 1000.0;
/// The most points of a trail, so that it is 100 m long at most.
const MOST: usize = 2000;
/// The part of full speed at which it goes, at most: above that of a pilot, so that it catches up with one.
const SPEED: f64 = 0.75;
/// The part of full speed at which each wheel turns it, at most.
const TURN_SPEED: f64 = 0.25;
/// Degrees: it turns on the spot when what it steers for is further off than this.
const ASTRAY: f64 = 60.0;
/// 1/s, as a pilot's.
const GAIN: f64 = 2.0;

/// Keeps a distance to a leader along the leader's trail.
///
/// It goes where the leader was, and stands while it does not know surely that the leader's newest pose is younger than [`LIMIT`].
#[derive(Debug, Clone, PartialEq)]
pub struct Follower {
    leader: Arc<str>,
    distance: f64,
    /// Where the leader was, the oldest first; the last is where it is.
    trail: VecDeque<Point>,
    /// When the newest pose was made, at the earliest.
    seen: Option<WheelTime>,
}

/// Why a trail cannot be followed any more.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Strayed {
    /// Poses between are missing, so that the way there is not known.
    #[error("the leader is {0:.0} mm from its last known position, and its path there is unknown")]
    Hole(f64),
    /// The trail is longer than can be kept.
    #[error("the leader is more than {} m ahead", MOST as f64 * STEP / 1000.0)]
    TooFar,
}

impl Follower {
    /// One that keeps so many mm behind the peer of this name.
    #[must_use]
    pub fn new(leader: Arc<str>, distance: f64) -> Self {
        Self {
            leader,
            distance,
            trail: VecDeque::new(),
            seen: None,
        }
    }

    /// The peer that it follows.
    #[must_use]
    pub fn leader(&self) -> &Arc<str> {
        &self.leader
    }

    /// The leader was there, at this time at the earliest. A pose that may be older than the newest one says nothing new.
    ///
    /// # Errors
    ///
    /// The leader cannot be followed there.
    pub fn heard(&mut self, at: Point, made: WheelTime) -> Result<(), Strayed> {
        if self.seen.is_some_and(|seen| made <= seen) || !(at.x.is_finite() && at.y.is_finite()) {
            return Ok(());
        }
        if let Some(last) = self.trail.back() {
            let hole = between(*last, at);
            if hole > HOLE {
                return Err(Strayed::Hole(hole));
            }
        }
        self.seen = Some(made);
        let count = self.trail.len();
        // The last point moves with the leader until it is a step from the one before.
        let before = count.checked_sub(2).and_then(|index| self.trail.get(index));
        if before.is_some_and(|before| between(*before, at) < STEP) {
            self.trail.pop_back();
        }
        self.trail.push_back(at);
        if self.trail.len() > MOST {
            return Err(Strayed::TooFar);
        }
        Ok(())
    }

    /// Whether the leader's newest pose may be too old, or there is none.
    #[must_use]
    pub fn is_lost(&self, now: WheelTime) -> bool {
        self.lost_at().is_none_or(|lost| now >= lost)
    }

    /// When the leader will be lost, unless it is heard of before.
    #[must_use]
    pub fn lost_at(&self) -> Option<WheelTime> {
        self.seen.map(|seen| seen.saturating_add(LIMIT))
    }

    /// mm along the trail from here to the leader.
    #[must_use]
    pub fn gap(&self, here: Point) -> Option<f64> {
        self.seen?;
        let ahead = self.trail.iter().scan(here, |from, to| {
            let length = between(*from, *to);
            *from = *to;
            Some(length)
        });
        Some(ahead.sum())
    }

    /// What the motors are to be set to now; called again and again.
    pub fn steer(&mut self, pose: Pose, chassis: &Chassis, now: WheelTime) -> Motors {
        let here = Point::new(pose.x, pose.y);
        self.pass(here);
        let ahead = self.gap(here).map_or(0.0, |gap| gap - self.distance);
        if self.is_lost(now) || ahead.is_nan() || ahead <= CLOSE {
            return Motors::STOP;
        }
        let target = self.sight(here);
        let bearing = (target.y - here.y).atan2(target.x - here.x).to_degrees();
        let off = Pose::new(0.0, 0.0, bearing - pose.heading).heading;
        let turn = (GAIN * off / chassis.full_turn()).clamp(-TURN_SPEED, TURN_SPEED);
        let speed = match off.abs() > ASTRAY {
            true => 0.0,
            false => (GAIN * ahead / chassis.full_speed).min(SPEED) * off.to_radians().cos(),
        };
        let per_mille = |part: f64| (part * 1000.0).round() as i16;
        Motors::new(per_mille(speed - turn), per_mille(speed + turn))
    }

    /// Forgets points that it is at, or past.
    fn pass(&mut self, here: Point) {
        while let (Some(first), Some(second)) = (self.trail.front(), self.trail.get(1)) {
            let near = between(here, *first);
            if near > PASSED && near < between(here, *second) {
                break;
            }
            self.trail.pop_front();
        }
    }

    /// The point of the trail that is as far along it as it looks ahead.
    fn sight(&self, here: Point) -> Point {
        let (mut from, mut left) = (here, SIGHT);
        for to in &self.trail {
            let length = between(from, *to);
            if length >= left {
                let part = left / length;
                return Point::new(from.x + (to.x - from.x) * part, from.y + (to.y - from.y) * part);
            }
            (from, left) = (*to, left - length);
        }
        from
    }
}

fn between(a: Point, b: Point) -> f64 {
    (b.x - a.x).hypot(b.y - a.y)
}

#[cfg(test)]
mod tests {
    use mom_wheels::{Driver as _, Floor, Pilot, Power, Simulated};
    use proptest::prelude::*;

    use super::*;

    const TICK: WheelTime = 50_000;

    fn robot(x: f64, y: f64) -> Simulated {
        let pose = Pose::new(x, y, 0.0);
        Simulated::new(Chassis::LINUXBOT, Power::LINUXBOT, Floor::ARENA, pose).expect("a robot")
    }

    fn follower(distance: f64) -> Follower {
        Follower::new("a".into(), distance)
    }

    fn place(robot: &mut Simulated, now: WheelTime) -> Point {
        let pose = robot.pose(now);
        Point::new(pose.x, pose.y)
    }

    /// Has a leader drive by points, and says where both were at each tick; poses are so old when they come.
    fn convoy(points: &[Point], distance: f64, age: WheelTime) -> (Vec<Point>, Vec<Point>, f64) {
        let (mut leader, mut behind) = (robot(2000.0, 1000.0), robot(1000.0, 1000.0));
        let mut pilot = Pilot::new(leader.chassis(), points, 0);
        let mut follower = follower(distance);
        let (mut led, mut followed) = (Vec::new(), Vec::new());
        let mut rest = 0;
        let mut now = 0;
        while rest < 100 {
            pilot.drive(&mut leader, now).expect("a simulated driver");
            led.push(place(&mut leader, now));
            if now % (2 * TICK) == 0
                && let Some(at) = led.len().checked_sub(1 + (age / TICK) as usize)
            {
                follower.heard(led[at], now - age).expect("a whole trail");
            }
            let motors = follower.steer(behind.pose(now), &Chassis::LINUXBOT, now);
            behind.set_motors(motors, now).expect("a simulated driver");
            followed.push(place(&mut behind, now));
            rest = if pilot.end().is_some() { rest + 1 } else { 0 };
            now += TICK;
        }
        let gap = follower.gap(place(&mut behind, now)).expect("it was heard");
        (led, followed, gap)
    }

    fn near(trail: &[Point], at: Point) -> f64 {
        trail
            .iter()
            .map(|point| between(*point, at))
            .fold(f64::MAX, f64::min)
    }

    #[test]
    fn it_goes_round_corners_where_the_leader_went() {
        let square = [
            (3000.0, 1000.0),
            (3000.0, 2000.0),
            (2000.0, 2000.0),
            (2000.0, 1200.0),
        ];
        let square = square.map(|(x, y)| Point::new(x, y));
        let (led, followed, gap) = convoy(&square, 500.0, 100_000);
        assert!((480.0..=540.0).contains(&gap), "{gap}");
        // From where the leader began on; before that nobody has been there.
        for at in followed.iter().filter(|at| at.x > 2000.0) {
            let off = near(&led, *at);
            assert!(off < 120.0, "{off} mm beside the trail at {at:?}");
        }
        assert!(
            near(&followed, square[1]) < 150.0,
            "it did not cut the corner across"
        );
    }

    #[test]
    fn it_stands_when_the_pose_may_be_too_old_or_was_never_heard() {
        let here = Pose::new(0.0, 0.0, 0.0);
        let mut follower = follower(300.0);
        assert!(follower.is_lost(0));
        assert_eq!(follower.steer(here, &Chassis::LINUXBOT, 0), Motors::STOP);
        follower
            .heard(Point::new(900.0, 0.0), 1000)
            .expect("the first one");
        for (now, goes) in [(1000, true), (LIMIT + 999, true), (LIMIT + 1000, false)] {
            assert_eq!(follower.is_lost(now), !goes, "{now}");
            let motors = follower.steer(here, &Chassis::LINUXBOT, now);
            assert_eq!(motors != Motors::STOP, goes, "{now}");
        }
        // It goes on when there is news.
        follower
            .heard(Point::new(950.0, 0.0), 2_000_000)
            .expect("it is near");
        assert!(follower.steer(here, &Chassis::LINUXBOT, 2_000_000) != Motors::STOP);
    }

    #[test]
    fn an_older_pose_and_one_that_is_nowhere_change_nothing() {
        let mut follower = follower(300.0);
        follower
            .heard(Point::new(900.0, 0.0), 1000)
            .expect("the first one");
        let before = follower.clone();
        for (x, made) in [(800.0, 999), (800.0, 1000), (f64::NAN, 2000)] {
            follower.heard(Point::new(x, 0.0), made).expect("it says nothing");
            assert_eq!(follower, before, "{x} {made}");
        }
    }

    #[test]
    fn a_hole_in_the_trail_ends_it() {
        let mut follower = follower(300.0);
        follower.heard(Point::new(0.0, 0.0), 1).expect("the first one");
        let hole = follower.heard(Point::new(1001.0, 0.0), 2);
        assert_eq!(hole, Err(Strayed::Hole(1001.0)));
        let words = "the leader is 1001 mm from its last known position, and its path there is unknown";
        assert_eq!(hole.map_err(|error| error.to_string()), Err(words.to_owned()));
    }

    #[test]
    fn a_leader_that_stands_makes_no_trail() {
        let mut follower = follower(300.0);
        for made in 1..10_000 {
            let x = 500.0 + (made % 7) as f64;
            follower.heard(Point::new(x, 0.0), made).expect("it stands");
        }
        assert!(follower.trail.len() <= 3, "{}", follower.trail.len());
    }

    /// It cuts more than where the way bends, as it passes points of both legs at once.
    #[test]
    fn it_keeps_its_distance_where_the_leader_turns_back() {
        let points = [(3055.448, 1565.57), (2547.564, 1383.1), (3052.179, 1773.839)];
        let (_, _, gap) = convoy(&points.map(|(x, y)| Point::new(x, y)), 697.2, 1);
        assert!(gap > 697.2 - SIGHT - PASSED, "{gap}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]

        /// Wherever the leader drives, but towards it at once: along its trail, it ends no nearer than its distance, but for
        /// the corners that it cuts.
        #[test]
        fn it_keeps_its_distance(
            points in proptest::collection::vec((2300.0..4000.0, 1000.0..4000.0), 1..5),
            distance in 250.0..800.0, age in 0..4_i64,
        ) {
            let points: Vec<Point> = points.into_iter().map(|(x, y)| Point::new(x, y)).collect();
            let (_, _, gap) = convoy(&points, distance, age * TICK);
            prop_assert!(gap > distance - SIGHT - PASSED, "{gap} of {distance}");
        }
    }
}
