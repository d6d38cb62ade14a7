//! A camera's newest image, looked at: one image at a time, and no more than are needed.

use std::time::Duration;

use mom_client::{Channel, Event, Events, HubClock, Map, Parcel, Value};
use mom_vision::{Picture, Projection};
use tokio::sync::watch as signal;
use tokio::task::spawn_blocking;
use tokio::time::{Instant, sleep_until, timeout};

use crate::eyes::Seen;

/// A camera that sends nothing is asked after this time; one that does not answer, again.
const ASK: Duration = Duration::from_millis(250);
/// Where the hub does not know the camera's clock, its times may be wrong by so much, µs.
const UNKNOWN: i64 = 500_000;
/// How often is looked whether there is one.
const LOOK: Duration = Duration::from_millis(10);
/// Images are looked at no more often.
const PERIOD: Duration = Duration::from_millis(150);

/// What is seen by all cameras: of each the newest image.
#[derive(Debug, Default)]
pub(super) struct Eyes {
    cameras: Vec<signal::Receiver<Option<Seen>>>,
    /// The camera that was heard last: the others come first.
    last: usize,
}

impl Eyes {
    /// Another camera.
    pub(super) fn add(&mut self) -> signal::Sender<Option<Seen>> {
        let (sender, receiver) = signal::channel(None);
        self.cameras.push(receiver);
        sender
    }

    /// An image that has come, of any camera.
    pub(super) fn ready(&mut self) -> Option<Seen> {
        let count = self.cameras.len();
        for step in 1..=count {
            let camera = (self.last + step) % count;
            let eye = &mut self.cameras[camera];
            if eye.has_changed().unwrap_or(false)
                && let Some(seen) = eye.borrow_and_update().clone()
            {
                self.last = camera;
                return Some(seen);
            }
        }
        None
    }

    /// The next image of any camera; none where there is no camera any more. Cancel safe.
    pub(super) async fn next(&mut self) -> Option<Seen> {
        loop {
            if let Some(seen) = self.ready() {
                return Some(seen);
            }
            if self.cameras.iter().all(|eye| eye.has_changed().is_err()) {
                return None;
            }
            tokio::time::sleep(LOOK).await;
        }
    }
}

/// Looks through a camera until nobody wants it any more.
pub(super) async fn watch(
    channel: Channel,
    clock: HubClock,
    camera: usize,
    seen: signal::Sender<Option<Seen>>,
) {
    let mut events = channel.events();
    let mut asked: Option<Instant> = None;
    loop {
        let begin = Instant::now();
        if asked.is_none_or(|at| at.elapsed() > ASK) {
            asked = Some(begin);
            let request = channel
                .message("request")
                .content(Value::from(Map::new()))
                .no_echo();
            if let Err(error) = request.send().await {
                tracing::debug!(%error, "an image could not be requested");
            }
        }
        let Ok(image) = timeout(ASK, newest(&mut events)).await else {
            if seen.is_closed() {
                return;
            }
            continue;
        };
        let Some(image) = image else { return };
        // The next one is asked for when none comes by itself.
        asked = Some(Instant::now());
        let error = clock.age(&image).and_then(|age| age.error_micros);
        let error = error.map_or(UNKNOWN, |error| i64::try_from(error).unwrap_or(i64::MAX));
        let looked = spawn_blocking(move || look(camera, error, &image)).await;
        match looked {
            Ok(Ok(found)) => {
                // The newest one counts.
                if seen.send(Some(found)).is_err() {
                    return;
                }
            }
            Ok(Err(why)) => tracing::warn!(camera, why, "an image cannot be used"),
            Err(error) => tracing::error!(%error, "processing an image failed with an internal error"),
        }
        sleep_until(begin + PERIOD).await;
    }
}

/// The newest image that has come; none at the end of all events.
async fn newest(events: &mut Events) -> Option<Parcel> {
    let mut image = None;
    loop {
        let event = match &image {
            None => events.next().await?,
            Some(_) => match events.try_next() {
                Some(event) => event,
                None => return image,
            },
        };
        if let Event::Message(parcel) = event
            && parcel.name() == "image"
        {
            image = Some(parcel);
        }
    }
}

/// What an image shows; in words, why it tells nothing.
pub(super) fn look(camera: usize, error: i64, image: &Parcel) -> Result<Seen, String> {
    let content = image.value();
    let taken = content.get("taken").and_then(Value::as_time);
    let taken = taken.ok_or("it does not tell when it was taken")?;
    let projection = matrix(&content).ok_or("it tells no matrix; calibrate its camera")?;
    let bytes = content.get("image").and_then(Value::as_binary);
    let picture = Picture::decode(bytes.ok_or("there is no image in it")?)?;
    let shows = content.get("pose-time").and_then(Value::as_time).unwrap_or(taken);
    Ok(Seen {
        shows: shows.micros().min(taken.micros()),
        error,
        ..Seen::look(camera, taken.micros(), projection, &picture)
    })
}

fn matrix(content: &Value) -> Option<Projection> {
    let numbers = content.get("matrix")?.as_list()?;
    let number = |value: &Value| match value {
        Value::Double(number) => Some(*number),
        Value::Int(number) => Some(*number as f64),
        _ => None,
    };
    let numbers: Vec<f64> = numbers.iter().filter_map(number).collect();
    Projection::new(numbers.try_into().ok()?)
}
