//! The newest image of a channel (M37).

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use http::header::{CONTENT_TYPE, HeaderName, LAST_MODIFIED};
use http::{HeaderMap, HeaderValue, Response, StatusCode};
use mom_client::{Channel, Client, Event, Family};
use mom_proto::{Code, Parcel, Path, Time, Value, WireError};
use parking_lot::Mutex;
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until, timeout};

use super::HttpConnection;
use super::answers::{self, Body, refuse_wire};
use super::visitors::{Visitor, refuse_client};

/// A channel about which nobody has asked for so long is left.
const IDLE: Duration = Duration::from_secs(60);

/// The first image may take so long.
const PATIENCE: Duration = Duration::from_secs(5);

/// How old the image is, in ms, where that is known.
const AGE: HeaderName = HeaderName::from_static("mom-age");

/// Channels that one visitor watches.
const MOST: usize = 16;

/// A channel that a visitor is a member of for its images.
#[derive(Debug)]
pub(super) struct Watched {
    newest: watch::Receiver<Option<Image>>,
    used: Mutex<Instant>,
}

/// One image.
#[derive(Clone, Debug)]
struct Image {
    bytes: Bytes,
    media: HeaderValue,
    /// When it was taken, as far as its message says so.
    taken: Option<Time>,
}

impl HttpConnection {
    /// Answers with the newest image of a channel.
    pub(super) async fn image(
        &self,
        headers: &HeaderMap,
        path: &str,
    ) -> Result<Response<Body>, Response<Body>> {
        let visitor = self.visitor(headers).await?;
        let path = Path::parse(path).map_err(|error| refuse_wire(&error))?;
        let watched = visitor.watch(&path).await?;
        let mut newest = watched.newest.clone();
        let image = match timeout(PATIENCE, newest.wait_for(Option::is_some)).await {
            Ok(Ok(image)) => image.clone(),
            _ => None,
        };
        let image = image.ok_or_else(|| {
            let text = format!("nobody has sent an image in {path} yet");
            refuse_wire(&WireError::new(Code::TIMED_OUT, text))
        })?;
        let mut answer = answers::bytes(StatusCode::OK, "image/jpeg", image.bytes);
        let headers = answer.headers_mut();
        headers.insert(CONTENT_TYPE, image.media);
        if let Some(taken) = image.taken {
            let age = self.services.board.clock.wall().micros() - taken.micros();
            headers.insert(AGE, HeaderValue::from((age / 1000).max(0)));
            if let Ok(date) = HeaderValue::try_from(http_date(taken)) {
                headers.insert(LAST_MODIFIED, date);
            }
        }
        Ok(answer)
    }
}

impl Visitor {
    /// Joins the channel, or stays in it.
    async fn watch(&self, path: &Path) -> Result<Arc<Watched>, Response<Body>> {
        let mut all = self.watched.lock().await;
        all.retain(|_, watched| watched.newest.has_changed().is_ok());
        if let Some(watched) = all.get(path) {
            *watched.used.lock() = Instant::now();
            return Ok(Arc::clone(watched));
        }
        if all.len() >= MOST {
            let text = format!(
                "one visitor may watch at most {MOST} channels; retry in {} s",
                IDLE.as_secs()
            );
            return Err(refuse_wire(
                &WireError::new(Code::TRY_LATER, text).retry_after(IDLE),
            ));
        }
        let joined = self.client.channel(path.as_str()).await;
        let channel = joined.map_err(|error| refuse_client(&error))?;
        let (say, newest) = watch::channel(None);
        let watched = Arc::new(Watched {
            newest,
            used: Mutex::new(Instant::now()),
        });
        all.insert(path.clone(), Arc::clone(&watched));
        tokio::spawn(follow(self.client.clone(), channel, say, Arc::clone(&watched)));
        Ok(watched)
    }
}

/// Keeps the newest image until nobody has asked for long.
async fn follow(client: Client, channel: Channel, say: watch::Sender<Option<Image>>, watched: Arc<Watched>) {
    let mut events = channel.events();
    let mut request = Parcel::new(Family::Message, "request").context(channel.path().clone());
    request.echo = Some(false);
    // Anyone may request an image (M37). Where nobody answers, the next one that is sent will do.
    let _ = client.send(request).await;
    loop {
        let until = *watched.used.lock() + IDLE;
        tokio::select! {
            event = events.next() => match event {
                Some(Event::Message(parcel)) => {
                    if let Some(image) = Image::of(&parcel) {
                        say.send_replace(Some(image));
                    }
                }
                Some(_) => {}
                None => return,
            },
            () = sleep_until(until) => {
                if *watched.used.lock() + IDLE <= Instant::now() {
                    break;
                }
            }
        }
    }
    // If the hub has closed the connection, it is out of the channel already.
    let _ = channel.leave().await;
}

impl Image {
    fn of(parcel: &Parcel) -> Option<Image> {
        if parcel.name() != "image" {
            return None;
        }
        let Value::Map(content) = parcel.value() else {
            return None;
        };
        let bytes = content.get("image")?.as_binary()?.clone();
        let format = content.get("format").and_then(Value::as_str);
        // Only these: what a page must not run as its own is not shown as what its sender calls it.
        let media = match format.map(str::to_ascii_lowercase).as_deref() {
            Some("png") => "image/png",
            Some("jpeg" | "jpg") | None => "image/jpeg",
            Some("webp") => "image/webp",
            Some(_) => "application/octet-stream",
        };
        Some(Image {
            bytes,
            media: HeaderValue::from_static(media),
            taken: parcel.timestamp,
        })
    }
}

/// `Sun, 06 Nov 1994 08:49:37 GMT`.
fn http_date(time: Time) -> String {
    let micros = u64::try_from(time.micros()).unwrap_or_default();
    httpdate::fmt_http_date(std::time::UNIX_EPOCH + Duration::from_micros(micros))
}
