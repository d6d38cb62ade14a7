//! The way to a hub: straight, or through the proxy that the environment names.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

use bytes::Bytes;
use http::header::{HOST, PROXY_AUTHORIZATION};
use http::{HeaderValue, Request, StatusCode, Uri};
use http_body_util::Empty;
use hyper_util::client::proxy::matcher::{Intercept, Matcher};
use tokio::net::TcpStream;

use crate::carrier::Carrier;
use crate::tls::TlsLink;
use crate::{Address, ClientTls, Door, NetError, http as http_door};

/// The name of this machine everywhere (RFC 6761).
const LOCALHOST: &str = "localhost";

/// How a hub is reached.
#[derive(Debug)]
pub(crate) struct Dialer {
    pub(crate) address: Address,
    tls: Option<ClientTls>,
    proxy: Option<Proxy>,
}

/// What stands between.
#[derive(Debug)]
struct Proxy {
    host: String,
    port: u16,
    authorization: Option<HeaderValue>,
}

impl Dialer {
    /// Where `HTTPS_PROXY` names a proxy, and `NO_PROXY` does not name the hub, every door with TLS goes through it; where
    /// `HTTP_PROXY` does, the tunnel without TLS.
    pub(crate) fn to(address: &Address, tls: Option<&ClientTls>) -> Result<Dialer, NetError> {
        let tls = match (address.tls, tls) {
            (false, _) => None,
            (true, Some(tls)) => Some(tls.clone()),
            (true, None) => return Err(io::Error::from(io::ErrorKind::Unsupported).into()),
        };
        Ok(Dialer {
            address: address.clone(),
            tls,
            proxy: Proxy::of(address)?,
        })
    }

    /// Connects, with TLS if the address says so.
    pub(crate) async fn dial(&self) -> Result<Carrier, NetError> {
        let address = &self.address;
        let stream = match &self.proxy {
            // Whatever a resolver makes of this name.
            None if address.host.eq_ignore_ascii_case(LOCALHOST) => {
                let here = [IpAddr::from(Ipv4Addr::LOCALHOST), Ipv6Addr::LOCALHOST.into()];
                let here = here.map(|ip| SocketAddr::new(ip, address.port));
                TcpStream::connect(&here[..]).await?
            }
            None => TcpStream::connect((address.host.as_str(), address.port)).await?,
            Some(proxy) => proxy.connect().await?,
        };
        let mut carrier = Carrier::Tcp(stream);
        let Some(tls) = &self.tls else {
            return Ok(carrier);
        };
        if let Some(proxy) = &self.proxy {
            carrier = proxy.pass(carrier, &address.authority()).await?;
        }
        let Carrier::Tcp(stream) = carrier else {
            return Err(io::Error::from(io::ErrorKind::Unsupported).into());
        };
        let client = tls.connection(&address.host)?;
        Ok(Carrier::Tls(
            TlsLink::handshake(stream, client.into(), &[]).await?,
        ))
    }

    /// Why a request was not answered by a hub, with the name of a proxy that may have answered in its place.
    pub(crate) fn named(&self, error: io::Error) -> io::Error {
        match &self.proxy {
            Some(proxy) if self.tls.is_none() && error.kind() == io::ErrorKind::InvalidData => {
                proxy.named(&error)
            }
            _ => error,
        }
    }

    /// The target of a request for this path, in the form that its receiver requires, and what the proxy has to be shown.
    pub(crate) fn target(&self, path: &str) -> (String, Option<HeaderValue>) {
        match &self.proxy {
            // It takes requests as such, not the bytes of a connection.
            Some(proxy) if self.tls.is_none() => {
                let whole = format!("http://{}{path}", self.address.authority());
                (whole, proxy.authorization.clone())
            }
            _ => (path.to_owned(), None),
        }
    }
}

impl Address {
    /// The proxy that a connection there goes through, as `HOST:PORT`, if the environment names one for this door.
    ///
    /// # Errors
    /// `Io` for a proxy that speaks no HTTP.
    pub fn proxy(&self) -> Result<Option<String>, NetError> {
        Ok(Proxy::of(self)?.map(|proxy| proxy.name()))
    }

