//! The options of every command.

use std::path::PathBuf;

use clap::Args;
use clap::builder::FalseyValueParser;

/// Options of every command.
#[derive(Args, Debug)]
#[command(next_help_heading = "Options of every command")]
pub(crate) struct GlobalArgs {
    /// The hub: bin://HOST:PORT (binary) or tcp://HOST:PORT (XML), bins:// or tcps:// with TLS, which may end in
    /// ?pin=FINGERPRINT; a path after the port is that of commands which are given none
    #[arg(
        long,
        global = true,
        value_name = "ADDRESS",
        env = "MOM_HUB",
        default_value = "bin://127.0.0.1:7666"
    )]
    pub(crate) hub: String,
    /// Who you are
    #[arg(long, short, global = true, value_name = "NAME", env = "MOM_USER")]
    pub(crate) user: Option<String>,
    /// Prove it with the private key in this file, not with a password
    #[arg(long, global = true, value_name = "FILE", conflicts_with_all = ["jwt", "guest"])]
    pub(crate) key: Option<PathBuf>,
    /// Prove it with this certificate (PEM), whose private key --key names, to a hub over TLS
    #[arg(long, global = true, value_name = "FILE", requires = "key")]
    pub(crate) certificate: Option<PathBuf>,
    /// Prove it with the token (JWT) in this file, which names you
    #[arg(long, global = true, value_name = "FILE", conflicts_with = "guest")]
    pub(crate) jwt: Option<PathBuf>,
    /// Log in as a guest, where the hub lets guests in
    #[arg(long, global = true)]
    pub(crate) guest: bool,
    /// If the hub cannot be reached, report why to it by plain HTTP, which may get through; for mom logs
    #[arg(long, global = true, env = "MOM_REPORT", value_parser = FalseyValueParser::new())]
    pub(crate) report: bool,
    /// Compress messages in both directions where that pays; for slow links
    #[arg(long, global = true, env = "MOM_COMPRESS", value_parser = FalseyValueParser::new())]
    pub(crate) compress: bool,
    /// Write JSON, one object per line
    #[arg(long, global = true)]
    pub(crate) json: bool,
}
