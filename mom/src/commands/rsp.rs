//! `mom rsp`: models of thin robots, without a hub.

use mom_rsp_model::verb::{self, RspFailure, VerbArgs};

use crate::failure::Failure;
use crate::output::Output;

pub(crate) fn run(args: &VerbArgs, output: Output) -> Result<(), Failure> {
    let mut tell = |json, line| output.tell(|| json, || line);
    verb::run(args, &mut tell).map_err(|failure| match failure {
        RspFailure::Failed { text, hint } => Failure::Failed { text, hint },
        RspFailure::Io(error) => Failure::Io(error),
    })
}
