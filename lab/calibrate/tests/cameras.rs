//! Cameras whose matrix is known: it is found again, with noise as well as statistics allow, and never from poses
//! that do not determine it.

use mom_calibrate::experiment::LAB_X;
use mom_calibrate::{CalibrationError, Observation, Projection, calibrate, dlt, poses};
use proptest::prelude::*;

const RADIUS: f64 = 12.0;

/// A camera at this place that looks at this one, with a focal length in pixels and any middle of the image.
fn camera(at: [f64; 3], target: [f64; 3], focal: f64, middle: [f64; 2]) -> Projection {
    let minus = |a: [f64; 3], b: [f64; 3]| std::array::from_fn::<f64, 3, _>(|i| a[i] - b[i]);
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    };
    let unit = |a: [f64; 3]| a.map(|part| part / dot(a, a).sqrt());
    let forward = unit(minus(target, at));
    let right = unit(cross(forward, [0.0, 0.0, 1.0]));
    let down = cross(forward, right);
    let row = |direction: [f64; 3]| [direction[0], direction[1], direction[2], -dot(direction, at)];
    let (x, y, z) = (row(right), row(down), row(forward));
    let mixed = |a: [f64; 4], part: f64| std::array::from_fn::<f64, 4, _>(|i| focal * a[i] + part * z[i]);
    let rows = [mixed(x, middle[0]), mixed(y, middle[1]), z].concat();
    Projection::new(rows.try_into().expect("twelve")).expect("a camera")
}

fn any_camera() -> impl Strategy<Value = Projection> {
    let angle = 0.0..std::f64::consts::TAU;
    let target = [-80.0..80.0, -80.0..80.0, 150.0..300.0];
    (
        angle,
        1300.0..3000.0,
        200.0..1800.0,
        target,
        400.0..1500.0,
        [250.0..390.0, 180.0..300.0],
    )
        .prop_map(|(angle, away, height, target, focal, middle)| {
            let at = [f64::cos(angle) * away, f64::sin(angle) * away, height];
            camera(at, target, focal, middle)
        })
}

fn observe(camera: &Projection, worlds: impl IntoIterator<Item = [f64; 3]>) -> Vec<Observation> {
    let see = |world| Observation {
        world,
        pixel: camera.project_ball(world, RADIUS).expect("in front"),
    };
    worlds.into_iter().map(see).collect()
}

fn places(count: usize, seed: u64) -> Vec<[f64; 3]> {
    let poses = poses::spread(count, seed);
    poses
        .iter()
        .map(|pose| pose.place(mom_calibrate::MARKER))
        .collect()
}

/// The largest distance between the pixels of two cameras, all over the workspace.
fn apart(a: &Projection, b: &Projection) -> f64 {
    distances(a, b).into_iter().fold(0.0, f64::max)
}

fn distances(a: &Projection, b: &Projection) -> Vec<f64> {
    let steps = || [-1.0, -0.5, 0.0, 0.5, 1.0].into_iter();
    let points = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
    let distance = |[x, y, z]: [f64; 3]| {
        let point = [300.0 * x, 300.0 * y, 225.0 + 225.0 * z];
        let (p, q) = (a.project(point).expect("seen"), b.project(point).expect("seen"));
        (p[0] - q[0]).hypot(p[1] - q[1])
    };
    points.map(distance).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn any_camera_is_found_exactly_without_noise(camera in any_camera(), count in 6_usize..40, seed in 0_u64..1000) {
        let found = calibrate(&observe(&camera, places(count, seed)), RADIUS).expect("determined");
        prop_assert!(apart(&camera, &found.projection) < 1e-6, "{}", apart(&camera, &found.projection));
        prop_assert_eq!(found.used(), count);
        prop_assert!(found.rms <= found.max && found.max < 1e-6);
    }

    /// Up to a fifth of measurements that are wrong by far are left out, and nothing else is.
    #[test]
    fn wrong_measurements_are_left_out(
        camera in any_camera(),
        count in 12_usize..40,
        seed in 0_u64..1000,
        wrong in prop::collection::vec((0_usize..40, 5.0..200.0, 0.0..6.2), 1..3),
    ) {
        let mut observations = observe(&camera, places(count, seed));
        let mut spoiled = vec![false; count];
        for (index, far, way) in wrong {
            let (index, (sin, cos)) = (index % count, f64::sin_cos(way));
            if !std::mem::replace(&mut spoiled[index], true) {
                observations[index].pixel[0] += far * cos;
                observations[index].pixel[1] += far * sin;
            }
        }
        let found = calibrate(&observations, RADIUS).expect("determined");
        let out: Vec<bool> = found.residuals.iter().map(|residual| !residual.used).collect();
        prop_assert_eq!(out, spoiled);
        prop_assert!(apart(&camera, &found.projection) < 1e-6);
    }

    /// Whatever is measured, there is an answer, and what is called a camera has every place that it used in front of it.
    #[test]
    fn nonsense_is_answered(numbers in prop::collection::vec(prop::array::uniform5(-500.0..500.0_f64), 0..25)) {
        let observations: Vec<Observation> = numbers
            .iter()
            .map(|n| Observation { world: [n[0], n[1], n[2]], pixel: [n[3], n[4]] })
            .collect();
        if let Ok(found) = calibrate(&observations, RADIUS) {
            let used = found.residuals.iter().filter(|residual| residual.used);
            prop_assert!(used.clone().count() >= 6);
            for residual in used {
                prop_assert!(found.projection.depth(residual.observation.world) > 0.0);
                prop_assert!(residual.length().is_finite());
            }
        }
    }
}

