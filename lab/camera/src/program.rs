//! The camera of the lab as a program of its own.

use std::ffi::OsString;
use std::path::PathBuf;

use crate::{CameraOptions, CameraSettings, Rendition, SettingsChange, Source, SourceUrl, View, peer};
use anyhow::Context;
use clap::Parser;
use mom_program::{HubArgs, begin, shutdown};

const EXAMPLES: &str = "\
Examples:
  MOM_PASSWORD=camera mom-camera
  mom-camera --hub tcp://127.0.0.1:7666 --password-file camera.secret --rate 5
  mom-camera --hub bin://lab.example.org --key camera.key
  MOM_PASSWORD=camera mom-camera --view top --width 320 --height 240 --format png
  MOM_PASSWORD=camera mom-camera --view wrist --overlay
  MOM_PASSWORD=camera mom-camera --view pan
  MOM_PASSWORD=camera mom-camera --channel /camera/x --url http://10.0.0.7/video.mjpg

Where its session or channel is missing, the camera makes it if it may. The password is that of MOM_PASSWORD, unless --password-file names a file. A key (mom keygen) is taken from
anywhere, a password over TLS (bins://, tcps://) or loopback. Where there is no hub yet it waits. The log goes to the standard error; RUST_LOG says how much of it. Ctrl-C and SIGTERM end the program.";

/// The camera of the demonstration lab: shows the robot's workspace after each of its states and on request.
#[derive(Debug, Parser)]
#[command(name = "mom-camera", version, after_help = EXAMPLES, mut_arg("user", |user| user.default_value("camera")))]
struct CameraArgs {
    #[command(flatten)]
    hub: HubArgs,
    /// Where the camera stands: x, y, top, wrist or pan (which turns and tilts by commands)
    #[arg(long, default_value = "x")]
    view: View,
    /// Shows a real camera: the URL of an MJPEG stream or of a single image, which is got --rate times a second.
    /// http://USER:PASSWORD@HOST/PATH logs in (Basic); others see the command line, so better set the variable
    #[arg(long, env = "MOM_CAMERA_URL", hide_env_values = true)]
    url: Option<String>,
    /// The channel of the images; /camera/VIEW if none is named
    #[arg(long, value_name = "PATH")]
    channel: Option<String>,
    /// The channel of the robot to look at
    #[arg(long, value_name = "PATH", default_value = "/robot/arm")]
    robot: String,
    /// The token whose owner may change the settings; /robot/token if none is named, but /camera/pan-token for the view pan
    #[arg(long, value_name = "PATH")]
    token: Option<String>,
    /// The manager of the token of the view pan, by its name in the hub's configuration, where the camera has to make it; without it: that
    /// of the session
    #[arg(long, value_name = "NAME")]
    manager: Option<String>,
    /// Images per second, at most, while the robot moves
    #[arg(long, default_value = "10")]
    rate: f64,
    /// How many past poses the path has
    #[arg(long, default_value = "100")]
    trail: usize,
    /// Width of the images in pixels, 64 to 1920
    #[arg(long)]
    width: Option<i64>,
    /// Height of the images in pixels, 48 to 1080
    #[arg(long)]
    height: Option<i64>,
    /// Quality of JPEG images, 1 to 100
    #[arg(long)]
    quality: Option<i64>,
    /// Format of the images: jpeg or png
    #[arg(long)]
    format: Option<String>,
    /// A file that keeps the measured matrix (mom calibrate) over restarts; it is made when there is something to keep
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Draw pose, path and outlines into the images; beside them, as data, they always are
    #[arg(long)]
    overlay: bool,
    /// Write where the simulated mount of --view pan looks, every 10 ms, into this file, for tests
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
}

/// Runs the program with these arguments, of which the first is its name, until it is done or told to end.
///
/// # Errors
///
/// What the program ends by; wrong arguments end the process.
pub fn run(args: Vec<OsString>) -> anyhow::Result<()> {
    mom_program::block_on(Box::pin(work(args)))
}

async fn work(args: Vec<OsString>) -> anyhow::Result<()> {
    let Some(args) = begin::<CameraArgs>(args, "info")? else {
        return Ok(());
    };
    let mut shutdown = Box::pin(shutdown()?);
    let options = options(&args)?;
    let login = args.hub.login("mom-camera", env!("CARGO_PKG_VERSION"))?;
    let login = login.nickname(args.view.peer(args.hub.user()));
    let Some(client) = args.hub.connect(login, &mut shutdown).await? else {
        return Ok(());
    };
    peer::run(client, options, shutdown)
        .await
        .context("the camera ended")
}

fn options(args: &CameraArgs) -> anyhow::Result<CameraOptions> {
    let lab = CameraOptions::new(args.view);
    let settings = SettingsChange {
        width: args.width,
        height: args.height,
        quality: args.quality,
        format: args.format.clone(),
        overlay: Some(args.overlay),
    };
    Ok(CameraOptions {
        channel: args.channel.clone().unwrap_or(lab.channel),
        manager: args.manager.clone(),
        robot: args.robot.clone(),
        token: args.token.clone().unwrap_or(lab.token),
        settings: CameraSettings::default().with(&settings)?,
        source: args.url.as_ref().map(|url| source(url, &settings)).transpose()?,
        rate: args.rate,
        trail: args.trail,
        calibration: args.calibration.clone(),
        trace: args.trace.clone(),
        ..CameraOptions::new(args.view)
    })
}

/// A real camera, with its pictures as it gives them where nothing else is asked for.
fn source(url: &str, settings: &SettingsChange) -> anyhow::Result<Source> {
    // Not read by clap, which would quote a bad one with its password.
    let url: SourceUrl = url.parse().context("--url")?;
    let rendition = Rendition::default().with(settings)?;
    Ok(Source { url, rendition })
}
