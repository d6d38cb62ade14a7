//! A robot in C over the library and a generated header, in the model's units.

mod c_common;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use c_common::{CUBO, c_end, header};
use mom_rsp::typed::Quantity;
use mom_rsp::{Kind, Motion, Payload};
use mom_rsp_model::{Model, ModelElement, generate};

const IR_ROBOT: &str = include_str!("../../../config/ir-robot.toml");
const KINDS: &str = include_str!("models/kinds.toml");
const BARE: &str = include_str!("models/bare.toml");

/// Makes a program of this text with the header of a model and the library; `None` without a compiler.
fn program(name: &str, model: &Model, text: &str) -> Option<PathBuf> {
    let main = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.c"));
    fs::write(&main, text).expect("a program");
    let inputs = [&[main], &c_end::sources()[..]].concat();
    c_end::program(name, &inputs, &[header(model)])
}

/// What a robot's program does that prints what it is told; `NAME` is the model's prefix.
fn printing(model: &Model) -> String {
    let name = model.name().replace('-', "_");
    let mut text = format!(
        "#include <stdio.h>\n#include <stdlib.h>\n#include <string.h>\n#include \"mom_rsp.h\"\n#include \"{}.h\"\n\n\
         static void fill(void *self, uint8_t *bytes, size_t size)\n{{\n    (void)self;\n    memset(bytes, 7, size);\n}}\n\n",
        model.name()
    );
    let mut members = String::new();
    for element in model.elements() {
        let function = match element.kind {
            Kind::Effector => "set",
            Kind::Command | Kind::MemoryCommand => "run",
            _ => continue,
        };
        if element.blob.is_some() {
            continue;
        }
        let function = format!("{function}_{}", element.name.replace('-', "_"));
        let (parameters, prints) = match element.payload {
            Payload::Nothing => (String::new(), String::new()),
            Payload::Numbers(_, 1) => (
                ", double value".to_owned(),
                "    printf(\" %a\", value);\n".to_owned(),
            ),
            Payload::Numbers(_, count) => (
                format!(", const double value[{count}]"),
                format!("    for (int i = 0; i < {count}; i++)\n        printf(\" %a\", value[i]);\n"),
            ),
            Payload::Bytes(_) => (
                ", const uint8_t *bytes, size_t size".to_owned(),
                "    for (size_t i = 0; i < size; i++)\n        printf(\" %02x\", (unsigned)bytes[i]);\n"
                    .to_owned(),
            ),
        };
        text.push_str(&format!(
            "static void {function}(void *self{parameters})\n{{\n    (void)self;\n    printf(\"{}\");\n{prints}    putchar('\\n');\n}}\n\n",
            element.name
        ));
        members.push_str(&format!("    .{function} = {function},\n"));
    }
    text.push_str(&format!(
        "static const struct {name}_program PROGRAM = {{\n    .random = fill,\n{members}}};\n\n"
    ));
    text
}

/// Gives the dispatch of a model values as the library does, and prints what comes of them.
const DISPATCH: &str = r#"
int main(void)
{
    static struct NAME_robot robot;
    static uint8_t bytes[65536];
    struct mom_rsp_settings settings = { NULL, NULL, 500, 1000 };
    int calls, place;
    if (NAME_init(&robot, &settings, &PROGRAM, NULL) != MOM_RSP_FINE)
        return 1;
    while ((calls = getchar()) != EOF) {
        place = getchar();
        size_t size = (size_t)getchar();
        if (fread(bytes, 1, size, stdin) != size)
            return 1;
        (calls == 'c' ? NAME_body.command : NAME_body.effector)(&robot, (uint8_t)place, bytes, size);
    }
    return 0;
}
"#;

/// A number as C's `%a` reads back: the bits of it.
fn number(word: &str) -> f64 {
    let (sign, word) = word.strip_prefix('-').map_or((1.0, word), |word| (-1.0, word));
    let (digits, exponent) = word
        .strip_prefix("0x")
        .and_then(|word| word.split_once('p'))
        .expect("a number");
    let (whole, part) = digits.split_once('.').unwrap_or((digits, ""));
    let mantissa = u64::from_str_radix(&format!("{whole}{part}"), 16).expect("digits");
    let exponent: i32 = exponent.parse().expect("an exponent");
    sign * mantissa as f64 * 2_f64.powi(exponent - 4 * part.len() as i32)
}

