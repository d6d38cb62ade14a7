//! The module `middle`: elements by their names, and events.

use mom_rsp::{Kind, Payload};

use crate::model::ModelElement;

use super::{Code, Shape, Writer, camel, doc, imports, snake, title};

impl Writer<'_> {
    pub(super) fn middle(&self, code: &mut Code) {
        let mut body = Code::default();
        self.handles(&mut body);
        if self.events().next().is_some() {
            body.line("");
            self.raised(&mut body);
        }
        let body = body.end();
        doc(code, "The robot at the middle.");
        code.block("pub mod middle {", "}\n", |code| {
            code.line(imports(
                &body,
                "::mom_rsp::middle",
                &[("Middle", "Middle"), ("Notice", "Notice")],
            ));
            code.line(imports(
                &body,
                "::mom_rsp::typed",
                &[("Handle", "Handle"), ("Numbers as _", "::decode(")],
            ));
            code.line("\nuse super::elements;\n");
            code.line(body.trim_end());
        });
    }

    fn handles(&self, code: &mut Code) {
        doc(code, "The elements of a middle of this model, by their names.");
        code.line("pub struct Elements<'a, 'm>(pub &'a mut Middle<'m>);\n");
        code.block("impl<'m> Elements<'_, 'm> {", "}", |code| {
            for (index, element) in self.model.elements.iter().enumerate() {
                if index > 0 {
                    code.line("");
                }
                doc(code, &title(element));
                let (small, large) = (snake(&element.name), camel(&element.name));
                let begin = format!("pub fn {small}(&mut self) -> Handle<'_, 'm, elements::{large}> {{");
                code.block(begin, "}", |code| {
                    code.line("Handle::new(self.0)");
                });
            }
        });
    }

    fn events(&self) -> impl Iterator<Item = (usize, &ModelElement)> {
        let is_event =
            |(_, element): &(usize, &ModelElement)| matches!(element.kind, Kind::Event | Kind::MemoryEvent);
        self.model.elements.iter().enumerate().filter(is_event)
    }

    fn raised(&self, code: &mut Code) {
        doc(code, "An event of the robot, with its data.");
        code.line("#[derive(Clone, Debug, PartialEq)]");
        code.block("pub enum Raised {", "}\n", |code| {
            for (_, element) in self.events() {
                doc(code, &title(element));
                let name = camel(&element.name);
                match (Shape::of(self.model, element, &self.units), element.payload) {
                    (Some(shape), _) => code.line(format!("{name}({}),", shape.path())),
                    (None, Payload::Bytes(_)) => code.line(format!("{name}(Vec<u8>),")),
                    (None, _) => code.line(format!("{name},")),
                };
            }
        });
        code.block("impl Raised {", "}", |code| {
            doc(code, "The event of a notice, if it is one.");
            code.line("#[must_use]");
            code.block("pub fn of(notice: &Notice) -> Option<Raised> {", "}", |code| {
                let has_data = self
                    .events()
                    .any(|(_, element)| element.payload != Payload::Nothing);
                let data = if has_data { " data," } else { "" };
                let begin = format!("let Notice::Raised {{ element,{data} .. }} = notice else {{");
                code.block(begin, "};", |code| {
                    code.line("return None;");
                });
                code.block("match element {", "}", |code| {
                    for (place, element) in self.events() {
                        let name = camel(&element.name);
                        match element.payload {
                            Payload::Numbers(..) => code.line(format!(
                                "{place} => elements::{name}::decode(data).map(Raised::{name}),"
                            )),
                            Payload::Bytes(_) => {
                                code.line(format!("{place} => Some(Raised::{name}(data.clone())),"))
                            }
                            Payload::Nothing => code.line(format!("{place} => Some(Raised::{name}),")),
                        };
                    }
                    code.line("_ => None,");
                });
            });
        });
    }
}
