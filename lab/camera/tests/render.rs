//! Pictures of known scenes: what is where, whether it moves, and that nothing can break the camera.

use image::{DynamicImage, ImageFormat, Rgb};
use mom_camera::{
    Camera, CameraSettings, Colour, DrawnBlock, DrawnGripper, DrawnPose, Format, Image, Renderer, Scene, View,
};
use proptest::collection::vec;
use proptest::num::f64;
use proptest::prelude::*;

const PNG: CameraSettings = CameraSettings {
    width: 640,
    height: 480,
    quality: 80,
    format: Format::Png,
    overlay: false,
};

fn render(view: View, settings: CameraSettings, scene: &Scene) -> Image {
    Renderer::new(view, settings)
        .expect("the tests' settings are within the limits")
        .render(scene)
}

fn decode(image: &Image) -> DynamicImage {
    let format = ImageFormat::from_mime_type(image.media_type).expect("the media type is known");
    image::load_from_memory_with_format(&image.bytes, format).expect("the file is of its media type")
}

/// The pixel on which the image's own matrix puts a point.
fn pixel_of(image: &Image, point: [f64; 3]) -> (u32, u32) {
    let row = |i: usize| {
        let r = &image.matrix[4 * i..4 * i + 4];
        r[0] * point[0] + r[1] * point[1] + r[2] * point[2] + r[3]
    };
    ((row(0) / row(2)).floor() as u32, (row(1) / row(2)).floor() as u32)
}

fn colour_at(image: &Image, point: [f64; 3]) -> Rgb<u8> {
    let (x, y) = pixel_of(image, point);
    *decode(image).to_rgb8().get_pixel(x, y)
}

/// The arm is at the far corner, out of the way of what is looked at.
fn with_block(x: f64, y: f64, colour: Colour) -> Scene {
    let block = DrawnBlock {
        x,
        y,
        z: 20.0,
        size: [40.0; 3],
        colour,
        ..DrawnBlock::default()
    };
    let pose = DrawnPose {
        x: -290.0,
        y: 290.0,
        ..DrawnPose::default()
    };
    Scene {
        pose,
        blocks: vec![block],
        ..Scene::default()
    }
}

const RED: Colour = Colour([214, 64, 56]);

#[test]
fn a_block_is_where_the_matrix_says() {
    let places = [
        (0.0, 0.0),
        (200.0, -150.0),
        (-120.0, -250.0),
        (280.0, 280.0),
        (260.0, -290.0),
    ];
    for (x, y) in places {
        let scene = with_block(x, y, RED);
        let empty = Scene {
            blocks: vec![],
            ..scene.clone()
        };
        let picture = render(View::Top, PNG, &scene);
        for (dx, dy) in [(0.0, 0.0), (15.0, 15.0), (-15.0, 15.0), (15.0, -15.0)] {
            let point = [x + dx, y + dy, 40.0];
            assert_eq!(colour_at(&picture, point).0, RED.0, "top view at {point:?}");
        }
        let beside = [x - 40.0, y - 5.0, 0.0];
        assert_ne!(colour_at(&picture, beside).0, RED.0, "top view at {beside:?}");
        for view in [View::X, View::Y] {
            let [r, g, b] = colour_at(&render(view, PNG, &scene), [x, y, 40.0]).0;
            assert!(
                r > 150 && g < 110 && b < 110,
                "{view} view at {x} {y}: {r} {g} {b}"
            );
            let [r, g, _] = colour_at(&render(view, PNG, &empty), [x, y, 40.0]).0;
            assert!(
                r.saturating_sub(g) < 60,
                "{view} view of the empty table at {x} {y}: {r} {g}"
            );
        }
    }
}

#[test]
fn a_moved_block_moves_in_the_picture() {
    for view in [View::X, View::Y, View::Top] {
        let (here, there) = ([-100.0, -60.0, 40.0], [150.0, 60.0, 40.0]);
        let before = render(view, PNG, &with_block(here[0], here[1], RED));
        let after = render(view, PNG, &with_block(there[0], there[1], RED));
        let reds = [&before, &after].map(|image| [here, there].map(|p| colour_at(image, p).0[1] < 110));
        assert_eq!(reds, [[true, false], [false, true]], "{view}");
        assert_eq!(before.matrix, after.matrix, "{view}");
    }
}

