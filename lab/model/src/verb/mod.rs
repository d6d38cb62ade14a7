//! Commands in terms of objects, which `mom` registers in `mom/src/devices.rs`.

pub mod bring;
mod carry;
mod channel;
pub mod objects;
pub mod put;

/// Where the model, the robot and its token are.
#[derive(Debug, clap::Args)]
pub struct DriveArgs {
    /// The model's channel
    #[arg(long, value_name = "PATH", default_value = "/model/objects")]
    pub model: String,
    /// The robot's channel
    #[arg(long, value_name = "PATH", default_value = "/robot/arm")]
    pub robot: String,
    /// The token that guards the robot
    #[arg(long, value_name = "PATH", default_value = "/robot/token")]
    pub token: String,
    /// Wait in the token's queue for at most so many seconds
    #[arg(long, value_name = "SECONDS")]
    pub wait: Option<u64>,
}

/// A word that only makes a sentence of a command.
fn word(wanted: &'static str) -> impl Fn(&str) -> Result<String, String> + Clone {
    move |given| match given == wanted {
        true => Ok(given.to_owned()),
        false => Err(format!("here stands the word {wanted}")),
    }
}
