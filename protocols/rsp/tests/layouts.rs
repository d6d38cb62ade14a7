//! Models by which no packets can be made, and buffers that do not fit a model.

mod common;

use common::*;
use mom_rsp::robot::{Robot, RobotFault, slot, values};
use mom_rsp::{Element, Kind, Layout, LayoutFault, Motion, Number, Payload};

const PAIR: Payload = Payload::Numbers(Number::I16, 2);

fn fault(elements: &[Element<'_>]) -> Option<LayoutFault> {
    Layout::try_new(1, [0; 32], elements).err()
}

/// The fault of an effector and one more element.
fn second(element: Element<'_>) -> Option<LayoutFault> {
    fault(&[common::element("motor", Kind::Effector, PAIR), element])
}

#[test]
fn each_fault_of_a_model_names_its_element() {
    let motor = element("motor-2", Kind::Effector, PAIR);
    assert_eq!(second(motor), None);
    assert_eq!(fault(&[]), Some(LayoutFault::Count));
    assert_eq!(fault(&[motor; 257]), Some(LayoutFault::Count));
    assert_eq!(second(Element { name: "", ..motor }), Some(LayoutFault::Name(1)));
    let short = Element { safe: &[0], ..motor };
    assert_eq!(second(short), Some(LayoutFault::Safe(1)));
    for (module, of) in [(Some(7), None), (Some(0), None)] {
        let member = Element { module, of, ..motor };
        assert_eq!(second(member), Some(LayoutFault::Module(1)), "{member:?}");
    }
    let monitor = element("monitor", Kind::Monitor, PAIR);
    assert_eq!(
        second(Element {
            of: Some(0),
            ..monitor
        }),
        None
    );
    for of in [None, Some(1), Some(7)] {
        let monitor = Element { of, ..monitor };
        assert_eq!(second(monitor), Some(LayoutFault::Monitor(1)), "{monitor:?}");
    }
    let text = Element {
        motion: Motion::Incremental { rate: None },
        ..element("text", Kind::Effector, Payload::Bytes(4))
    };
    assert_eq!(second(text), Some(LayoutFault::Motion(1)));
    for rate in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let motion = Motion::Incremental { rate: Some(rate) };
        assert_eq!(
            second(Element { motion, ..motor }),
            Some(LayoutFault::Rate(1)),
            "{rate}"
        );
    }
    let empty = element("sensor", Kind::Sensor, Payload::Nothing);
    assert_eq!(second(empty), Some(LayoutFault::Payload(1)));
    let large = element("sensor", Kind::Sensor, Payload::Bytes(65_500));
    assert_eq!(second(large), Some(LayoutFault::Large));
    let words = LayoutFault::Rate(1).to_string();
    assert_eq!(words, "element 1: the most change a second is not above 0");
}

#[test]
#[should_panic(expected = "no packets can be made by this model")]
fn a_constant_of_such_a_model_is_none() {
    let _ = Layout::new(1, [0; 32], &[]);
}

#[test]
fn a_robot_has_buffers_that_fit_its_model() {
    const V: usize = values(&CUBO);
    const S: usize = slot(&CUBO);
    assert!(Robot::<16, V, 4, S>::new(&CUBO, Default::default()).is_ok());
    let fault = Robot::<15, V, 4, S>::new(&CUBO, Default::default()).err();
    assert_eq!(fault, Some(RobotFault::Elements));
    let fault = Robot::<16, { V - 1 }, 4, S>::new(&CUBO, Default::default()).err();
    assert_eq!(fault, Some(RobotFault::Values));
    let fault = Robot::<16, V, 4, { S - 1 }>::new(&CUBO, Default::default()).err();
    assert_eq!(fault, Some(RobotFault::Buffers));
    let fault = Robot::<16, V, 256, S>::new(&CUBO, Default::default()).err();
    assert_eq!(fault, Some(RobotFault::Buffers));
}
