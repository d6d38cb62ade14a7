//! The URL of a real camera, with the password that nobody is told.

use std::fmt;
use std::str::FromStr;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use http::Uri;
use http::header::HeaderValue;
use http::uri::Scheme;
use percent_encoding::percent_decode_str;

/// Where a real camera's pictures are: `http://[user:password@]host[:port]/path`, or `https`.
///
/// What it shows of itself has neither user nor password, and no query: many cameras take their password there.
///
/// ```
/// use mom_camera::SourceUrl;
///
/// let url: SourceUrl = "http://ann:secret@10.0.0.7:8080/video.mjpg?fps=5".parse()?;
/// assert_eq!(url.to_string(), "http://10.0.0.7:8080/video.mjpg?…");
/// assert!(!format!("{url:?}").contains("secret"));
/// # Ok::<(), mom_camera::BadUrl>(())
/// ```
#[derive(Clone, PartialEq, Eq)]
pub struct SourceUrl {
    uri: Uri,
    /// The value of `authorization`, if the URL names a user.
    authorization: Option<HeaderValue>,
}

/// What is wrong with the URL of a camera. It never quotes the URL, which may hold a password.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum BadUrl {
    /// It is not a URL.
    #[error(
        "this is not a URL ({0}); write http://host/path, and % codes for special characters in a password"
    )]
    Syntax(String),
    /// Another protocol.
    #[error("a camera's URL must begin with http:// or https://")]
    Scheme,
    /// A user or a password that cannot be sent.
    #[error(
        "user and password in the URL must be UTF-8 without control characters, and the user without a colon"
    )]
    Login,
}

impl SourceUrl {
    /// Whether it is reached by TLS.
    pub(crate) fn is_tls(&self) -> bool {
        self.uri.scheme() == Some(&Scheme::HTTPS)
    }

    /// The host without the brackets of IPv6.
    pub(crate) fn host(&self) -> &str {
        let host = self.uri.host().unwrap_or_default();
        host.trim_start_matches('[').trim_end_matches(']')
    }

    pub(crate) fn port(&self) -> u16 {
        let usual = if self.is_tls() { 443 } else { 80 };
        self.uri.port_u16().unwrap_or(usual)
    }

    /// Host and port as the request names them.
    pub(crate) fn host_header(&self) -> String {
        let host = self.uri.host().unwrap_or_default();
        match self.uri.port_u16() {
            Some(port) => format!("{host}:{port}"),
            None => host.to_owned(),
        }
    }

    /// Path and query as the request names them.
    pub(crate) fn target(&self) -> &str {
        self.uri.path_and_query().map_or("/", |target| target.as_str())
    }

    pub(crate) fn authorization(&self) -> Option<&HeaderValue> {
        self.authorization.as_ref()
    }
}

impl FromStr for SourceUrl {
    type Err = BadUrl;

    fn from_str(text: &str) -> Result<Self, BadUrl> {
        let uri: Uri = text
            .parse()
            .map_err(|error: http::uri::InvalidUri| BadUrl::Syntax(error.to_string()))?;
        if uri.scheme() != Some(&Scheme::HTTP) && uri.scheme() != Some(&Scheme::HTTPS) {
            return Err(BadUrl::Scheme);
        }
        let authority = uri.authority().map_or("", |authority| authority.as_str());
        if uri.host().is_none_or(str::is_empty) {
            return Err(BadUrl::Syntax("the address has no host".to_owned()));
        }
        // A port that is none is left out by the parser.
        let place = authority.rsplit('@').next().unwrap_or_default();
        if uri.port_u16().is_none() && !place.ends_with(uri.host().unwrap_or_default()) {
            return Err(BadUrl::Syntax(
                "its port is not a number from 0 to 65535".to_owned(),
            ));
        }
        let authorization = match authority.rsplit_once('@') {
            Some((login, _)) => Some(basic(login)?),
            None => None,
        };
        Ok(SourceUrl { uri, authorization })
    }
}

