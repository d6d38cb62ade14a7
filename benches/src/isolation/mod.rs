//! What attackers cost others: an operator and a robot beside an attack, and beside the same attack on another broker.

mod canary;
mod child;

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use mom_tests::attacks::{Attack, configuration};

pub use canary::{Canary, Song};
use child::Attackers;
pub use child::attack;

use crate::{Error, Process, control};

/// What one attack did.
#[derive(Clone, Debug)]
pub struct Figures {
    /// While the attackers attacked another broker, and while they attacked this one.
    pub songs: [Song; 2],
    /// The most memory that the attacked broker ever had, in bytes.
    pub memory: Option<u64>,
    /// What the attackers heard, as `code × times`.
    pub heard: Vec<String>,
}

/// Runs these attacks together on fresh brokers of this program, which run at this niceness.
///
/// # Errors
/// Programs that do not start, or a broker that refuses the canary what it may do.
pub fn measure(program: &Path, niceness: i32, attacks: &[Attack], time: Duration) -> Result<Figures, Error> {
    let start = || {
        let mut command = Command::new(program);
        command.arg("--config").arg(configuration());
        command.env("MOM_NICENESS", niceness.to_string());
        Process::start(command)
    };
    let (attacked, other) = (start()?, start()?);
    let figures = control::run(async {
        let mut canary = Canary::start(attacked.address()).await?;
        let elsewhere = Attackers::start(attacks, other.address())?;
        let idle = canary.sing(time).await?;
        elsewhere.end()?;
        let here = Attackers::start(attacks, attacked.address())?;
        let under = canary.sing(time).await?;
        let heard = here.end()?;
        Ok(Figures {
            songs: [idle, under],
            memory: attacked.most_memory(),
            heard,
        })
    });
    attacked.end();
    figures
}
