//! The header for C: it compiles without warnings, and a program in C makes and reads the bytes that the layout means.

mod c_common;

use std::fs;
use std::path::Path;

use c_common::{CUBO, c_end};
use mom_rsp::{Item, Items, Kind, Layout, Payload, Writer};
use mom_rsp_model::{Direction, Model, generate};

const IR_ROBOT: &str = include_str!("../../../config/ir-robot.toml");
const KINDS: &str = include_str!("models/kinds.toml");

/// Compiles a program with the model's header alone, runs it, and gives what it prints; `None` without a compiler.
fn run(name: &str, model: &Model, program: &str) -> Option<String> {
    run_on(name, model, program, &[])
}

/// The same of a program that reads these bytes.
fn run_on(name: &str, model: &Model, program: &str, input: &[u8]) -> Option<String> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("c-{name}"));
    fs::create_dir_all(&folder).expect("a folder");
    let (header, main) = (folder.join("rsp.h"), folder.join("main.c"));
    fs::write(&header, generate::c(model)).expect("a header");
    fs::write(&main, program).expect("a program");
    let made = c_end::program(&format!("c-alone-{name}"), &[main], &[header])?;
    Some(c_end::run_on(&made, input))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Prints bytes as hexadecimal digits, and stops with the line where something is not so.
const TOOLS: &str = r#"
#include <stdio.h>
#include <stdlib.h>
#include "rsp.h"

#define CHECK(it) do { if (!(it)) { fprintf(stderr, "line %d: %s\n", __LINE__, #it); exit(1); } } while (0)

static void print(const uint8_t *bytes, size_t size)
{
    for (size_t i = 0; i < size; i++)
        printf("%02x", (unsigned)bytes[i]);
    printf("\n");
}
"#;

#[test]
fn figure_8s_packets_have_the_papers_maps() {
    // S18: 11100000, with the command 11100100, with the ack of the event 11100010.
    let program = format!(
        "{TOOLS}{}",
        r#"
int main(void)
{
    uint8_t bytes[IR_ROBOT_DOWN_SIZE];
    struct ir_robot_down down = { { 0 }, -100, 100, -2, { 0 } , 0 };
    struct ir_robot_down back;
    ir_robot_set_bit(down.map, IR_ROBOT_ELEMENT_LEFT_WHEEL);
    ir_robot_set_bit(down.map, IR_ROBOT_ELEMENT_RIGHT_WHEEL);
    ir_robot_set_bit(down.map, IR_ROBOT_ELEMENT_TURRET);
    print(bytes, ir_robot_down_encode(&down, bytes, sizeof bytes));
    ir_robot_set_bit(down.map, IR_ROBOT_ELEMENT_IR_FIRE);
    down.ir_fire.id = 7;
    down.ir_fire.data = 0x42;
    size_t size = ir_robot_down_encode(&down, bytes, sizeof bytes);
    print(bytes, size);
    CHECK(ir_robot_down_decode(&back, bytes, size));
    CHECK(back.left_wheel == -100 && back.right_wheel == 100 && back.turret == -2);
    CHECK(back.ir_fire.id == 7 && back.ir_fire.data == 0x42);
    for (size_t less = 0; less < size; less++) {
        CHECK(!ir_robot_down_decode(&back, bytes, less));
        CHECK(ir_robot_down_encode(&down, bytes, less) == 0);
    }
    CHECK(!ir_robot_down_decode(&back, bytes, size + 1));
    down.map[0] = 0xe0;
    ir_robot_set_bit(down.map, IR_ROBOT_ELEMENT_IR_RECEIVER);
    down.ir_receiver = 9;
    print(bytes, ir_robot_down_encode(&down, bytes, sizeof bytes));

    /* The bit of an effector is always 0 in a packet of the robot. */
    struct ir_robot_up up;
    CHECK(!ir_robot_up_decode(&up, (const uint8_t *)"\x80", 1));
    CHECK(ir_robot_up_decode(&up, (const uint8_t *)"\x02\x05\x33", 3));
    CHECK(up.ir_receiver.id == 5 && up.ir_receiver.data == 0x33);
    return 0;
}
"#
    );
    let Some(printed) = run("ir-robot", &Model::read(IR_ROBOT).unwrap(), &program) else {
        return;
    };
    assert_eq!(printed, "e09c64fffe\ne49c64fffe0742\ne29c64fffe09\n");
}

