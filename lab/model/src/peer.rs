//! The model server as a peer: joins its contexts and connects them to the [`ModelServer`].

use std::collections::VecDeque;
use std::future::Future;
use std::pin::pin;
use std::time::Duration;

use mom_client::{
    Boxed, Channel, Client, ClientError, Code, ContextKind, Event, Events, LinkState, Parcel, Path, Thinning,
    Time, Token, WireError,
};
use mom_program::work::{done, send, users, wall};
use tokio::sync::mpsc;
use tokio::task::{JoinHandle, JoinSet, spawn_blocking};
use tokio::time::{MissedTickBehavior, interval};

use crate::{Image, Kind, Look, ModelServer, ServerOptions};

/// How often the server looks at its clock.
const TICK: Duration = Duration::from_millis(250);
/// How many images of each camera are looked at, at most: a look takes about 10 ms of a processor.
const RATE: &str = "4/s";
/// Events that wait for the server.
const WAITING: usize = 256;

/// Where the model server listens and tells.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelOptions {
    /// The channel in which it tells; tokens beside it are those of single objects.
    pub channel: String,
    /// The channels of the cameras by which it sees. Those that move are of no use.
    pub cameras: Vec<String>,
    /// The channel of the robot, which says what it holds.
    pub robot: String,
    /// The token whose owner writes all objects.
    pub token: String,
    /// What it looks for.
    pub kinds: Vec<Kind>,
}

impl Default for ModelOptions {
    /// The lab's: three cameras that stand, three blocks of 40 mm.
    fn default() -> ModelOptions {
        let kind = |(name, colour): (&str, [u8; 3])| Kind {
            name: name.to_owned(),
            size: 40.0,
            colour,
        };
        ModelOptions {
            channel: "/model/objects".to_owned(),
            cameras: ["/camera/x", "/camera/y", "/camera/top"]
                .map(str::to_owned)
                .to_vec(),
            robot: "/robot/arm".to_owned(),
            token: "/robot/token".to_owned(),
            kinds: [
                ("red", [200, 40, 40]),
                ("green", [40, 150, 60]),
                ("blue", [40, 80, 190]),
            ]
            .map(kind)
            .to_vec(),
        }
    }
}

impl ModelOptions {
    fn server(&self) -> Result<ServerOptions, ClientError> {
        let cameras: Result<Vec<Path>, _> = self.cameras.iter().map(|path| Path::parse(path)).collect();
        Ok(ServerOptions {
            channel: Path::parse(&self.channel)?,
            token: Path::parse(&self.token)?,
            cameras: cameras?,
            kinds: self.kinds.clone(),
        })
    }
}

/// An event, and where it happened.
enum Heard {
    Camera(usize, Event),
    Robot(Event),
    Model(Event),
}

/// The model's images on their way: of each camera the newest that nobody has looked at, and the one under way.
#[derive(Default)]
struct Looking {
    /// The camera that has waited longest is the first.
    waiting: VecDeque<(usize, Image)>,
    under_way: Option<JoinHandle<(usize, Result<Look, String>)>>,
}

impl Looking {
    /// Takes a camera's image; it keeps its place among the others.
    fn add(&mut self, camera: usize, image: Image) {
        match self.waiting.iter_mut().find(|(other, _)| *other == camera) {
            Some((_, older)) => *older = image,
            None => self.waiting.push_back((camera, image)),
        }
    }

    /// Looks at the next image, on a thread of its own.
    fn begin(&mut self, server: &ModelServer) {
        if self.under_way.is_none()
            && let Some((camera, image)) = self.waiting.pop_front()
        {
            let wanted = server.wanted();
            self.under_way = Some(spawn_blocking(move || (camera, image.look(&wanted))));
        }
    }

    /// What the image under way shows.
    async fn done(&mut self) -> Option<(usize, Look)> {
        let (camera, look) = done("model", &mut self.under_way).await?;
        look.inspect_err(|error| tracing::warn!(error, "an image cannot be read"))
            .ok()
            .map(|look| (camera, look))
    }
}

/// Runs a model server until `shutdown` is done; then it logs out.
///
/// Images are looked at on tokio's blocking threads, one at a time.
///
/// ```no_run
/// use mom_client::Client;
/// use mom_model::{ModelOptions, peer};
///
/// # async fn example() -> Result<(), mom_client::ClientError> {
/// let client = Client::builder("bin://127.0.0.1:7666").user("model").password("model").connect().await?;
/// peer::run(client, ModelOptions::default(), std::future::pending()).await?;
/// # Ok(())
/// # }
/// ```
///
/// # Errors
///
/// [`ClientError`] if an option is bad, a context cannot be joined, or the connection is closed for good.
pub fn run(
    client: Client,
    options: ModelOptions,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Boxed<'static, Result<(), ClientError>> {
    Box::pin(run_until(client, options, Box::pin(shutdown)))
}

