//! Commands that the packages of the wings bring along: each is a module there, and one line here.

use clap::Subcommand;
use mom_client::Client;

use crate::connect::{Stay, connect};
use crate::failure::Failure;
use crate::global::GlobalArgs;
use crate::output::Output;
use mom_pages::Interrupt;

/// The commands of packages, each with the path of its module, which has
///
/// - `VerbArgs`, the arguments with their help,
/// - `run(&args, &client, interrupt, tell)`, which works until it is done or `interrupt` is, and tells each result as
///   JSON and as a line for people; the client is logged out here, however it ends,
///
/// whose failure is a `VerbFailure`.
macro_rules! devices {
    ($($name:ident: $($module:ident)::+, $stay:ident;)*) => {
        /// The commands of devices.
        #[derive(Debug, Subcommand)]
        pub(crate) enum DeviceCommand {
            $($name($($module)::+::VerbArgs),)*
        }

        impl DeviceCommand {
            /// Runs it as a peer of its own.
            pub(crate) async fn run(&self, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
                let stay = match self {
                    $(DeviceCommand::$name(_) => Stay::$stay,)*
                };
                let client = connect(global, stay).await?;
                let ran = match self.run_as(&client, output).await {
                    Err(failure) => Err(failure.at_a_fleet(&client).await),
                    ran => ran,
                };
                client.close().await;
                ran
            }

            async fn run_as(&self, client: &Client, output: Output) -> Result<(), Failure> {
                let mut interrupt = Interrupt::install()?;
                let mut tell = |json, line| output.tell(|| json, || line);
                match self {
                    $(DeviceCommand::$name(args) => {
                        let ran = $($module)::+::run(args, client, interrupt.wait(), &mut tell).await;
                        ran.map_err(Failure::from)
                    })*
                }
            }
        }
    };
}

devices! {
    Calibrate: mom_calibrate::verb, Driving;
    // It moves nothing: on a busy machine it need not hear of a loss within seconds.
    Objects: mom_model::verb::objects, Once;
    Put: mom_model::verb::put, Driving;
    Bring: mom_model::verb::bring, Driving;
    Servo: mom_servo::verb, Driving;
    Fleet: mom_gateway::verb, Driving;
}