#[test]
fn a_block_is_turned_and_tilted() {
    let check = |size: [f64; 3], yaw, tilt, expected: [bool; 3]| {
        // Away from the table's red axis.
        let mut scene = with_block(150.0, -150.0, RED);
        let block = &mut scene.blocks[0];
        (block.size, block.yaw, block.tilt) = (size, yaw, tilt);
        let picture = render(View::Top, PNG, &scene);
        let places = [[230.0, -150.0, 20.0], [150.0, -70.0, 20.0], [207.0, -93.0, 20.0]];
        let got = places.map(|point| colour_at(&picture, point).0[1] < 110);
        assert_eq!(
            got, expected,
            "{size:?} yaw {yaw} tilt {tilt}: along x, along y, between"
        );
    };
    let (long, high) = ([200.0, 24.0, 24.0], [24.0, 24.0, 200.0]);
    check(long, 0.0, 0.0, [true, false, false]);
    check(long, 90.0, 0.0, [false, true, false]);
    check(long, 45.0, 0.0, [false, false, true]);
    check(high, 0.0, 90.0, [false, true, false]);
    check(high, -45.0, 90.0, [false, false, true]);
}

#[test]
fn shadows_lie_straight_below() {
    let brightness = |scene: &Scene, point| {
        let [r, g, b] = colour_at(&render(View::X, PNG, scene), point).0;
        u32::from(r) + u32::from(g) + u32::from(b)
    };
    let gripper = |x, y| Scene {
        pose: DrawnPose {
            x,
            y,
            ..DrawnPose::default()
        },
        ..Scene::default()
    };
    let (here, there) = ([166.0, -124.0, 0.0], [66.0, 176.0, 0.0]);
    // A little off the middle, where the spot under the tip is marked, and off the lines of the grid.
    for (pose, dark, light) in [((160.0, -130.0), here, there), ((60.0, 170.0), there, here)] {
        let scene = gripper(pose.0, pose.1);
        assert!(
            brightness(&scene, dark) + 90 < brightness(&scene, light),
            "gripper at {pose:?}"
        );
    }
    let mut scene = with_block(160.0, -130.0, RED);
    scene.blocks[0].z = 200.0;
    assert!(
        brightness(&scene, here) + 90 < brightness(&scene, there),
        "block in the air"
    );
}

#[test]
fn a_jpeg_has_the_colours_of_the_scene() {
    let settings = CameraSettings {
        format: Format::Jpeg,
        ..PNG
    };
    let got = colour_at(
        &render(View::Top, settings, &with_block(120.0, 60.0, RED)),
        [120.0, 60.0, 40.0],
    )
    .0;
    let near = got.iter().zip(RED.0).all(|(a, b)| a.abs_diff(b) < 12);
    assert!(near, "{got:?}");
}

#[test]
fn a_block_in_front_hides_the_one_behind() {
    let mut scene = with_block(100.0, 0.0, RED);
    let blue = Colour([20, 60, 220]);
    scene.blocks.push(DrawnBlock {
        x: -60.0,
        size: [40.0; 3],
        colour: blue,
        ..scene.blocks[0].clone()
    });
    scene.blocks[0].size = [40.0, 120.0, 200.0];
    scene.blocks[0].z = 100.0;
    for reverse in [false, true] {
        if reverse {
            scene.blocks.reverse();
        }
        let [r, _, b] = colour_at(&render(View::X, PNG, &scene), [-60.0, 0.0, 40.0]).0;
        assert!(r > b, "the far block shines through: {r} {b}");
        let side = render(View::Y, PNG, &scene);
        let [r, _, b] = colour_at(&side, [-60.0, 0.0, 40.0]).0;
        assert!(b > r, "the other block is seen from the side: {r} {b}");
    }
}

#[test]
fn the_gripper_is_seen_at_its_pose_and_opens() {
    let scene = |opening| Scene {
        pose: DrawnPose {
            x: 60.0,
            y: 0.0,
            z: 250.0,
            spin: 0.0,
            tilt: 0.0,
        },
        gripper: DrawnGripper { opening },
        ..Scene::default()
    };
    let dark = |opening, x: f64| {
        let image = render(View::Y, PNG, &scene(opening));
        colour_at(&image, [x, -8.0, 262.0]).0.iter().all(|c| *c < 90)
    };
    // The jaws close along x; a finger is 8 mm thick.
    for (opening, x, expected) in [
        (80.0, 60.0, false),
        (80.0, 60.0 - 44.0, true),
        (80.0, 60.0 + 44.0, true),
        (20.0, 60.0 + 14.0, true),
        (20.0, 60.0 + 44.0, false),
    ] {
        assert_eq!(dark(opening, x), expected, "opening {opening}, at {x}");
    }
}

