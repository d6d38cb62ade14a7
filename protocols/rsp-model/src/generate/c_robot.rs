//! What the header of C has for the library of the robot's end in C: layout, memory, and functions in the model's types.

use mom_rsp::{Kind, Motion, Number, Payload};

use crate::model::{Model, ModelElement};

use super::code::{Code, comment_lines};
use super::names::upper;

/// Writes it, for where `mom_rsp.h` is included before the header. Functions and types begin with `small`, constants with `large`.
pub(super) fn robot(model: &Model, small: &str, large: &str, code: &mut Code) {
    let robot = Robot { model, small, large };
    code.line("#ifdef MOM_RSP_LIBRARY_H");
    code.line("/* ---- The robot's end, where mom_rsp.h is included before this file ---- */\n");
    robot.sizes(code);
    robot.layout(code);
    robot.quantities(code);
    robot.program(code);
    let (types, functions) = ROBOT.split_once("static inline").unwrap_or((ROBOT, ""));
    let named = |text: &str| text.replace("NAME", small).replace("PREFIX", large);
    code.line(named(types).trim_end()).line("");
    robot.dispatch("effector", "value", code);
    robot.dispatch("command", "data", code);
    code.line(named(&format!("static inline{functions}")));
    for element in &model.elements {
        robot.tell(element, code);
    }
    code.line("#endif /* MOM_RSP_LIBRARY_H */\n");
}

struct Robot<'m> {
    model: &'m Model,
    small: &'m str,
    large: &'m str,
}

