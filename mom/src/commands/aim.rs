//! `mom aim`: turns the camera that can be turned (M62).

use mom_camera::pan::Mount;

use super::run::{Errand, ScriptLine};
use crate::cli::{self, GlobalArgs};
use crate::failure::Failure;
use crate::output::Output;

pub(crate) async fn run(args: &cli::AimArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let text = script(args);
    // The camera says what it cannot reach; what is not an angle it need not be asked.
    Mount::script(&text)
        .map_err(|error| Failure::usage(error.to_string(), "angles are degrees: mom aim 20 -10"))?;
    let errand = Errand {
        device: "camera",
        channel: &args.channel,
        token: &args.token,
        zones: &[],
        keep_going: false,
        checked: None,
        shown: None,
    };
    errand.run(&[ScriptLine::alone(text)], global, output).await
}

fn script(args: &cli::AimArgs) -> String {
    match (args.by, &args.angles[..]) {
        (true, [pan, tilt]) => format!("turn {pan} {tilt}"),
        (false, [pan, tilt]) => format!("look {pan} {tilt}"),
        _ => "home".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_scripts_of_the_camera() {
        let args = |by: bool, angles: &[f64]| cli::AimArgs {
            angles: angles.to_vec(),
            home: angles.is_empty(),
            by,
            channel: "/camera/pan".to_owned(),
            token: "/camera/pan-token".to_owned(),
        };
        for (args, expected) in [
            (args(false, &[20.0, -10.5]), "look 20 -10.5"),
            (args(true, &[5.0, 0.0]), "turn 5 0"),
            (args(false, &[]), "home"),
        ] {
            assert_eq!(script(&args), expected);
        }
        let wrong = Mount::script(&script(&args(false, &[f64::NAN, 0.0])));
        assert!(wrong.is_err(), "{wrong:?}");
    }
}
