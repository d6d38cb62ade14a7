//! `mom calibrate`: an ordinary peer that drives the arm, looks through a camera, and tells it its matrix.

use std::fs;
use std::future::Future;
use std::io;
use std::path::PathBuf;
use std::pin::pin;
use std::time::Duration;

use mom_client::{Client, Value};
use mom_drive::{
    Commander, DeviceChannel, Doing as _, Holding, Pose, RobotState, Tell, VerbFailure, WorkEnd, both,
};
use mom_pages::duration_within;
use serde_json::json;
use tokio::time::timeout;

use crate::agent::{self, AgentOptions};
use crate::camera::Camera;
use crate::error::no_calibration;
use crate::{Calibration, Observation, Picture, calibrate, marker, poses, residuals};

/// Calibrate a camera: drive the arm, find its marker in the images, and tell the camera its matrix
#[derive(Debug, Clone, PartialEq, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct VerbArgs {
    /// The camera, by its channel's name: x, y or top
    #[arg(
        required_unless_present = "serve",
        default_value = "",
        hide_default_value = true
    )]
    pub view: String,
    /// Calibrate for others: wait in this channel for who lends the token, such as a person at the console
    #[arg(long, value_name = "PATH", num_args = 0..=1, default_missing_value = "/calibrate", conflicts_with_all = ["view", "output", "wait"])]
    pub serve: Option<String>,
    /// In how many poses to look; a matrix takes 6, and more make it better
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u16).range(6..=500))]
    pub poses: u16,
    /// Draw the residuals into this file (SVG)
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Where the middle of the marker is in the gripper's frame, mm: along the jaw line, across it, and from the tip
    /// towards the wrist
    #[arg(long, value_name = "X,Y,Z", default_value = "0,-140,75", value_parser = place, allow_hyphen_values = true)]
    pub marker: [f64; 3],
    /// The radius of the marker, a ball, mm
    #[arg(long, value_name = "MM", default_value = "12", value_parser = length)]
    pub radius: f64,
    /// The colour of the marker, red, green and blue in hexadecimal
    #[arg(long, value_name = "RRGGBB", default_value = "ff00ff", value_parser = colour)]
    pub colour: [u8; 3],
    /// The session of the cameras
    #[arg(long, value_name = "PATH", default_value = "/camera")]
    pub session: String,
    /// The robot's channel
    #[arg(long, value_name = "PATH", default_value = "/robot/arm")]
    pub robot: String,
    /// The token that guards robot and cameras
    #[arg(long, value_name = "PATH", default_value = "/robot/token")]
    pub token: String,
    /// Wait in the token's queue for at most so many seconds
    #[arg(long, value_name = "SECONDS")]
    pub wait: Option<u64>,
    /// How long after each move the camera's picture is waited for; 500ms or more for a real camera
    #[arg(long, value_name = "TIME", default_value = "0s", value_parser = duration_within(Duration::ZERO..=Duration::from_secs(60)))]
    pub settle: Duration,
}

const EXAMPLES: &str = "\
It grabs the robot's token, drives the arm to poses all over the workspace, about 1.5 s each, and measures in each where
the marker on the gripper is seen, in lossless images. Poses in which it is not seen whole are left out, and so are
measurements that do not agree with the others. At the end the arm is at home, the camera has its settings back and
uses the measured matrix, and the token is free.

Examples:
  mom calibrate x
  mom calibrate top --poses 50 --output residuals.svg
  mom calibrate y --marker 0,-140,75 --radius 12 --colour ff00ff
  mom calibrate x --wait 300               when it is your turn
  mom calibrate bench --settle 500ms       a real camera shows the arm later than the arm tells
  mom calibrate x --json | jq -s 'last.rms'
  mom calibrate --serve                    calibrates for peers that ask in /calibrate and lend it the token

Ctrl-C ends it: the settings are restored and the token is released, and the hub halts the robot.";

impl VerbArgs {
    /// As `mom calibrate VIEW` has them, in so many poses.
    #[must_use]
    pub fn of(view: &str, poses: u16) -> VerbArgs {
        VerbArgs {
            view: view.to_owned(),
            serve: None,
            poses,
            output: None,
            marker: crate::MARKER,
            radius: crate::RADIUS,
            colour: crate::COLOUR,
            session: "/camera".to_owned(),
            robot: "/robot/arm".to_owned(),
            token: "/robot/token".to_owned(),
            wait: None,
            settle: Duration::ZERO,
        }
    }
}