#[test]
fn every_degree_of_freedom_is_seen() {
    let at = DrawnPose {
        x: 20.0,
        y: 10.0,
        z: 150.0,
        spin: 10.0,
        tilt: 5.0,
    };
    let poses = [
        DrawnPose { x: 60.0, ..at },
        DrawnPose { y: 60.0, ..at },
        DrawnPose { z: 220.0, ..at },
        DrawnPose { spin: 50.0, ..at },
        DrawnPose { tilt: -25.0, ..at },
    ];
    for view in View::ALL {
        let plain = Scene {
            blocks: with_block(40.0, 90.0, RED).blocks,
            pose: at,
            ..Scene::default()
        };
        let renderer = Renderer::new(view, PNG).unwrap();
        let picture = |scene: &Scene| renderer.render(scene).bytes;
        for pose in poses {
            let moved = Scene {
                pose,
                ..plain.clone()
            };
            assert_ne!(picture(&plain), picture(&moved), "{view} {pose:?}");
            let same_matrix = renderer.render(&plain).matrix == renderer.render(&moved).matrix;
            assert_eq!(same_matrix, view != View::Wrist, "{view} {pose:?}");
        }
        let trail = Scene {
            trail: vec![at, poses[1]],
            ..plain.clone()
        };
        assert_eq!(picture(&plain), picture(&trail), "{view} trail, beside the image");
        let overlay = CameraSettings { overlay: true, ..PNG };
        let drawn = [&plain, &trail].map(|scene| render(view, overlay, scene));
        assert_ne!(drawn[0].bytes, drawn[1].bytes, "{view} trail, in the image");
        assert_ne!(drawn[0].bytes, renderer.render(&plain).bytes, "{view} outlines");
        assert_eq!(renderer.render(&plain), renderer.render(&plain.clone()), "{view}");
    }
}

#[test]
fn the_views_look_as_they_are_called() {
    let pose = DrawnPose::default();
    let check = |view: View, point: [f64; 3], right: f64, down: f64| {
        let camera: Camera = view.camera(&pose, 640, 480);
        let [u0, v0] = camera.project([0.0, 0.0, 0.0]).unwrap();
        let [u, v] = camera.project(point).unwrap();
        let sign = |d: f64| if d.abs() < 1e-6 { 0.0 } else { d.signum() };
        assert_eq!([sign(u - u0), sign(v - v0)], [right, down], "{view} {point:?}");
    };
    let [x, y, z] = [[100.0, 0.0, 0.0], [0.0, 100.0, 0.0], [0.0, 0.0, 100.0]];
    check(View::X, x, 0.0, 1.0);
    check(View::X, y, 1.0, 0.0);
    check(View::X, z, 0.0, -1.0);
    check(View::Y, x, 1.0, 0.0);
    check(View::Y, y, 0.0, -1.0);
    check(View::Y, z, 0.0, -1.0);
    check(View::Top, x, 1.0, 0.0);
    check(View::Top, y, 0.0, -1.0);
    check(View::Top, z, 0.0, 0.0);
    check(View::Wrist, x, 0.0, -1.0);
    check(View::Wrist, y, -1.0, 0.0);
    for view in View::ALL {
        assert_eq!(view.name().parse(), Ok(view));
        assert_eq!(serde_json::to_string(&view).unwrap(), format!("\"{view}\""));
    }
    assert_eq!(
        "z".parse::<View>().unwrap_err().to_string(),
        "there is no view \"z\"; the views are x, y, top, wrist and pan"
    );
}

/// The camera on the forearm sees the gripper's tip and what lies below it, wherever the hand is (M50, M54).
#[test]
fn the_camera_on_the_third_joint_sees_the_tip() {
    for corner in 0..16 {
        let side = |bit: i32, low: f64, high: f64| if corner >> bit & 1 == 1 { high } else { low };
        let pose = DrawnPose {
            x: side(0, -280.0, 280.0),
            y: side(1, -280.0, 280.0),
            z: side(2, 20.0, 400.0),
            spin: side(3, 0.0, 60.0),
            tilt: 0.0,
        };
        let camera = View::Wrist.camera(&pose, 640, 480);
        for down in [0.0, 15.0] {
            let [u, v] = camera
                .project([pose.x, pose.y, pose.z - down])
                .expect("it is ahead");
            let inside = (0.0..640.0).contains(&u) && (0.0..480.0).contains(&v);
            assert!(inside, "{pose:?}: {u:.0} {v:.0}");
        }
    }
}

