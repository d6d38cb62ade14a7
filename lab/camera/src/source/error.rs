//! Why a real camera gives no pictures.

use std::time::Duration;

use mom_client::{Code, WireError, visible};

use super::multipart::MultipartError;
use super::{FrameError, SourceUrl};

/// More characters of what a camera sends are not quoted.
const QUOTED: usize = 80;

/// Why a real camera gives no pictures. None of them quotes the URL: the message to the
/// channel adds it without its secrets.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SourceError {
    /// The connection was refused, or the host is not known, or TLS failed.
    #[error("it cannot be connected: {0}")]
    Connect(String),
    /// No answer to the attempt to connect.
    #[error("there is no connection within {} s", .0.as_secs())]
    NoConnection(Duration),
    /// TLS cannot be used here.
    #[error("TLS cannot be used: {0}")]
    Tls(String),
    /// Connected, but no bytes come.
    #[error("nothing has come for {} s", .0.as_secs())]
    Silent(Duration),
    /// Bytes come, but no whole picture.
    #[error("no whole picture has come for {} s", .0.as_secs())]
    Slow(Duration),
    /// The answer is not a success.
    #[error("the answer is {0}")]
    Status(http::StatusCode),
    /// The answer names another place.
    #[error("it is redirected{}; name the URL that it leads to", to(.0))]
    Redirect(Option<String>),
    /// User and password are missing or wrong.
    #[error("{}", login(*.basic))]
    Login {
        /// Whether the camera takes a password by Basic authorisation.
        basic: bool,
    },
    /// Neither a stream of pictures nor a picture.
    #[error("the answer is {0}, and no multipart stream or image")]
    Kind(String),
    /// The connection broke down, or the answer is not HTTP.
    #[error("the answer cannot be read: {0}")]
    Broken(String),
    /// The stream has ended.
    #[error("the stream has ended")]
    Ended,
    /// The stream is not what it says.
    #[error(transparent)]
    Multipart(#[from] MultipartError),
    /// What came is not a picture.
    #[error(transparent)]
    Frame(#[from] FrameError),
}

impl SourceError {
    /// An answer of this content type.
    pub(super) fn kind(content_type: &str) -> SourceError {
        let quoted: String = content_type.chars().take(QUOTED).collect();
        SourceError::Kind(match quoted.is_empty() {
            true => "of no content type".to_owned(),
            false => visible(&quoted).to_string(),
        })
    }

    /// The error as all are told: what is wrong, at which URL, and what happens next.
    pub(crate) fn tell(&self, url: &SourceUrl, again: Duration) -> WireError {
        let code = match self {
            SourceError::NoConnection(_) | SourceError::Silent(_) | SourceError::Slow(_) => Code::TIMED_OUT,
            // It is tried again, so that any of them may be over in a while.
            _ => Code::TRY_LATER,
        };
        let next = match again.as_secs() {
            0 => "the next picture may be better".to_owned(),
            seconds => format!("trying again in {seconds} s"),
        };
        let text = format!("{url}: {self}; {next}");
        WireError::new(code, text).retry_after(again)
    }
}

fn to(place: &Option<String>) -> String {
    place
        .as_ref()
        .map(|place| format!(" to {place}"))
        .unwrap_or_default()
}

fn login(basic: bool) -> &'static str {
    match basic {
        true => {
            "the camera refuses to answer without the right user and password; write http://user:password@host/"
        }
        false => {
            "the camera does not take a password by Basic authorisation, which is all that is spoken here"
        }
    }
}
