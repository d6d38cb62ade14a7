//! Which pages may use the hub.

use std::net::{IpAddr, SocketAddr};

use http::HeaderValue;

/// Hosts that are this machine, whatever a name server says.
const HERE: [&str; 3] = ["localhost", "127.0.0.1", "[::1]"];

/// The longest origin that is repeated to who sent it.
const LONGEST: usize = 300;

/// Origins, as browsers send them. A page whose host is a name of the hub's own is not let in for that: the name may have been
/// another machine's a moment ago (DNS rebinding).
#[derive(Debug)]
pub(super) struct Origins(Vec<String>);

impl Origins {
    pub(super) fn new(named: &[String]) -> Origins {
        Origins(named.iter().map(|name| name.to_ascii_lowercase()).collect())
    }

    /// Whether pages of this origin may use the hub by a connection that has come to this address. The hub's own may: those that this
    /// machine serves at the same port, and those that were opened by the address itself, which no name server can give to another.
    pub(super) fn allow(&self, origin: &HeaderValue, local: SocketAddr) -> bool {
        let Ok(origin) = origin.to_str() else { return false };
        let origin = origin.to_ascii_lowercase();
        let own = |(host, port): (&str, u16)| {
            let address = ip(host).is_some_and(|ip| ip.to_canonical() == local.ip().to_canonical());
            port == local.port() && (HERE.contains(&host) || address)
        };
        self.0.contains(&origin) || parts(&origin).is_some_and(own)
    }

    /// What is said to pages that may not.
    pub(super) fn refusal(origin: &HeaderValue) -> String {
        let origin = origin.to_str().unwrap_or_default().to_ascii_lowercase();
        // In quotes, for a file: nothing that would end them.
        let plain = |byte: u8| byte.is_ascii_alphanumeric() || b".:-_[]".contains(&byte);
        let named = parts(&origin).is_some_and(|(host, _)| !host.is_empty() && host.bytes().all(plain));
        match named && origin.len() <= LONGEST {
            true => format!(
                "pages of {origin} may not use this hub; its owner can let them in by this line below [web] of its configuration, or \
                 by one more entry of that list: origins = [\"{origin}\"]"
            ),
            false => {
                "pages of this origin may not use this hub; its owner can add it to [web] origins".to_owned()
            }
        }
    }
}

/// Host and port of an origin.
fn parts(origin: &str) -> Option<(&str, u16)> {
    let (place, usual) = match origin.strip_prefix("http://") {
        Some(place) => (place, 80),
        None => (origin.strip_prefix("https://")?, 443),
    };
    let host = place.rfind(']').map_or(0, |end| end + 1);
    let Some(colon) = place[host..].find(':') else {
        return Some((place, usual));
    };
    let (host, port) = place.split_at(host + colon);
    let port = &port[1..];
    let digits = !port.is_empty() && port.bytes().all(|byte| byte.is_ascii_digit());
    Some((host, port.parse().ok().filter(|_| digits)?))
}

/// The address that a host is by itself; none if it is a name.
fn ip(host: &str) -> Option<IpAddr> {
    match host.strip_prefix('[') {
        Some(rest) => rest.strip_suffix(']')?.parse().ok().map(IpAddr::V6),
        None => host.parse().ok().map(IpAddr::V4),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(origins: &Origins, local: &str, table: &[(&'static str, bool)]) {
        let local = local.parse().expect("an address");
        for (origin, allowed) in table {
            let said = origins.allow(&HeaderValue::from_static(origin), local);
            assert_eq!(said, *allowed, "{origin} at {local}");
        }
    }

    #[test]
    fn who_is_on_the_list_comes_in() {
        let origins = Origins::new(&["https://Lab.example.org".to_owned()]);
        let table = [
            ("https://lab.example.org", true),
            ("http://lab.example.org", false),
            ("https://lab.example.org:444", false),
            ("https://lab.example.org.evil.net", false),
            ("http://localhost:7666", true),
            ("http://127.0.0.1:7666", true),
            ("https://[::1]:7666", true),
            ("http://localhost:8080", false),
            ("http://rebound.example.net:7666", false),
            ("null", false),
        ];
        check(&origins, "127.0.0.1:7666", &table);
    }

    #[test]
    fn a_page_opened_by_the_hubs_own_address_comes_in() {
        let origins = Origins::new(&[]);
        let table = [
            ("http://192.168.1.5:7666", true),
            ("https://192.168.1.5:7666", true),
            ("http://localhost:7666", true),
            ("http://[::ffff:192.168.1.5]:7666", true),
            ("http://192.168.1.5", false),
            ("http://192.168.1.5:7667", false),
            ("http://192.168.1.5:", false),
            ("http://192.168.1.5:+7666", false),
            ("http://192.168.1.5:7666/", false),
            ("http://192.168.1.6:7666", false),
            ("http://0.0.0.0:7666", false),
            ("http://[192.168.1.5]:7666", false),
            ("http://192.168.1.5.example.net:7666", false),
            ("http://192.168.1.005:7666", false),
            ("http://me@192.168.1.5:7666", false),
            ("ftp://192.168.1.5:7666", false),
            ("192.168.1.5:7666", false),
            ("http://192.168.1.5:7666, http://evil.example.net", false),
        ];
        check(&origins, "192.168.1.5:7666", &table);
        check(&origins, "[::ffff:192.168.1.5]:7666", &table);
        let table = [
            ("http://[2001:db8::5]:80", true),
            ("http://[2001:db8::5]", true),
            ("http://[2001:DB8:0::5]", true),
            ("http://localhost", true),
            ("https://[2001:db8::5]", false),
            ("http://[2001:db8::6]", false),
            ("http://2001:db8::5", false),
            ("http://[2001:db8::5", false),
            ("http://[2001:db8::5]x", false),
        ];
        check(&origins, "[2001:db8::5]:80", &table);
    }

    #[test]
    fn a_refusal_names_the_line_that_is_missing() {
        for (origin, line) in [
            ("http://lab.local:7666", true),
            ("https://Lab.example.org", true),
            ("http://[2001:db8::5]:7666", true),
            ("null", false),
            ("http://", false),
            ("http://a\"]", false),
            ("chrome-extension://abc", false),
        ] {
            let text = Origins::refusal(&HeaderValue::from_static(origin));
            let wanted = format!("origins = [\"{}\"]", origin.to_ascii_lowercase());
            assert_eq!(text.ends_with(&wanted), line, "{text}");
        }
    }
}