const CUBOS_PACKETS: &str = r#"
int main(void)
{
    static uint8_t bytes[CUBO_HEADER_SIZE + CUBO_DOWN_SIZE], music[1956];
    struct cubo_header header = { 1, CUBO_MODEL_ID, 0, CUBO_TYPE_DATA, 0x1234, 0x01020304, { 1, 2, 3, 4, 5, 6 }, 0xffff, 3 };
    struct cubo_header back;
    cubo_header_encode(&header, bytes);
    print(bytes, CUBO_HEADER_SIZE);
    CHECK(cubo_header_decode(&back, bytes, CUBO_HEADER_SIZE));
    CHECK(back.stamp == 0x01020304 && back.sequence == 0x1234 && back.last == 0xffff && back.session[5] == 6);
    CHECK(!cubo_header_decode(&back, bytes, CUBO_HEADER_SIZE - 1));
    bytes[1] ^= 1;
    CHECK(!cubo_header_decode(&back, bytes, CUBO_HEADER_SIZE));

    struct cubo_down down;
    memset(&down, 0, sizeof down);
    down.left_wheel = -500;
    down.right_wheel = 500;
    down.joints[2] = 400;
    down.lips = 10000;
    cubo_set_bit(down.map, CUBO_ELEMENT_LEFT_WHEEL);
    cubo_set_bit(down.map, CUBO_ELEMENT_RIGHT_WHEEL);
    cubo_set_bit(down.map, CUBO_ELEMENT_JOINTS);
    cubo_set_bit(down.map, CUBO_ELEMENT_LIPS);
    uint8_t *body = bytes + CUBO_HEADER_SIZE;
    size_t size = cubo_down_encode(&down, body, CUBO_DOWN_SIZE);
    print(body, size);
    CHECK(CUBO_HEADER_SIZE + size == 34);
    cubo_set_bit(down.map, CUBO_ELEMENT_SPEAKER);
    down.speaker.size = sizeof music;
    down.speaker.bytes = music;
    size = cubo_down_encode(&down, body, CUBO_DOWN_SIZE);
    CHECK(CUBO_HEADER_SIZE + size == 1992);
    struct cubo_down heard;
    CHECK(cubo_down_decode(&heard, body, size));
    CHECK(heard.joints[2] == 400 && heard.lips == 10000 && heard.speaker.size == 1956 && heard.speaker.bytes == body + 16);
    down.speaker.size = 1957;
    CHECK(cubo_down_encode(&down, body, CUBO_DOWN_SIZE) == 0);

    /* A memory event has the length of its data. */
    struct cubo_up up;
    memset(&up, 0, sizeof up);
    cubo_set_bit(up.map, CUBO_ELEMENT_MESSAGE_RECORDED);
    cubo_set_bit(up.map, CUBO_ELEMENT_SERVICE_BUTTON);
    up.service_button.id = 1;
    up.message_recorded.id = 2;
    up.message_recorded.data[0] = 3;
    up.message_recorded.data[1] = 0x1234;
    size = cubo_up_encode(&up, body, CUBO_UP_SIZE);
    print(body, size);
    CHECK(cubo_up_decode(&up, body, size));
    body[5] ^= 1;
    CHECK(!cubo_up_decode(&up, body, size));
    static const uint8_t hash[] = CUBO_HASH;
    print(hash, sizeof hash);
    return 0;
}
"#;

