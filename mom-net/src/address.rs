//! Addresses of hubs (M21).

use std::fmt;

use mom_proto::codec::Form;
use mom_proto::{BadFingerprint, Fingerprint, Path};

use crate::NetError;

/// The port of the hub where an address names none.
const DEFAULT_PORT: u16 = 7666;

/// Where a hub is and how to speak to it: `tcp://host:port/path` for XML, `bin://…` for binary, `json://…` for JSON, `mom://…` for
/// whichever [door](Address::doors) opens, in the binary form; `ws://…` for a WebSocket and `http://…` for a tunnel,
/// both binary unless `?form=` says another. With TLS `tcps://…`, `bins://…`, `jsons://…`, `moms://…`, `wss://…` and
/// `https://…`, which may end in `?pin=` and the fingerprint of the hub's certificate.
///
/// ```
/// use mom_net::Address;
/// let address: Address = "tcp://127.0.0.1/robot".parse().unwrap();
/// assert_eq!((address.port, address.path.unwrap().as_str()), (7666, "/robot"));
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// The form to speak.
    pub form: Form,
    /// What carries it over the network.
    pub door: Door,
    /// With TLS.
    pub tls: bool,
    /// A name or number of the host.
    pub host: String,
    /// The TCP port.
    pub port: u16,
    /// A context at that hub, if the address names one.
    pub path: Option<Path>,
    /// The certificate that the hub has to show.
    pub pin: Option<Fingerprint>,
    /// Any door will do, and `door` is the one to try first.
    pub any: bool,
    /// The port is the address's own, and not the usual one.
    pub port_named: bool,
}

/// What carries a form over the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Door {
    /// The connection itself.
    Stream,
    /// A WebSocket.
    WebSocket,
    /// Requests of HTTP.
    Tunnel {
        /// Each is answered as a whole, as behind a proxy that waits for the end of answers.
        polled: bool,
    },
}

impl Door {
    /// Its word in reports.
    pub fn word(self) -> &'static str {
        match self {
            Door::Stream => "tcp",
            Door::WebSocket => "websocket",
            Door::Tunnel { .. } => "tunnel",
        }
    }
}

impl Address {
    /// The doors to try, the best first: one, or of `mom://` all that may be open. On this machine the shortest way is first, from
    /// elsewhere those with TLS are; none of `moms://` is without. With a `secret` none where others could read it. A port that is named is
    /// that of all, as a hub takes all of them at one port; else WebSocket and tunnel have the ports of the web.
    ///
    /// ```
    /// use mom_net::Address;
    /// let doors = |text: &str, secret| {
    ///     let doors = text.parse::<Address>().unwrap().doors(secret);
    ///     doors.iter().map(Address::to_string).collect::<Vec<_>>().join(" ")
    /// };
    /// assert_eq!(doors("mom://lab.example", true), "bins://lab.example:7666 wss://lab.example:443 https://lab.example:443");
    /// assert_eq!(
    ///     doors("mom://lab.example:1", false),
    ///     "bins://lab.example:1 wss://lab.example:1 https://lab.example:1 bin://lab.example:1 ws://lab.example:1"
    /// );
    /// assert_eq!(
    ///     doors("mom://[::1]:1", true),
    ///     "bin://[::1]:1 ws://[::1]:1 http://[::1]:1 bins://[::1]:1 wss://[::1]:1 https://[::1]:1"
    /// );
    /// assert_eq!(doors("bin://lab.example", false), "bin://lab.example:7666");
    /// ```
    pub fn doors(&self, secret: bool) -> Vec<Address> {
        if !self.any {
            return vec![self.clone()];
        }
        let kinds = [Door::Stream, Door::WebSocket, TUNNEL];
        let with = |tls: bool| kinds.map(|door| (door, tls));
        let here = Address {
            tls: false,
            ..self.clone()
        };
        let ways = match here.is_private() {
            true => [with(false), with(true)].concat(),
            // Anyone who sees the id of a tunnel could take it over.
            false => [&with(true)[..], &with(false)[..2]].concat(),
        };
        let address = |(door, tls): (Door, bool)| Address {
            door,
            tls,
            port: match (self.port_named || door == Door::Stream, tls) {
                (true, _) => self.port,
                (false, true) => 443,
                (false, false) => 80,
            },
            pin: self.pin.filter(|_| tls),
            any: false,
            ..self.clone()
        };
        let permitted = |address: &Address| (address.tls || !self.tls) && (!secret || address.is_private());
        ways.into_iter().map(address).filter(permitted).collect()
    }

