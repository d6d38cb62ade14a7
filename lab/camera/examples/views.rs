//! Draws a scene as each camera sees it: `cargo run -p mom-camera --example views -- FOLDER`.

use std::path::PathBuf;
use std::time::Instant;

use mom_camera::{CameraSettings, Format, Renderer, Scene, View};

const SCENE: &str = r##"{
    "pose": {"x": 90, "y": -60, "z": 150, "spin": 25, "tilt": 15},
    "gripper": {"opening": 40},
    "blocks": [
        {"x": -160, "y": 120, "z": 20, "size": 40, "colour": "red", "yaw": 15},
        {"x": -40, "y": 190, "z": 20, "size": 40, "colour": "blue", "yaw": -30},
        {"x": -40, "y": 190, "z": 60, "size": 40, "colour": "yellow", "yaw": 10},
        {"x": 180, "y": 110, "z": 20, "size": [40, 80, 40], "colour": "green", "yaw": 40},
        {"x": 150, "y": -180, "z": 20, "size": 40, "colour": "purple", "yaw": 0}
    ],
    "trail": [
        {"x": -160, "y": 120, "z": 60}, {"x": -160, "y": 120, "z": 150}, {"x": -100, "y": 77, "z": 150},
        {"x": -40, "y": 33, "z": 150}, {"x": 20, "y": -10, "z": 150}, {"x": 90, "y": -60, "z": 150}
    ]
}"##;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).ok_or("name a folder for the images")?);
    let scene: Scene = serde_json::from_str(SCENE)?;
    let mut report = String::new();
    for view in View::ALL {
        for (format, overlay, ending) in [
            (Format::Png, false, "png"),
            (Format::Jpeg, false, "jpg"),
            (Format::Png, true, "overlay.png"),
        ] {
            let renderer = Renderer::new(
                view,
                CameraSettings {
                    format,
                    overlay,
                    ..CameraSettings::default()
                },
            )?;
            let image = renderer.render(&scene);
            std::fs::write(folder.join(format!("cam-{view}.{ending}")), &image.bytes)?;
            const TIMES: u32 = 50;
            let start = Instant::now();
            for _ in 0..TIMES {
                renderer.render(&scene);
            }
            let each = start.elapsed() / TIMES;
            report.push_str(&format!(
                "{view:5} {ending:11} {:7} bytes {each:?}\n",
                image.bytes.len()
            ));
        }
    }
    std::fs::write(folder.join("cam-times.txt"), report)?;
    Ok(())
}