/// What a robot's program in Rust is told: `typed::Numbers::decode`, as generated code has it.
fn expected(element: &ModelElement, bytes: &[u8]) -> Vec<f64> {
    let Payload::Numbers(kind, count) = element.payload else {
        return Vec::new();
    };
    let limited = element.kind == Kind::Effector && matches!(element.motion, Motion::Absolute { .. });
    (0..usize::from(count))
        .map(|index| {
            let of = element.quantity(index).expect("a quantity");
            let quantity = Quantity {
                number: kind,
                scale: of.scale,
                min: of.min,
                max: of.max,
            };
            let value = quantity
                .get(&bytes[index * kind.size()..][..kind.size()])
                .expect("its size");
            if limited {
                value.max(of.min).min(of.max)
            } else {
                value
            }
        })
        .collect()
}

/// Clamping: a program in C is told the same numbers as one in Rust, and never one beyond the model's range.
#[test]
fn numbers_come_in_their_units_and_within_their_range() {
    for (name, text) in [
        ("cubo", CUBO),
        ("ir-robot", IR_ROBOT),
        ("kinds", KINDS),
        ("bare", BARE),
    ] {
        let model = Model::read(text).expect("a model");
        let prefix = model.name().replace('-', "_");
        let text = format!("{}{}", printing(&model), DISPATCH.replace("NAME", &prefix));
        let Some(program) = program(&format!("c-dispatch-{name}"), &model, &text) else {
            return;
        };
        let (mut input, mut wanted) = (Vec::new(), Vec::new());
        for (place, element) in (0..).zip(model.elements()) {
            let verb = match element.kind {
                Kind::Effector => b'e',
                Kind::Command | Kind::MemoryCommand => b'c',
                _ => continue,
            };
            if element.blob.is_some() {
                continue;
            }
            let size = element.payload.size();
            for fill in [
                [0x00_u8; 4],
                [0x7F, 0x7F, 0xFF, 0xFF],
                [0x80, 0, 0, 0],
                [0xFF, 0x7F, 0xFF, 0xFF],
                [0, 0xC8, 1, 0x2C],
            ] {
                let bytes: Vec<u8> = fill.iter().copied().cycle().take(size.min(200)).collect();
                input.extend([verb, place, bytes.len() as u8]);
                input.extend(&bytes);
                wanted.push((element, bytes));
            }
        }
        let printed = c_end::run_on(&program, &input);
        assert_eq!(printed.lines().count(), wanted.len(), "{name}");
        for (line, (element, bytes)) in printed.lines().zip(wanted) {
            let mut words = line.split(' ');
            assert_eq!(words.next(), Some(element.name.as_str()));
            match element.payload {
                Payload::Bytes(_) => {
                    let all: Vec<String> = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
                    assert_eq!(words.collect::<Vec<_>>(), all, "{}", element.name);
                }
                _ => {
                    let numbers: Vec<u64> = words.map(|word| number(word).to_bits()).collect();
                    let all: Vec<u64> = expected(element, &bytes).into_iter().map(f64::to_bits).collect();
                    assert_eq!(numbers, all, "{} {bytes:02x?}: {line}", element.name);
                }
            }
        }
    }
}

/// What a program tells in the model's units, and what is refused.
const TELLS: &str = r#"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "mom_rsp.h"
#include "cubo.h"

#define CHECK(it) do { if (!(it)) { fprintf(stderr, "line %d: %s\n", __LINE__, #it); exit(1); } } while (0)

static void fill(void *self, uint8_t *bytes, size_t size)
{
    (void)self;
    memset(bytes, 7, size);
}