    /// Host and port, as HTTP wants them.
    pub(crate) fn authority(&self) -> String {
        match self.host.contains(':') {
            true => format!("[{}]:{}", self.host, self.port),
            false => format!("{}:{}", self.host, self.port),
        }
    }
}

impl std::str::FromStr for Address {
    type Err = NetError;

    fn from_str(text: &str) -> Result<Address, NetError> {
        read(text).map_err(|why| NetError::Address {
            text: text.to_owned(),
            why,
        })
    }
}

const TUNNEL: Door = Door::Tunnel { polled: false };

/// One way to speak to a hub.
struct Scheme {
    name: &'static str,
    /// The form where the address names none.
    form: Form,
    door: Door,
    tls: bool,
    /// The port where the address names none.
    port: u16,
    /// Any door will do.
    any: bool,
}

const fn scheme(name: &'static str, form: Form, door: Door, tls: bool, port: u16) -> Scheme {
    Scheme {
        name,
        form,
        door,
        tls,
        port,
        any: false,
    }
}

/// Of any door, in the binary form.
const fn any_door(name: &'static str, tls: bool) -> Scheme {
    Scheme {
        any: true,
        ..scheme(name, Form::Binary, Door::Stream, tls, DEFAULT_PORT)
    }
}

/// Of those that are alike, the first is how an address is written.
const SCHEMES: [Scheme; 12] = [
    scheme("tcp", Form::Xml, Door::Stream, false, DEFAULT_PORT),
    scheme("tcps", Form::Xml, Door::Stream, true, DEFAULT_PORT),
    scheme("bin", Form::Binary, Door::Stream, false, DEFAULT_PORT),
    scheme("bins", Form::Binary, Door::Stream, true, DEFAULT_PORT),
    scheme("json", Form::Json, Door::Stream, false, DEFAULT_PORT),
    scheme("jsons", Form::Json, Door::Stream, true, DEFAULT_PORT),
    any_door("mom", false),
    any_door("moms", true),
    scheme("ws", Form::Binary, Door::WebSocket, false, 80),
    scheme("wss", Form::Binary, Door::WebSocket, true, 443),
    scheme("http", Form::Binary, TUNNEL, false, 80),
    scheme("https", Form::Binary, TUNNEL, true, 443),
];

/// Reads an address, or says what is wrong with it.
fn read(text: &str) -> Result<Address, String> {
    let (name, rest) = text
        .split_once("://")
        .ok_or("the address must begin with bin:// or tcp://")?;
    let known = SCHEMES.iter().find(|scheme| scheme.name == name);
    let scheme = known.ok_or_else(|| format!("{name}:// is not a scheme of a hub"))?;
    let (door, tls) = (scheme.door, scheme.tls);
    let (rest, query) = rest.split_once('?').unwrap_or((rest, ""));
    let (mut door, mut form, mut pin) = (door, scheme.form, None);
    for part in query.split('&').filter(|part| !part.is_empty()) {
        match part.split_once('=') {
            Some(("pin", _)) if !tls && !scheme.any => {
                return Err(format!("a fingerprint requires TLS: {name}s://"));
            }
            Some(("pin", text)) => pin = Some(read_pin(text)?),
            Some(("form", _)) if door == Door::Stream => {
                return Err(format!(
                    "{name}:// implies its form; other forms have their own schemes"
                ));
            }
            Some(("poll", "1")) if door == TUNNEL => door = Door::Tunnel { polled: true },
            Some(("form", text)) => form = read_form(text, door)?,
            _ => {
                return Err(
                    "after ? only pin= with a fingerprint or form= with a form may follow".to_owned(),
                );
            }
        }
    }
    let (authority, path) = match rest.find('/') {
        Some(at) if rest.len() > at + 1 => {
            let path = Path::parse(&rest[at..]);
            let path = path.map_err(|error| format!("its path is invalid: {}", error.text))?;
            (&rest[..at], Some(path))
        }
        Some(at) => (&rest[..at], None),
        None => (rest, None),
    };
    // A colon inside brackets belongs to an IPv6 address.
    let (host, port, port_named) = match authority.rsplit_once(':') {
        Some((host, port)) if !port.ends_with(']') => (host, read_port(port)?, true),
        _ => (authority, scheme.port, false),
    };
    let inside = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    let named = |c: char| c.is_alphanumeric() || matches!(c, '-' | '.' | '_');
    match (inside, host) {
        (None, "") => Err("the address has no host".to_owned()),
        (None, _) if host.contains(':') => Err("write an IPv6 address in brackets, as [::1]".to_owned()),
        (None, _) if !host.chars().all(named) => Err(format!("{host:?} is not a host name")),
        (Some(inside), _) if !inside.contains(':') => {
            Err("brackets are for IPv6 addresses, as [::1]".to_owned())
        }
        _ => Ok(Address {
            form,
            door,
            tls,
            host: inside.unwrap_or(host).to_owned(),
            port,
            path,
            pin,
            any: scheme.any,
            port_named,
        }),
    }
}

