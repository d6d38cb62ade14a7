//! The module `robot`: what a robot's program does, and what it tells.

use mom_rsp::{Kind, Payload};

use crate::model::ModelElement;

use super::{Code, Shape, Writer, camel, doc, imports, title};

impl Writer<'_> {
    pub(super) fn robot(&self, code: &mut Code) {
        let mut body = Code::default();
        self.body(&mut body);
        self.dispatch(&mut body);
        self.said(&mut body);
        let body = body.end();
        doc(code, "The robot itself: no library, no allocator.");
        code.block("pub mod robot {", "}", |code| {
            let of_typed = [("Named as _", "::PLACE"), ("Numbers as _", "code("), ("Unsent", "Unsent")];
            let mut used = vec![
                "use ::mom_rsp::robot::{self, Outgoing};".to_owned(),
                imports(&body, "::mom_rsp::typed", &of_typed),
                imports(&body, "::mom_rsp", &[("Fragment", "Fragment<"), ("Refused", "Refused")]),
            ];
            used.retain(|line| !line.is_empty());
            // As rustfmt orders them: lists go last.
            used.sort_by_key(|line| line.contains("mom_rsp::{"));
            used.sort_by_key(|line| !line.contains("mom_rsp::Fragment"));
            code.line(used.join("\n"));
            let of_file = [("LAYOUT", ""), ("elements", "elements::")];
            code.line(format!("\n{}\n", imports(&body, "super", &of_file)));
            doc(code, "Bytes for values and data that wait.");
            code.line("pub const VALUES: usize = robot::values(&LAYOUT);\n");
            doc(code, "Bytes of one buffer of memory events.");
            code.line("pub const SLOT: usize = robot::slot(&LAYOUT);\n");
            doc(code, "Bytes of the buffer into which datagrams are received, and of the one for those that are sent.");
            code.line("pub const PACKET: usize = LAYOUT.largest();\n");
            doc(code, "The end of a robot with `B` buffers of memory events.");
            let count = self.model.elements.len();
            code.line(format!(
                "pub type Robot<const B: usize> = robot::Robot<'static, {count}, VALUES, B, SLOT>;\n"
            ));
            code.line(body.trim_end());
        });
    }

    /// The functions that a robot's program has for effectors and commands: their names, kinds and parameters.
    fn heard(&self) -> impl Iterator<Item = (usize, &ModelElement, String, Option<(&'static str, String)>)> {
        self.model
            .elements
            .iter()
            .enumerate()
            .filter_map(|(place, element)| {
                let prefix = match element.kind {
                    Kind::Effector => "set",
                    Kind::Command | Kind::MemoryCommand => "run",
                    _ => return None,
                };
                // Nothing comes of a value that travels in fragments alone: those are heard as they are.
                if element.blob.is_some() {
                    return None;
                }
                let parameter = match (Shape::of(self.model, element, &self.units), element.payload) {
                    (Some(shape), _) => Some(("value", shape.path())),
                    (None, Payload::Bytes(_)) => Some(("bytes", "&[u8]".to_owned())),
                    (None, _) => None,
                };
                let name = format!("{prefix}_{}", element.name.replace('-', "_"));
                Some((place, element, name, parameter))
            })
    }

    fn body(&self, code: &mut Code) {
        doc(code, "What the robot's own program does.");
        code.block("pub trait Body {", "}\n", |code| {
            doc(code, "Fills the bytes with what nobody can foresee.");
            code.line("fn random(&mut self, bytes: &mut [u8]);");
            for (_, element, name, parameter) in self.heard() {
                code.line("");
                doc(code, &title(element));
                let parameter = parameter.map(|(name, path)| format!(", {name}: {path}"));
                code.line(format!("fn {name}(&mut self{});", parameter.unwrap_or_default()));
            }
            code.line(DEFAULTS);
        });
    }

    fn dispatch(&self, code: &mut Code) {
        doc(
            code,
            "Brings what arrives to a program's functions: `robot.receive(now, datagram, &mut Dispatch(&mut body))`.",
        );
        code.line("#[derive(Debug)]\npub struct Dispatch<'b, B>(pub &'b mut B);\n");
        code.block("impl<B: Body> robot::Body for Dispatch<'_, B> {", "}\n", |code| {
            code.block("fn random(&mut self, bytes: &mut [u8]) {", "}\n", |code| {
                code.line("self.0.random(bytes);");
            });
            self.arms(
                "fn effector(&mut self, element: u8, value: &[u8]) {",
                "value",
                true,
                code,
            );
            code.line("");
            self.arms(
                "fn command(&mut self, element: u8, data: &[u8]) {",
                "data",
                false,
                code,
            );
            code.line(PASSED);
        });
    }

    /// A function that finds the function of an element.
    fn arms(&self, begin: &str, argument: &str, effectors: bool, code: &mut Code) {
        let arms: Vec<_> = self
            .heard()
            .filter(|(_, element, ..)| (element.kind == Kind::Effector) == effectors)
            .collect();
        if arms.len() == 1 {
            code.line("#[allow(clippy::single_match, reason = \"another model has several\")]");
        }
        code.block(begin, "}", |code| {
            if arms.is_empty() {
                code.line(format!("let _ = (element, {argument});"));
                return;
            }
            if !arms.iter().any(|(.., parameter)| parameter.is_some()) {
                code.line(format!("let _ = {argument};"));
            }
            code.block("match element {", "}", |code| {
                for (place, element, name, parameter) in arms {
                    match (parameter, element.payload) {
                        (Some(_), Payload::Numbers(..)) => {
                            code.block(format!("{place} => {{"), "}", |code| {
                                let of = camel(&element.name);
                                let begin =
                                    format!("if let Some(value) = elements::{of}::decode({argument}) {{");
                                code.block(begin, "}", |code| {
                                    code.line(format!("self.0.{name}(value);"));
                                });
                            });
                        }
                        (Some(_), _) => {
                            code.line(format!("{place} => self.0.{name}({argument}),"));
                        }
                        (None, _) => {
                            code.line(format!("{place} => self.0.{name}(),"));
                        }
                    }
                }
                code.line("_ => {}");
            });
        });
    }

    /// Functions by which a robot's program tells values and events.
    fn said(&self, code: &mut Code) {
        let mut is_first = true;
        for element in &self.model.elements {
            let (call, prefix) = match element.kind {
                Kind::Sensor | Kind::Monitor if element.blob.is_none() => ("set", "tell"),
                Kind::Event | Kind::MemoryEvent => ("raise", "raise"),
                _ => continue,
            };
            if !std::mem::take(&mut is_first) {
                code.line("");
            }
            let large = camel(&element.name);
            let function = format!(
                "pub fn {prefix}_{}<const B: usize>",
                element.name.replace('-', "_")
            );
            doc(code, &title(element));
            code.line("///\n/// # Errors\n///");
            match (Shape::of(self.model, element, &self.units), element.payload) {
                (Some(shape), _) => {
                    doc(
                        code,
                        "[`Unsent`]: a number is outside its range, or the robot's end refuses it.",
                    );
                    let path = shape.path();
                    signature(&function, &format!("value: {path}"), "Unsent", code);
                    code.inside("}", |code| {
                        code.line(format!(
                            "let bytes = elements::{large}::encode(value).ok_or(Unsent::Range)?;"
                        ));
                        code.line(format!("Ok(robot.{call}(elements::{large}::PLACE, &bytes)?)"));
                    });
                }
                (None, Payload::Bytes(_)) => {
                    doc(code, "[`Refused`], as the robot's end says.");
                    signature(&function, "bytes: &[u8]", "Refused", code);
                    code.inside("}", |code| {
                        code.line(format!("robot.{call}(elements::{large}::PLACE, bytes)"));
                    });
                }
                (None, _) => {
                    doc(code, "[`Refused`], as the robot's end says.");
                    code.block(
                        format!("{function}(robot: &mut Robot<B>) -> Result<(), Refused> {{"),
                        "}",
                        |code| {
                            code.line(format!("robot.{call}(elements::{large}::PLACE, &[])"));
                        },
                    );
                }
            }
        }
    }
}

