//! The hand in the images: where its marker is by now, and how far off the cameras' matrices are.
//!
//! The interaction matrix of a camera (how a motion of the hand moves the marker in its image) follows from the
//! image's matrix. That may be some degrees wrong, so it is corrected by what the hand's own motions do in the images.
//! Broyden's update does so by one secant after the other, for one place only; here the least squares of all recent
//! secants gives a small rotation of each camera, which holds everywhere in its image. The same fit gives the time from a
//! command to its effect.

use std::collections::VecDeque;

use mom_vision::Projection;
use mom_vision::marker::MARKER;
use nalgebra::{DMatrix, DVector, Matrix3x4, Rotation3, Vector3};

use crate::Micros;
use crate::motion::{Motion, Travel};

/// Where the tip is taken to be before any picture, mm.
const UNSEEN: Vector3<f64> = Vector3::new(0.0, 0.0, 250.0);
/// Deviation of a camera's rotation that is expected, radians: two degrees.
const TURN: f64 = 0.035;
/// The same after another fit has told it.
const TURN_KNOWN: f64 = 0.005;
/// The delay of commands that is expected, s, and its deviation.
const DELAY: [f64; 2] = [0.2, 0.4];
/// The longest that is believed, s.
const MOST_DELAY: f64 = 3.0;
/// A camera that is turned by more was not put up so, degrees: the times are wrong.
const MOST_TURN: f64 = 8.0;
/// What a fit leaves at most where the estimate is right, pixels.
const FITS: f64 = 4.0;
/// Of the marker's place in an image, pixels.
const NOISE: f64 = 0.3;
/// Pixels that a mm is wide, about.
const SCALE: f64 = 0.5;
/// Further off, in deviations, a measurement counts less.
const HUBER: f64 = 3.0;
/// Measurements of each camera that are kept.
const KEPT: usize = 40;

/// How regular the way of images and commands is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Deviation of an image's time, s: a hand that moves is elsewhere.
    pub time: f64,
    /// Deviation that a command adds to where the hand is, mm: it is begun, or replaced, a little sooner or later.
    pub command: f64,
}

impl Default for Noise {
    /// Hardly any.
    fn default() -> Noise {
        Noise {
            time: 0.02,
            command: 0.0,
        }
    }
}

/// The cameras' eyes on the hand.
#[derive(Debug, Clone)]
pub struct Track {
    cameras: Vec<TrackedCamera>,
    observations: VecDeque<Observation>,
    /// Where the tip was when nothing had been commanded, mm, as the cameras have it together.
    base: Vector3<f64>,
    /// Spin and tilt then, degrees.
    turned: [f64; 2],
    /// From a command to its effect in the images, s, its deviation, and what it was expected to be.
    delay: f64,
    delay_error: f64,
    expected: [f64; 2],
    /// No effect comes sooner, s.
    least: f64,
    noise: Noise,
    /// Commands until now.
    commands: u32,
    /// Root of the mean square of what the fit leaves, pixels.
    rms: f64,
}

#[derive(Debug, Clone)]
struct TrackedCamera {
    nominal: Projection,
    /// The correction, a rotation vector in the world's axes about the camera's middle.
    turn: Vector3<f64>,
    /// What it was before the measurements, and its deviation.
    before: (Vector3<f64>, f64),
    corrected: Projection,
    newest: Option<Observation>,
}

/// The marker in an image.
#[derive(Debug, Clone, Copy)]
struct Observation {
    camera: usize,
    taken: Micros,
    /// When the hand was there.
    shows: Micros,
    pixel: [f64; 2],
    /// Commands until then.
    commands: u32,
}

impl Track {
    /// Nothing seen yet; spin and tilt of the hand cannot be seen and are told.
    #[must_use]
    pub fn new(turned: [f64; 2]) -> Track {
        Track {
            cameras: Vec::new(),
            observations: VecDeque::new(),
            base: UNSEEN,
            turned,
            delay: DELAY[0],
            delay_error: DELAY[1],
            expected: DELAY,
            least: 0.0,
            noise: Noise::default(),
            commands: 0,
            rms: 0.0,
        }
    }

