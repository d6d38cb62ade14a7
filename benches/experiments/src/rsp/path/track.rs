//! Paths on the floor, how far from one a robot is, and pure pursuit along it.

use std::f64::consts::TAU;

use mom_wheels::{Chassis, Pose};

/// mm between two points of a path.
const STEP: f64 = 5.0;
/// mm/s.
pub(super) const SPEED: f64 = 200.0;
/// mm along the path from where the robot is to where it drives for.
pub(super) const LOOKAHEAD: f64 = 200.0;
/// Points before and after the last place among which the nearest is looked for: so a crossing misleads nobody.
const BEHIND: usize = 20;
const AHEAD: usize = 80;
/// mm before its end where a path counts as driven.
const END: f64 = 20.0;

/// A path, in mm.
#[derive(Clone, Debug)]
pub(super) struct Track {
    pub(super) name: &'static str,
    points: Vec<[f64; 2]>,
}

impl Track {
    /// 2 m × 2 m, counterclockwise.
    pub(super) fn square() -> Track {
        let corners = [
            [2000.0, 2000.0],
            [4000.0, 2000.0],
            [4000.0, 4000.0],
            [2000.0, 4000.0],
            [2000.0, 2000.0],
        ];
        let mut points = Vec::new();
        for (from, to) in corners.iter().zip(corners.iter().skip(1)) {
            let steps = 2000.0 / STEP;
            points.extend((0..steps as usize).map(|step| {
                let share = step as f64 / steps;
                [0, 1].map(|axis: usize| from[axis] + (to[axis] - from[axis]) * share)
            }));
        }
        points.push([2000.0, 2000.0]);
        Track {
            name: "square",
            points,
        }
    }

    /// Two circles of 1 m that touch: one to the left, one to the right.
    pub(super) fn eight() -> Track {
        let radius = 500.0;
        let steps = (TAU * radius / STEP) as usize;
        let circle = |side: f64| {
            (0..steps).map(move |step| {
                let (sin, cos) = (TAU * step as f64 / steps as f64).sin_cos();
                [3000.0 + radius * sin, 3000.0 + side * radius * (1.0 - cos)]
            })
        };
        Track {
            name: "figure eight",
            points: circle(1.0)
                .chain(circle(-1.0))
                .chain([[3000.0, 3000.0]])
                .collect(),
        }
    }

    /// So much of it, from its beginning.
    pub(super) fn shortened(mut self, mm: f64) -> Track {
        self.points.truncate((mm / STEP) as usize + 1);
        self
    }

    /// mm.
    pub(super) fn length(&self) -> f64 {
        (self.points.len() - 1) as f64 * STEP
    }

    /// Where it begins; it goes along x there.
    pub(super) fn start(&self) -> [f64; 2] {
        self.points[0]
    }

    /// As a line to draw, m.
    pub(super) fn line(&self) -> Vec<(f64, f64)> {
        let every = self.points.iter().step_by(4).chain(self.points.last());
        every.map(|[x, y]| (x / 1000.0, y / 1000.0)).collect()
    }

    /// The point that lies so many mm along the path behind another; beyond its end it goes on straight.
    fn point(&self, from: usize, along: f64) -> [f64; 2] {
        let at = from + (along / STEP) as usize;
        let last = self.points.len() - 1;
        if at <= last {
            return self.points[at];
        }
        let (end, before) = (self.points[last], self.points[last - 1]);
        [0, 1].map(|axis: usize| end[axis] + (end[axis] - before[axis]) * (at - last) as f64)
    }
}

/// How far a peer has come.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Progress {
    at: usize,
}

impl Progress {
    /// Goes on to the nearest place, and says how far from the path this is, mm.
    pub(super) fn update(&mut self, track: &Track, x: f64, y: f64) -> f64 {
        let first = self.at.saturating_sub(BEHIND);
        let last = (self.at + AHEAD).min(track.points.len() - 2);
        let (mut at, mut least) = (self.at, f64::INFINITY);
        for place in first..=last {
            let distance = to_segment([x, y], track.points[place], track.points[place + 1]);
            if distance < least {
                (at, least) = (place, distance);
            }
        }
        self.at = at;
        least
    }

    /// Whether the path has been driven.
    pub(super) fn is_done(self, track: &Track) -> bool {
        self.at as f64 * STEP >= track.length() - END
    }

    /// The speeds of both wheels, mm/s, that lead onto the path a little further on (pure pursuit).
    pub(super) fn steer(self, track: &Track, pose: Pose) -> [i16; 2] {
        let [x, y] = track.point(self.at, LOOKAHEAD);
        let (dx, dy) = (x - pose.x, y - pose.y);
        let bearing = dy.atan2(dx) - pose.heading.to_radians();
        let curvature = 2.0 * bearing.sin() / dx.hypot(dy).max(1.0);
        let turn = SPEED * curvature * Chassis::CUBO.wheel_base / 2.0;
        let limit = Chassis::CUBO.full_speed;
        [SPEED - turn, SPEED + turn].map(|speed| speed.clamp(-limit, limit).round() as i16)
    }
}

fn to_segment([x, y]: [f64; 2], [x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) -> f64 {
    let (dx, dy) = (x2 - x1, y2 - y1);
    let share = ((x - x1) * dx + (y - y1) * dy) / (dx * dx + dy * dy);
    let share = share.clamp(0.0, 1.0);
    (x - x1 - share * dx).hypot(y - y1 - share * dy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_to_the_part_of_the_path_that_one_is_at() {
        let square = Track::square();
        assert_eq!(square.length(), 8000.0);
        let mut progress = Progress::default();
        for x in 0..200 {
            assert_eq!(progress.update(&square, 2000.0 + f64::from(x * 10), 2007.0), 7.0);
        }
        assert!(!progress.is_done(&square));
        let eight = Track::eight();
        assert!(
            (eight.length() - 2.0 * TAU * 500.0).abs() < 10.0,
            "{}",
            eight.length()
        );
        // Half way it crosses where it began, and is not there again.
        let mut progress = Progress::default();
        for step in 0..=628 {
            let (sin, cos) = (f64::from(step) / 100.0).sin_cos();
            progress.update(&eight, 3000.0 + 500.0 * sin, 3500.0 - 500.0 * cos);
        }
        assert!(progress.at > 600 && !progress.is_done(&eight), "{progress:?}");
    }

    #[test]
    fn pursuit_leads_back_to_the_path() {
        let square = Track::square();
        let left_of_it = Pose::new(2500.0, 2050.0, 0.0);
        let mut progress = Progress { at: 100 };
        progress.update(&square, left_of_it.x, left_of_it.y);
        let [left, right] = progress.steer(&square, left_of_it);
        assert!(left > right, "{left} {right}");
        assert_eq!(
            progress.steer(&square, Pose::new(2500.0, 2000.0, 0.0)),
            [200, 200]
        );
    }
}