/// All of the workspace (M50) can be seen by the fixed cameras, whatever the shape of the image.
#[test]
fn the_fixed_cameras_see_the_workspace() {
    for (width, height) in [(640, 480), (64, 48), (1920, 1080), (64, 1080), (1920, 48)] {
        for view in [View::X, View::Y, View::Top] {
            let camera = view.camera(&DrawnPose::default(), width, height);
            for corner in 0..8 {
                let side = |bit: i32| if corner >> bit & 1 == 1 { 300.0 } else { -300.0 };
                let point = [side(0), side(1), if corner & 4 == 4 { 450.0 } else { 0.0 }];
                let [u, v] = camera.project(point).unwrap();
                let inside = (0.0..f64::from(width)).contains(&u) && (0.0..f64::from(height)).contains(&v);
                assert!(inside, "{view} {width}x{height} {point:?}: {u:.0} {v:.0}");
            }
        }
    }
}

#[test]
fn files_decode_to_the_stated_size() {
    for (width, height) in [
        (64, 48),
        (320, 240),
        (640, 480),
        (1920, 1080),
        (1920, 48),
        (64, 1080),
    ] {
        for format in [Format::Jpeg, Format::Png] {
            for view in [View::X, View::Wrist] {
                let settings = CameraSettings {
                    width,
                    height,
                    format,
                    quality: 60,
                    overlay: true,
                };
                let image = render(view, settings, &with_block(0.0, 0.0, RED));
                let decoded = decode(&image);
                assert_eq!(
                    (decoded.width(), decoded.height()),
                    (width, height),
                    "{settings:?}"
                );
                assert_eq!((image.width, image.height, image.format), (width, height, format));
            }
        }
    }
}

#[test]
fn quality_is_paid_in_bytes() {
    let size = |quality| {
        let settings = CameraSettings {
            quality,
            format: Format::Jpeg,
            ..PNG
        };
        render(View::X, settings, &with_block(0.0, 0.0, RED)).bytes.len()
    };
    let sizes = [1, 30, 80, 100].map(size);
    assert!(sizes.is_sorted() && sizes[3] > 3 * sizes[0], "{sizes:?}");
    assert!(Renderer::new(View::X, CameraSettings { quality: 0, ..PNG }).is_err());
}

#[test]
fn a_long_scene_costs_no_more_than_its_limits() {
    let mut scene = with_block(0.0, 0.0, RED);
    scene.blocks = (0..100_000)
        .map(|i| DrawnBlock {
            x: f64::from(i % 600 - 300),
            ..DrawnBlock::default()
        })
        .collect();
    let newest = vec![scene.pose; 200];
    scene.trail = [vec![DrawnPose::default(); 100_000], newest.clone()].concat();
    let short = Scene {
        trail: newest,
        blocks: scene.blocks[..64].to_vec(),
        ..scene.clone()
    };
    let small = CameraSettings {
        width: 64,
        height: 48,
        ..PNG
    };
    assert_eq!(render(View::X, small, &scene), render(View::X, small, &short));
}

fn any_pose() -> impl Strategy<Value = DrawnPose> {
    let number = || prop_oneof![3 => -700.0..700.0, 1 => f64::ANY];
    (number(), number(), number(), number(), number()).prop_map(|(x, y, z, spin, tilt)| DrawnPose {
        x,
        y,
        z,
        spin,
        tilt,
    })
}

fn any_block() -> impl Strategy<Value = DrawnBlock> {
    let edge = prop_oneof![3 => 0.0..3000.0, 1 => f64::ANY];
    (any_pose(), [edge.clone(), edge.clone(), edge], any::<[u8; 3]>()).prop_map(|(pose, size, colour)| {
        let DrawnPose { x, y, z, spin, tilt } = pose;
        DrawnBlock {
            x,
            y,
            z,
            size,
            yaw: spin,
            tilt,
            colour: Colour(colour),
            ..DrawnBlock::default()
        }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn no_scene_breaks_the_camera(
        pose in any_pose(), opening in f64::ANY, blocks in vec(any_block(), 0..6), trail in vec(any_pose(), 0..6),
        view in prop::sample::select(&View::ALL[..]), width in 64_u32..200, height in 48_u32..200,
    ) {
        let scene = Scene { pose, gripper: DrawnGripper { opening }, blocks, trail, ..Scene::default() };
        let settings = CameraSettings { width, height, overlay: true, ..PNG };
        let image = render(view, settings, &scene);
        prop_assert!(image.matrix.iter().all(|v| v.is_finite()), "{:?}", image.matrix);
        let decoded = decode(&image);
        prop_assert_eq!((decoded.width(), decoded.height()), (width, height));
        prop_assert_eq!(image, render(view, settings, &scene));
    }
}