/// So long a camera may take to have its settings back while the arm may move.
const RESTORED: Duration = Duration::from_secs(1);

/// What the camera has been told of its new matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Told {
    Nothing,
    /// It was sent, and the camera has not answered.
    Sent,
    Matrix,
}

impl Told {
    fn words(self) -> &'static str {
        match self {
            Told::Nothing => "nothing was told to the camera",
            Told::Sent => {
                "the matrix was sent, and whether the camera uses it is not known; its next image tells"
            }
            Told::Matrix => "the camera uses the new matrix",
        }
    }
}

/// Calibrates until it is done, or `interrupt` is. The caller closes the client.
///
/// # Errors
///
/// [`VerbFailure`]; whatever happened, the settings are restored and the token is released, unless it was lost.
pub async fn run(
    args: &VerbArgs,
    client: &Client,
    interrupt: impl Future<Output = ()>,
    tell: Tell<'_>,
) -> Result<(), VerbFailure> {
    if let Some(channel) = &args.serve {
        let options = AgentOptions {
            channel: channel.clone(),
            args: args.clone(),
        };
        return agent::run(client.clone(), options, interrupt)
            .await
            .doing(format!("wait in {channel}"));
    }
    let mut interrupt = pin!(interrupt);
    let begun = async {
        let path = format!("{}/{}", args.session.trim_end_matches('/'), args.view);
        let camera = Camera::meet(DeviceChannel::join(client, &path).await?).await?;
        let robot = DeviceChannel::join(client, &args.robot).await?;
        let wait = args.wait.map(Duration::from_secs);
        let holding = Holding::grab(client, &args.token, wait).await?;
        Ok::<_, VerbFailure>((camera, Commander::new(robot, holding.fence()), holding))
    };
    let (camera, robot, holding) = tokio::select! {
        begun = begun => begun?,
        () = &mut interrupt => return Err(VerbFailure::plain("interrupted before the token was grabbed")),
    };
    under(args, camera, robot, holding, interrupt, tell).await
}

/// Calibrates under a token that is held, and gives it back.
pub(crate) async fn under(
    args: &VerbArgs,
    camera: Camera,
    robot: Commander,
    mut holding: Holding,
    interrupt: impl Future<Output = ()>,
    tell: Tell<'_>,
) -> Result<(), VerbFailure> {
    let mut job = Job {
        args,
        camera,
        robot,
        tell,
        told: Told::Nothing,
    };
    let ended = match holding.during(interrupt, job.carry_out()).await {
        WorkEnd::Lost(lost) => {
            let loss = holding.loss(&lost, &mut job.robot).await;
            return Err(lost_failure(args, &loss, job.told));
        }
        WorkEnd::Ended(ended) => Some(ended),
        WorkEnd::Interrupted => None,
    };
    // The camera's settings are its owner's to restore, and so before the token is given back; a camera that says nothing does not keep the
    // arm going.
    let restored = match timeout(RESTORED, job.camera.restore()).await {
        Ok(restored) => restored,
        Err(_) => Err(VerbFailure::new(
            format!(
                "the camera in {} does not say that it has its settings back",
                job.camera.channel.path()
            ),
            format!("restore them: mom camera {} --format jpeg", args.view),
        )),
    };
    let given_back = both(restored, holding.end(&mut job.robot).await);
    match (ended, given_back) {
        (Some(ended), given_back) => both(ended, given_back),
        (None, Ok(())) => Err(VerbFailure::plain(format!(
            "interrupted; {}, its settings are restored, and the token is released",
            job.told.words()
        ))),
        (None, given_back) => both(
            Err(VerbFailure::plain(format!("interrupted; {}", job.told.words()))),
            given_back,
        ),
    }
}

fn lost_failure(args: &VerbArgs, why: &VerbFailure, told: Told) -> VerbFailure {
    VerbFailure::new(
        format!("{why}; {}", told.words()),
        format!(
            "only the token's owner restores the camera's settings: mom camera {} --format jpeg",
            args.view
        ),
    )
}

/// What is done under the token.
struct Job<'a> {
    args: &'a VerbArgs,
    camera: Camera,
    robot: Commander,
    tell: Tell<'a>,
    told: Told,
}

/// What was measured.
#[derive(Default)]
struct Measurements {
    observations: Vec<Observation>,
    /// Of the images, pixels.
    size: (usize, usize),
    /// Poses to which the robot did not go.
    refused: usize,
    /// Poses whose images have no marker that is whole and alone.
    unseen: usize,
}

