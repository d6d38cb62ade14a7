//! The models that MOM brings along, and the packets that follow from them.

use mom_rsp::{Kind, Motion, Number, Payload};
use mom_rsp_model::{Direction, Model};

const CUBO: &str = include_str!("../../../config/cubo.toml");
const IR_ROBOT: &str = include_str!("../../../config/ir-robot.toml");

#[test]
fn cubos_packets_have_the_papers_sizes() {
    // S26: 34 bytes with motion, 1992 with music beside it.
    let model = Model::read(CUBO).unwrap();
    assert_eq!(
        (model.elements().len(), model.map_size(), model.period()),
        (16, 2, 20)
    );
    let size = |names: &[&str]| -> usize {
        let payload = |name: &&str| {
            let (_, element) = model.find(name).unwrap();
            element.payload_size(Direction::Down)
        };
        mom_rsp_model::HEADER + model.map_size() + names.iter().map(payload).sum::<usize>()
    };
    let motion = ["left-wheel", "right-wheel", "joints", "lips"];
    assert_eq!(size(&motion), 34);
    assert_eq!(size(&[&motion[..], &["speaker"]].concat()), 1992);
}

#[test]
fn the_page_shows_the_text_behind_the_hash() {
    let page = include_str!("../../../docs/rsp.md");
    let rest = page.split_once("```canonical\n").expect("a block").1;
    let shown = rest.split_once("```").expect("its end").0;
    let model = Model::read(IR_ROBOT).unwrap();
    assert_eq!(shown.trim_end(), model.canonical().trim_end());
    let hash: String = model.hash().iter().map(|byte| format!("{byte:02x}")).collect();
    assert!(page.contains(&hash), "{hash}");
}

#[test]
fn what_does_not_fit_a_packet_travels_in_fragments() {
    let model = Model::read(CUBO).unwrap();
    let fragmented: Vec<&str> = model
        .elements()
        .iter()
        .filter(|element| element.blob == Some(65_535))
        .map(|element| element.name.as_str())
        .collect();
    assert_eq!(fragmented, ["lcd", "camera"]);
    // With music; an empty display, two acks of events, a gesture of 2, an ack of the memory event.
    assert_eq!(model.packet_size(Direction::Down), 1992 + 2 + 2 + 2 + 1);
    // Surroundings 12, pose 6, two events of 1, sound 642, an empty image, an ack, the memory event 7, posture 6.
    assert_eq!(
        model.packet_size(Direction::Up),
        22 + 12 + 6 + 2 + 642 + 2 + 1 + 7 + 6
    );
}

#[test]
fn a_layout_has_what_packets_need() {
    let model = Model::read(IR_ROBOT).unwrap();
    let elements = model.wire_elements();
    let layout = model.layout(&elements);
    assert_eq!((layout.id(), *layout.hash()), (8, model.hash()));
    let kinds: Vec<Kind> = layout.elements().iter().map(|element| element.kind).collect();
    // Figure 8: bits 6 and 7 are the command and the event (S18).
    assert_eq!(
        kinds,
        [
            Kind::Effector,
            Kind::Effector,
            Kind::Effector,
            Kind::Sensor,
            Kind::Monitor,
            Kind::Command,
            Kind::Event,
            Kind::Module
        ]
    );
    let turret = &layout.elements()[2];
    assert_eq!(turret.name, "turret");
    assert_eq!(turret.payload, Payload::Numbers(Number::I16, 1));
    // 90 degrees a second are 900 steps of the wire.
    assert_eq!(turret.motion, Motion::Incremental { rate: Some(900.0) });
    assert_eq!(turret.safe, [0, 0]);
    assert_eq!((turret.module, turret.of), (Some(7), None));
    let monitor = &layout.elements()[4];
    assert_eq!((monitor.of, monitor.payload), (Some(2), turret.payload));
    assert_eq!(layout, Model::read(IR_ROBOT).unwrap().into_layout());
}

#[test]
fn a_safe_value_is_on_the_wire_as_it_is_sent() {
    let text = "name = \"x\"\nid = 1\n[[element]]\nname = \"a\"\nkind = \"effector\"\ntype = \"i16\"\ncount = 2\nscale = 0.1\nrange = [-90, 90]\nsafe = [-1.0, 45]\n";
    let model = Model::read(text).unwrap();
    assert_eq!(model.elements()[0].safe, [0xff, 0xf6, 0x01, 0xc2]);
    let text = text
        .replace("i16", "f32")
        .replace("count = 2", "count = 1")
        .replace("[-1.0, 45]", "45");
    let model = Model::read(&text).unwrap();
    assert_eq!(model.elements()[0].safe, 450f32.to_be_bytes());
}

#[test]
fn defaults_are_those_of_the_protocol() {
    let text = "name = \"x\"\nid = 1\n[[element]]\nname = \"a\"\nkind = \"sensor\"\ntype = \"u8\"\n";
    let model = Model::read(text).unwrap();
    assert_eq!(
        (model.period(), model.largest_packet(), model.watchdog()),
        (20, 1472, 500)
    );
    let element = &model.elements()[0];
    let quantity = element.quantity(0).unwrap();
    assert_eq!(
        (quantity.min, quantity.max, quantity.scale, quantity.unit.as_str()),
        (0.0, 255.0, 1.0, "")
    );
    assert_eq!(element.quantity(1), None);
}
