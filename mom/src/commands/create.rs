//! `mom create`: makes a context.

use mom_client::{ContextKind, Map, Value, to_value};
use serde_json::json;

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::Output;
use crate::output::style::{Tone, ink};

pub(crate) async fn run(args: &cli::CreateArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let spec = spec(args)?;
    let client = connect(global, Stay::Once).await?;
    let (kind, path) = (args.kind, &args.path);
    client
        .create(path, spec)
        .await
        .doing(format!("create {kind} {path}"))?;
    client.close().await;
    output.tell(
        || json!({"state": "created", "path": path, "kind": kind.word()}),
        || ink(format_args!("{kind} {path} is there"), Tone::Good),
    )?;
    Ok(())
}

/// What the hub is told about it.
fn spec(args: &cli::CreateArgs) -> Result<Map, Failure> {
    let mut spec = match &args.spec {
        None => Map::new(),
        Some(text) => read(text)?,
    };
    let kind = args.kind;
    let mut set = |key: &str, value: Value| match spec.get(key) {
        None => {
            spec.set(key, value);
            Ok(())
        }
        Some(_) => Err(Failure::usage(
            format!("--spec says {key}, and so does the command line"),
            "say it once",
        )),
    };
    set("kind", kind.word().into())?;
    if let Some(manager) = &args.manager {
        set("manager", manager.as_str().into())?;
    }
    if let Some(lease) = args.lease {
        only(kind, ContextKind::Token, "--lease")?;
        let millis = i64::try_from(lease.as_millis()).unwrap_or(i64::MAX);
        set("lease", millis.into())?;
    }
    if let Some(token) = &args.guard {
        only(kind, ContextKind::Channel, "--guard")?;
        let names: Vec<Value> = args.guarded.iter().map(|name| name.as_str().into()).collect();
        set(
            "guard",
            Map::new()
                .with("token", token.as_str())
                .with("names", names)
                .into(),
        )?;
    }
    if args.transient {
        set("transient", true.into())?;
    }
    Ok(spec)
}

fn read(text: &str) -> Result<Map, Failure> {
    let wrong = |text: String| Failure::usage(text, "quote it for the shell: --spec '{\"deadman\": 500}'");
    let json: serde_json::Value =
        serde_json::from_str(text).map_err(|error| wrong(format!("--spec: {error}")))?;
    match to_value(&json) {
        Ok(Value::Map(map)) => Ok(map),
        Ok(_) => Err(wrong("--spec is not an object of JSON".to_owned())),
        Err(error) => Err(wrong(format!("--spec: {}", error.text))),
    }
}

fn only(kind: ContextKind, of: ContextKind, option: &str) -> Result<(), Failure> {
    match kind == of {
        true => Ok(()),
        false => Err(Failure::usage(
            format!("a {kind} has no {option}"),
            format!("only a {of} has; see: mom create --help"),
        )),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn args(kind: ContextKind) -> cli::CreateArgs {
        cli::CreateArgs {
            kind,
            path: "/lab/arm".to_owned(),
            manager: None,
            guard: None,
            guarded: vec!["command".to_owned()],
            lease: None,
            transient: false,
            spec: None,
        }
    }

    #[test]
    fn options_and_json_together() {
        let channel = cli::CreateArgs {
            guard: Some("/lab/key".to_owned()),
            transient: true,
            spec: Some(r#"{"delivery": "latest"}"#.to_owned()),
            ..args(ContextKind::Channel)
        };
        let guard = Map::new()
            .with("token", "/lab/key")
            .with("names", vec![Value::from("command")]);
        let want = Map::new()
            .with("delivery", "latest")
            .with("kind", "channel")
            .with("guard", guard)
            .with("transient", true);
        assert_eq!(spec(&channel).ok(), Some(want));
        for wrong in [
            cli::CreateArgs {
                lease: Some(Duration::from_secs(1)),
                ..args(ContextKind::Channel)
            },
            cli::CreateArgs {
                guard: Some("/lab/key".to_owned()),
                ..args(ContextKind::Token)
            },
            cli::CreateArgs {
                spec: Some("[1]".to_owned()),
                ..args(ContextKind::Token)
            },
            cli::CreateArgs {
                spec: Some(r#"{"kind": "token"}"#.to_owned()),
                ..args(ContextKind::Token)
            },
        ] {
            assert!(spec(&wrong).is_err(), "{wrong:?}");
        }
    }
}