impl Robot<'_> {
    fn sizes(&self, code: &mut Code) {
        let large = self.large;
        let elements = self.model.wire_elements();
        let layout = self.model.layout(&elements);
        let holds = elements.iter().any(|element| element.kind == Kind::MemoryEvent);
        let buffers = if holds { 8 } else { 0 };
        code.line(format!(
            "/* Buffers for memory events, 0 to 255: define another number before this file. */\n\
             #ifndef {large}_BUFFERS\n#define {large}_BUFFERS {buffers}\n#endif"
        ));
        for (name, value, what) in [
            (
                "VALUES",
                mom_rsp::robot::values(&layout),
                "Bytes for values and data that wait.",
            ),
            (
                "SLOT",
                mom_rsp::robot::slot(&layout),
                "Bytes of one buffer of memory events.",
            ),
            (
                "PACKET",
                layout.largest(),
                "Bytes of the buffers for datagrams that are received and sent.",
            ),
        ] {
            code.line(format!("/* {what} */\n#define {large}_{name} {value}"));
        }
        code.line("");
    }

    fn layout(&self, code: &mut Code) {
        let (small, large) = (self.small, self.large);
        for element in &self.model.elements {
            if !element.safe.is_empty() {
                let bytes: Vec<String> = element.safe.iter().map(|byte| format!("0x{byte:02x}")).collect();
                let name = plain(element);
                code.line(format!(
                    "static const uint8_t {small}_safe_{name}[] = {{ {} }};",
                    bytes.join(", ")
                ));
            }
        }
        let begin = format!("static const struct mom_rsp_element {small}_elements[{large}_ELEMENTS] = {{");
        code.block(begin, "};\n", |code| {
            for element in &self.model.elements {
                code.line(entry(small, element));
            }
        });
        code.line(format!(
            "static const struct mom_rsp_layout {small}_layout = {{ {large}_MODEL_ID, {large}_HASH, {large}_ELEMENTS, {small}_elements }};\n"
        ));
    }

    fn quantities(&self, code: &mut Code) {
        for element in &self.model.elements {
            let Payload::Numbers(number, _) = element.payload else {
                continue;
            };
            let begin = format!(
                "static const struct mom_rsp_quantity {} = {{",
                self.quantity_name(element, "[]")
            );
            code.block(begin, "};", |code| {
                for of in &element.quantities {
                    code.line(format!(
                        "{{ {}, {:?}, {:?}, {:?} }},",
                        type_of(number),
                        of.scale,
                        of.min,
                        of.max
                    ));
                }
            });
        }
        code.line("");
    }

    fn quantity_name(&self, element: &ModelElement, behind: &str) -> String {
        format!("{}_quantities_{}{behind}", self.small, plain(element))
    }

    /// The program's functions for effectors, or for commands: their elements and names.
    fn heard(&self) -> impl Iterator<Item = (&ModelElement, String)> {
        self.model.elements.iter().filter_map(|element| {
            let prefix = match element.kind {
                Kind::Effector => "set",
                Kind::Command | Kind::MemoryCommand => "run",
                _ => return None,
            };
            // Nothing comes of a value that travels in fragments alone: those are heard as they are.
            let whole = element.blob.is_none();
            whole.then(|| (element, format!("{prefix}_{}", plain(element))))
        })
    }

    fn program(&self, code: &mut Code) {
        code.line(
            "/* The robot's own program, in the units of the model. Each function gets `self`; those that are NULL are left out, but for `random`.\n   \
             A value of an absolute effector is within its range, whatever was sent. */",
        );
        code.block(format!("struct {}_program {{", self.small), "};\n", |code| {
            code.line("/* Fills the bytes with what nobody can foresee. */");
            code.line("void (*random)(void *self, uint8_t *bytes, size_t size);");
            for (element, name) in self.heard() {
                self.comment(element, code);
                let parameters = parameters(element);
                code.line(format!("void (*{name})(void *self{parameters});"));
            }
            code.line("/* As in struct mom_rsp_body. */");
            code.line("void (*fragment)(void *self, const struct mom_rsp_fragment *fragment);");
            code.line("bool (*next_fragment)(void *self, struct mom_rsp_fragment *fragment, uint8_t *into);");
            code.line("void (*active)(void *self, uint8_t element, bool active);");
            code.line("void (*session)(void *self, bool up);");
            code.line("void (*unknown)(void *self, uint8_t element);");
        });
    }

    /// What an element is, with its parts and units.
    fn comment(&self, element: &ModelElement, code: &mut Code) {
        let numbers = element.quantities.iter().map(|of| {
            let words = [of.part.as_deref().unwrap_or(""), of.unit.as_str()];
            let words: Vec<&str> = words.into_iter().filter(|word| !word.is_empty()).collect();
            words.join(" in ")
        });
        let numbers: Vec<String> = numbers.filter(|words| !words.is_empty()).collect();
        let all = match numbers.as_slice() {
            [] => String::new(),
            numbers => format!(" ({})", numbers.join(", ")),
        };
        code.line(format!("/* {}{all}", comment_lines(&element.name).concat()));
        let doc = comment_lines(&element.doc);
        if doc.is_empty() {
            code.line(" */");
        }
        for (index, line) in doc.iter().enumerate() {
            let end = if index + 1 == doc.len() { " */" } else { "" };
            code.line(format!("   {line}{end}"));
        }
    }

    /// The function that brings what arrives to a function of the program.
    fn dispatch(&self, what: &str, argument: &str, code: &mut Code) {
        let (small, large) = (self.small, self.large);
        let heard: Vec<_> = self
            .heard()
            .filter(|(element, _)| (element.kind == Kind::Effector) == (what == "effector"))
            .collect();
        let begin = format!(
            "static inline void {small}_on_{what}(void *self, uint8_t element, const uint8_t *{argument}, size_t size)\n{{"
        );
        code.block(begin, "}\n", |code| {
            code.line(format!(
                "const struct {small}_robot *robot = (const struct {small}_robot *)self;\n\
                 const struct {small}_program *program = robot->program;\n(void){argument};\n(void)size;\n(void)program;"
            ));
            code.line("switch (element) {");
            for (element, name) in heard {
                code.line(format!("case {large}_ELEMENT_{}:", upper(&element.name)));
                let begin = format!("    if (program->{name} != NULL) {{");
                code.block(begin, "    }\n    break;", |code| {
                    self.call(element, &name, argument, code);
                });
            }
            code.line("default:\n    break;\n}");
        });
    }

    fn call(&self, element: &ModelElement, name: &str, argument: &str, code: &mut Code) {
        let call = |with: &str| format!("    program->{name}(robot->self{with});");
        let Payload::Numbers(_, count) = element.payload else {
            let with = match element.payload {
                Payload::Bytes(_) => format!(", {argument}, size"),
                _ => String::new(),
            };
            code.line(call(&with));
            return;
        };
        let limited = element.kind == Kind::Effector && matches!(element.motion, Motion::Absolute { .. });
        let with = if count == 1 { ", numbers[0]" } else { ", numbers" };
        code.line(format!(
            "    double numbers[{count}];\n    mom_rsp_decode({}, {}, {limited}, {argument}, numbers, {count});",
            self.quantity_name(element, ""),
            element.quantities.len(),
        ));
        code.line(call(with));
    }

    /// A function by which a robot's program tells a value or raises an event.
    fn tell(&self, element: &ModelElement, code: &mut Code) {
        let (small, large) = (self.small, self.large);
        let (call, prefix) = match element.kind {
            Kind::Sensor | Kind::Monitor if element.blob.is_none() => ("set", "tell"),
            Kind::Event | Kind::MemoryEvent => ("raise", "raise"),
            _ => return,
        };
        self.comment(element, code);
        let parameters = parameters(element);
        let begin = format!(
            "static inline enum mom_rsp_refused {small}_{prefix}_{}(struct {small}_robot *robot{parameters})\n{{",
            plain(element)
        );
        code.block(begin, "}\n", |code| {
            let place = format!("{large}_ELEMENT_{}", upper(&element.name));
            match element.payload {
                Payload::Numbers(number, count) => {
                    let value = if count == 1 { "&value" } else { "value" };
                    code.line(format!(
                        "uint8_t bytes[{}];\nif (!mom_rsp_encode({}, {}, {value}, bytes, {count}))\n    return MOM_RSP_REFUSED_RANGE;\n\
                         return mom_rsp_{call}(&robot->end, {place}, bytes, sizeof bytes);",
                        number.size() * usize::from(count),
                        self.quantity_name(element, ""),
                        element.quantities.len(),
                    ));
                }
                Payload::Bytes(_) => {
                    code.line(format!("return mom_rsp_{call}(&robot->end, {place}, bytes, size);"));
                }
                Payload::Nothing => {
                    code.line(format!("return mom_rsp_{call}(&robot->end, {place}, NULL, 0);"));
                }
            }
        });
    }
}

