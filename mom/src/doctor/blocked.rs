//! What stands in the way of a door (M58), and what to do about it.

use std::io::{self, ErrorKind};

use mom_client::NetError;

/// Why a door does not open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Blocked {
    /// Nobody knows the host's name.
    UnknownName(String),
    /// The host answers that nothing listens there.
    Refused,
    /// Nothing came for too long: at what.
    TimedOut(&'static str),
    /// There is no way to the host.
    Unreachable(String),
    /// The connection was cut.
    Reset,
    /// The connection was closed without a word.
    Closed,
    /// The hub shows a certificate that is not trusted: why, and its fingerprint.
    Untrusted(String, Option<String>),
    /// No handshake came about.
    Tls(String),
    /// The other side is not a MOM hub: what it is.
    NoHub(String),
    /// A hub answers, and does not take this: its words.
    NotTaken(String),
    /// A proxy lets nothing through, or something in between answers in the hub's place: what happens.
    Proxy(String),
    /// Anything else.
    Failed(String),
}

impl Blocked {
    /// What a failed link means.
    pub(crate) fn of(error: &NetError) -> Blocked {
        match error {
            NetError::Io(error) => Blocked::of_io(error),
            NetError::Wire(error) => Blocked::NotTaken(error.text.clone()),
            NetError::Address { .. } => Blocked::Failed(error.to_string()),
        }
    }

    /// What an error of the system means.
    pub(crate) fn of_io(error: &io::Error) -> Blocked {
        let text = error.to_string();
        match error.kind() {
            // Whatever it is, it is there and not at the hub.
            _ if text.starts_with("the proxy ") => Blocked::Proxy(text),
            ErrorKind::ConnectionRefused => Blocked::Refused,
            ErrorKind::TimedOut => Blocked::TimedOut("the connection"),
            ErrorKind::HostUnreachable | ErrorKind::NetworkUnreachable => Blocked::Unreachable(text),
            // A firewall of this machine.
            ErrorKind::PermissionDenied => Blocked::Unreachable(text),
            ErrorKind::ConnectionReset | ErrorKind::ConnectionAborted | ErrorKind::BrokenPipe => {
                Blocked::Reset
            }
            ErrorKind::UnexpectedEof => Blocked::Closed,
            ErrorKind::InvalidData if text.contains("certificate") => Blocked::Untrusted(text, None),
            ErrorKind::InvalidData if text.contains(NO_HUB) => Blocked::NoHub(
                text.split_once(NO_HUB)
                    .map_or(text.clone(), |(_, what)| what.to_owned()),
            ),
            ErrorKind::InvalidData => Blocked::Tls(text),
            _ => Blocked::Failed(text),
        }
    }

    /// What the first bytes of an answer mean that is not a parcel of this door.
    pub(crate) fn of_answer(said: &[u8]) -> Option<Blocked> {
        let text = String::from_utf8_lossy(said);
        let line = text.lines().next().unwrap_or_default().trim_end();
        let line: String = line.chars().take(SHOWN).collect();
        let lower = text.to_lowercase();
        Some(match said {
            [] => return None,
            // An alert, or a handshake.
            [0x15 | 0x16, 3, ..] => Blocked::NoHub("a server that speaks TLS only".to_owned()),
            // The hub's words in the form that people can read.
            _ if said.starts_with(b"Content-") => Blocked::NotTaken(words_of_hub(&text).unwrap_or(line)),
            _ if said.starts_with(b"HTTP/") => {
                let between = ["\nvia:", "proxy", "squid"]
                    .iter()
                    .any(|word| lower.contains(word));
                match between {
                    true => Blocked::Proxy(format!("something in between answers: {line}")),
                    false => Blocked::NoHub(format!("an HTTP server: {line}")),
                }
            }
            _ if said.starts_with(b"SSH-") => Blocked::NoHub(format!("an SSH server: {line}")),
            _ => Blocked::NoHub(format!("it says {line:?}")),
        })
    }