/// `Basic …` (RFC 7617) of `user:password` as it stands in a URL.
fn basic(login: &str) -> Result<HeaderValue, BadUrl> {
    let (user, password) = login.split_once(':').unwrap_or((login, ""));
    let decoded = |text: &str| {
        let text = percent_decode_str(text)
            .decode_utf8()
            .map_err(|_| BadUrl::Login)?;
        match text.chars().any(char::is_control) {
            true => Err(BadUrl::Login),
            false => Ok(text.into_owned()),
        }
    };
    let (user, password) = (decoded(user)?, decoded(password)?);
    if user.contains(':') {
        return Err(BadUrl::Login);
    }
    let value = format!("Basic {}", STANDARD.encode(format!("{user}:{password}")));
    let mut value = HeaderValue::try_from(value).map_err(|_| BadUrl::Login)?;
    value.set_sensitive(true);
    Ok(value)
}

impl fmt::Display for SourceUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = self.uri.scheme_str().unwrap_or_default();
        let query = if self.uri.query().is_some() { "?…" } else { "" };
        write!(f, "{scheme}://{}{}{query}", self.host_header(), self.uri.path())
    }
}

impl fmt::Debug for SourceUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SourceUrl({self})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(text: &str, expected: Result<(&str, u16, &str, Option<&str>), BadUrl>) {
        let got = text.parse::<SourceUrl>();
        match (&got, expected) {
            (Ok(url), Ok((host, port, target, login))) => {
                assert_eq!(
                    (url.host(), url.port(), url.target()),
                    (host, port, target),
                    "{text}"
                );
                let sent = login.map(|login| format!("Basic {}", STANDARD.encode(login)));
                let told = url
                    .authorization()
                    .map(|value| value.to_str().unwrap().to_owned());
                assert_eq!(told, sent, "{text}");
            }
            (Err(error), Err(expected)) => assert_eq!(*error, expected, "{text}"),
            (got, expected) => panic!("{text}: {got:?}, expected {expected:?}"),
        }
    }

    #[test]
    fn urls_are_read() {
        check("http://cam", Ok(("cam", 80, "/", None)));
        check("https://cam/a?b=c", Ok(("cam", 443, "/a?b=c", None)));
        check("http://[::1]:81/a", Ok(("::1", 81, "/a", None)));
        check(
            "http://ann:s%40c@cam:8080/",
            Ok(("cam", 8080, "/", Some("ann:s@c"))),
        );
        check("http://ann@cam/", Ok(("cam", 80, "/", Some("ann:"))));
        check("http://ann:a:b@cam/", Ok(("cam", 80, "/", Some("ann:a:b"))));
    }

    #[test]
    fn bad_urls_are_refused_without_a_quotation() {
        check("rtsp://cam/1", Err(BadUrl::Scheme));
        check("/dev/video0", Err(BadUrl::Scheme));
        check("http://a%3Ab:c@cam/", Err(BadUrl::Login));
        check("http://ann:%0a@cam/", Err(BadUrl::Login));
        check("http://ann:%ff@cam/", Err(BadUrl::Login));
        for text in [
            "http://",
            "http://ann:secret word@cam/",
            "http://ann:secret@/x",
            "http://ann:secret@cam:99999/",
        ] {
            let error = text.parse::<SourceUrl>().expect_err(text);
            assert!(!error.to_string().contains("secret"), "{error}");
        }
    }

    #[test]
    fn the_password_is_not_shown() {
        let url: SourceUrl = "http://ann:secret@cam:81/x?pwd=hidden".parse().unwrap();
        for shown in [
            url.to_string(),
            format!("{url:?}"),
            format!("{:?}", url.authorization()),
        ] {
            assert!(
                !shown.contains("secret") && !shown.contains("hidden") && !shown.contains("ann"),
                "{shown}"
            );
        }
    }
}
