//! Whose a request is that a proxy brings (RFC 7239).

use std::net::{IpAddr, SocketAddr};

use http::header::{FORWARDED, HeaderMap, HeaderName, VIA};
use mom_config::Network;

use crate::connection::Remote;

const X_FORWARDED_FOR: HeaderName = HeaderName::from_static("x-forwarded-for");

/// Whose a request is that came over a connection. Only the proxies on the list are believed what they say of others; any other
/// that shows itself is taken for what the connection says, and is nobody of this machine.
pub(super) fn remote(connection: Remote, headers: &HeaderMap, believed: &[Network]) -> Remote {
    let is_believed = |address: IpAddr| believed.iter().any(|network| network.contains(address));
    let Some(near) = connection.from else {
        return connection;
    };
    let relayed = Remote {
        relayed: true,
        ..connection
    };
    if !is_believed(near) {
        let shown = [FORWARDED, VIA, X_FORWARDED_FOR]
            .iter()
            .any(|name| headers.contains_key(name));
        return if shown { relayed } else { connection };
    }
    let mut last = Remote {
        from: Some(near),
        ..relayed
    };
    let lines = headers.get_all(FORWARDED).into_iter();
    let lines: Result<Vec<&str>, _> = lines.map(|value| value.to_str()).collect();
    // A quote that nobody has closed may hold the proxy's own word, and what stands before it may be anybody's.
    let Some(lines) = lines
        .ok()
        .filter(|lines| lines.iter().all(|line| is_balanced(line)))
    else {
        return last;
    };
    let all = lines.join(",");
    // Each proxy adds itself at the end. What stands before one that is not on the list may be anybody's word.
    for element in split(&all, ',').into_iter().rev() {
        let pairs: Vec<(&str, String)> = split(element, ';').into_iter().filter_map(pair).collect();
        let value = |name: &str| {
            let mut found = pairs.iter().filter(|(key, _)| key.eq_ignore_ascii_case(name));
            found.next().map(|(_, value)| value.as_str())
        };
        let Some(from) = value("for").and_then(node) else {
            break;
        };
        last = Remote {
            from: Some(from),
            relayed: true,
            secured: value("proto").is_some_and(|proto| proto.eq_ignore_ascii_case("https")),
            ..connection
        };
        if !is_believed(from) {
            break;
        }
    }
    last
}

/// Where text is quoted, character by character.
#[derive(Clone, Copy, Debug, Default)]
struct Quotes {
    open: bool,
    escaped: bool,
}

impl Quotes {
    /// Takes the next character; whether it is quoted.
    fn take(&mut self, c: char) -> bool {
        let escaped = std::mem::take(&mut self.escaped);
        match c {
            '\\' if self.open && !escaped => self.escaped = true,
            '"' if !escaped => self.open = !self.open,
            _ => {}
        }
        self.open
    }
}

/// Splits where this stands outside of quotes.
fn split(text: &str, by: char) -> Vec<&str> {
    let mut quotes = Quotes::default();
    text.split(move |c| !quotes.take(c) && c == by).collect()
}

/// Whether each quote is closed.
fn is_balanced(text: &str) -> bool {
    let mut quotes = Quotes::default();
    for c in text.chars() {
        quotes.take(c);
    }
    !quotes.open
}

/// `key=value` or `key="value"`.
fn pair(text: &str) -> Option<(&str, String)> {
    let (key, value) = text.trim().split_once('=')?;
    let inside = value.strip_prefix('"').and_then(|value| value.strip_suffix('"'));
    Some((key, inside.unwrap_or(value).replace('\\', "")))
}

/// `192.0.2.1`, `192.0.2.1:80`, `[2001:db8::1]` or `[2001:db8::1]:80`; what hides itself is none.
fn node(text: &str) -> Option<IpAddr> {
    let inside = text.strip_prefix('[').and_then(|text| text.strip_suffix(']'));
    let address = text.parse().or_else(|_| inside.unwrap_or(text).parse()).ok();
    address.or_else(|| text.parse::<SocketAddr>().ok().map(|address| address.ip()))
}