    /// The word for programs.
    pub(crate) fn word(&self) -> &'static str {
        match self {
            Blocked::UnknownName(_) => "unknown-name",
            Blocked::Refused => "refused",
            Blocked::TimedOut(_) => "timed-out",
            Blocked::Unreachable(_) => "unreachable",
            Blocked::Reset => "reset",
            Blocked::Closed => "closed",
            Blocked::Untrusted(..) => "not-trusted",
            Blocked::Tls(_) => "no-tls",
            Blocked::NoHub(_) => "no-hub",
            Blocked::NotTaken(_) => "not-taken",
            Blocked::Proxy(_) => "proxy",
            Blocked::Failed(_) => "failed",
        }
    }

    /// What it is, for people.
    pub(crate) fn text(&self) -> String {
        match self {
            Blocked::UnknownName(why) => format!("unknown name: {why}"),
            Blocked::Refused => "refused: nothing listens on this port".to_owned(),
            Blocked::TimedOut(what) => format!("timed out: {what} took too long"),
            Blocked::Unreachable(why) => format!("unreachable: {why}"),
            Blocked::Reset => "reset: the connection was cut".to_owned(),
            Blocked::Closed => "closed: the connection ended without an answer".to_owned(),
            Blocked::Untrusted(why, _) => format!("not trusted: {why}"),
            Blocked::Tls(why) => format!("no TLS: {why}"),
            Blocked::NoHub(what) => format!("not a MOM hub: {what}"),
            Blocked::NotTaken(why) => format!("not taken: the hub says: {why}"),
            Blocked::Proxy(said) => format!("proxy: {said}"),
            Blocked::Failed(why) => format!("failed: {why}"),
        }
    }

    /// What to do about it.
    pub(crate) fn hint(&self, hub: &str) -> String {
        match self {
            Blocked::UnknownName(_) => {
                "check the spelling of the host; where a proxy looks names up, name the hub by its number".to_owned()
            }
            Blocked::Refused => {
                "start a hub there (mom lab, mom-broker), or name its port: mom doctor HOST:PORT".to_owned()
            }
            Blocked::TimedOut(_) => {
                "a firewall may drop what goes to this port: ask who runs the network, or try another port".to_owned()
            }
            Blocked::Unreachable(_) => {
                "there is no route to the host: look at this machine's network, VPN and firewall".to_owned()
            }
            Blocked::Reset | Blocked::Closed => {
                "a firewall or another server cuts what it does not know: look at the hub's log whether it came there"
                    .to_owned()
            }
            Blocked::Untrusted(_, Some(shown)) => format!(
                "if the hub's log, or mom lab, prints {shown}, trust it by its fingerprint: mom doctor '{hub}?pin={shown}'"
            ),
            Blocked::Untrusted(_, None) => format!(
                "if nobody has signed its certificate, trust it by the fingerprint that the hub's log prints: \
                 mom doctor '{hub}?pin=FINGERPRINT'"
            ),
            Blocked::Tls(_) => "a hub speaks TLS where its configuration has [tls] with a certificate".to_owned(),
            Blocked::NoHub(_) => "another server listens there: name the hub's port, mom doctor HOST:PORT".to_owned(),
            Blocked::NotTaken(_) => {
                "use a door that is open, or change what the hub takes in its configuration".to_owned()
            }
            Blocked::Proxy(_) => {
                "ask who runs the network whether the proxy may let this through, or name the hub in NO_PROXY".to_owned()
            },
            Blocked::Failed(_) => "try again; if it stays so, look at the hub's log".to_owned(),
        }
    }
}

/// How an answer of HTTP is told of that is not a hub's.
const NO_HUB: &str = "what answers is not a hub: ";

/// How much of a foreign answer is shown.
const SHOWN: usize = 80;

/// The text of an error in XML.
fn words_of_hub(entity: &str) -> Option<String> {
    let (_, rest) = entity.split_once("<text")?;
    let (_, rest) = rest.split_once('>')?;
    let (text, _) = rest.split_once("</text>")?;
    let plain = [
        ("&lt;", "<"),
        ("&gt;", ">"),
        ("&quot;", "\""),
        ("&apos;", "'"),
        ("&amp;", "&"),
    ];
    let text = plain
        .iter()
        .fold(text.to_owned(), |text, (escape, sign)| text.replace(escape, sign));
    Some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_have_names() {
        for (kind, word) in [
            (ErrorKind::ConnectionRefused, "refused"),
            (ErrorKind::TimedOut, "timed-out"),
            (ErrorKind::HostUnreachable, "unreachable"),
            (ErrorKind::NetworkUnreachable, "unreachable"),
            (ErrorKind::ConnectionReset, "reset"),
            (ErrorKind::UnexpectedEof, "closed"),
            (ErrorKind::InvalidData, "no-tls"),
            (ErrorKind::Other, "failed"),
        ] {
            assert_eq!(Blocked::of_io(&io::Error::from(kind)).word(), word);
        }
        let untrusted = io::Error::new(ErrorKind::InvalidData, "invalid peer certificate: UnknownIssuer");
        assert_eq!(Blocked::of_io(&untrusted).word(), "not-trusted");
        let proxy = io::Error::new(ErrorKind::ConnectionRefused, "the proxy lab:3128: nobody listens");
        assert_eq!(
            Blocked::of_io(&proxy).text(),
            "proxy: the proxy lab:3128: nobody listens"
        );
    }

    #[test]
    fn answers_have_names() {
        for (said, text) in [
            (
                &b"SSH-2.0-OpenSSH_9.2\r\n"[..],
                "an SSH server: SSH-2.0-OpenSSH_9.2",
            ),
            (
                b"HTTP/1.1 400 Bad Request\r\nServer: nginx\r\n",
                "an HTTP server: HTTP/1.1 400 Bad Request",
            ),
            (
                b"HTTP/1.1 400 Bad Request\r\nVia: 1.1 gate\r\n",
                "proxy: something in between answers: HTTP/1.1 400",
            ),
            (b"HTTP/1.1 407 Proxy Authentication Required\r\n", "proxy: "),
            (b"\x15\x03\x01\x00\x02", "TLS only"),
            (b"220 mail\r\n", "it says \"220 mail\""),
            (b"\x1b[2J\0", "it says \"\\u{1b}[2J\\0\""),
            (
                b"Content-Length: 1\r\n\r\n<parcel><content type=\"map\"><text>no &lt;TLS&gt; here</text>",
                "not taken: the hub says: no <TLS> here",
            ),
        ] {
            let blocked = Blocked::of_answer(said).unwrap().text();
            assert!(blocked.contains(text), "{text}: {blocked}");
        }
        assert_eq!(Blocked::of_answer(b""), None);
    }
}
