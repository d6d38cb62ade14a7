//! Where the pictures of a real camera come from: a URL that streams them, or gives one for each GET.
//!
//! `watch` runs for as long as the camera does. Its newest frame takes the place of an older one that nobody has
//! used, so what it keeps is bounded whatever the URL sends: the newest frame, and the one that is being read.

mod error;
mod frame;
mod http;
pub mod multipart;
mod url;

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch::{Receiver, Sender, channel};
use tokio::time::{Instant, sleep, sleep_until};

pub use error::SourceError;
pub(crate) use frame::Frame;
use frame::LARGEST;
pub use frame::{FrameError, Rendition};
pub use url::{BadUrl, SourceUrl};

use http::{Answer, HttpSource};
use multipart::Multipart;

/// The first pause between two attempts; each is twice the one before.
const FIRST_PAUSE: Duration = Duration::from_secs(1);
/// The longest.
const LONGEST_PAUSE: Duration = Duration::from_secs(30);

/// A camera by URL.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// Where its pictures are.
    pub url: SourceUrl,
    /// What is wanted of them; by default they go out as the camera gives them.
    pub rendition: Rendition,
}

/// What is known of a real camera now.
#[derive(Debug, Clone, Default)]
pub(crate) enum Sight {
    /// Nothing yet.
    #[default]
    Waiting,
    /// Its newest picture.
    Frame(Arc<Frame>),
    /// Why there is none, and when it is tried again.
    Failed { error: SourceError, again: Duration },
}

/// The newest that is known of a camera, and the work that finds it out: it never ends, and ends when dropped.
pub(crate) fn watch(url: SourceUrl, period: Duration) -> (Receiver<Sight>, impl Future<Output = ()> + Send) {
    let (sight, seen) = channel(Sight::Waiting);
    (seen, look(url, period, sight))
}

async fn look(url: SourceUrl, period: Duration, sight: Sender<Sight>) {
    let mut pause = FIRST_PAUSE;
    loop {
        let mut seen = 0_u64;
        let error = read(&url, period, |frame| {
            seen += 1;
            sight.send_replace(Sight::Frame(Arc::new(frame)));
        })
        .await;
        if seen > 0 {
            pause = FIRST_PAUSE;
        }
        tracing::info!(%url, %error, again = ?pause, "the camera gives no pictures");
        sight.send_replace(Sight::Failed { error, again: pause });
        sleep(pause).await;
        pause = (pause * 2).min(LONGEST_PAUSE);
    }
}

/// Reads pictures until something goes wrong.
async fn read(url: &SourceUrl, period: Duration, mut take: impl FnMut(Frame) + Send) -> SourceError {
    let failed = async {
        let http = HttpSource::new(url.clone())?;
        loop {
            let next = Instant::now() + period;
            let answer = http.get().await?;
            let (kind, _) = answer
                .content_type
                .split_once(';')
                .unwrap_or((&answer.content_type, ""));
            match kind.trim().to_ascii_lowercase().split_once('/') {
                Some(("multipart", _)) => read_stream(answer, &mut take).await?,
                Some(("image", _)) => take(read_picture(answer).await?),
                _ => return Err(SourceError::kind(&answer.content_type)),
            }
            sleep_until(next).await;
        }
    };
    let Err(error): Result<std::convert::Infallible, SourceError> = failed.await;
    error
}

/// Reads a stream to its end, which is an error as well.
async fn read_stream(mut answer: Answer, take: &mut (impl FnMut(Frame) + Send)) -> Result<(), SourceError> {
    let mut parts = Multipart::new(&answer.content_type, LARGEST)?;
    while let Some(bytes) = answer.bytes().await? {
        parts.push(&bytes);
        let mut newest = None;
        while let Some(part) = parts.next_part()? {
            newest = Some(part);
        }
        if let Some(part) = newest {
            take(Frame::read(part)?);
            answer.note_picture();
        }
        if parts.is_ended() {
            break;
        }
    }
    Err(SourceError::Ended)
}

async fn read_picture(mut answer: Answer) -> Result<Frame, SourceError> {
    let mut file = bytes::BytesMut::new();
    while let Some(bytes) = answer.bytes().await? {
        if file.len() + bytes.len() > LARGEST {
            return Err(FrameError::TooLarge.into());
        }
        file.extend_from_slice(&bytes);
    }
    Ok(Frame::read(file.freeze())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nothing listens there, so that each attempt fails at once and the clock goes from pause to pause.
    #[tokio::test(start_paused = true)]
    async fn attempts_become_rare() {
        let closed = std::net::TcpListener::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap();
        let url = format!("http://{closed}/").parse().unwrap();
        let (mut seen, work) = watch(url, Duration::from_secs(1));
        let work = tokio::spawn(work);
        let mut pauses = Vec::new();
        while pauses.len() < 8 {
            seen.changed().await.unwrap();
            match &*seen.borrow_and_update() {
                Sight::Failed { again, .. } => pauses.push(again.as_secs()),
                sight => panic!("{sight:?}"),
            }
        }
        assert_eq!(pauses, [1, 2, 4, 8, 16, 30, 30, 30]);
        work.abort();
    }
}