#[cfg(test)]
mod tests {
    use http::HeaderValue;

    use super::*;

    fn from(address: &str) -> Remote {
        Remote {
            from: Some(address.parse().expect("an address")),
            ..Remote::default()
        }
    }

    #[test]
    fn only_the_proxies_of_the_list_are_believed() {
        let believed: Vec<Network> = ["127.0.0.1", "10.0.0.0/8"]
            .map(|text| text.parse().expect("a network"))
            .to_vec();
        let far = "192.0.2.60";
        for (near, said, from, secured) in [
            ("127.0.0.1", &["for=192.0.2.60"][..], far, false),
            ("127.0.0.1", &["for=192.0.2.60;proto=https"], far, true),
            (
                "127.0.0.1",
                &["For=\"192.0.2.60:4711\";Proto=HTTPS;by=203.0.113.43"],
                far,
                true,
            ),
            (
                "127.0.0.1",
                &["for=\"[2001:db8::17]:4711\""],
                "2001:db8::17",
                false,
            ),
            ("127.0.0.1", &["for=\"[2001:db8::17]\""], "2001:db8::17", false),
            // One that a client has written itself, before the proxy's own.
            (
                "127.0.0.1",
                &["for=127.0.0.1;proto=https, for=192.0.2.60"],
                far,
                false,
            ),
            ("127.0.0.1", &["for=127.0.0.1", "for=192.0.2.60"], far, false),
            (
                "127.0.0.1",
                &["for=192.0.2.60;proto=https, for=10.1.2.3"],
                far,
                true,
            ),
            (
                "127.0.0.1",
                &["for=\"_a,for=1.1.1.1\", for=192.0.2.60"],
                far,
                false,
            ),
            ("127.0.0.1", &["for=unknown;proto=https"], "127.0.0.1", false),
            ("127.0.0.1", &["192.0.2.60"], "127.0.0.1", false),
            ("127.0.0.1", &[""], "127.0.0.1", false),
            ("127.0.0.1", &[], "127.0.0.1", false),
            (
                "203.0.113.9",
                &["for=192.0.2.60;proto=https"],
                "203.0.113.9",
                false,
            ),
        ] {
            let mut headers = HeaderMap::new();
            for said in said {
                headers.append(FORWARDED, HeaderValue::from_static(said));
            }
            let found = remote(super::tests::from(near), &headers, &believed);
            assert_eq!(found.from, Some(from.parse().expect("an address")), "{said:?}");
            assert_eq!(found.secured, secured, "{said:?}");
            assert!(found.relayed, "{said:?}");
        }
    }

    #[test]
    fn a_quote_that_is_not_closed_has_nothing_believed() {
        let believed = ["127.0.0.1".parse().expect("a network")];
        for said in [
            &["for=1.1.1.1;proto=https;by=\"_a, for=192.0.2.60"][..],
            &["for=1.1.1.1;proto=https;by=\"_a", "for=192.0.2.60"],
            &["for=1.1.1.1;proto=https;by=\"_a\\\"", "for=192.0.2.60"],
            &["for=1.1.1.1;proto=https", "for=192.0.2.60;by=\u{fc}"],
        ] {
            let mut headers = HeaderMap::new();
            for said in said {
                let said = HeaderValue::from_bytes(said.as_bytes()).expect("a header may have it");
                headers.append(FORWARDED, said);
            }
            let found = remote(from("127.0.0.1"), &headers, &believed);
            let proxy = from("127.0.0.1").from;
            assert_eq!(
                (found.from, found.secured, found.relayed),
                (proxy, false, true),
                "{said:?}"
            );
        }
    }

    #[test]
    fn a_proxy_that_shows_itself_is_not_this_machine() {
        let mut headers = HeaderMap::new();
        assert!(!remote(from("127.0.0.1"), &headers, &[]).relayed);
        headers.insert(VIA, HeaderValue::from_static("1.1 squid"));
        let found = remote(from("127.0.0.1"), &headers, &[]);
        assert!(found.relayed && !found.secured);
    }
}
