//! The camera as a peer: joins its contexts and connects them to the [`ImageServer`].

use std::future::{Future, pending};
use std::path::PathBuf;
use std::pin::pin;
use std::time::Duration;

use mom_client::{Boxed, Channel, Client, ClientError, Code, Event, LinkState, Map, Path, Token, WireError};
use mom_device::{card, ensure, ensure_above, ensure_guarded, is_missing};
use mom_program::work::{done, send, users, wall};
use mom_trace::Trace;
use tokio::sync::watch::Receiver;
use tokio::task::{JoinSet, spawn_blocking};
use tokio::time::{Instant, sleep_until};

use crate::calibration::{CalibrationFile, CalibrationKeeper};
use crate::pan::CameraTime;
use crate::pan::Mount;
use crate::pan::peer::RunningMount;
use crate::source::{self, Sight};
use crate::{CameraSettings, ImageServer, ServerOptions, SettingsError, Source, View};

/// A snapshot is got at least so often, so that it is known whether the camera lives.
const LONGEST_SNAPSHOT_PERIOD: Duration = Duration::from_secs(60);

/// Where the camera stands and what it listens to.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraOptions {
    /// Where the camera stands.
    pub view: View,
    /// The channel of its images. Where it is missing the camera makes it, if it may; with [`View::Pan`] its token too.
    pub channel: String,
    /// The manager of that token, if it is made; none: that of the session.
    pub manager: Option<String>,
    /// The channel of the robot that it looks at.
    pub robot: String,
    /// The token whose owner may change the settings; that of [`View::Pan`] guards its commands too.
    pub token: String,
    /// The settings to begin with, where the images are drawn.
    pub settings: CameraSettings,
    /// The real camera whose images are shown; none = they are drawn.
    pub source: Option<Source>,
    /// Broadcast images per second, at most.
    pub rate: f64,
    /// How many past poses the path in the image has (M44).
    pub trail: usize,
    /// The file that keeps the measured matrix over restarts, if one does (M55).
    pub calibration: Option<PathBuf>,
    /// A file into which it is written where the simulated mount of [`View::Pan`] looks, for tests.
    pub trace: Option<PathBuf>,
}

impl CameraOptions {
    /// The lab's camera of this view: on `/camera/<view>`, at most 10 images per second.
    #[must_use]
    pub fn new(view: View) -> Self {
        Self {
            view,
            channel: format!("/camera/{view}"),
            manager: None,
            robot: "/robot/arm".to_owned(),
            token: match view {
                View::Pan => "/camera/pan-token".to_owned(),
                _ => "/robot/token".to_owned(),
            },
            settings: CameraSettings::default(),
            source: None,
            rate: 10.0,
            trail: 100,
            calibration: None,
            trace: None,
        }
    }

    /// The server's options from these.
    fn server(&self) -> Result<ImageServer, ClientError> {
        let bad = |error: SettingsError| WireError::new(Code::BAD_CONTENT, error.to_string());
        if !(self.rate > 0.0 && self.rate.is_finite()) {
            let text = format!("the rate is {} images per second; it must be above 0", self.rate);
            return Err(WireError::new(Code::BAD_CONTENT, text).into());
        }
        if self.view == View::Pan && self.source.is_some() {
            let text = "the view pan is drawn, as its mount is simulated; a real camera has another view";
            return Err(WireError::new(Code::BAD_CONTENT, text).into());
        }
        let options = ServerOptions {
            view: self.view,
            channel: Path::parse(&self.channel)?,
            token: Path::parse(&self.token)?,
            settings: self.settings,
            period: (1e6 / self.rate) as CameraTime,
            trail: self.trail,
        };
        let server = match &self.source {
            Some(source) => ImageServer::real(options, source),
            None => ImageServer::new(options),
        };
        Ok(server.map_err(bad)?)
    }

    /// What is seen of the real camera, if it is one; the work for it is a task.
    fn watch(&self, tasks: &mut JoinSet<()>) -> Option<Receiver<Sight>> {
        let source = self.source.as_ref()?;
        let period = Duration::try_from_secs_f64(1.0 / self.rate).unwrap_or(LONGEST_SNAPSHOT_PERIOD);
        let (seen, work) = source::watch(source.url.clone(), period.min(LONGEST_SNAPSHOT_PERIOD));
        tasks.spawn(work);
        Some(seen)
    }
}

