//! The marker in the cameras' images: where the matrix says, to a small part of a pixel, and seen in most poses (M55).

use mom_calibrate::marker::{MarkerError, find};
use mom_calibrate::{COLOUR, Observation, Picture, Projection, RADIUS, calibrate, poses};
use mom_camera::{
    CameraSettings, Colour, DrawnBlock, DrawnPose, Format, MARKER, MARKER_COLOUR, MARKER_RADIUS, Renderer,
    Scene, View,
};
use mom_drive::Pose;

fn renderer(view: View, width: u32, height: u32) -> Renderer {
    let settings = CameraSettings {
        width,
        height,
        format: Format::Png,
        ..CameraSettings::default()
    };
    Renderer::new(view, settings).expect("within the limits")
}

/// With blocks of every colour that has a name.
fn scene(pose: &Pose) -> Scene {
    let colours = [
        "red", "blue", "yellow", "green", "purple", "pink", "wood", "white",
    ];
    let block = |(i, name): (usize, &&str)| DrawnBlock {
        x: 80.0 * i as f64 - 280.0,
        y: if i % 2 == 0 { 120.0 } else { -150.0 },
        colour: Colour::from_name(name),
        ..DrawnBlock::default()
    };
    Scene {
        pose: DrawnPose {
            x: pose.x,
            y: pose.y,
            z: pose.z,
            spin: pose.spin,
            tilt: pose.tilt,
        },
        blocks: colours.iter().enumerate().map(block).collect(),
        ..Scene::default()
    }
}

/// What the camera's own calibrator knows without asking it.
#[test]
fn the_calibrators_marker_is_the_cameras() {
    assert_eq!((MARKER, MARKER_RADIUS), (mom_calibrate::MARKER, RADIUS));
    assert_eq!(MARKER_COLOUR, Colour(COLOUR));
}

#[test]
fn the_marker_is_where_the_matrix_says() {
    for (view, width, height) in [
        (View::X, 640, 480),
        (View::Y, 640, 480),
        (View::Top, 640, 480),
        (View::X, 1280, 720),
    ] {
        let renderer = renderer(view, width, height);
        let (mut observations, mut matrix) = (Vec::new(), None);
        for pose in poses::spread(30, 0) {
            let image = renderer.render(&scene(&pose));
            let picture = Picture::decode(&image.bytes).expect("a PNG");
            let truth = Projection::new(image.matrix).expect("a camera");
            let world = pose.place(MARKER);
            matrix = Some(truth);
            match find(&picture, COLOUR) {
                Ok(spot) => observations.push(Observation {
                    world,
                    pixel: spot.middle,
                }),
                Err(MarkerError::Hidden | MarkerError::NotSeen) => {}
                Err(error) => panic!("{view} {width}: {pose:?}: {error}"),
            }
        }
        assert!(
            observations.len() >= 25,
            "{view}: seen in {} of 30",
            observations.len()
        );
        let truth = matrix.expect("many poses");
        let off = |seen: &Observation| {
            let [u, v] = truth.project_ball(seen.world, RADIUS).expect("in front");
            (seen.pixel[0] - u).hypot(seen.pixel[1] - v)
        };
        let mut offs: Vec<f64> = observations.iter().map(off).collect();
        offs.sort_by(f64::total_cmp);
        let count = offs.len();
        // Where an edge of what is behind runs along the rim, or a little is hidden, it is worse.
        assert!(
            offs[count / 2] < 0.03 && offs[count - 1] < 2.0,
            "{view} {width}: {offs:?}"
        );
        let found = calibrate(&observations, RADIUS).expect("a camera");
        assert!(found.rms < 0.06, "{view} {width}: {}", found.rms);
        assert!(found.outliers() <= 4, "{view} {width}: {}", found.outliers());
        let points = [
            [-300.0, -300.0, 0.0],
            [300.0, 300.0, 0.0],
            [300.0, -300.0, 450.0],
            [0.0, 0.0, 225.0],
        ];
        for point in points {
            let (a, b) = (
                truth.project(point).expect("seen"),
                found.projection.project(point).expect("seen"),
            );
            let apart = (a[0] - b[0]).hypot(a[1] - b[1]);
            assert!(apart < 0.5, "{view} {width}: {apart} pixels at {point:?}");
        }
    }
}