/// An element's line of the layout.
fn entry(small: &str, element: &ModelElement) -> String {
    let (number, count) = match element.payload {
        Payload::Nothing => ("MOM_RSP_NOTHING", 0),
        Payload::Numbers(number, count) => (type_of(number), count),
        Payload::Bytes(most) => ("MOM_RSP_BYTES", most),
    };
    let (motion, rate) = match element.motion {
        Motion::Absolute {
            interpolate: false,
            rate,
        } => ("ABSOLUTE", rate),
        Motion::Absolute {
            interpolate: true,
            rate,
        } => ("INTERPOLATED", rate),
        Motion::Incremental { rate } => ("INCREMENTAL", rate),
    };
    let safe = match element.safe.is_empty() {
        true => "NULL".to_owned(),
        false => format!("{small}_safe_{}", plain(element)),
    };
    let module = element
        .module
        .map_or_else(|| "MOM_RSP_NO_MODULE".to_owned(), |module| module.to_string());
    format!(
        "{{ \"{}\", 0x{:08x}u, MOM_RSP_{}, {number}, {count}, MOM_RSP_{motion}, {:?}f, {safe}, {}, {}, {module} }},",
        element.name,
        element.digest,
        kind_of(element.kind),
        rate.unwrap_or(0.0),
        element.safe.len(),
        element.period,
    )
}

/// What a function has behind `self` for the data of an element.
fn parameters(element: &ModelElement) -> String {
    match element.payload {
        Payload::Nothing => String::new(),
        Payload::Numbers(_, 1) => ", double value".to_owned(),
        Payload::Numbers(_, count) => format!(", const double value[{count}]"),
        Payload::Bytes(_) => ", const uint8_t *bytes, size_t size".to_owned(),
    }
}

/// `left_wheel`, also where that is a keyword: behind a prefix it is none.
fn plain(element: &ModelElement) -> String {
    element.name.replace('-', "_")
}

fn kind_of(kind: Kind) -> &'static str {
    match kind {
        Kind::Effector => "EFFECTOR",
        Kind::Sensor => "SENSOR",
        Kind::Monitor => "MONITOR",
        Kind::Command => "COMMAND",
        Kind::Module => "MODULE",
        Kind::Event => "EVENT",
        Kind::MemoryCommand => "MEMORY_COMMAND",
        Kind::MemoryEvent => "MEMORY_EVENT",
    }
}

fn type_of(number: Number) -> &'static str {
    match number {
        Number::U8 => "MOM_RSP_U8",
        Number::I8 => "MOM_RSP_I8",
        Number::U16 => "MOM_RSP_U16",
        Number::I16 => "MOM_RSP_I16",
        Number::U32 => "MOM_RSP_U32",
        Number::I32 => "MOM_RSP_I32",
        Number::F32 => "MOM_RSP_F32",
    }
}

/// What does not depend on the model but by its names.
const ROBOT: &str = include_str!("robot.h");