/// The head of a function, over several lines, as its parameters seldom fit one.
fn signature(function: &str, parameter: &str, error: &str, code: &mut Code) {
    code.line(format!(
        "{function}(\n    robot: &mut Robot<B>,\n    {parameter},\n) -> Result<(), {error}> {{"
    ));
}

/// What a robot's program may leave out.
const DEFAULTS: &str = "
/// A part of a blob is here; parts come in any order and may be lost.
fn fragment(&mut self, fragment: Fragment<'_>) {
    let _ = fragment;
}

/// The next part of a blob for the middle.
fn next_fragment(&mut self, into: &mut [u8]) -> Option<Outgoing> {
    let _ = into;
    None
}

/// An element was activated or deactivated.
fn active(&mut self, element: u8, active: bool) {
    let _ = (element, active);
}

/// A session began; or it is over, and all effectors have their safe values.
fn session(&mut self, up: bool) {
    let _ = up;
}

/// The session ended before the middle said that an event has arrived.
fn unknown(&mut self, element: u8) {
    let _ = element;
}";

/// What goes to a robot's program as it is.
const PASSED: &str = "
fn fragment(&mut self, fragment: Fragment<'_>) {
    self.0.fragment(fragment);
}

fn next_fragment(&mut self, into: &mut [u8]) -> Option<Outgoing> {
    self.0.next_fragment(into)
}

fn active(&mut self, element: u8, active: bool) {
    self.0.active(element, active);
}

fn session(&mut self, up: bool) {
    self.0.session(up);
}

fn unknown(&mut self, element: u8) {
    self.0.unknown(element);
}";