impl CameraOptions {
    /// The camera's channel, after the camera has made what is missing of its own contexts.
    async fn enter(&self, client: &Client) -> Result<Channel, ClientError> {
        match self.join(client).await {
            Err(error) if is_missing(&error) => {}
            joined => return joined,
        }
        ensure_above(client, &self.channel).await?;
        match self.view {
            View::Pan => {
                ensure_above(client, &self.token).await?;
                ensure_guarded(client, &self.channel, &self.token, self.manager.as_deref()).await?;
            }
            _ => ensure(client, &self.channel, Map::new().with("kind", "channel")).await?,
        }
        self.join(client).await
    }

    async fn join(&self, client: &Client) -> Result<Channel, ClientError> {
        match self.view {
            // It obeys stops, and is waited for.
            View::Pan => {
                let card = card(&Mount::default());
                client.channel_with_card(&self.channel, &card).await
            }
            _ => client.channel(&self.channel).await,
        }
    }

    /// What turns the camera, if anything does.
    fn mount(
        &self,
        client: &Client,
        channel: &Channel,
        begin: Instant,
    ) -> Result<Option<RunningMount>, ClientError> {
        if self.view != View::Pan {
            return Ok(None);
        }
        let mount = match &self.trace {
            Some(file) => Mount::traced(Trace::open(file).map_err(|error| {
                let text = format!("{} cannot be written: {error}", file.display());
                WireError::new(Code::BAD_CONTENT, text)
            })?),
            None => Mount::default(),
        };
        Ok(Some(RunningMount::start(client, channel, mount, begin)))
    }

    /// The file of the measured matrix, read.
    fn calibration_file(&self) -> Result<Option<CalibrationFile>, ClientError> {
        let open = |path: &PathBuf| CalibrationFile::open(path, self.view);
        let file = self.calibration.as_ref().map(open).transpose();
        file.map_err(|text| WireError::new(Code::BAD_CONTENT, text).into())
    }
}

/// Runs a camera until `shutdown` is done; then it logs out.
///
/// Images are drawn on tokio's blocking threads, one at a time.
///
/// ```no_run
/// use mom_camera::{CameraOptions, View, peer};
/// use mom_client::Client;
///
/// # async fn example() -> Result<(), mom_client::ClientError> {
/// let client = Client::builder("bin://127.0.0.1:7666").user("camera").password("camera").connect().await?;
/// peer::run(client, CameraOptions::new(View::X), std::future::pending()).await?;
/// # Ok(())
/// # }
/// ```
///
/// # Errors
///
/// [`ClientError`] if an option is bad, a context cannot be joined, or the connection is closed for good.
pub fn run(
    client: Client,
    options: CameraOptions,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Boxed<'static, Result<(), ClientError>> {
    Box::pin(run_until(client, options, Box::pin(shutdown)))
}

