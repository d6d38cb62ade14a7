//! The server of MCP: which tool is called, with what, and when its turn is.

use std::sync::Arc;
use std::time::Duration;

use rmcp::model::{
    CallToolRequestParams, CallToolResponse, CallToolResult, ErrorData, Implementation, JsonObject,
    ListToolsResult, PaginatedRequestParams, ServerCapabilities, ServerConfig, Tool,
};
use rmcp::service::RequestContext;
use rmcp::{RoleServer, ServerHandler};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value as Json;
use tokio::sync::watch;
use tokio::time::timeout;

use crate::answer::Answer;
use crate::assistant::Assistant;
use crate::drive::{self, Wish};
use crate::progress::Progress;
use crate::{sight, tools};

/// So long the first calls wait for the hub.
const LOGIN: Duration = Duration::from_secs(3);

/// The tools, whether or not the hub is there.
#[derive(Clone)]
pub(crate) struct Tools {
    /// None until this peer is logged in.
    assistant: watch::Receiver<Option<Arc<Assistant>>>,
    gone: watch::Receiver<bool>,
    hub: String,
    turn: CallOrder,
}

/// The one tool at a time that has to do with the token; others wait in the order of their calls.
pub(crate) type CallOrder = Arc<tokio::sync::Mutex<()>>;

