//! The camera of the lab as a program of its own.

use std::future::Future;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::pin::pin;
use std::time::Duration;

use anyhow::{Context, anyhow};
use clap::Parser;
use mom_camera::{CameraOptions, CameraSettings, Rendition, SettingsChange, Source, SourceUrl, View, peer};
use mom_client::{Client, Identity, Key, Proof};
use tokio::signal::unix::{SignalKind, signal};
use tracing_subscriber::EnvFilter;

/// For how long the hub keeps its place when the connection is lost.
const GRACE: Duration = Duration::from_secs(30);

const EXAMPLES: &str = "\
Examples:
  MOM_PASSWORD=camera mom-camera
  mom-camera --hub tcp://127.0.0.1:7666 --password-file camera.secret --rate 5
  mom-camera --hub bin://lab.example.org --key camera.key
  MOM_PASSWORD=camera mom-camera --view top --width 320 --height 240 --format png
  MOM_PASSWORD=camera mom-camera --view wrist --overlay
  MOM_PASSWORD=camera mom-camera --view pan
  MOM_PASSWORD=camera mom-camera --channel /camera/x --url http://10.0.0.7/video.mjpg

The password is that of MOM_PASSWORD, unless --password-file names a file. A key (mom keygen) is taken from
anywhere, a password over TLS (bins://, tcps://) or loopback. Where there is no hub yet it waits. The log goes to the standard error; RUST_LOG says how much of it. Ctrl-C and SIGTERM end the program.";

/// The camera of the demonstration lab: shows the robot's workspace after each of its states and on request.
#[derive(Debug, Parser)]
#[command(name = "mom-camera", version, after_help = EXAMPLES)]
struct CameraArgs {
    /// The hub, as bin://host:port (binary) or tcp://host:port (XML), bins:// or tcps:// with TLS, which may end in ?pin=FINGERPRINT
    #[arg(long, env = "MOM_HUB", default_value = "bin://127.0.0.1:7666")]
    hub: String,
    /// If the hub cannot be reached, report why to it by plain HTTP, which may get through; for mom logs
    #[arg(long, env = "MOM_REPORT", value_parser = clap::builder::FalseyValueParser::new())]
    report: bool,
    /// The user to log in as
    #[arg(long, default_value = "camera")]
    user: String,
    /// A file whose first line is the password
    #[arg(long, value_name = "FILE", conflicts_with = "key")]
    password_file: Option<PathBuf>,
    /// A file with the private key of the user, as mom keygen makes it; it needs no password
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// A certificate of the user (PEM), whose private key --key names, for a hub over TLS
    #[arg(long, value_name = "FILE", requires = "key")]
    certificate: Option<PathBuf>,
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
}

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    if let Some(written) = mom_pages::asked::<CameraArgs>() {
        return Ok(written?);
    }
    let args = CameraArgs::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    let mut shutdown = pin!(shutdown()?);
    let options = options(&args)?;
    let mut builder = Client::builder(&args.hub)
        .user(&args.user)
        .nickname(args.view.peer(&args.user))
        .proof(proof(&args)?)
        .link(GRACE)
        .wait_for_hub();
    if args.report {
        builder = builder.report_failures("mom-camera", env!("CARGO_PKG_VERSION"));
    }
    let connected = tokio::select! {
        connected = builder.connect() => connected,
        () = &mut shutdown => return Ok(()),
    };
    let client = connected.with_context(|| format!("{} cannot log in at {}", args.user, args.hub))?;
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
        robot: args.robot.clone(),
        token: args.token.clone().unwrap_or(lab.token),
        settings: CameraSettings::default().with(&settings)?,
        source: args.url.as_ref().map(|url| source(url, &settings)).transpose()?,
        rate: args.rate,
        trail: args.trail,
        calibration: args.calibration.clone(),
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

/// Authenticates by key if there is one.
fn proof(args: &CameraArgs) -> anyhow::Result<Proof> {
    match (&args.key, &args.certificate) {
        (Some(key), Some(certificate)) => Ok(Proof::Certificate(Identity {
            certificate: certificate.clone(),
            key: key.clone(),
        })),
        (Some(file), None) => Ok(Proof::Key(Key::from_file(file).context("--key")?)),
        (None, _) => password(args).map(Proof::Password),
    }
}

fn password(args: &CameraArgs) -> anyhow::Result<String> {
    let Some(file) = &args.password_file else {
        return std::env::var("MOM_PASSWORD")
            .map_err(|_| anyhow!("set MOM_PASSWORD, or name a file with --password-file or --key"));
    };
    let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    Ok(text.lines().next().unwrap_or_default().to_owned())
}

/// Done at Ctrl-C or SIGTERM.
fn shutdown() -> anyhow::Result<impl Future<Output = ()>> {
    let mut interrupt = signal(SignalKind::interrupt()).context("cannot listen for Ctrl-C")?;
    let mut terminate = signal(SignalKind::terminate()).context("cannot listen for SIGTERM")?;
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
        tracing::info!("ending");
    })
}