/// Calibrates the lab's camera where each place of the marker is measured with an error of this deviation, pixels, and
/// says how far off the result is all over the workspace.
fn error_of(poses: usize, noise: f64, seed: u64) -> f64 {
    let camera = Projection::new(LAB_X).expect("a camera");
    let mut random = fastrand::Rng::with_seed(seed);
    let mut observations = observe(&camera, places(poses, seed));
    for pixel in observations.iter_mut().flat_map(|seen| &mut seen.pixel) {
        // Uniform within √3 deviations.
        *pixel += noise * 3_f64.sqrt() * (2.0 * random.f64() - 1.0);
    }
    let found = calibrate(&observations, RADIUS).expect("determined");
    let distances = distances(&camera, &found.projection);
    let squares: f64 = distances.iter().map(|distance| distance * distance).sum();
    (squares / distances.len() as f64).sqrt()
}

/// With noise the error is of the noise's size, falls with the number of poses, and grows in proportion.
#[test]
fn errors_follow_noise_and_the_number_of_poses() {
    let median = |poses: usize, noise: f64| {
        let mut errors: Vec<f64> = (1..=101).map(|seed| error_of(poses, noise, seed)).collect();
        errors.sort_by(f64::total_cmp);
        errors[50]
    };
    let (few, many) = (median(12, 0.5), median(48, 0.5));
    assert!((2.0..4.0).contains(&(few / many)), "12 poses: {few}, 48: {many}");
    let usual = median(20, 0.5);
    assert!((0.4..1.0).contains(&usual), "{usual}");
    let (small, large) = (median(20, 0.25), median(20, 1.0));
    assert!((3.5..4.5).contains(&(large / small)), "{small} {large}");
    assert!(median(20, 0.0) < 1e-6);
}

/// The model of a ball's outline matters little: without it the matrix takes up nearly all of the difference.
#[test]
fn a_ball_is_no_point() {
    let camera = Projection::new(LAB_X).expect("a camera");
    let observations = observe(&camera, places(20, 0));
    let as_ball = calibrate(&observations, RADIUS).expect("determined");
    let as_point = calibrate(&observations, 0.0).expect("determined");
    assert!(as_ball.max < 1e-7, "{}", as_ball.max);
    assert!((1e-6..1e-3).contains(&as_point.max), "{}", as_point.max);
    let wrong = apart(&camera, &as_point.projection);
    assert!((1e-3..0.05).contains(&wrong), "{wrong}");
}

#[test]
fn poses_that_determine_no_camera_are_refused_with_the_reason() {
    let camera = Projection::new(LAB_X).expect("a camera");
    let refused =
        |worlds: Vec<[f64; 3]>| calibrate(&observe(&camera, worlds), RADIUS).expect_err("no camera");
    assert_eq!(
        refused(places(5, 0)),
        CalibrationError::TooFew { found: 5, least: 6 }
    );
    // In one plane, and in one that is two mm thick.
    for thick in [0.0, 2.0] {
        let level = places(20, 0)
            .into_iter()
            .enumerate()
            .map(|(i, [x, y, _])| [x, y, 200.0 + thick * (i % 2) as f64]);
        match refused(level.collect()) {
            CalibrationError::Flat { ratio, least } => assert!(ratio < least && least == dlt::FLAT),
            other => panic!("{other}"),
        }
    }
    // On a line; all in one place.
    for step in [10.0, 0.0] {
        let line = (0..10)
            .map(|i| [step * f64::from(i), 0.0, 200.0 + step * f64::from(i)])
            .collect();
        assert!(matches!(refused(line), CalibrationError::Flat { .. }));
    }
    // On a twisted cubic through the camera, every place fits infinitely many cameras; likewise where most are in a plane
    // and the others on one line of sight.
    let [x, y, z] = [1600.0, 0.0, 760.0];
    let mut worlds: Vec<[f64; 3]> = places(12, 0).into_iter().map(|[x, y, _]| [x, y, 100.0]).collect();
    worlds.extend((1..8).map(|i| {
        let part = 0.05 * f64::from(i);
        [
            (1.0 - part) * 50.0 + part * x,
            part * y,
            (1.0 - part) * 250.0 + part * z,
        ]
    }));
    let reason = refused(worlds);
    assert!(matches!(reason, CalibrationError::Ambiguous { .. }), "{reason}");
    assert!(reason.hint().contains("differ in all three directions"));
}

#[test]
fn a_mirror_and_a_muddle_are_no_cameras() {
    let camera = Projection::new(LAB_X).expect("a camera");
    let mut mirrored = observe(&camera, places(20, 0));
    for seen in &mut mirrored {
        seen.pixel[0] = 640.0 - seen.pixel[0];
    }
    let refused = calibrate(&mirrored, RADIUS).expect_err("a mirror");
    assert!(matches!(refused, CalibrationError::NoCamera(_)), "{refused}");
    let mut muddled = observe(&camera, places(20, 0));
    for i in 0..10 {
        let other = muddled[19 - i].pixel;
        muddled[19 - i].pixel = muddled[i].pixel;
        muddled[i].pixel = other;
    }
    match calibrate(&muddled, RADIUS) {
        // Least squares finds something that is near to nothing.
        Ok(found) => assert!(found.rms > 20.0, "{}", found.rms),
        Err(error) => assert!(!error.hint().is_empty()),
    }
}