/// A tool and its arguments.
enum Call {
    Look(String),
    Where,
    RequestToken(Wish),
    Move(String),
    Stop,
    ReturnToken,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Nothing {}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Looked {
    camera: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Scripted {
    script: String,
}

impl Call {
    /// Reads a call: what is wrong with its arguments is for the model, an unknown tool for its program.
    fn read(name: &str, arguments: Option<JsonObject>) -> Result<Result<Call, String>, ErrorData> {
        let arguments = arguments.unwrap_or_default();
        Ok(match name {
            "look" => read(arguments).map(|Looked { camera }| Call::Look(camera)),
            "where" => read(arguments).map(|Nothing {}| Call::Where),
            "request_token" => {
                read(arguments).and_then(|wish: Wish| wish.check().map(|()| Call::RequestToken(wish)))
            }
            "move" => read(arguments).map(|Scripted { script }| Call::Move(script)),
            "stop" => read(arguments).map(|Nothing {}| Call::Stop),
            "return_token" => read(arguments).map(|Nothing {}| Call::ReturnToken),
            _ => {
                let known: Vec<_> = tools::all(None).into_iter().map(|tool| tool.name).collect();
                let text = format!("there is no tool {name:?}; there are {}", known.join(", "));
                return Err(ErrorData::invalid_params(text, None));
            }
        })
    }
}

fn read<T: DeserializeOwned>(arguments: JsonObject) -> Result<T, String> {
    serde_json::from_value(Json::Object(arguments)).map_err(|error| error.to_string())
}

impl Tools {
    pub(crate) fn new(
        assistant: watch::Receiver<Option<Arc<Assistant>>>,
        gone: watch::Receiver<bool>,
        hub: &str,
        turn: CallOrder,
    ) -> Tools {
        Tools {
            assistant,
            gone,
            hub: hub.to_owned(),
            turn,
        }
    }

    async fn call(&self, call: Call, context: RequestContext<RoleServer>) -> Answer {
        let mut progress = Progress::of(context, self.gone.clone());
        // Before anything is waited for, so that the first caller has its turn first.
        let turn = match call {
            Call::Look(_) | Call::Where | Call::Stop => None,
            Call::RequestToken(_) | Call::Move(_) | Call::ReturnToken => tokio::select! {
                biased;
                turn = self.turn.lock() => Some(turn),
                // Once the client is gone, what is before it ends at once.
                () = progress.unwanted() => return Answer::bad("cancelled", "before it was its turn"),
            },
        };
        let assistant = match self.assistant().await {
            Ok(assistant) => assistant,
            Err(answer) => return *answer,
        };
        let answer = match call {
            // A call that is cancelled gives its place to another, so its work has to end.
            Call::Look(camera) => tokio::select! {
                answer = sight::look(&assistant, &camera) => answer,
                () = progress.unwanted() => Answer::bad("cancelled", "before there was an image"),
            },
            Call::Where => tokio::select! {
                answer = sight::places(&assistant) => answer,
                () = progress.unwanted() => Answer::bad("cancelled", "before all had answered"),
            },
            // It overtakes whatever is under way.
            Call::Stop => drive::stop(&assistant).await,
            Call::RequestToken(wish) => drive::request_token(&assistant, &wish, &mut progress).await,
            Call::Move(script) => drive::run(&assistant, &script, &mut progress).await,
            Call::ReturnToken => drive::return_token(&assistant).await,
        };
        drop(turn);
        answer
    }

    /// The peer at the hub; why there is none.
    async fn assistant(&self) -> Result<Arc<Assistant>, Box<Answer>> {
        let mut assistant = self.assistant.clone();
        let there = timeout(LOGIN, assistant.wait_for(Option::is_some)).await;
        let assistant = there
            .ok()
            .and_then(Result::ok)
            .and_then(|assistant| assistant.clone());
        let Some(assistant) = assistant else {
            let text = format!(
                "the hub {} has not let this peer in yet; the program keeps trying",
                self.hub
            );
            return Err(Box::new(Answer::bad("disconnected", text)));
        };
        match assistant.disconnected() {
            Some(answer) => Err(Box::new(answer)),
            None => Ok(assistant),
        }
    }
}

impl ServerHandler for Tools {
    fn get_info(&self) -> ServerConfig {
        ServerConfig::new(ServerCapabilities::builder().enable_tools().build())
            .with_server_info(Implementation::new("mom-mcp", env!("CARGO_PKG_VERSION")))
            .with_instructions(tools::INSTRUCTIONS)
    }

    async fn list_tools(
        &self,
        _request: Option<PaginatedRequestParams>,
        _context: RequestContext<RoleServer>,
    ) -> Result<ListToolsResult, ErrorData> {
        // A client may ask before there is a hub, and asks once.
        let card = match self.assistant().await {
            Ok(assistant) => assistant.card().await,
            Err(_) => None,
        };
        Ok(ListToolsResult::with_all_items(tools::all(card.as_ref())))
    }

    fn get_tool(&self, name: &str) -> Option<Tool> {
        tools::all(None).into_iter().find(|tool| tool.name == name)
    }

    async fn call_tool(
        &self,
        request: CallToolRequestParams,
        context: RequestContext<RoleServer>,
    ) -> Result<CallToolResponse, ErrorData> {
        let answer = match Call::read(&request.name, request.arguments)? {
            Ok(call) => self.call(call, context).await,
            Err(text) => Answer::bad("bad-arguments", text),
        };
        Ok(CallToolResult::from(answer).into())
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn arguments_are_what_the_schemas_say() {
        for (name, arguments, good) in [
            ("look", json!({"camera": "x"}), true),
            ("look", json!({}), false),
            ("look", json!({"camera": 7}), false),
            ("look", json!({"camera": "x", "zoom": 2}), false),
            ("where", json!({}), true),
            ("where", Json::Null, true),
            ("where", json!({"the": "arm"}), false),
            ("move", json!({"script": "home"}), true),
            ("move", json!({"script": ["home"]}), false),
            ("stop", json!({}), true),
            ("return_token", json!({}), true),
            ("request_token", json!({"reason": "to help"}), true),
            ("request_token", json!({"reason": ""}), false),
        ] {
            let read = Call::read(name, arguments.as_object().cloned()).expect("a known tool");
            assert_eq!(read.is_ok(), good, "{name} {arguments}");
        }
        let unknown = Call::read("grab", None).err().expect("there is none");
        assert!(
            unknown.message.contains("look, where, request_token"),
            "{}",
            unknown.message
        );
    }

    #[test]
    fn each_tool_that_is_listed_can_be_called() {
        for tool in tools::all(None) {
            let required = tool.input_schema["required"]
                .as_array()
                .cloned()
                .unwrap_or_default();
            let arguments: JsonObject = required
                .iter()
                .filter_map(|name| Some((name.as_str()?.to_owned(), json!("home"))))
                .collect();
            let read = Call::read(&tool.name, Some(arguments)).expect("it is known");
            assert!(read.is_ok(), "{}", tool.name);
            assert!(
                tool.annotations.is_some() && tool.title.is_some(),
                "{}",
                tool.name
            );
        }
    }
}
