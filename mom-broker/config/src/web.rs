//! What HTTP may ask.

use serde::Deserialize;

use mom_login::KeyFile;

use super::Network;

/// The `[web]` of the configuration.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct WebConfig {
    /// Where pages come from that may use the hub, beside its own.
    pub origins: Vec<String>,
    /// The proxies whose `Forwarded` is believed.
    pub forwarded_by: Vec<Network>,
    /// The token that `/metrics` is shown for, beside users who may ask for statistics.
    pub metrics_token: Option<KeyFile>,
    /// The channel in which the hub says what programs report of their errors; none = nothing is taken.
    pub log: Option<String>,
    /// Whether the console is served, if it was built in.
    pub console: bool,
}

impl Default for WebConfig {
    fn default() -> WebConfig {
        WebConfig {
            origins: Vec::new(),
            forwarded_by: Vec::new(),
            metrics_token: None,
            log: None,
            console: true,
        }
    }
}