/// What became of one pose.
enum PoseOutcome {
    Measured(Observation, (usize, usize)),
    Refused(String),
    Unseen(String),
}

impl Job<'_> {
    async fn carry_out(&mut self) -> Result<(), VerbFailure> {
        self.camera.set().await?;
        let poses = poses::spread(self.args.poses.into(), 0);
        let mut measured = Measurements::default();
        for (index, pose) in poses.iter().enumerate() {
            let outcome = self.measure(pose).await?;
            self.tell_pose(index + 1, poses.len(), pose, &outcome)?;
            match outcome {
                PoseOutcome::Refused(_) => measured.refused += 1,
                PoseOutcome::Unseen(_) => measured.unseen += 1,
                PoseOutcome::Measured(observation, size) => {
                    if !measured.observations.is_empty() && measured.size != size {
                        return Err(VerbFailure::plain(
                            "the size of the images was changed meanwhile; calibrate again",
                        ));
                    }
                    measured.size = size;
                    measured.observations.push(observation);
                }
            }
        }
        if let Some(why) = self.robot.carry_out("home").await.unreachable()? {
            let text = format!("the robot does not go home: {why}; {}", self.told.words());
            return Err(VerbFailure::plain(text));
        }
        let calibration =
            calibrate(&measured.observations, self.args.radius).map_err(|error| no_calibration(&error))?;
        if let Some(file) = &self.args.output {
            let (width, height) = (measured.size.0 as f64, measured.size.1 as f64);
            let title = format!("Residuals of camera {}", self.args.view);
            let drawn = residuals::svg(&calibration, &title, width, height);
            fs::write(file, drawn)
                .map_err(|error| VerbFailure::plain(format!("cannot write {}: {error}", file.display())))?;
        }
        // Before the answer: it may be in use although the answer is lost.
        self.told = Told::Sent;
        self.camera.publish(&calibration, measured.size).await?;
        self.told = Told::Matrix;
        self.tell_end(&calibration, &measured)
    }

    /// Goes to a pose and looks for the marker.
    async fn measure(&mut self, pose: &Pose) -> Result<PoseOutcome, VerbFailure> {
        if let Some(why) = self.robot.carry_out(pose.command()).await.unreachable()? {
            return Ok(PoseOutcome::Refused(why));
        }
        let state = self
            .robot
            .state_when(|state: &RobotState| state.rests_at(pose))
            .await?;
        let mut after = None;
        if !self.args.settle.is_zero() {
            // A real camera is late: a frame has the state of the time when it came, and may show the arm before that.
            self.robot.rest(self.args.settle).await?;
            after = self.camera.newest().await?;
        }
        let image = self.camera.image_of(&state, after).await?;
        let bytes = image.get("image").and_then(Value::as_binary);
        let picture = match bytes.map(|bytes| Picture::decode(bytes)) {
            Some(Ok(picture)) => picture,
            Some(Err(why)) => return Ok(PoseOutcome::Unseen(format!("the image cannot be read: {why}"))),
            None => return Ok(PoseOutcome::Unseen("the answer holds no image".to_owned())),
        };
        Ok(match marker::find(&picture, self.args.colour) {
            Ok(spot) => PoseOutcome::Measured(
                Observation {
                    world: state.pose.place(self.args.marker),
                    pixel: spot.middle,
                },
                (picture.width, picture.height),
            ),
            Err(why) => PoseOutcome::Unseen(format!("marker {why}")),
        })
    }

    /// A line for each pose.
    fn tell_pose(&mut self, number: usize, of: usize, pose: &Pose, outcome: &PoseOutcome) -> io::Result<()> {
        let Pose { x, y, z, spin, tilt } = pose;
        let (key, value, words) = match outcome {
            PoseOutcome::Measured(Observation { pixel: [u, v], .. }, _) => {
                ("marker", json!([u, v]), format!("marker at {u:.2} {v:.2}"))
            }
            PoseOutcome::Refused(why) => ("refused", json!(why), format!("left out: the arm refuses: {why}")),
            PoseOutcome::Unseen(why) => ("unseen", json!(why), format!("left out: {why}")),
        };
        let mut json = json!({"pose": number, "of": of, "at": pose});
        json[key] = value;
        let width = of.to_string().len();
        let line = format!("[{number:width$}/{of}] pose {x} {y} {z} {spin} {tilt}  {words}");
        (self.tell)(json, line)
    }

    fn tell_end(&mut self, calibration: &Calibration, measured: &Measurements) -> Result<(), VerbFailure> {
        let Calibration {
            rms, max, condition, ..
        } = calibration;
        let (used, outliers) = (calibration.used(), calibration.outliers());
        let Measurements {
            refused,
            unseen,
            size,
            ..
        } = measured;
        let path = self.camera.channel.path().to_string();
        let json = json!({
            "camera": path,
            "rms": rms,
            "max": max,
            "condition": condition,
            "used": used,
            "outliers": outliers,
            "refused": refused,
            "unseen": unseen,
            "matrix": calibration.projection.numbers(),
            "width": size.0,
            "height": size.1,
            "file": self.args.output,
        });
        let mut line = format!(
            "{path}  RMS {rms:.3} px, largest {max:.3} px, from {used} of {} poses",
            self.args.poses
        );
        for (count, why) in [
            (*refused, "refused by the arm"),
            (*unseen, "without a marker"),
            (outliers, "not in agreement"),
        ] {
            if count > 0 {
                line.push_str(&format!(", {count} {why}"));
            }
        }
        line.push_str(&format!("; condition {condition:.0}; the camera uses it now"));
        Ok((self.tell)(json, line)?)
    }
}

