//! Where the hub is, and who logs in there.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, anyhow};
use clap::Args;
use mom_client::{Builder, Client, Identity, Key, Proof};

use crate::installation::installation;

/// For how long the hub keeps the peer's place when the connection is lost.
const GRACE: Duration = Duration::from_secs(30);

/// The options of the hub and the login, for `#[command(flatten)]`; `#[command(mut_arg("user", …))]` gives the user a default.
#[derive(Debug, Args)]
pub struct HubArgs {
    /// The hub, as bin://host:port (binary) or tcp://host:port (XML), bins:// or tcps:// with TLS, which may end in ?pin=FINGERPRINT
    #[arg(long, env = "MOM_HUB", default_value = "bin://127.0.0.1:7666")]
    pub hub: String,
    /// If the hub cannot be reached, report why to it by plain HTTP, which may get through; for mom logs
    #[arg(long, env = "MOM_REPORT", value_parser = clap::builder::FalseyValueParser::new())]
    report: bool,
    /// The user to log in as
    #[arg(long)]
    user: Option<String>,
    /// A file whose first line is the password
    #[arg(long, value_name = "FILE", conflicts_with = "key")]
    password_file: Option<PathBuf>,
    /// A file with the private key of the user, as mom keygen makes it; it needs no password
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// A certificate of the user (PEM), whose private key --key names, for a hub over TLS
    #[arg(long, value_name = "FILE", requires = "key")]
    certificate: Option<PathBuf>,
    /// How often hub and program say that they are there, in ms, from 100 to 10000: a link that is silent for three times as long is
    /// lost, and whatever moves halts
    #[arg(long, value_name = "MS", default_value = "500", value_parser = clap::value_parser!(u64).range(100..=10_000))]
    heartbeat: u64,
}

impl HubArgs {
    /// Who logs in.
    #[must_use]
    pub fn user(&self) -> &str {
        self.user.as_deref().unwrap_or_default()
    }

    /// The user to log in as where the options name none.
    pub fn or_user(&mut self, user: &str) {
        self.user.get_or_insert_with(|| user.to_owned());
    }

    /// A login as the options say, which waits for a hub. With `--report`, its failures are told as those of `program`.
    ///
    /// # Errors
    ///
    /// No password, or a file that cannot be read.
    pub fn login(&self, program: &str, version: &str) -> anyhow::Result<Builder> {
        let builder = Client::builder(&self.hub)
            .user(self.user())
            .proof(self.proof()?)
            .heartbeat(Duration::from_millis(self.heartbeat))
            .wait_for_hub();
        let builder = match installation() {
            Some(id) => builder.installation(&id),
            None => builder,
        };
        Ok(match self.report {
            true => builder.report_failures(program, version),
            false => builder,
        })
    }

    /// Connects a device, whose place the hub keeps for 30 s when its connection is lost; none if the program is to end first.
    ///
    /// # Errors
    ///
    /// A login that the hub refuses.
    pub async fn connect(
        &self,
        builder: Builder,
        shutdown: impl Future<Output = ()>,
    ) -> anyhow::Result<Option<Client>> {
        let connected = tokio::select! {
            connected = builder.link(GRACE).connect() => connected,
            () = shutdown => return Ok(None),
        };
        let client = connected.with_context(|| format!("{} cannot log in at {}", self.user(), self.hub))?;
        Ok(Some(client))
    }

    /// Authenticates by key if there is one.
    fn proof(&self) -> anyhow::Result<Proof> {
        match (&self.key, &self.certificate) {
            (Some(key), Some(certificate)) => Ok(Proof::Certificate(Identity {
                certificate: certificate.clone(),
                key: key.clone(),
            })),
            (Some(file), None) => Ok(Proof::Key(Key::from_file(file).context("--key")?)),
            (None, _) => self.password().map(Proof::Password),
        }
    }

    fn password(&self) -> anyhow::Result<String> {
        let Some(file) = &self.password_file else {
            return std::env::var("MOM_PASSWORD")
                .map_err(|_| anyhow!("set MOM_PASSWORD, or name a file with --password-file or --key"));
        };
        let text =
            std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
        Ok(text.lines().next().unwrap_or_default().to_owned())
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    #[command(mut_arg("user", |user| user.default_value("arm")))]
    struct Program {
        #[command(flatten)]
        hub: HubArgs,
    }

    fn read(args: &[&str]) -> HubArgs {
        let args = ["program"].iter().chain(args);
        Program::try_parse_from(args).expect("they are right").hub
    }

    #[test]
    fn a_program_names_its_own_user() {
        assert_eq!(read(&[]).user(), "arm");
        let mut named = read(&["--user", "alice"]);
        named.or_user("rover");
        assert_eq!(named.user(), "alice");
    }

    #[test]
    fn a_lost_link_is_noticed_soon_unless_the_options_say_otherwise() {
        assert_eq!(read(&[]).heartbeat, 500);
        assert_eq!(read(&["--heartbeat", "100"]).heartbeat, 100);
        for wrong in ["99", "10001", "500ms"] {
            let args = ["program", "--heartbeat", wrong];
            assert!(Program::try_parse_from(args).is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_password_is_the_first_line_of_its_file() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        std::fs::write(file.path(), "secret\nand a note\n").expect("it is written");
        let args = read(&["--password-file", &file.path().to_string_lossy()]);
        assert_eq!(args.password().expect("it is there"), "secret");
        let missing = read(&["--password-file", "/nowhere/at-all"]);
        let error = missing.password().expect_err("it is not there").to_string();
        assert_eq!(error, "cannot read /nowhere/at-all");
    }
}