    /// Expects this noise.
    pub fn expect(&mut self, noise: Noise) {
        self.noise = noise;
    }

    /// No command has its effect sooner than this after it is sent, µs.
    pub fn no_sooner_than(&mut self, least: Micros) {
        self.least = (least.max(0) as f64 / 1e6).min(MOST_DELAY);
        self.delay = self.delay.max(self.least);
    }

    /// The estimate that cannot be, in words, if there is one: the delay before the cameras, whose turns follow from it.
    #[must_use]
    pub fn absurd(&self) -> Option<String> {
        if !self.delay.is_finite() || self.delay >= MOST_DELAY {
            return Some(format!(
                "the command delay is {:.1} s; the limit is {MOST_DELAY:.1} s",
                self.delay
            ));
        }
        let turns = self.corrections();
        let (camera, turn) = turns.iter().enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b))?;
        // No number is not an estimate, either.
        let sane = *turn <= MOST_TURN && self.base.iter().all(|part| part.is_finite());
        (!sane).then(|| {
            format!(
                "camera {} would be turned by {turn:.0} degrees, {MOST_TURN:.0} are the limit, with commands that take {:.1} s ± {:.1} s",
                camera + 1,
                self.delay,
                self.delay_error
            )
        })
    }

    /// Whether what two cameras or more have seen, of a hand that has moved in between, fits the estimate.
    #[must_use]
    pub fn fits(&self) -> bool {
        let tells = |camera: usize| {
            let mut commands = self
                .observations
                .iter()
                .filter(|one| one.camera == camera)
                .map(|one| one.commands);
            let first = commands.next();
            commands.any(|other| Some(other) != first)
        };
        let cameras = (0..self.cameras.len()).filter(|camera| tells(*camera)).count();
        cameras >= self.cameras.len().min(2) && self.rms < FITS
    }

    /// Another command was sent.
    pub fn count(&mut self, commands: u32) {
        self.commands = commands;
    }

    /// An image of this camera has come, with its matrix.
    pub fn meet(&mut self, camera: usize, projection: &Projection) {
        while self.cameras.len() <= camera {
            self.cameras.push(TrackedCamera::new(*projection));
        }
        // A new size, or a calibration meanwhile.
        if self.cameras[camera].nominal != *projection {
            self.cameras[camera] = TrackedCamera::new(*projection);
            self.observations.retain(|one| one.camera != camera);
        }
    }

    /// The marker was seen in an image that was taken, and shows the hand, at these times.
    pub fn see(&mut self, camera: usize, [taken, shows]: [Micros; 2], pixel: [f64; 2], motion: &Motion) {
        let Some(tracked) = self.cameras.get_mut(camera) else {
            return;
        };
        let observation = Observation {
            camera,
            taken,
            shows,
            pixel,
            commands: self.commands,
        };
        tracked.newest = Some(observation);
        let of_camera: Vec<usize> = (0..self.observations.len())
            .filter(|&i| self.observations[i].camera == camera)
            .collect();
        let at = |shows: Micros| motion.at(shows - self.delay_micros());
        if let [.., before, last] = of_camera[..] {
            let rests = |i: usize| {
                let (then, now) = (at(self.observations[i].shows), at(shows));
                (0..5).all(|k| (then[k] - now[k]).abs() < 0.5)
            };
            // A hand that rests tells the same again.
            if rests(before) && rests(last) {
                self.observations[last] = observation;
                return;
            }
        }
        if of_camera.len() >= KEPT {
            self.observations.remove(of_camera[0]);
        }
        self.observations.push_back(observation);
    }

    /// The newest image of the marker: the camera's time.
    #[must_use]
    pub fn seen(&self, camera: usize) -> Option<Micros> {
        let camera = self.cameras.get(camera)?;
        camera.newest.map(|newest| newest.taken)
    }

    /// Whether a camera has seen the marker; with a time, whether it has seen it since then, and at rest.
    #[must_use]
    pub fn has_seen(&self, camera: usize, since: Option<Micros>, motion: &Motion) -> bool {
        let newest = self.cameras.get(camera).and_then(|camera| camera.newest);
        let (Some(newest), Some(since)) = (newest, since) else {
            return newest.is_some();
        };
        let (_, end) = motion.end();
        let then = motion.at(newest.shows - self.delay_micros() + self.delay_error_micros().min(20_000));
        newest.taken >= since && (0..5).all(|i| (then[i] - end[i]).abs() < 1.0)
    }

    /// A camera's matrix, corrected.
    #[must_use]
    pub fn projection(&self, camera: usize) -> Option<&Projection> {
        self.cameras.get(camera).map(|camera| &camera.corrected)
    }

    /// How many cameras there are.
    #[must_use]
    pub fn cameras(&self) -> usize {
        self.cameras.len()
    }

    /// By how many degrees each camera is corrected.
    #[must_use]
    pub fn corrections(&self) -> Vec<f64> {
        let degrees = |camera: &TrackedCamera| camera.turn.norm().to_degrees();
        self.cameras.iter().map(degrees).collect()
    }

    /// From a command to its effect in the images, µs.
    #[must_use]
    pub fn delay_micros(&self) -> Micros {
        (self.delay * 1e6) as Micros
    }

    /// How well that is known, µs.
    #[must_use]
    pub fn delay_error_micros(&self) -> Micros {
        (self.delay_error * 1e6) as Micros
    }

    /// What the fit leaves, pixels.
    #[must_use]
    pub fn rms(&self) -> f64 {
        self.rms
    }

    /// The tip after so much travel, as the cameras have it together.
    #[must_use]
    pub fn tip(&self, travel: &Travel) -> [f64; 3] {
        [
            self.base.x + travel[0],
            self.base.y + travel[1],
            self.base.z + travel[2],
        ]
    }

    /// Spin after so much travel, degrees.
    #[must_use]
    pub fn spin(&self, travel: &Travel) -> f64 {
        self.turned[0] + travel[3]
    }

    /// Tilt after so much travel, degrees.
    #[must_use]
    pub fn tilt(&self, travel: &Travel) -> f64 {
        self.turned[1] + travel[4]
    }

    /// From the tip to the marker, mm.
    #[must_use]
    pub fn reach(&self, travel: &Travel) -> Vector3<f64> {
        marker(self.spin(travel), self.tilt(travel))
    }

    fn marker(&self, travel: &Travel) -> [f64; 3] {
        (Vector3::from(self.tip(travel)) + self.reach(travel)).into()
    }

    /// The marker's place in a camera's image when the hand has travelled so far: where it was seen, moved by what has been commanded
    /// since (Smith's predictor).
    #[must_use]
    pub fn predict(&self, camera: usize, travel: &Travel, motion: &Motion) -> Option<[f64; 2]> {
        let tracked = self.cameras.get(camera)?;
        let seen = tracked.newest?;
        let then = motion.at(seen.shows - self.delay_micros());
        let before = tracked.corrected.project(self.marker(&then))?;
        let after = tracked.corrected.project(self.marker(travel))?;
        Some([0, 1].map(|i| seen.pixel[i] + after[i] - before[i]))
    }

    /// The hand is not where the commands lead: it was stopped, or met something. What the cameras told of themselves is kept.
    pub fn lose_count(&mut self) {
        self.observations.clear();
        for camera in &mut self.cameras {
            camera.before = (camera.turn, TURN_KNOWN);
            camera.newest = None;
        }
        self.expected = [self.delay, self.delay_error.max(0.02)];
    }

    /// Nothing fits any more: all but the newest images and the delay is forgotten.
    pub fn forget(&mut self) {
        self.observations.clear();
        for camera in &mut self.cameras {
            *camera = TrackedCamera {
                newest: camera.newest,
                ..TrackedCamera::new(camera.nominal)
            };
            self.observations.extend(camera.newest);
        }
        self.expected = [self.delay, DELAY[1]];
    }

    /// The times were wrong, and with them all that was learnt by them: the delay is measured anew, from pictures that are still to come.
    pub fn forget_times(&mut self) {
        self.forget();
        self.observations.clear();
        for camera in &mut self.cameras {
            // Of a hand that moved, this one would be off by as much as the times were.
            camera.newest = None;
        }
        if !self.base.iter().all(|part| part.is_finite()) {
            self.base = UNSEEN;
        }
        (self.delay, self.delay_error) = (DELAY[0].max(self.least), DELAY[1]);
        self.expected = [self.delay, DELAY[1]];
        self.rms = 0.0;
    }

    /// Fits hand, cameras and delay to what has been seen.
    pub fn fit(&mut self, motion: &Motion) {
        let unknowns = 4 + 3 * self.cameras.len();
        if self.observations.is_empty() {
            return;
        }
        for _ in 0..4 {
            let now = self.unknowns();
            let (normal, right) = self.equations(&now, motion);
            let Some(step) = normal.cholesky().map(|root| root.solve(&right)) else {
                return;
            };
            let mut next = now - &step;
            next[unknowns - 1] = next[unknowns - 1].clamp(self.least, MOST_DELAY);
            self.set(&next);
            if step.amax() < 1e-5 {
                break;
            }
        }
        let now = self.unknowns();
        let (normal, _) = self.equations(&now, motion);
        if let Some(spread) = normal.try_inverse() {
            self.delay_error = spread[(unknowns - 1, unknowns - 1)].max(0.0).sqrt();
        }
        let off: Vec<f64> = self
            .observations
            .iter()
            .filter_map(|one| self.off(one, &now, motion))
            .map(|off| off[0].powi(2) + off[1].powi(2))
            .collect();
        self.rms = (off.iter().sum::<f64>() / off.len().max(1) as f64).sqrt();
    }

    /// Base in mm, the turns in radians, the delay in s.
    fn unknowns(&self) -> DVector<f64> {
        let turns = self.cameras.iter().flat_map(|camera| camera.turn.iter().copied());
        let all = self.base.iter().copied().chain(turns).chain([self.delay]);
        DVector::from_iterator(4 + 3 * self.cameras.len(), all)
    }

    fn set(&mut self, unknowns: &DVector<f64>) {
        self.base = Vector3::new(unknowns[0], unknowns[1], unknowns[2]);
        for (i, camera) in self.cameras.iter_mut().enumerate() {
            camera.turn = Vector3::new(unknowns[3 + 3 * i], unknowns[4 + 3 * i], unknowns[5 + 3 * i]);
            camera.corrected = turned(&camera.nominal, &camera.turn).unwrap_or(camera.nominal);
        }
        self.delay = unknowns[unknowns.len() - 1];
    }

    /// How far a measurement is from what these unknowns expect, pixels.
    fn off(&self, one: &Observation, unknowns: &DVector<f64>, motion: &Motion) -> Option<[f64; 2]> {
        let camera = &self.cameras[one.camera];
        let at = 3 + 3 * one.camera;
        let turn = Vector3::new(unknowns[at], unknowns[at + 1], unknowns[at + 2]);
        let delay = (unknowns[unknowns.len() - 1] * 1e6) as Micros;
        let travel = motion.at(one.shows - delay);
        let tip = Vector3::new(
            unknowns[0] + travel[0],
            unknowns[1] + travel[1],
            unknowns[2] + travel[2],
        );
        let expected = turned(&camera.nominal, &turn)?.project((tip + self.reach(&travel)).into())?;
        Some([one.pixel[0] - expected[0], one.pixel[1] - expected[1]])
    }

    /// The normal equations of a step: the matrix, and the gradient.
    fn equations(&self, now: &DVector<f64>, motion: &Motion) -> (DMatrix<f64>, DVector<f64>) {
        let size = now.len();
        let (mut normal, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
        let prior = |i: usize| match i {
            0..3 => (now[i], 1000.0),
            i if i == size - 1 => (self.expected[0], self.expected[1]),
            i => {
                let (mean, deviation) = self.cameras[(i - 3) / 3].before;
                (mean[(i - 3) % 3], deviation)
            }
        };
        for i in 0..size {
            let (mean, deviation) = prior(i);
            normal[(i, i)] += deviation.powi(-2);
            right[i] += (now[i] - mean) / deviation.powi(2);
        }
        for one in &self.observations {
            let Some(off) = self.off(one, now, motion) else {
                continue;
            };
            // Only these unknowns matter to it.
            let own = [
                0,
                1,
                2,
                3 + 3 * one.camera,
                4 + 3 * one.camera,
                5 + 3 * one.camera,
                size - 1,
            ];
            let mut slopes = [[0.0; 2]; 7];
            for (slope, &i) in slopes.iter_mut().zip(&own) {
                let step = if i < 3 {
                    0.5
                } else if i == size - 1 {
                    0.01
                } else {
                    1e-4
                };
                let mut moved = now.clone();
                moved[i] += step;
                if let Some(other) = self.off(one, &moved, motion) {
                    *slope = [0, 1].map(|k| (other[k] - off[k]) / step);
                }
            }
            // While the hand moves, a time that is a little wrong is a place that is.
            let passing = slopes[6][0].hypot(slopes[6][1]) * self.noise.time;
            let since = f64::from(self.commands.saturating_sub(one.commands));
            let drifted = self.noise.command * SCALE * since.sqrt();
            let deviation = NOISE.hypot(passing).hypot(drifted);
            let far = off[0].hypot(off[1]) / deviation;
            let weight = (HUBER / far.max(HUBER)) / deviation.powi(2);
            for (a, &i) in slopes.iter().zip(&own) {
                right[i] += weight * (a[0] * off[0] + a[1] * off[1]);
                for (b, &k) in slopes.iter().zip(&own) {
                    normal[(i, k)] += weight * (a[0] * b[0] + a[1] * b[1]);
                }
            }
        }
        (normal, right)
    }
}

