//! A GET of a camera's URL: connected, asked and read with a time limit for each step.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use http::header::{
    ACCEPT, AUTHORIZATION, CONNECTION, CONTENT_TYPE, HOST, LOCATION, USER_AGENT, WWW_AUTHENTICATE,
};
use http::{HeaderMap, Request, Response, StatusCode};
use http_body_util::{BodyExt as _, Empty};
use hyper::body::Incoming;
use hyper::client::conn::http1;
use hyper_util::rt::TokioIo;
use rustls::pki_types::ServerName;
use rustls::{ClientConfig, RootCertStore, crypto};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::task::AbortHandle;
use tokio::time::{Instant, timeout, timeout_at};
use tokio_rustls::TlsConnector;

use super::{SourceError, SourceUrl};

/// For a connection, with TLS if the URL has it.
const CONNECT: Duration = Duration::from_secs(5);
/// For the next bytes.
const SILENCE: Duration = Duration::from_secs(5);
/// For the next whole picture, while bytes come.
const PICTURE: Duration = Duration::from_secs(30);

/// Gets one URL.
#[derive(Debug)]
pub(super) struct HttpSource {
    url: SourceUrl,
    tls: Option<ClientTls>,
}

/// An answer that is being read.
#[derive(Debug)]
pub(super) struct Answer {
    /// The media type with its parameters.
    pub(super) content_type: String,
    body: Incoming,
    /// Until when a picture has to be whole.
    deadline: Instant,
    _connection: ConnectionTask,
}

/// The task of a connection, which ends with it.
#[derive(Debug)]
struct ConnectionTask(AbortHandle);

#[derive(Clone)]
struct ClientTls(TlsConnector);

impl HttpSource {
    /// # Errors
    /// [`SourceError::Tls`] if TLS is asked for and the system trusts nobody.
    pub(super) fn new(url: SourceUrl) -> Result<HttpSource, SourceError> {
        let tls = url.is_tls().then(ClientTls::new).transpose()?;
        Ok(HttpSource { url, tls })
    }

    /// Asks for the URL, and gives the answer once it begins, if it is a success.
    pub(super) async fn get(&self) -> Result<Answer, SourceError> {
        let deadline = Instant::now() + CONNECT;
        let connect = TcpStream::connect((self.url.host(), self.url.port()));
        let late = |_| SourceError::NoConnection(CONNECT);
        let stream = timeout_at(deadline, connect)
            .await
            .map_err(late)?
            .map_err(connecting)?;
        let _ = stream.set_nodelay(true);
        match &self.tls {
            None => self.ask(stream).await,
            Some(tls) => {
                let secure = timeout_at(deadline, tls.connect(self.url.host(), stream));
                self.ask(secure.await.map_err(late)?.map_err(connecting)?).await
            }
        }
    }

    async fn ask<S>(&self, stream: S) -> Result<Answer, SourceError>
    where
        S: AsyncRead + AsyncWrite + Send + Unpin + 'static,
    {
        let asked = timeout(SILENCE, exchange(self.request(), stream)).await;
        let (response, connection) = asked
            .map_err(|_| SourceError::Silent(SILENCE))?
            .map_err(reading)?;
        let (head, body) = response.into_parts();
        check(head.status, &head.headers)?;
        let content_type = head
            .headers
            .get(CONTENT_TYPE)
            .and_then(|value| value.to_str().ok());
        Ok(Answer {
            content_type: content_type.unwrap_or_default().to_owned(),
            body,
            deadline: Instant::now() + PICTURE,
            _connection: connection,
        })
    }

    fn request(&self) -> Request<Empty<Bytes>> {
        let mut request = Request::new(Empty::new());
        // It was a part of a valid URL.
        *request.uri_mut() = self.url.target().parse().unwrap_or_default();
        let headers = request.headers_mut();
        if let Ok(host) = self.url.host_header().parse() {
            headers.insert(HOST, host);
        }
        headers.insert(USER_AGENT, const { http::HeaderValue::from_static("mom-camera") });
        headers.insert(
            ACCEPT,
            const { http::HeaderValue::from_static("multipart/x-mixed-replace, image/jpeg, image/png") },
        );
        headers.insert(CONNECTION, const { http::HeaderValue::from_static("close") });
        if let Some(authorization) = self.url.authorization() {
            headers.insert(AUTHORIZATION, authorization.clone());
        }
        request
    }
}

impl Answer {
    /// The next bytes; none at the end.
    pub(super) async fn bytes(&mut self) -> Result<Option<Bytes>, SourceError> {
        let silent = Instant::now() + SILENCE;
        let limit = silent.min(self.deadline);
        loop {
            let Ok(frame) = timeout_at(limit, self.body.frame()).await else {
                return Err(match limit == silent {
                    true => SourceError::Silent(SILENCE),
                    false => SourceError::Slow(PICTURE),
                });
            };
            match frame.transpose().map_err(reading)? {
                None => return Ok(None),
                Some(frame) => {
                    // Trailers are no bytes.
                    if let Ok(bytes) = frame.into_data() {
                        return Ok(Some(bytes));
                    }
                }
            }
        }
    }

    /// A picture was whole: the next one has its time.
    pub(super) fn note_picture(&mut self) {
        self.deadline = Instant::now() + PICTURE;
    }
}