async fn run_until(
    client: Client,
    options: ModelOptions,
    shutdown: Boxed<'static, ()>,
) -> Result<(), ClientError> {
    let mut server = ModelServer::new(options.server()?, wall(&client));
    // The tasks end with this function.
    let mut tasks = JoinSet::new();
    let (sender, mut heard) = mpsc::channel(WAITING);
    let mut tokens = join_tokens(&client, &options).await?;
    for (token, _) in &tokens {
        server.handle_token_info(token.path(), &token.info().await?);
    }
    let robot = client.channel(&options.robot).await?;
    forward(&mut tasks, robot.events(), &sender, Heard::Robot);
    let _cameras = join_cameras(&client, &options, &mut tasks, &sender).await?;
    let channel = client.channel(&options.channel).await?;
    forward(&mut tasks, channel.events(), &sender, Heard::Model);
    drop(sender);
    let (mut looking, mut asking, mut out) = (Looking::default(), None, Vec::new());
    let mut tick = interval(TICK);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut shutdown = pin!(shutdown);
    tracing::info!(peer = client.name(), channel = %channel.path(), "the model is ready");
    loop {
        looking.begin(&server);
        if asking.is_none() && server.ask_users() {
            let contexts = tokens
                .iter()
                .map(|(token, _)| token.path())
                .chain([channel.path()])
                .map(Path::to_string)
                .collect();
            asking = Some(tokio::spawn(users(client.clone(), contexts)));
        }
        tokio::select! {
            () = &mut shutdown => break,
            () = send(&client, &mut out) => {}
        }
        tokio::select! {
            biased;
            () = &mut shutdown => break,
            event = heard.recv() => {
                let event = event.ok_or_else(|| ended(&client))?;
                // The hub tells of an owner before it forwards what he writes.
                take_owners(&mut tokens, &mut server).await;
                take(event, &mut server, &mut looking, wall(&client), &mut out);
            }
            look = looking.done() => if let Some((camera, look)) = look {
                server.handle_look(camera, look, wall(&client), &mut out);
            },
            users = done("model", &mut asking) => {
                server.handle_users(&users.unwrap_or_default(), wall(&client), &mut out);
            }
            _ = tick.tick() => {
                take_owners(&mut tokens, &mut server).await;
                server.advance(wall(&client), &mut out);
            }
        }
    }
    client.close().await;
    Ok(())
}

/// The tokens by which objects are written: that of all, and those beside the model's channel.
async fn join_tokens(client: &Client, options: &ModelOptions) -> Result<Vec<(Token, Events)>, ClientError> {
    let session = options
        .channel
        .rsplit_once('/')
        .map_or("/", |(session, _)| session);
    let mut paths = vec![options.token.clone()];
    let beside = client.list(session).await?;
    let beside = beside.iter().filter(|context| context.kind == ContextKind::Token);
    paths.extend(beside.map(|context| context.path.to_string()));
    let mut tokens = Vec::new();
    for path in paths {
        let token = client.token(&path).await?;
        let events = token.events();
        tokens.push((token, events));
    }
    Ok(tokens)
}

/// The cameras' channels, whose events come to the server.
async fn join_cameras(
    client: &Client,
    options: &ModelOptions,
    tasks: &mut JoinSet<()>,
    sender: &mpsc::Sender<Heard>,
) -> Result<Vec<Channel>, ClientError> {
    let thinning = Thinning {
        newest: true,
        rate: Some(RATE.parse()?),
    };
    let mut cameras = Vec::new();
    for (index, path) in options.cameras.iter().enumerate() {
        let camera = client.channel_thinned(path, thinning).await?;
        forward(tasks, camera.events(), sender, move |event| {
            Heard::Camera(index, event)
        });
        cameras.push(camera);
    }
    Ok(cameras)
}

/// Brings events to the server; it ends when one of the contexts does.
fn forward(
    tasks: &mut JoinSet<()>,
    mut events: Events,
    sender: &mpsc::Sender<Heard>,
    wrap: impl Fn(Event) -> Heard + Send + 'static,
) {
    let sender = sender.clone();
    tasks.spawn(async move {
        while let Some(event) = events.next().await {
            match &event {
                Event::Refused(error, reference) => {
                    tracing::warn!(%error, reference, "the hub refused a message");
                }
                Event::Lagged(count) => tracing::warn!(count, "events were lost"),
                event => tracing::trace!(?event),
            }
            if sender.send(wrap(event)).await.is_err() {
                return;
            }
        }
    });
}

/// Takes what has come of tokens.
async fn take_owners(tokens: &mut [(Token, Events)], server: &mut ModelServer) {
    for (token, events) in tokens {
        while let Some(event) = events.try_next() {
            tracing::trace!(?event);
            server.handle_token(token.path(), &event);
            if matches!(event, Event::Rejoined | Event::Resumed | Event::Lagged(_)) {
                match token.info().await {
                    Ok(info) => server.handle_token_info(token.path(), &info),
                    Err(error) => {
                        tracing::warn!(%error, path = %token.path(), "the owner of the token is not known");
                    }
                }
            }
        }
    }
}

fn take(heard: Heard, server: &mut ModelServer, looking: &mut Looking, now: Time, out: &mut Vec<Parcel>) {
    match heard {
        Heard::Camera(camera, event) => {
            if let Some(image) = server.handle_camera(camera, &event, now) {
                looking.add(camera, image);
            }
        }
        Heard::Robot(event) => server.handle_robot(&event, now, out),
        Heard::Model(event) => server.handle_model(&event, now, out),
    }
}

/// Why there are no more events.
fn ended(client: &Client) -> ClientError {
    match &*client.state().borrow() {
        LinkState::Closed(error) => ClientError::Closed(error.clone()),
        _ => WireError::new(Code::UNKNOWN_PATH, "the hub deleted the contexts of the model").into(),
    }
}
