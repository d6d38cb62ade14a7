//! What statements are on the wire, as far as the robots of this gateway know it.

use mom_brs::{Code, Direction, Frame, Table};
use mom_client::Card;
use mom_device::{DeviceError, ErrorName};
use mom_wheeled::{Action, card_of};

/// The most points of one statement; the robot keeps 64.
const MOST_POINTS: usize = 64;

/// The frames of a statement, in order.
///
/// # Errors
///
/// `syntax` for a statement that no robot of this table can carry out as it stands, `workspace-boundary` for too many points.
pub(super) fn frames(unit: u32, table: &'static Table, action: &Action) -> Result<Vec<Frame>, DeviceError> {
    match action {
        Action::Motor { left, right, .. } => Ok(vec![frame(table, "motor", Code::MOTOR, &[*left, *right])?]),
        Action::Leds(data) => Ok(vec![frame(table, "leds", Code::LEDS, &[*data])?]),
        Action::Drive(points) if points.len() > MOST_POINTS => {
            let text = format!("a way has at most {MOST_POINTS} points, not {}", points.len());
            Err(DeviceError::new(ErrorName::WorkspaceBoundary, text))
        }
        Action::Drive(points) => {
            let each = points.iter().zip(0..).map(|((x, y), number)| match number {
                0 => frame(table, "goto", Code::GOTO, &[*x, *y]),
                _ => frame(table, "via", Code::VIA, &[*x, *y]),
            });
            each.collect()
        }
        Action::Follow { .. } => {
            let text = format!(
                "robot {unit} hears its gateway alone; `follow` is for robots that are peers themselves (mom-rover)"
            );
            Err(DeviceError::new(ErrorName::Syntax, text))
        }
    }
}

/// What a robot of this table can do: the statements that it has commands for. It hears no other robot.
pub(super) fn card(table: &Table) -> Card {
    let has = |code| table.get(code).is_some();
    let verbs = Action::verbs().into_iter().filter(|verb| match &*verb.name {
        "motor" => has(Code::MOTOR),
        "leds" => has(Code::LEDS),
        "goto" => has(Code::GOTO),
        "via" => has(Code::GOTO) && has(Code::VIA),
        _ => false,
    });
    card_of("A robot on two wheels, by the radio of its base station").verbs(verbs)
}

fn frame(table: &'static Table, name: &str, code: Code, values: &[i32]) -> Result<Frame, DeviceError> {
    let syntax = |text: String| DeviceError::new(ErrorName::Syntax, text);
    let command = table.get(code);
    let Some((command, parameters)) =
        command.and_then(|command| Some((command, command.said(Direction::Command)?)))
    else {
        return Err(syntax(format!(
            "the robots of this gateway know no `{name}`: its table of commands has no code {code}"
        )));
    };
    let frame = Frame::new(command, values).map_err(|fault| {
        syntax(format!(
            "the robots of this gateway know another `{name}`: {fault}"
        ))
    })?;
    // What the table's range cuts off would be another place or speed than was said.
    let cut = parameters
        .iter()
        .zip(values)
        .find(|(parameter, value)| parameter.clamp(**value) != **value);
    match cut {
        Some((parameter, value)) => Err(syntax(format!(
            "`{name}` takes {} from {} to {} by this gateway's table of commands, not {value}",
            parameter.name, parameter.min, parameter.max
        ))),
        None => Ok(frame),
    }
}
