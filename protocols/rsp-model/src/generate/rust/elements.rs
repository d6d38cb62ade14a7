//! The module `elements`: a type for each element.

use mom_rsp::{Kind, Motion, Payload};

use crate::model::{ModelElement, Quantity};

use super::super::units::Scalar;
use super::{Code, Shape, Writer, camel, doc, number_name, snake, spaced, title};

impl Writer<'_> {
    pub(super) fn elements(&self, code: &mut Code) {
        doc(code, "A type for each element.");
        code.block("pub mod elements {", "}\n", |code| {
            code.line("use ::mom_rsp::typed;");
            for (place, element) in self.model.elements.iter().enumerate() {
                code.line("");
                self.element_type(place, element, code);
            }
        });
    }

    fn element_type(&self, place: usize, element: &ModelElement, code: &mut Code) {
        let name = camel(&element.name);
        let shape = Shape::of(self.model, element, &self.units);
        doc(code, &title(element));
        if !element.doc.is_empty() {
            code.line("///");
            doc(code, &element.doc);
        }
        match &shape {
            Some(Shape::Parts(of, parts)) if *of == name => {
                code.line("#[derive(Clone, Copy, Debug, Default, PartialEq)]");
                code.block(format!("pub struct {name} {{"), "}\n", |code| {
                    for ((part, scalar), quantity) in parts.iter().zip(&element.quantities) {
                        let words = format!("{}: {} to {}", spaced(part), quantity.min, quantity.max);
                        doc(code, format!("{words} {}", quantity.unit).trim());
                        code.line(format!("pub {}: {},", snake(part), scalar.path()));
                    }
                });
            }
            _ => {
                code.line("#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]");
                code.line(format!("pub struct {name};\n"));
            }
        }
        code.block(format!("impl typed::Named for {name} {{"), "}", |code| {
            code.line(format!(
                "const PLACE: u8 = {place};\nconst NAME: &'static str = {:?};",
                element.name
            ));
        });
        if let Some(sound) = element.sound {
            code.block(format!("\nimpl {name} {{"), "}", |code| {
                code.line("/// What its bytes are.");
                code.block(
                    "pub const SOUND: ::mom_rsp::Sound = ::mom_rsp::Sound {",
                    "};",
                    |code| {
                        code.line(format!(
                            "codec: ::mom_rsp::AudioCodec::{:?},\nrate: {},",
                            sound.codec, sound.rate
                        ));
                    },
                );
            });
        }
        let mut marks = Vec::new();
        match element.kind {
            Kind::Effector => marks.push("Effector"),
            Kind::Sensor | Kind::Monitor => marks.push("Sensor"),
            Kind::Command | Kind::MemoryCommand => marks.push("Command"),
            Kind::Event | Kind::MemoryEvent | Kind::Module => {}
        }
        match element.payload {
            Payload::Bytes(_) => marks.push("Bytes"),
            Payload::Nothing if element.kind != Kind::Module => marks.push("Plain"),
            _ => {}
        }
        for mark in marks {
            code.line(format!("\nimpl typed::{mark} for {name} {{}}"));
        }
        if let Some(shape) = shape {
            code.line("");
            self.numbers(element, &name, &shape, code);
        }
    }

    fn numbers(&self, element: &ModelElement, name: &str, shape: &Shape, code: &mut Code) {
        let Payload::Numbers(number, count) = element.payload else {
            return;
        };
        let is_limited = element.kind == Kind::Effector && matches!(element.motion, Motion::Absolute { .. });
        code.block(format!("impl typed::Numbers for {name} {{"), "}", |code| {
            code.line(format!("type Value = {};", shape.path()));
            code.line(format!(
                "type List = [f64; {count}];\ntype Bytes = [u8; {}];",
                element.payload.size()
            ));
            code.line(format!("const LIST: [f64; {count}] = [0.0; {count}];"));
            let size = element.payload.size();
            code.line(format!("const BYTES: [u8; {size}] = [0; {size}];"));
            let start = "const QUANTITIES: &'static [typed::Quantity] = &[";
            let inside = |quantity: &Quantity, code: &mut Code| {
                code.line(format!("number: ::mom_rsp::Number::{},", number_name(number)));
                code.line(format!("scale: {:?},", quantity.scale));
                code.line(format!("min: {:?},\nmax: {:?},", quantity.min, quantity.max));
            };
            match element.quantities.as_slice() {
                [only] => {
                    code.block(format!("{start}typed::Quantity {{"), "}];", |code| {
                        inside(only, code);
                    });
                }
                several => {
                    code.block(start, "];", |code| {
                        for quantity in several {
                            code.block("typed::Quantity {", "},", |code| inside(quantity, code));
                        }
                    });
                }
            }
            code.line(format!("const LIMITED: bool = {is_limited};\n"));
            conversions(shape, count, code);
        });
    }
}

/// How a value becomes plain numbers, and comes of them.
fn conversions(shape: &Shape, count: u16, code: &mut Code) {
    let (list, value) = match shape {
        Shape::One(scalar) => (
            format!("[{}]", scalar.number("value")),
            format!("let [number] = list;\n{}", scalar.of_number("number")),
        ),
        Shape::Array(Scalar::Float, _) => ("value".to_owned(), "list".to_owned()),
        Shape::Array(scalar @ Scalar::Unit(_), _) => (
            format!("value.map(|number| {})", scalar.number("number")),
            format!("list.map({})", scalar.path()),
        ),
        Shape::Array(scalar @ Scalar::Raw(_), _) => (
            "value.map(f64::from)".to_owned(),
            format!("list.map(|number| {})", scalar.of_number("number")),
        ),
        Shape::Parts(name, parts) => {
            let numbers = parts
                .iter()
                .map(|(part, scalar)| scalar.number(&format!("value.{}", snake(part))));
            let members = parts.iter().map(|(part, scalar)| {
                let part = snake(part);
                match scalar.of_number(&part) {
                    same if same == part => format!("    {part},"),
                    made => format!("    {part}: {made},"),
                }
            });
            let names: Vec<String> = parts.iter().map(|(part, _)| snake(part)).collect();
            (
                array(&numbers.collect::<Vec<_>>()),
                format!(
                    "let {} = list;\nsuper::elements::{name} {{\n{}\n}}",
                    array(&names),
                    members.collect::<Vec<_>>().join("\n")
                ),
            )
        }
    };
    code.block(
        format!("fn list(value: Self::Value) -> [f64; {count}] {{"),
        "}\n",
        |code| {
            code.line(list);
        },
    );
    code.block(
        format!("fn value(list: [f64; {count}]) -> Self::Value {{"),
        "}",
        |code| {
            code.line(value);
        },
    );
}

/// An array in a line, or in a line for each if it is long.
fn array(items: &[String]) -> String {
    let line = items.join(", ");
    match line.len() <= 58 {
        true => format!("[{line}]"),
        false => format!("[\n    {},\n]", items.join(",\n    ")),
    }
}
