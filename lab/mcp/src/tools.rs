//! The tools as a language model reads of them.

use std::borrow::Cow;
use std::sync::Arc;

use mom_client::Card;
use rmcp::model::{JsonObject, Tool, ToolAnnotations};
use serde_json::{Value as Json, json};

use crate::device::statements;

/// What a model is told of the whole.
pub(crate) const INSTRUCTIONS: &str = "\
These tools look at a robot and drive it. A person has to grant you the robot's token before anything moves: call \
request_token and say why; only a person can give it, and nothing here can take it. Look (look, where) before you move, \
and after. The grant usually has a scope: so many seconds, so many commands; `where` tells what is left. You may lose \
the token at any moment, because a person takes it or the scope is over: then stop, say so, and do not try to get it \
back without being told to. Give it back with return_token as soon as you are done. If anything looks dangerous, call \
stop: it needs no token, and only a person lets the robot go again.";

/// All of them, for the robot of this card. An empty schema of properties takes no arguments.
pub(crate) fn all(card: Option<&Card>) -> Vec<Tool> {
    vec![
        look(),
        places(),
        request_token(),
        moves(card),
        stop(),
        return_token(),
    ]
}

fn tool(
    name: &'static str,
    title: &str,
    description: impl Into<Cow<'static, str>>,
    properties: &Json,
    required: &Json,
) -> Tool {
    let schema = json!({
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": false,
    });
    let schema = match schema {
        Json::Object(schema) => schema,
        _ => JsonObject::new(),
    };
    Tool::new(name, description, Arc::new(schema)).with_title(title)
}

fn look() -> Tool {
    tool(
        "look",
        "Look through a camera",
        "Takes a picture of the robot with one of the cameras and returns it as an image, with the time when it was taken, how \
         old it is, and the pose of the robot that it shows, if it does. Needs no token. The lab's cameras are x (from the \
         front), y (from the side), top (from above) and wrist (on the forearm, moves with it); a name that does not exist is \
         answered with those that do.",
        &json!({"camera": {"type": "string", "description": "the camera's name, such as x, y, top or wrist"}}),
        &json!(["camera"]),
    )
    .with_annotations(ToolAnnotations::new().read_only(true).open_world(false))
}

fn places() -> Tool {
    tool(
        "where",
        "Where everything is",
        "Tells where the robot is (of the lab's arm: x, y, z of the tip in millimetres from the middle of the table, spin and \
         tilt in degrees, and what the gripper holds), whether it moves or is stopped, how old this knowledge is, and the \
         statements of its scripts; who owns the robot's token, whether that is you, and how much is left of your scope; and \
         where the objects are, if the hub has a model of them. Needs no token.",
        &json!({}),
        &json!([]),
    )
    .with_annotations(ToolAnnotations::new().read_only(true).open_world(false))
}

fn request_token() -> Tool {
    tool(
        "request_token",
        "Ask a person for the robot",
        "Asks the person who has the robot's token to let you drive, and waits for the answer. Say in `reason` what you \
         want to do, in one sentence that the person can judge, and for how long and with how many commands. If nobody \
         has the token, the answer is the command with which a person gives it to you: show it to your user, then call again \
         with wait_seconds. If the answer is no, do not ask again unless your user wants you to.",
        &json!({
            "reason": {"type": "string", "maxLength": 500, "description": "what you want to do with the robot, for the person who decides"},
            "for_seconds": {"type": "integer", "minimum": 1, "maximum": 86_400, "description": "how long you need it"},
            "commands": {"type": "integer", "minimum": 1, "maximum": 10_000, "description": "how many calls of move you need"},
            "wait_seconds": {"type": "integer", "minimum": 1, "maximum": 600, "description": "how long the person may take; if absent, 50 for one who has the token, 0 if nobody has it"},
        }),
        &json!(["reason"]),
    )
    .with_annotations(ToolAnnotations::new().read_only(false).destructive(false).open_world(false))
}

/// What the card says are the device's words, so they stand behind what is said of it here.
fn moves(card: Option<&Card>) -> Tool {
    let statements = match card {
        Some(card) if card.name == "arm" => {
            format!("{ARM} Its statements: {}.", statements(card).join(" | "))
        }
        Some(card) => format!(
            "Its statements, as the robot describes them: {}.",
            statements(card).join(" | ")
        ),
        None => "`where` tells its statements.".to_owned(),
    };
    let description = format!(
        "Has the robot carry out a script and waits for its end. Works only while you hold the token. Statements are separated by `;` \
         or new lines. One call counts as one command of your scope, however many statements it has. A script that fails is not \
         repeated: look before you go on. {statements}"
    );
    tool(
        "move",
        "Drive the robot",
        description,
        &json!({"script": {"type": "string", "maxLength": 65_536, "description": "statements with `;` between, such as: wait 500"}}),
        &json!(["script"]),
    )
    .with_annotations(
        ToolAnnotations::new()
            .read_only(false)
            .destructive(true)
            .idempotent(false)
            .open_world(false),
    )
}

/// What a model that drives the lab's arm has to know beside its statements.
const ARM: &str = "\
It is a robot arm: millimetres from the middle of the table, Z is the height above it. Its workspace is X and Y from -300 to 300, Z from 0 to \
450. To take a block, open the gripper above it, move down so that its middle is between the jaws, close, and move up before you go across.";

fn stop() -> Tool {
    tool(
        "stop",
        "Stop the robot now",
        "Stops the robot at once, even if another peer drives it, and tells whether it stands. Needs no token. It stays stopped until a \
         person lets it go; you cannot. Use it when people or things are in danger, not to end your own work.",
        &json!({}),
        &json!([]),
    )
    .with_annotations(
        ToolAnnotations::new()
            .read_only(false)
            .destructive(true)
            .idempotent(true)
            .open_world(false),
    )
}

fn return_token() -> Tool {
    tool(
        "return_token",
        "Give the robot back",
        "Gives the robot's token back to the person who gave it to you. Call it as soon as you are done; the arm stands \
         from then on.",
        &json!({}),
        &json!([]),
    )
    .with_annotations(
        ToolAnnotations::new()
            .read_only(false)
            .destructive(false)
            .idempotent(true)
            .open_world(false),
    )
}
