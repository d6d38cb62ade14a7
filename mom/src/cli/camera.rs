//! Arguments of the command that sets a camera.

use std::time::Duration;

use clap::Args;

use mom_pages::duration;

/// `mom camera`
#[derive(Args, Debug)]
pub(crate) struct CameraArgs {
    /// The camera, by its channel's name: x, y, top, wrist, pan
    pub(crate) view: String,
    /// Width and height of the images in pixels, 64x48 to 1920x1080
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    pub(crate) size: Option<ImageSize>,
    /// Quality of JPEG images, 1 (smallest) to 100 (best)
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub(crate) quality: Option<i64>,
    /// Format of the images: jpeg or png
    #[arg(long, value_name = "FORMAT")]
    pub(crate) format: Option<String>,
    /// Whether pose, path and outlines are drawn into the images; beside them they always are: on or off
    #[arg(long, value_name = "WORD", value_parser = on_or_off)]
    pub(crate) overlay: Option<bool>,
    /// The session of the cameras
    #[arg(long, value_name = "PATH", default_value = "/camera")]
    pub(crate) session: String,
    /// The token whose owner may set the camera; /robot/token if none is named, but /camera/pan-token for pan
    #[arg(long, value_name = "PATH")]
    pub(crate) token: Option<String>,
    /// How long to wait for the camera's answer: 5s
    #[arg(long, value_name = "TIME", value_parser = duration, default_value = "10s")]
    pub(crate) timeout: Duration,
}

/// `mom aim`
#[derive(Args, Debug)]
pub(crate) struct AimArgs {
    /// Where the camera is to look, in degrees: PAN -170 to 170, 0 is the middle of the table and more is to the right;
    /// TILT -60 to 30, 0 is level and more is up
    #[arg(num_args = 2, value_names = ["PAN", "TILT"], allow_negative_numbers = true, required_unless_present = "home")]
    pub(crate) angles: Vec<f64>,
    /// Look home: arm and table in the middle of the image
    #[arg(long, conflicts_with_all = ["angles", "by"])]
    pub(crate) home: bool,
    /// The angles are differences from where it looks now
    #[arg(long)]
    pub(crate) by: bool,
    /// The camera's channel
    #[arg(long, value_name = "PATH", default_value = "/camera/pan")]
    pub(crate) channel: String,
    /// The token that guards it
    #[arg(long, value_name = "PATH", default_value = "/camera/pan-token")]
    pub(crate) token: String,
}

pub(crate) const AIM: &str = "\
It grabs the camera's token, waits until the camera looks there, and releases the token. A longer way is a script:
  echo 'look 40 -10; wait 500; home' | mom run --channel /camera/pan --token /camera/pan-token -

Examples:
  mom aim 20 -10                           20 degrees to the right of the table, 10 below the level
  mom aim --by -5 0                        5 degrees to the left of where it looks now
  mom aim --home
  mom snap pan                             what it sees there

Ctrl-C releases the token; the hub then halts the camera.";

/// Width and height in pixels, as they were asked for: the camera knows its limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ImageSize {
    pub(crate) width: i64,
    pub(crate) height: i64,
}

pub(crate) const CAMERA: &str = "\
Without options it tells the settings in use, to anybody. Only the owner of the robot's token changes them, and those of
pan only the owner of its own: if nobody owns it, it is grabbed for the change and released after it.

Examples:
  mom camera x                             its settings
  mom camera x --size 640x480 --quality 60
  mom camera wrist --format png --overlay on
  mom camera top --json | jq .quality

Exit codes: 0 done, 1 the camera refused or did not answer, 2 a command line that makes no sense.";

fn size(text: &str) -> Result<ImageSize, String> {
    let number = |digits: &str| match digits.bytes().all(|byte| byte.is_ascii_digit()) {
        true => digits.parse().ok(),
        false => None,
    };
    let pair = text.split_once(['x', 'X']);
    pair.and_then(|(width, height)| {
        Some(ImageSize {
            width: number(width)?,
            height: number(height)?,
        })
    })
    .ok_or_else(|| "a size is width and height in pixels: 640x480".to_owned())
}

fn on_or_off(text: &str) -> Result<bool, String> {
    match text {
        "on" => Ok(true),
        "off" => Ok(false),
        _ => Err("it is on or off".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_two_whole_numbers() {
        let told = |width, height| Ok(ImageSize { width, height });
        assert_eq!(size("640x480"), told(640, 480));
        assert_eq!(size("1X99999"), told(1, 99999), "the camera knows its limits");
        for wrong in [
            "",
            "x",
            "640",
            "640x",
            "x480",
            "640x480x3",
            "6.5x4",
            "+6x4",
            "-6x4",
            "99999999999999999999x1",
        ] {
            let refused = size(wrong).expect_err(wrong);
            assert!(refused.contains("640x480"), "{wrong}: {refused}");
        }
        assert_eq!((on_or_off("on"), on_or_off("off")), (Ok(true), Ok(false)));
        assert!(on_or_off("yes").is_err());
    }
}