#[test]
fn cubos_packets_and_header_are_those_of_the_protocol() {
    let program = format!("{TOOLS}{CUBOS_PACKETS}");
    let model = Model::read(CUBO).unwrap();
    let Some(printed) = run("cubo", &model, &program) else {
        return;
    };
    let hash = hex(&model.hash());
    let lines: Vec<&str> = printed.lines().collect();
    assert_eq!(
        lines,
        [
            "01c0b0000112340102030401020304050 6ffff03"
                .replace(' ', "")
                .as_str(),
            "f000fe0c01f40000000001902710",
            "00840102000400031234",
            hash.as_str(),
        ]
    );
}

#[test]
fn every_type_goes_there_and_back() {
    let mut text = "name = \"double\"\nid = 1\n".to_owned();
    for kind in [
        "effector",
        "sensor",
        "command",
        "event",
        "memory-command",
        "memory-event",
    ] {
        for number in ["u8", "i8", "u16", "i16", "u32", "i32", "f32"] {
            text.push_str(&format!(
                "[[element]]\nname = \"{kind}-{number}\"\nkind = \"{kind}\"\ntype = \"{number}\"\n[[element]]\nname = \"{kind}-{number}s\"\nkind = \"{kind}\"\ntype = \"{number}\"\ncount = 3\n"
            ));
        }
        text.push_str(&format!(
            "[[element]]\nname = \"{kind}-bytes\"\nkind = \"{kind}\"\ntype = \"bytes\"\nmax = 4\n"
        ));
    }
    text.push_str("[[element]]\nname = \"int\"\nkind = \"event\"\ndoc = \"*/ ends \\\\ no comment\"\n");
    let model = Model::read(&text).unwrap();
    let used =
        |direction: Direction| -> String {
            let sent = model
                .elements()
                .iter()
                .filter(|element| element.payload_size(direction) > 0);
            let set = sent.map(|element| {
            let name = element.name.replace('-', "_");
            let bit = format!("    double__set_bit(from.map, DOUBLE_ELEMENT_{});\n", name.to_uppercase());
            let member = match element.kind {
                Kind::Effector | Kind::Sensor => name,
                _ => format!("{name}.data"),
            };
            let sends_data = element.payload_size(direction) > 1;
            match element.payload {
                Payload::Bytes(_) if sends_data => format!(
                    "{bit}    from.{member}.size = 4;\n    from.{member}.bytes = (const uint8_t *)\"abcd\";\n"
                ),
                _ => bit,
            }
        });
            set.collect()
        };
    // 0x5a5a5a5a is a number in every type.
    let way = |way: &str, bits: &str, size: &str| {
        format!(
            "static void {way}(void)\n{{\n    static struct double__{way} from, back;\n    static uint8_t bytes[{size}], again[{size}];\n    memset(&from, 0x5a, sizeof from);\n    memset(from.map, 0, sizeof from.map);\n{bits}    size_t size = double__{way}_encode(&from, bytes, sizeof bytes);\n    CHECK(size > DOUBLE_MAP_SIZE && double__{way}_decode(&back, bytes, size));\n    CHECK(double__{way}_encode(&back, again, sizeof again) == size && memcmp(bytes, again, size) == 0);\n    print(bytes, size);\n}}\n"
        )
    };
    let program = format!(
        "{TOOLS}{}{}int main(void)\n{{\n    down();\n    up();\n    return 0;\n}}\n",
        way("down", &used(Direction::Down), "DOUBLE_DOWN_SIZE"),
        way("up", &used(Direction::Up), "DOUBLE_UP_SIZE"),
    );
    let Some(printed) = run("double", &model, &program) else {
        return;
    };
    let sizes: Vec<usize> = printed.lines().map(|line| line.len() / 2).collect();
    let full = [Direction::Down, Direction::Up].map(|way| model.packet_size(way) - mom_rsp_model::HEADER);
    assert_eq!(sizes, full);
}

