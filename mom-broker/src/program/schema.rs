//! `mom-broker schema`: the shape of the files, for editors.

use std::io::Write;

use anyhow::Result;

#[derive(clap::Args)]
pub(super) struct SchemaArgs {
    /// The schema of the users file instead.
    #[arg(long)]
    users: bool,
}

pub(super) fn run(args: &SchemaArgs) -> Result<()> {
    let schema = match args.users {
        true => mom_broker::users_schema(),
        false => mom_broker::config_schema(),
    };
    let mut out = std::io::stdout().lock();
    serde_json::to_writer_pretty(&mut out, &schema)?;
    writeln!(out)?;
    Ok(())
}