/// Reads a fingerprint, or says what is wrong with it.
fn read_pin(text: &str) -> Result<Fingerprint, String> {
    text.parse().map_err(|error: BadFingerprint| error.to_string())
}

/// Reads the word of a form, or says what is wrong with it.
fn read_form(text: &str, door: Door) -> Result<Form, String> {
    let known = |form: &Form| form.word() == text && (door != Door::WebSocket || *form != Form::Xml);
    let found = Form::ALL.into_iter().find(known);
    found.ok_or_else(|| format!("{text:?} is not a form that this door carries"))
}

/// Reads a port, or says what is wrong with it.
fn read_port(text: &str) -> Result<u16, String> {
    match text {
        "" => Err("its port is missing after the colon".to_owned()),
        _ => text
            .parse()
            .map_err(|_| format!("a port must be a number from 0 to 65535, not {text:?}")),
    }
}

impl fmt::Display for Address {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let polled = matches!(self.door, Door::Tunnel { polled: true });
        let door = if polled { TUNNEL } else { self.door };
        let same = |scheme: &&Scheme| {
            let carried = (scheme.door, scheme.tls, scheme.any) == (door, self.tls, self.any);
            carried && (self.door != Door::Stream || scheme.form == self.form)
        };
        let scheme = SCHEMES.iter().find(same).unwrap_or(&SCHEMES[0]);
        let name = scheme.name;
        match self.host.contains(':') {
            true => write!(formatter, "{name}://[{}]:{}", self.host, self.port)?,
            false => write!(formatter, "{name}://{}:{}", self.host, self.port)?,
        }
        if let Some(path) = &self.path {
            path.fmt(formatter)?;
        }
        let mut mark = '?';
        if scheme.form != self.form {
            write!(formatter, "{mark}form={}", self.form.word())?;
            mark = '&';
        }
        if polled {
            write!(formatter, "{mark}poll=1")?;
            mark = '&';
        }
        match &self.pin {
            Some(pin) => write!(formatter, "{mark}pin={pin}"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses() {
        for (text, shown) in [
            ("tcp://127.0.0.1:7666", "tcp://127.0.0.1:7666"),
            ("bin://lab", "bin://lab:7666"),
            ("mom://lab:1/robot/arm", "mom://lab:1/robot/arm"),
            ("tcp://[::1]:5/", "tcp://[::1]:5"),
            ("tcp://[::1]", "tcp://[::1]:7666"),
            ("tcps://lab", "tcps://lab:7666"),
            ("moms://lab/robot", "moms://lab:7666/robot"),
            ("json://lab/robot", "json://lab:7666/robot"),
            ("jsons://[::1]:5", "jsons://[::1]:5"),
            ("wss://lab", "wss://lab:443"),
            ("ws://lab?form=json", "ws://lab:80?form=json"),
            ("http://lab/robot?form=xml", "http://lab:80/robot?form=xml"),
            ("https://lab:1?poll=1", "https://lab:1?poll=1"),
            (
                "moms://lab/robot?pin=4355a46b19d348dc2f57c046f8ef63d4538ebb936000f3c9ee954a27460dd865",
                "moms://lab:7666/robot?pin=sha256:4355a46b19d348dc2f57c046f8ef63d4538ebb936000f3c9ee954a27460dd865",
            ),
        ] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), shown);
        }
        for (bad, why) in [
            ("", "begin with"),
            ("lab:7666", "begin with"),
            ("ftp://lab", "ftp://"),
            ("ws://lab?form=xml", "not a form"),
            ("bin://lab?form=xml", "their own schemes"),
            ("tcp://", "no host"),
            ("tcp://:1", "no host"),
            ("tcp://lab:", "port is missing"),
            ("tcp://lab:x", "from 0 to 65535"),
            ("tcp://lab:70000", "from 0 to 65535"),
            ("tcp://l//x", "path"),
            ("bin://no host:1", "not a host name"),
            ("bin://alice@lab:1", "not a host name"),
            ("bin://::1:7666", "brackets"),
            ("bin://[lab]:7666", "brackets"),
            ("bins://lab?pin=12", "64 hexadecimal digits"),
            ("bins://lab?name=12", "pin="),
            ("bin://lab?pin=12", "bins://"),
        ] {
            let error = bad.parse::<Address>().unwrap_err().to_string();
            assert!(error.contains(why), "{bad}: {error}");
        }
    }
}
