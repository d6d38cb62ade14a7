//! A scripted client of the Model Context Protocol: it starts the real `mom-mcp` and talks to it in lines.

use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::mpsc;
use std::time::Instant;

use serde_json::{Value as Json, json};

use crate::programs::{PATIENCE, program};

/// A scripted client of MCP, and the server that it has started.
#[derive(Debug)]
pub struct Assistant {
    child: Child,
    input: Option<ChildStdin>,
    lines: mpsc::Receiver<Json>,
    last: u64,
}

impl Assistant {
    /// Starts the server and greets it.
    ///
    /// # Panics
    /// If it does not answer as a server of MCP.
    pub fn at(hub: &str) -> Assistant {
        let mut assistant = Assistant::start(hub);
        let hello = json!({"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "test", "version": "1"}});
        let welcome = assistant.request("initialize", &hello);
        assert_eq!(welcome["serverInfo"]["name"], "mom-mcp", "{welcome}");
        assert!(welcome["instructions"].is_string(), "{welcome}");
        assistant.line(r#"{"jsonrpc":"2.0","method":"notifications/initialized"}"#);
        // From here on it is at the hub.
        assistant.good("where", &json!({}));
        assistant
    }

    /// Starts the server.
    ///
    /// # Panics
    /// If it cannot be started.
    pub fn start(hub: &str) -> Assistant {
        let mut child = Command::new(program("mom-mcp"))
            .envs([("MOM_HUB", hub), ("MOM_PASSWORD", "assistant")])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let input = child.stdin.take();
        let output = BufReader::new(child.stdout.take().expect("it is piped"));
        let (sender, lines) = mpsc::channel();
        std::thread::spawn(move || {
            for line in output.lines().map_while(Result::ok) {
                let line = serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line}"));
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        Assistant {
            child,
            input,
            lines,
            last: 0,
        }
    }

    /// Says a line.
    ///
    /// # Panics
    /// If nobody reads it.
    pub fn line(&mut self, line: &str) {
        let input = self.input.as_mut().expect("it is open");
        writeln!(input, "{line}").expect("it reads");
        input.flush().expect("it reads");
    }

    /// The next line that it says.
    ///
    /// # Panics
    /// If none comes in time.
    pub fn heard(&self) -> Json {
        self.lines.recv_timeout(PATIENCE).expect("it answers")
    }

    /// Sends a request and gives its id.
    ///
    /// # Panics
    /// If nobody reads it.
    pub fn send(&mut self, method: &str, params: &Json) -> u64 {
        self.last += 1;
        let request = json!({"jsonrpc": "2.0", "id": self.last, "method": method, "params": params});
        self.line(&request.to_string());
        self.last
    }

    /// Calls a tool and gives the id of the call.
    ///
    /// # Panics
    /// If nobody reads it.
    pub fn begin(&mut self, tool: &str, arguments: &Json) -> u64 {
        self.send("tools/call", &json!({"name": tool, "arguments": arguments}))
    }

    /// The answer to a request.
    ///
    /// # Panics
    /// If none comes in time.
    pub fn answer(&self, id: u64) -> Json {
        loop {
            let answer = self.heard();
            if answer["id"] == id {
                return answer;
            }
        }
    }

    /// The result of a request.
    ///
    /// # Panics
    /// If it is an error of the protocol, or does not come.
    pub fn result(&self, id: u64) -> Json {
        let answer = self.answer(id);
        assert!(answer["result"].is_object(), "{answer}");
        answer["result"].clone()
    }

    /// Sends a request and gives its result.
    ///
    /// # Panics
    /// As [`result`](Self::result).
    pub fn request(&mut self, method: &str, params: &Json) -> Json {
        let id = self.send(method, params);
        self.result(id)
    }

    /// Calls a tool.
    ///
    /// # Panics
    /// As [`result`](Self::result).
    pub fn call(&mut self, tool: &str, arguments: &Json) -> Json {
        let id = self.begin(tool, arguments);
        self.result(id)
    }

    /// Calls a tool that is to work, and gives its facts.
    ///
    /// # Panics
    /// If it does not.
    pub fn good(&mut self, tool: &str, arguments: &Json) -> Json {
        let result = self.call(tool, arguments);
        assert_eq!(result["isError"], false, "{tool}: {result}");
        result["structuredContent"].clone()
    }

    /// Calls a tool that is to fail with this code, and gives its words.
    ///
    /// # Panics
    /// If it does not.
    pub fn bad(&mut self, tool: &str, arguments: &Json, code: &str) -> String {
        let id = self.begin(tool, arguments);
        self.failure(id, code)
    }

    /// The words of a call that is to fail with this code.
    ///
    /// # Panics
    /// If it does not.
    pub fn failure(&self, id: u64, code: &str) -> String {
        let result = self.result(id);
        assert_eq!(result["isError"], true, "{result}");
        assert_eq!(result["structuredContent"]["error"]["code"], code, "{result}");
        text(&result)
    }

    /// Moves; the facts of the answer.
    ///
    /// # Panics
    /// If it does not.
    pub fn moves(&mut self, script: &str) -> Json {
        self.good("move", &json!({"script": script}))
    }

    /// The number of its process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Closes its input and waits for its end.
    ///
    /// # Panics
    /// If it cannot be waited for.
    pub fn close(mut self) -> ExitStatus {
        drop(self.input.take());
        self.end()
    }

    /// Waits for its end.
    ///
    /// # Panics
    /// If it cannot be waited for.
    pub fn end(&mut self) -> ExitStatus {
        let deadline = Instant::now() + PATIENCE;
        // Its output ends with it.
        while Instant::now() < deadline && self.lines.recv_timeout(PATIENCE).is_ok() {}
        self.child.wait().expect("it ends")
    }
}

impl Drop for Assistant {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The words of a tool's answer.
pub fn text(result: &Json) -> String {
    result["content"][0]["text"]
        .as_str()
        .unwrap_or_default()
        .to_owned()
}