/// Three numbers of mm.
fn place(text: &str) -> Result<[f64; 3], String> {
    let numbers: Vec<f64> = text
        .split(',')
        .filter_map(|number| number.trim().parse().ok())
        .filter(|number: &f64| number.abs() <= 10_000.0)
        .collect();
    match text.split(',').count() {
        3 => <[f64; 3]>::try_from(numbers).ok(),
        _ => None,
    }
    .ok_or_else(|| "a place is three numbers of mm: 0,-140,75".to_owned())
}

fn length(text: &str) -> Result<f64, String> {
    let number: Option<f64> = text.parse().ok();
    number
        .filter(|number| (0.0..=1000.0).contains(number))
        .ok_or_else(|| "it is a number of mm, 0 to 1000".to_owned())
}

fn colour(text: &str) -> Result<[u8; 3], String> {
    let wrong = || "a colour is six hexadecimal digits: ff00ff".to_owned();
    let digits = text.strip_prefix('#').unwrap_or(text);
    if digits.len() != 6 || !digits.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return Err(wrong());
    }
    let byte = |i: usize| u8::from_str_radix(&digits[i..i + 2], 16).map_err(|_| wrong());
    let colour = [byte(0)?, byte(2)?, byte(4)?];
    match colour.iter().max().zip(colour.iter().min()) {
        Some((most, least)) if most - least >= 64 => Ok(colour),
        _ => Err("grey is not a colour for a marker".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_the_labs() {
        #[derive(Debug, clap::Parser)]
        struct Line {
            #[command(flatten)]
            args: VerbArgs,
        }
        let read = |line: &[&str]| <Line as clap::Parser>::try_parse_from([&["calibrate"], line].concat());
        let args = read(&["x"]).expect("a view is enough").args;
        assert_eq!(
            (args.marker, args.radius, args.colour),
            (crate::MARKER, crate::RADIUS, crate::COLOUR)
        );
        assert_eq!(
            read(&["x", "--marker", "-5,0.5,7"]).expect("a place").args.marker,
            [-5.0, 0.5, 7.0]
        );
        assert_eq!(args.settle, Duration::ZERO);
        for (time, millis) in [("500ms", 500), ("2s", 2000), ("60s", 60_000)] {
            let args = read(&["x", "--settle", time]).expect("a time").args;
            assert_eq!(args.settle, Duration::from_millis(millis));
        }
        for line in [
            &[][..],
            &["x", "--settle", "500"],
            &["x", "--settle", "s"],
            &["x", "--settle", "61s"],
            &["x", "--settle", "99999999999999999999s"],
            &["x", "--poses", "5"],
            &["x", "--marker", "1,2"],
            &["x", "--marker", "1,2,nan"],
            &["x", "--marker", "1,2,3,4"],
            &["x", "--marker", "1,2,x,4"],
            &["x", "--radius", "-1"],
            &["x", "--colour", "808080"],
            &["x", "--colour", "+f00ff"],
            &["x", "--colour", "ééé"],
        ] {
            assert!(read(line).is_err(), "{line:?}");
        }
    }
}
