//! Which pages may use the hub.

use http::HeaderValue;

/// Origins, as browsers send them. A page whose host is the hub's own is not let in for that: its name may have been another
/// machine's a moment ago (DNS rebinding).
#[derive(Debug)]
pub(super) struct Origins(Vec<String>);

impl Origins {
    pub(super) fn new(named: &[String]) -> Origins {
        Origins(named.iter().map(|name| name.to_ascii_lowercase()).collect())
    }

    /// Whether pages of this origin may use the hub at this port. Those that this machine serves at the same port may: they are
    /// the hub's own.
    pub(super) fn allow(&self, origin: &HeaderValue, port: u16) -> bool {
        let Ok(origin) = origin.to_str() else { return false };
        let origin = origin.to_ascii_lowercase();
        let own = |host: &str| {
            ["http", "https"]
                .iter()
                .any(|scheme| origin == format!("{scheme}://{host}:{port}"))
        };
        self.0.contains(&origin) || ["localhost", "127.0.0.1", "[::1]"].into_iter().any(own)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_is_on_the_list_comes_in() {
        let origins = Origins::new(&["https://Lab.example.org".to_owned()]);
        for (origin, allowed) in [
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
        ] {
            assert_eq!(
                origins.allow(&HeaderValue::from_static(origin), 7666),
                allowed,
                "{origin}"
            );
        }
    }
}
