//! The last poses of the gripper, for the path in the image (M44).

use std::collections::VecDeque;

use crate::DrawnPose;

/// mm that the gripper moves between two poses of the trail, so that slow motion does not shorten it.
const APART: f64 = 5.0;

/// The last poses, oldest first, at most so many.
#[derive(Debug, Clone)]
pub(crate) struct Trail {
    poses: VecDeque<DrawnPose>,
    most: usize,
}

impl Trail {
    pub(crate) fn new(most: usize) -> Self {
        Self {
            poses: VecDeque::new(),
            most,
        }
    }

    /// Takes the pose of a new state.
    pub(crate) fn push(&mut self, pose: DrawnPose) {
        if self
            .poses
            .back()
            .is_some_and(|last| distance(last, &pose) < APART)
        {
            return;
        }
        self.poses.push_back(pose);
        while self.poses.len() > self.most {
            self.poses.pop_front();
        }
    }

    /// The path that ends at the gripper.
    pub(crate) fn up_to(&self, now: DrawnPose) -> Vec<DrawnPose> {
        if self.most == 0 {
            return Vec::new();
        }
        let here = self.poses.back().is_some_and(|last| distance(last, &now) == 0.0);
        let end = if here { None } else { Some(now) };
        self.poses.iter().copied().chain(end).collect()
    }
}

fn distance(a: &DrawnPose, b: &DrawnPose) -> f64 {
    (a.x - b.x).hypot(a.y - b.y).hypot(a.z - b.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64) -> DrawnPose {
        DrawnPose {
            x,
            ..DrawnPose::default()
        }
    }

    fn check(most: usize, pushed: &[f64], now: f64, expected: &[f64]) {
        let mut trail = Trail::new(most);
        pushed.iter().for_each(|x| trail.push(at(*x)));
        let got: Vec<f64> = trail.up_to(at(now)).iter().map(|pose| pose.x).collect();
        assert_eq!(got, expected, "{pushed:?} to {now}");
    }

    #[test]
    fn the_last_poses_are_kept_apart() {
        check(9, &[], 1.0, &[1.0]);
        check(9, &[0.0, 4.9, 5.0, 7.0], 7.0, &[0.0, 5.0, 7.0]);
        check(9, &[0.0, 5.0], 5.0, &[0.0, 5.0]);
        check(2, &[0.0, 10.0, 20.0, 30.0], 30.0, &[20.0, 30.0]);
        check(0, &[0.0, 10.0], 20.0, &[]);
    }
}