    /// Whether nobody between could read what is said there: it has TLS, or it is on this machine and no proxy is between. A name
    /// is another machine, even if it is not now, except `localhost`, which is never looked up.
    pub fn is_private(&self) -> bool {
        let here = match self.host.parse::<IpAddr>() {
            Ok(ip) => ip.to_canonical().is_loopback(),
            Err(_) => self.host.eq_ignore_ascii_case(LOCALHOST),
        };
        self.tls || (here && matches!(Proxy::of(self), Ok(None)))
    }
}

impl Proxy {
    fn of(address: &Address) -> Result<Option<Proxy>, NetError> {
        if !address.tls && !matches!(address.door, Door::Tunnel { .. }) {
            return Ok(None);
        }
        let scheme = if address.tls { "https" } else { "http" };
        let target: Result<Uri, _> = format!("{scheme}://{}/", address.authority()).parse();
        let Ok(target) = target else { return Ok(None) };
        let Some(found) = Matcher::from_env().intercept(&target) else {
            return Ok(None);
        };
        Proxy::read(&found).map(Some).ok_or_else(|| {
            let text = format!(
                "the proxy {} of the environment is not an HTTP proxy",
                found.uri()
            );
            io::Error::new(io::ErrorKind::InvalidInput, text).into()
        })
    }

    fn read(found: &Intercept) -> Option<Proxy> {
        let uri = found.uri();
        if uri.scheme_str().is_some_and(|scheme| scheme != "http") {
            return None;
        }
        let host = uri.host()?.trim_start_matches('[').trim_end_matches(']');
        Some(Proxy {
            host: host.to_owned(),
            port: uri.port_u16().unwrap_or(80),
            authorization: found.basic_auth().cloned(),
        })
    }

    async fn connect(&self) -> io::Result<TcpStream> {
        let connected = TcpStream::connect((self.host.as_str(), self.port)).await;
        connected.map_err(|error| self.named(&error))
    }

    /// Has the proxy pass a connection on.
    async fn pass(&self, carrier: Carrier, to: &str) -> io::Result<Carrier> {
        let mut request = Request::connect(to).header(HOST, to);
        if let Some(authorization) = &self.authorization {
            request = request.header(PROXY_AUTHORIZATION, authorization);
        }
        let request = request.body(Empty::<Bytes>::new()).map_err(io::Error::other)?;
        // What it says itself is a page for people.
        let refused = |status, _: &[u8]| io::Error::other(why(status, to));
        match http_door::switch(carrier, request, StatusCode::OK, refused).await {
            Ok((_, carrier, _)) => Ok(carrier),
            Err(error) => Err(self.named(&error)),
        }
    }

    /// An error with the proxy's name in front.
    fn named(&self, error: &io::Error) -> io::Error {
        let text = format!("the proxy {}: {error}", self.name());
        io::Error::new(error.kind(), text)
    }

    fn name(&self) -> String {
        match self.host.contains(':') {
            true => format!("[{}]:{}", self.host, self.port),
            false => format!("{}:{}", self.host, self.port),
        }
    }
}

/// Why a proxy passes no connection on.
fn why(status: StatusCode, to: &str) -> String {
    let why = match status {
        StatusCode::PROXY_AUTHENTICATION_REQUIRED => {
            "it requires a password; set HTTPS_PROXY=http://USER:PASSWORD@HOST:PORT".to_owned()
        }
        StatusCode::BAD_GATEWAY | StatusCode::SERVICE_UNAVAILABLE | StatusCode::GATEWAY_TIMEOUT => {
            format!("it does not reach {to}")
        }
        _ => format!("it does not allow connections to {to}"),
    };
    format!("{why} (it answers {status})")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_could_read_along() {
        for (address, private) in [
            ("bins://lab.example.org", true),
            ("https://192.0.2.1", true),
            ("bin://127.0.0.1", true),
            ("tcp://127.9.9.9:1", true),
            ("ws://[::1]", true),
            ("json://[::ffff:127.0.0.1]", true),
            ("ws://LocalHost:1", true),
            ("mom://lab.example.org", false),
            ("bin://192.0.2.1", false),
            ("tcp://0.0.0.0", false),
            ("ws://[::]", false),
            ("http://127.1", false),
            ("bin://127.0.0.1.example.org", false),
            ("bin://localhost.example.org", false),
            ("json://[::ffff:192.0.2.1]", false),
        ] {
            let address: Address = address.parse().expect("an address");
            assert_eq!(address.is_private(), private, "{address}");
        }
    }
}
