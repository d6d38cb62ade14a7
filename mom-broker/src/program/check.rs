//! `mom-broker check`: validates a configuration file, shows its contexts and warns of likely mistakes.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use mom_broker::{Config, ConfigError, ConfigErrors};
use mom_hub::ContextSpec;
use mom_managers::{Expiry, Terms};
use mom_proto::{ContextKind, Path, Verb};
use serde_json::{Value, json};

#[derive(clap::Args)]
pub(super) struct CheckArgs {
    /// The file.
    file: PathBuf,
    /// Print JSON, errors too.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &CheckArgs) -> Result<ExitCode> {
    let mut out = std::io::stdout().lock();
    let checked = |config: Config| {
        mom_broker::read_tls(&config)
            .map(|_| config)
            .map_err(ConfigErrors::from)
    };
    match Config::load(&args.file).and_then(checked) {
        Err(errors) if args.json => {
            let errors: Vec<Value> = errors.iter().map(remark).collect();
            let report = json!({ "right": false, "errors": errors });
            writeln!(out, "{report:#}")?;
            Ok(ExitCode::FAILURE)
        }
        Err(errors) => Err(errors.into()),
        Ok(config) => {
            let lines = tree(&config)?;
            match args.json {
                true => writeln!(out, "{:#}", report(&config, &lines))?,
                false => show(&mut out, args, &config, &lines)?,
            }
            Ok(ExitCode::SUCCESS)
        }
    }
}

/// One context of the tree.
struct TreeLine {
    path: Path,
    kind: &'static str,
    manager: String,
    managed_at: Path,
    guard: Option<(String, Vec<String>)>,
    terms: Option<Terms>,
    /// Of a channel: who may be a device there.
    devices: Devices,
}

/// Who may be a device, which obeys stops and is believed when it says so.
enum Devices {
    Anybody,
    These(Vec<String>),
}

/// The contexts in the order of the tree, the root first.
fn tree(config: &Config) -> Result<Vec<TreeLine>, ConfigError> {
    let hub = config.hub()?;
    let paths = config.contexts.iter().filter_map(path_of);
    let mut paths: Vec<Path> = std::iter::once(Path::root()).chain(paths).collect();
    // Children come before the next sibling, whatever characters their names contain.
    paths.sort_by(|one, other| one.segments().cmp(other.segments()));
    let everybody = config.users.len() + usize::from(config.login.guests);
    let devices = config.allowed(Verb::Device, &paths)?;
    let places = paths
        .iter()
        .zip(devices)
        .filter_map(|(path, devices)| Some((hub.place(path)?, devices)));
    let line = |(place, devices): (mom_hub::ContextOutline, Vec<String>)| {
        let mut specs = config.contexts.iter();
        let spec = specs.find(|spec| path_of(spec).as_ref() == Some(&place.path));
        let guard = spec.and_then(|spec| spec.guard.as_ref());
        TreeLine {
            kind: place.kind.word(),
            manager: place.manager,
            managed_at: place.managed_at,
            guard: guard.map(|guard| (guard.token.clone(), guard.names.clone())),
            terms: place.terms,
            devices: match place.kind {
                ContextKind::Channel if everybody > 0 && devices.len() == everybody => Devices::Anybody,
                ContextKind::Channel => Devices::These(devices),
                _ => Devices::These(Vec::new()),
            },
            path: place.path,
        }
    };
    Ok(places.map(line).collect())
}

fn path_of(spec: &ContextSpec) -> Option<Path> {
    Path::parse(spec.path.as_deref()?).ok()
}

fn show(out: &mut impl Write, args: &CheckArgs, config: &Config, lines: &[TreeLine]) -> Result<()> {
    let (managers, contexts, users) = (config.managers.len(), config.contexts.len(), config.users.len());
    writeln!(
        out,
        "{}: right; {managers} managers, {contexts} contexts, {users} users",
        args.file.display()
    )?;
    let rows: Vec<[String; 3]> = lines.iter().enumerate().map(|(at, _)| row(lines, at)).collect();
    let width = |column: usize| {
        let longest = rows.iter().map(|row| row[column].chars().count()).max();
        longest.unwrap_or_default()
    };
    let (first, second) = (width(0), width(1));
    for [place, kind, facts] in &rows {
        writeln!(out, "  {place:<first$}  {kind:<second$}  {facts}")?;
    }
    for warning in config.warnings() {
        writeln!(out, "warning: {warning}")?;
    }
    Ok(())
}

fn row(lines: &[TreeLine], at: usize) -> [String; 3] {
    let line = &lines[at];
    let depth = line.path.segments().count();
    let name = match depth {
        0 => "/".to_owned(),
        _ => format!("{}{}", branches(lines, at, depth), line.path.name()),
    };
    let mut facts = line.manager.clone();
    if line.managed_at != line.path {
        facts.push_str(&format!(" (of {})", line.managed_at));
    }
    if let Some((token, names)) = &line.guard {
        facts.push_str(&format!("; {} needs {token}", names.join(", ")));
    }
    match &line.devices {
        Devices::Anybody => facts.push_str("; device: anybody"),
        Devices::These(names) if !names.is_empty() => {
            facts.push_str(&format!("; device: {}", names.join(", ")));
        }
        // A device is meant to obey there.
        Devices::These(_) if line.guard.is_some() => facts.push_str("; device: nobody"),
        Devices::These(_) => {}
    }
    if let Some(terms) = &line.terms {
        facts.push_str(&lease(terms));
    }
    [name, line.kind.to_owned(), facts]
}

/// The lines that lead to a context.
fn branches(lines: &[TreeLine], at: usize, depth: usize) -> String {
    // Whether another context of this depth follows under the same parent.
    let goes_on = |depth: usize| {
        let mut below = lines[at + 1..].iter().map(|line| line.path.segments().count());
        below.find(|other| *other <= depth) == Some(depth)
    };
    let above: String = (1..depth)
        .map(|depth| if goes_on(depth) { "│  " } else { "   " })
        .collect();
    above + if goes_on(depth) { "├─ " } else { "└─ " }
}

fn lease(terms: &Terms) -> String {
    let how = match terms.expiry {
        Expiry::Lazy => "lazy",
        Expiry::Eager => "eager",
    };
    match terms.lease {
        Some(lease) => format!("; lease {} ms, {how}", lease / 1000),
        None => "; no lease".to_owned(),
    }
}

fn report(config: &Config, lines: &[TreeLine]) -> Value {
    let contexts: Vec<Value> = lines
        .iter()
        .map(|line| {
            let mut context = json!({
                "path": line.path.as_str(),
                "kind": line.kind,
                "manager": line.manager,
                "managed-at": line.managed_at.as_str(),
            });
            if let Some((token, names)) = &line.guard {
                context["guard"] = json!({ "token": token, "names": names });
            }
            if line.kind == ContextKind::Channel.word() {
                context["devices"] = match &line.devices {
                    Devices::Anybody => "anybody".into(),
                    Devices::These(names) => names.clone().into(),
                };
            }
            if let Some(terms) = &line.terms {
                context["lease"] = terms.lease.map(|lease| lease / 1000).into();
            }
            context
        })
        .collect();
    let warnings: Vec<Value> = config.warnings().iter().map(remark).collect();
    json!({
        "right": true,
        "managers": config.managers.keys().collect::<Vec<_>>(),
        "contexts": contexts,
        "users": config.users.len(),
        "warnings": warnings,
    })
}

fn remark(error: &ConfigError) -> Value {
    json!({ "file": error.file, "line": error.line, "key": error.key, "text": error.text })
}