impl Drop for ConnectionTask {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl ClientTls {
    fn new() -> Result<ClientTls, SourceError> {
        let mut roots = RootCertStore::empty();
        roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
        if roots.is_empty() {
            return Err(SourceError::Tls(
                "this system has no certificates to trust".to_owned(),
            ));
        }
        let config = ClientConfig::builder_with_provider(Arc::new(crypto::ring::default_provider()))
            .with_safe_default_protocol_versions()
            .map_err(|error| SourceError::Tls(error.to_string()))?
            .with_root_certificates(roots)
            .with_no_client_auth();
        Ok(ClientTls(TlsConnector::from(Arc::new(config))))
    }

    async fn connect(
        &self,
        host: &str,
        stream: TcpStream,
    ) -> io::Result<tokio_rustls::client::TlsStream<TcpStream>> {
        let name = ServerName::try_from(host.to_owned()).map_err(io::Error::other)?;
        self.0.connect(name, stream).await
    }
}

impl std::fmt::Debug for ClientTls {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("ClientTls")
    }
}

async fn exchange<S>(
    request: Request<Empty<Bytes>>,
    stream: S,
) -> Result<(Response<Incoming>, ConnectionTask), hyper::Error>
where
    S: AsyncRead + AsyncWrite + Send + Unpin + 'static,
{
    let (mut sender, connection) = http1::handshake(TokioIo::new(stream)).await?;
    // It reads no further than hyper's buffer while nobody takes the body's bytes.
    let running = ConnectionTask(tokio::spawn(connection).abort_handle());
    Ok((sender.send_request(request).await?, running))
}

/// Whether the answer is a success, and if not, what can be done.
fn check(status: StatusCode, headers: &HeaderMap) -> Result<(), SourceError> {
    if status.is_success() {
        return Ok(());
    }
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    if status.is_redirection() {
        // Without what may be secret in it.
        let place = text(LOCATION).and_then(|place| place.parse::<SourceUrl>().ok());
        return Err(SourceError::Redirect(place.map(|url| url.to_string())));
    }
    if status == StatusCode::UNAUTHORIZED {
        // A camera that names no way is taken to mean the usual one.
        let mut ways = headers.get_all(WWW_AUTHENTICATE).iter().peekable();
        let basic = ways.peek().is_none() || ways.any(|line| names_basic(line.as_bytes()));
        return Err(SourceError::Login { basic });
    }
    Err(SourceError::Status(status))
}

/// Whether one of the ways to log in is Basic: each may have a line of its own, or they share one.
fn names_basic(line: &[u8]) -> bool {
    let mut quoted = false;
    let mut parts = line.split(|&byte| {
        quoted ^= byte == b'"';
        byte == b',' && !quoted
    });
    parts.any(|part| {
        let word = part.trim_ascii().split(u8::is_ascii_whitespace).next();
        word.is_some_and(|word| word.eq_ignore_ascii_case(b"basic"))
    })
}

#[expect(clippy::needless_pass_by_value, reason = "it is what map_err gives")]
fn connecting(error: io::Error) -> SourceError {
    SourceError::Connect(error.to_string())
}

#[expect(clippy::needless_pass_by_value, reason = "it is what map_err gives")]
fn reading(error: hyper::Error) -> SourceError {
    // hyper says what it did; the cause says what went wrong.
    let cause = std::error::Error::source(&error).map(|cause| format!(": {cause}"));
    SourceError::Broken(format!("{error}{}", cause.unwrap_or_default()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(status: u16, name: &http::HeaderName, values: &[&str]) -> String {
        let mut headers = HeaderMap::new();
        for value in values {
            headers.append(name, value.parse().unwrap());
        }
        let checked = check(StatusCode::from_u16(status).unwrap(), &headers);
        checked.map_or_else(|error| error.to_string(), |()| "taken".to_owned())
    }

    #[test]
    fn what_is_no_success_says_what_to_do() {
        assert_eq!(checked(200, &LOCATION, &[]), "taken");
        assert_eq!(
            checked(503, &LOCATION, &[]),
            "the answer is 503 Service Unavailable"
        );
        for (place, words) in [
            (
                &["http://ann:secret@b/c?d"][..],
                "it is redirected to http://b/c?…; name the URL that it leads to",
            ),
            (
                &["/login?secret"],
                "it is redirected; name the URL that it leads to",
            ),
            (&[], "it is redirected; name the URL that it leads to"),
        ] {
            assert_eq!(checked(301, &LOCATION, place), words);
        }
        for (ways, words) in [
            (
                &["Digest realm=x", "basic realm=x"][..],
                "without the right user and password",
            ),
            (&[], "without the right user and password"),
            (
                &["Digest realm=\"x\", nonce=\"y\", Basic realm=\"x\""],
                "without the right user and password",
            ),
            (
                &["Digest realm=\"a, basic b\", basically=no"],
                "does not take a password by Basic authorisation",
            ),
            (
                &["Digest realm=x"],
                "does not take a password by Basic authorisation",
            ),
        ] {
            let told = checked(401, &WWW_AUTHENTICATE, ways);
            assert!(told.contains(words), "{told}");
        }
    }
}