async fn run_until(
    client: Client,
    options: CameraOptions,
    shutdown: Boxed<'static, ()>,
) -> Result<(), ClientError> {
    let mut server = options.server()?;
    let mut keeper = CalibrationKeeper::new(options.calibration_file()?);
    server = server.calibrated(keeper.kept().cloned());
    let channel = options.enter(&client).await?;
    let begin = Instant::now();
    // It hears what has been said since the join: a stop may be among it.
    let mut mount = options.mount(&client, &channel, begin)?;
    let mut camera = channel.events();
    let token = client.token(&options.token).await.map_err(of_the_robot)?;
    let mut owner = token.events();
    server.handle_token_info(&token.info().await?);
    let arm = client.channel(&options.robot).await.map_err(of_the_robot)?;
    let mut robot = arm.events();
    // The tasks end with this function.
    let mut tasks = JoinSet::new();
    let mut sights = options.watch(&mut tasks);
    let mut drawing = None;
    let mut looking = None;
    let mut out = Vec::new();
    let mut shutdown = pin!(shutdown);
    tracing::info!(peer = client.name(), channel = %channel.path(), "the camera is ready");
    loop {
        server.handle_slew(mount.as_ref().map(RunningMount::slew));
        if let Some(shot) = server.advance(micros(begin), wall(&client), &mut out) {
            drawing = Some(spawn_blocking(move || shot.take()));
        }
        tokio::select! {
            () = &mut shutdown => break,
            () = send(&client, &mut out) => {}
        }
        if looking.is_none() && server.ask_users() {
            let contexts = vec![options.token.clone(), options.channel.clone()];
            looking = Some(tokio::spawn(users(client.clone(), contexts)));
        }
        keeper.keep(server.calibration());
        let wake = server.next_wake().map(|due| until(begin, due));
        tokio::select! {
            // Who owns the token is known before what its owner says next is judged.
            biased;
            () = &mut shutdown => break,
            event = owner.next() => {
                let event = open(event, &client)?;
                server.handle_token(&event);
                match event {
                    Event::LinkDown => tracing::warn!("the link is lost"),
                    Event::Rejoined | Event::Resumed | Event::Lagged(_) => ask_owner(&token, &mut server).await,
                    _ => {}
                }
            }
            picture = done("camera", &mut drawing) => match picture {
                Some(picture) => server.handle_picture(picture, &mut out),
                None => server.handle_failure(),
            },
            users = done("camera", &mut looking) => server.handle_users(&users.unwrap_or_default(), &mut out),
            event = camera.next() => server.handle_camera(&open(event, &client)?, &mut out),
            () = keeper.written() => {}
            () = turned(&mut mount) => {}
            event = robot.next() => server.handle_robot(&open(event, &client)?),
            sight = sight(&mut sights) => server.handle_sight(sight, wall(&client), &mut out),
            () = sleep_or_wait(wake) => {}
        }
    }
    end(mount).await;
    keeper.finish(server.calibration()).await;
    client.close().await;
    Ok(())
}

/// Who makes a context that is missing and not the camera's own.
fn of_the_robot(error: ClientError) -> ClientError {
    match error {
        ClientError::Refused(mut error) if error.code == Code::UNKNOWN_PATH => {
            error
                .text
                .push_str("; the robot makes it when it starts (mom-arm), or the hub's configuration has it");
            ClientError::Refused(error)
        }
        error => error,
    }
}

/// The event, or the end of all events.
fn open(event: Option<Event>, client: &Client) -> Result<Event, ClientError> {
    let event = event.ok_or_else(|| ended(client))?;
    match &event {
        Event::Refused(error, reference) => tracing::warn!(%error, reference, "the hub refused a message"),
        Event::Lagged(count) => tracing::warn!(count, "events were lost"),
        event => tracing::trace!(?event),
    }
    Ok(event)
}

/// Why there are no more events.
fn ended(client: &Client) -> ClientError {
    match &*client.state().borrow() {
        LinkState::Closed(error) => ClientError::Closed(error.clone()),
        _ => WireError::new(Code::UNKNOWN_PATH, "the hub deleted a context of the camera").into(),
    }
}

/// Asks the hub who owns the token, in case events were missed.
async fn ask_owner(token: &Token, server: &mut ImageServer) {
    match token.info().await {
        Ok(info) => server.handle_token_info(&info),
        Err(error) => tracing::warn!(%error, "the owner of the token is not known"),
    }
}

/// Waits for news of the real camera, if it is one.
async fn sight(sights: &mut Option<Receiver<Sight>>) -> Sight {
    let Some(seen) = sights else {
        return pending().await;
    };
    match seen.changed().await {
        Ok(()) => seen.borrow_and_update().clone(),
        // Its task does not end before this one.
        Err(_) => pending().await,
    }
}

/// Halts the mount, if there is one.
async fn end(mount: Option<RunningMount>) {
    if let Some(mount) = mount {
        mount.end().await;
    }
}

/// Waits until the mount does something else, if there is one.
async fn turned(mount: &mut Option<RunningMount>) {
    match mount {
        Some(mount) => mount.changed().await,
        None => pending().await,
    }
}

pub(crate) async fn sleep_or_wait(wake: Option<Instant>) {
    match wake {
        Some(wake) => sleep_until(wake).await,
        None => pending().await,
    }
}

/// µs since the server began.
pub(crate) fn micros(begin: Instant) -> CameraTime {
    CameraTime::try_from(begin.elapsed().as_micros()).unwrap_or(CameraTime::MAX)
}

/// The time that is so many µs after the beginning.
pub(crate) fn until(begin: Instant, micros: CameraTime) -> Instant {
    begin + Duration::from_micros(u64::try_from(micros).unwrap_or(0))
}