int main(void)
{
    static struct cubo_robot robot;
    static uint8_t key[32];
    struct cubo_program program = { .random = NULL };
    struct mom_rsp_settings settings = { key, NULL, 500, 1000 };
    const double far[3] = { 0, 40000, 0 }, near[3] = { -1, 2500.4, 90 };
    CHECK(CUBO_PACKET == mom_rsp_largest(&cubo_layout) && CUBO_VALUES == mom_rsp_values(&cubo_layout));
    CHECK(CUBO_SLOT == mom_rsp_slot(&cubo_layout) && CUBO_BUFFERS == 8);
    CHECK(cubo_init(&robot, &settings, &program, NULL) == MOM_RSP_FAULT_BODY);
    program.random = fill;
    CHECK(cubo_init(&robot, &settings, &program, NULL) == MOM_RSP_FAULT_CIPHER);
    settings.cipher = &mom_rsp_portable_cipher;
    CHECK(cubo_init(&robot, &settings, &program, NULL) == MOM_RSP_FINE);
    CHECK(cubo_tell_pose(&robot, far) == MOM_RSP_REFUSED_RANGE);
    CHECK(cubo_tell_pose(&robot, near) == MOM_RSP_DONE);
    const uint8_t pose[6] = { 0xff, 0xff, 0x09, 0xc4, 0x03, 0x84 };
    CHECK(memcmp(robot.values + robot.cells[CUBO_ELEMENT_POSE].start, pose, sizeof pose) == 0);
    CHECK(cubo_tell_microphone(&robot, key, 32) == MOM_RSP_DONE);
    static const uint8_t music[641];
    CHECK(cubo_tell_microphone(&robot, music, sizeof music) == MOM_RSP_REFUSED_SIZE);
    CHECK(cubo_raise_service_button(&robot) == MOM_RSP_REFUSED_NO_SESSION);
    const double message[2] = { 3, 0.4 };
    for (int i = 0; i < CUBO_BUFFERS; i++)
        CHECK(cubo_raise_message_recorded(&robot, message) == MOM_RSP_DONE);
    CHECK(cubo_raise_message_recorded(&robot, message) == MOM_RSP_REFUSED_FULL);
    printf("%zu %zu", sizeof robot, sizeof robot.end);
    return 0;
}
"#;

#[test]
fn what_is_told_is_within_its_range_and_what_is_wrong_is_refused() {
    let model = Model::read(CUBO).expect("a model");
    let Some(program) = program("c-tells", &model, TELLS) else {
        return;
    };
    let sizes = c_end::run(&program, "");
    let [all, end] = sizes.split(' ').collect::<Vec<_>>()[..] else {
        panic!("{sizes}");
    };
    println!("{all} B for a robot of CUBO's model with all its values, {end} of them for the session");
    assert!(end.parse::<usize>().expect("a number") <= 640, "{sizes}");
}

/// The page shows the example's loop as it is.
#[test]
fn the_page_of_the_library_shows_the_example() {
    let example = fs::read_to_string(c_end::folder().join("example/cubo.c")).expect("the example");
    let page = fs::read_to_string(c_end::folder().join("README.md")).expect("the page");
    let inside = example
        .split("/* Begin of the robot */\n")
        .nth(1)
        .expect("its begin");
    let inside = inside.split("/* End of the robot */").next().expect("its end");
    assert!(
        page.contains(&format!("```c\n{inside}```")),
        "README.md has another loop than example/cubo.c"
    );
}

/// What is written for users is the library.
#[test]
fn the_library_that_is_written_is_all_of_it() {
    let written = generate::library();
    let mut files = [c_end::headers(), c_end::sources()].concat();
    files.sort();
    assert_eq!(written.len(), files.len());
    for file in files {
        let name = file.file_name().and_then(|name| name.to_str()).expect("a name");
        let text = fs::read_to_string(&file).expect("text");
        assert!(written.contains(&(name, text.as_str())), "{name}");
    }
}

/// Firmware in C++ may include the headers.
#[test]
fn headers_are_cpp_too() {
    let compiler = "c++";
    if !c_end::compiles(compiler, &["-c"], "") {
        return c_end::skip("headers in C++", "`c++` is not installed");
    }
    for text in [CUBO, IR_ROBOT, KINDS, BARE] {
        let model = Model::read(text).expect("a model");
        let header = header(&model);
        let main = format!(
            "#include \"mom_rsp.h\"\n#include \"{}.h\"\nint main() {{ return sizeof(struct {}_robot) == 0; }}\n",
            model.name(),
            model.name().replace('-', "_")
        );
        let file = header.with_extension("cpp");
        fs::write(&file, main).expect("a program");
        let compiled = Command::new(compiler)
            .args(["-std=c++11", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-I"])
            .arg(c_end::folder())
            .arg(&file)
            .output()
            .expect("it is there");
        let said = String::from_utf8_lossy(&compiled.stderr);
        assert!(compiled.status.success(), "{}: {said}", model.name());
    }
}
