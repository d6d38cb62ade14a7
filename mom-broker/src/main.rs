//! The broker service's program.

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::{Parser, Subcommand};
use mom_broker::{Broker, Config};
use tokio::signal::unix::{SignalKind, signal};
use tracing_subscriber::EnvFilter;

const EXAMPLES: &str = "Examples:
  mom-broker --config config/lab.toml        run the demonstration lab's broker
  mom-broker check config/lab.toml           say whether a configuration is right, and where not
  mom-broker passwd alice                    ask for a password, print its line for the users file
  mom-broker passwd alice --users users.toml change or add the user in the file";

/// The MOM broker: the hub to which robots, cameras, agents and people connect.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    /// The configuration file; without one the broker is closed to everybody.
    #[arg(long, short, env = "MOM_CONFIG")]
    config: Option<PathBuf>,
    /// Listen here instead of where the configuration says; port 0 takes any free one.
    #[arg(long)]
    listen: Vec<String>,
    /// Log as JSON lines.
    #[arg(long)]
    log_json: bool,
}

#[derive(Subcommand)]
enum Command {
    /// Say whether a configuration file is right, and where not.
    Check {
        /// The file.
        file: PathBuf,
    },
    /// Hash a password, from MOM_PASSWORD, a prompt or standard input, for the users file.
    Passwd {
        /// The user's name.
        user: String,
        /// The users file to change; without it the entry is printed.
        #[arg(long)]
        users: Option<PathBuf>,
    },
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match &cli.command {
        Some(Command::Check { file }) => check(file),
        Some(Command::Passwd { user, users }) => passwd(user, users.as_deref()),
        None => serve(&cli),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Standard error may be closed; the exit code says it all the same.
            let _ = writeln!(std::io::stderr(), "mom-broker: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn check(file: &Path) -> Result<()> {
    let config = Config::load(file)?;
    let (managers, contexts, users) = (config.managers.len(), config.contexts.len(), config.users.len());
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "{}: right; {managers} managers, {contexts} contexts, {users} users",
        file.display()
    )?;
    Ok(())
}

fn serve(cli: &Cli) -> Result<()> {
    let mut config = match &cli.config {
        Some(file) => Config::load(file)?,
        None => Config::default(),
    };
    if !cli.listen.is_empty() {
        config.listen.clone_from(&cli.listen);
    }
    log(&config.log, cli.log_json)?;
    if cli.config.is_none() {
        tracing::warn!("no configuration: nobody can log in; try --config config/lab.toml");
    }
    let runtime = tokio::runtime::Runtime::new().context("cannot start the runtime")?;
    runtime.block_on(run(config))
}

async fn run(config: Config) -> Result<()> {
    let mut terminate = signal(SignalKind::terminate()).context("cannot wait for SIGTERM")?;
    let broker = Broker::start(config).await?;
    // On standard output, so that whoever chose port 0 can read which it is.
    for address in broker.local_addrs() {
        writeln!(
            std::io::stdout(),
            "listening at tcp://{address} (XML) and bin://{address} (binary)"
        )?;
    }
    std::io::stdout().flush()?;
    tokio::select! {
        _ = terminate.recv() => tracing::info!("SIGTERM: stopping"),
        result = tokio::signal::ctrl_c() => result.context("cannot wait for Ctrl-C")?,
    }
    broker.stop().await;
    Ok(())
}

fn log(filter: &str, json: bool) -> Result<()> {
    let filter = EnvFilter::try_new(filter).with_context(|| format!("log: {filter:?} is no filter"))?;
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr);
    match json {
        true => builder.json().init(),
        false => builder.init(),
    }
    Ok(())
}

fn passwd(user: &str, users: Option<&Path>) -> Result<()> {
    mom_proto::check_name(user)?;
    let password = match std::env::var("MOM_PASSWORD") {
        Ok(password) => password,
        Err(_) => rpassword::prompt_password(format!("Password for {user}: ")).or_else(|_| read_line())?,
    };
    if password.is_empty() {
        bail!("an empty password lets anybody in; nothing was changed");
    }
    let hash = mom_broker::hash(&password).map_err(anyhow::Error::msg)?;
    let Some(file) = users else {
        writeln!(
            std::io::stdout(),
            "[[users]]\nname = \"{user}\"\npassword = \"{hash}\"\nlevel = 0\ngroups = []"
        )?;
        return Ok(());
    };
    let text = match std::fs::read_to_string(file) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
        Err(error) => return Err(error).with_context(|| format!("cannot read {}", file.display())),
    };
    let (text, what) = set_password(&text, user, &hash).with_context(|| format!("in {}", file.display()))?;
    replace(file, &text)?;
    writeln!(std::io::stdout(), "{what} {user} in {}", file.display())?;
    Ok(())
}

fn read_line() -> std::io::Result<String> {
    let mut line = String::new();
    std::io::stdin().read_line(&mut line)?;
    Ok(line.trim_end_matches(['\r', '\n']).to_owned())
}

/// The users file with a new password; comments and order stay.
fn set_password(text: &str, user: &str, hash: &str) -> Result<(String, &'static str)> {
    let mut document: toml_edit::DocumentMut = text.parse().context("this is no TOML")?;
    let users = document
        .entry("users")
        .or_insert(toml_edit::ArrayOfTables::new().into());
    let users = users
        .as_array_of_tables_mut()
        .context("users is not a list of [[users]] tables")?;
    let known = users
        .iter_mut()
        .find(|entry| entry.get("name").and_then(|name| name.as_str()) == Some(user));
    let what = match known {
        Some(entry) => {
            entry["password"] = toml_edit::value(hash);
            "changed the password of"
        }
        None => {
            let mut entry = toml_edit::Table::new();
            entry["name"] = toml_edit::value(user);
            entry["password"] = toml_edit::value(hash);
            entry["level"] = toml_edit::value(0);
            entry["groups"] = toml_edit::value(toml_edit::Array::new());
            users.push(entry);
            "added"
        }
    };
    Ok((document.to_string(), what))
}

/// Writes a file whole or not at all.
fn replace(file: &Path, text: &str) -> Result<()> {
    let new = file.with_extension("new");
    let permissions = std::fs::metadata(file).map(|known| known.permissions()).ok();
    std::fs::write(&new, text).with_context(|| format!("cannot write {}", new.display()))?;
    if let Some(permissions) = permissions {
        std::fs::set_permissions(&new, permissions)?;
    }
    std::fs::rename(&new, file).with_context(|| format!("cannot replace {}", file.display()))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passwords_are_changed_in_place() {
        let text = "# staff\n[[users]]\nname = \"alice\" # boss\npassword = \"old\"\nlevel = 5\n";
        let (changed, what) = set_password(text, "alice", "new").unwrap();
        assert_eq!(changed, text.replace("\"old\"", "\"new\""));
        assert_eq!(what, "changed the password of");
        let (added, what) = set_password(text, "bob", "hash").unwrap();
        assert!(
            added.starts_with(text) && added.contains("name = \"bob\"\npassword = \"hash\""),
            "{added}"
        );
        assert_eq!(what, "added");
        assert!(set_password("users = 1", "bob", "hash").is_err());
    }
}