/// Reads bodies of packets, each behind its direction and its length, and prints what is written of what was read.
const AGAIN: &str = r#"
int main(void)
{
    static uint8_t body[65536], again[65536];
    int direction;
    while ((direction = getchar()) != EOF) {
        size_t size = (size_t)getchar() << 8;
        size |= (size_t)getchar();
        CHECK(fread(body, 1, size, stdin) == size);
        struct kinds_down down;
        struct kinds_up up;
        if (direction == 0 && kinds_down_decode(&down, body, size))
            print(again, kinds_down_encode(&down, again, sizeof again));
        else if (direction == 1 && kinds_up_decode(&up, body, size))
            print(again, kinds_up_encode(&up, again, sizeof again));
        else
            printf("refused\n");
    }
    return 0;
}
"#;

/// Numbers that look random, the same each time (splitmix64).
struct Random(u64);

impl Random {
    fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((mixed ^ mixed >> 31) % end as u64) as usize
    }

    fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| self.below(256) as u8).collect()
    }

    /// The body of a packet with some of the elements.
    fn body(&mut self, layout: &Layout<'_>, direction: mom_rsp::Direction) -> Vec<u8> {
        let mut body = vec![0; 65_536];
        let mut writer = Writer::new(layout, direction, &mut body).expect("room for the map");
        let seldom = 1 + self.below(8);
        for (place, element) in (0..).zip(layout.elements()) {
            if self.below(seldom) > 0 {
                continue;
            }
            let size = match element.payload {
                Payload::Bytes(most) => self.below(usize::from(most) + 1),
                payload => payload.size(),
            };
            let data = self.bytes(size);
            let (id, ack) = (1 + self.below(255) as u8, self.below(256) as u8);
            let call = Item::Call { id, data: &data };
            for item in [
                Item::Value(&data),
                Item::Ask,
                Item::Activate,
                Item::Ack(ack),
                call,
            ] {
                if writer.put(place, item).is_ok() {
                    break;
                }
            }
        }
        let size = writer.finish();
        body.truncate(size);
        body
    }

    /// One byte is another, one is missing, or there are more.
    fn spoil(&mut self, body: &mut Vec<u8>) {
        let place = self.below(body.len());
        let byte = [0, 0x7f, 0xff, self.below(256) as u8][self.below(4)];
        match self.below(4) {
            0 => body.truncate(place),
            1 => body.push(byte),
            _ => body[place] = byte,
        }
    }
}

#[test]
fn c_takes_and_makes_the_same_packets_as_rust() {
    let model = Model::read(KINDS).unwrap();
    let elements = model.wire_elements();
    let layout = model.layout(&elements);
    let mut random = Random(1);
    let (mut input, mut expected) = (Vec::new(), Vec::new());
    for number in 0..20_000 {
        let (code, direction) = match random.below(2) {
            0 => (0, mom_rsp::Direction::Down),
            _ => (1, mom_rsp::Direction::Up),
        };
        let mut body = random.body(&layout, direction);
        if number % 2 == 1 {
            random.spoil(&mut body);
        }
        input.push(code);
        input.extend((body.len() as u16).to_be_bytes());
        input.extend(&body);
        expected.push(match Items::parse(&layout, direction, &body) {
            Ok(_) => hex(&body),
            Err(_) => "refused".to_owned(),
        });
    }
    let refused = expected.iter().filter(|line| *line == "refused").count();
    assert!(
        (2_000..9_000).contains(&refused),
        "{refused} of the bodies are wrong"
    );
    let Some(printed) = run_on("again", &model, &format!("{TOOLS}{AGAIN}"), &input) else {
        return;
    };
    let lines: Vec<&str> = printed.lines().collect();
    for (number, (line, expected)) in lines.iter().zip(&expected).enumerate() {
        assert_eq!(line, expected, "packet {number}");
    }
    assert_eq!(lines.len(), expected.len());
}