impl TrackedCamera {
    fn new(nominal: Projection) -> TrackedCamera {
        TrackedCamera {
            nominal,
            turn: Vector3::zeros(),
            before: (Vector3::zeros(), TURN),
            corrected: nominal,
            newest: None,
        }
    }
}

/// From the tip to the marker, mm, in a hand with this spin and tilt in degrees.
#[must_use]
pub fn marker(spin: f64, tilt: f64) -> Vector3<f64> {
    let spin = Rotation3::from_axis_angle(&Vector3::z_axis(), spin.to_radians());
    let tilt = Rotation3::from_axis_angle(&Vector3::x_axis(), tilt.to_radians());
    spin * tilt * Vector3::from(MARKER)
}

/// The camera turned about its own middle by a rotation vector in the world's axes.
#[must_use]
pub fn turned(projection: &Projection, turn: &Vector3<f64>) -> Option<Projection> {
    let matrix = Matrix3x4::from_row_slice(&projection.numbers());
    let left = matrix.fixed_columns::<3>(0).into_owned();
    let middle = -(left.try_inverse()? * matrix.column(3));
    let left = left * Rotation3::new(*turn).matrix();
    let last = -(left * middle);
    let mut moved = Matrix3x4::zeros();
    moved.fixed_columns_mut::<3>(0).copy_from(&left);
    moved.set_column(3, &last);
    Projection::of(moved)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_learnt_by_wrong_times_is_forgotten_with_them() {
        let mut track = Track::new([0.0; 2]);
        let above = [
            500.0, 0.0, -320.0, 320_000.0, 0.0, -500.0, -240.0, 240_000.0, 0.0, 0.0, -1.0, 1000.0,
        ];
        track.meet(0, &Projection::new(above).unwrap());
        track.no_sooner_than(300_000);
        track.see(0, [1_000_000; 2], [320.0, 240.0], &Motion::new(0));
        (track.delay, track.delay_error) = (MOST_DELAY, 0.001);
        track.cameras[0].turn = Vector3::new(0.4, 0.0, 0.0);
        let why = track.absurd().unwrap();
        assert!(
            why.starts_with("the command delay is 3.0 s"),
            "the delay is blamed first: {why}"
        );
        track.delay = 0.4;
        let why = track.absurd().unwrap();
        assert!(why.starts_with("camera 1 would be turned by 23 degrees"), "{why}");
        track.forget_times();
        assert_eq!(track.absurd(), None);
        assert_eq!(track.delay_micros(), 300_000, "no sooner than the arm begins");
        assert_eq!((track.seen(0), track.delay_error_micros()), (None, 400_000));
        assert!(!track.fits(), "nothing was seen since");
    }
}
