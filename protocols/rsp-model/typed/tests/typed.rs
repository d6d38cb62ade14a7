//! Generated Rust has the layout of its model, and brings typed values from one end to the other.

use mom_rsp::middle::{Middle, Notice};
use mom_rsp::typed::{Numbers as _, Unsent};
use mom_rsp::{middle, robot};
use mom_rsp_model::Model;
use mom_rsp_typed::cubo::elements::{Joints, MessageRecorded, Pose};
use mom_rsp_typed::cubo::middle::{Elements, Raised};
use mom_rsp_typed::cubo::robot::{Body, Dispatch, Robot};
use mom_rsp_typed::cubo::units::{Deg, Mm, MmPerS, Percent, S};
use mom_rsp_typed::{bare, cubo, ir_robot, kinds};

#[test]
fn a_generated_layout_is_that_of_the_model() {
    for (text, layout) in [
        (include_str!("../../../../config/cubo.toml"), cubo::LAYOUT),
        (include_str!("../../../../config/ir-robot.toml"), ir_robot::LAYOUT),
        (include_str!("../../tests/models/kinds.toml"), kinds::LAYOUT),
        (include_str!("../../tests/models/bare.toml"), bare::LAYOUT),
    ] {
        let model = Model::read(text).unwrap();
        assert_eq!(layout, model.layout(&model.wire_elements()));
        for direction in [
            (mom_rsp::Direction::Down, mom_rsp_model::Direction::Down),
            (mom_rsp::Direction::Up, mom_rsp_model::Direction::Up),
        ] {
            let bytes = model.packet_size(direction.1) + mom_rsp_model::TAG;
            assert_eq!(layout.largest_data(direction.0), bytes);
        }
    }
}

/// What CUBO's program heard.
#[derive(Debug, Default, PartialEq)]
struct Heard {
    left_wheel: Option<MmPerS>,
    joints: Option<Joints>,
    speaker: Vec<u8>,
    gestures: Vec<u8>,
    filled: u8,
}

impl Body for Heard {
    fn random(&mut self, bytes: &mut [u8]) {
        self.filled += 1;
        bytes.fill(self.filled);
    }

    fn set_left_wheel(&mut self, value: MmPerS) {
        self.left_wheel = Some(value);
    }

    fn set_right_wheel(&mut self, _: MmPerS) {}

    fn set_joints(&mut self, value: Joints) {
        self.joints = Some(value);
    }

    fn set_lips(&mut self, _: Percent) {}

    fn set_speaker(&mut self, bytes: &[u8]) {
        self.speaker = bytes.to_vec();
    }

    fn run_gesture(&mut self, value: u8) {
        self.gestures.push(value);
    }
}

/// Both ends, and what they have said.
struct Wire {
    middle: Middle<'static>,
    robot: Robot<2>,
    heard: Heard,
    now: u64,
    notices: Vec<Notice>,
}

impl Wire {
    fn new() -> Wire {
        let mut filled = 100;
        let random = move |bytes: &mut [u8]| {
            filled += 1;
            bytes.fill(filled);
        };
        let layout: &'static mom_rsp::Layout<'static> = &cubo::LAYOUT;
        let mut middle = Middle::new(layout, middle::Settings::default(), random).expect("a middle");
        middle.start(0);
        Wire {
            middle,
            robot: Robot::new(layout, robot::Settings::default()).expect("a robot"),
            heard: Heard::default(),
            now: 0,
            notices: Vec::new(),
        }
    }

    /// So many ms, in which every datagram arrives at once.
    fn pass(&mut self, ms: u64) {
        let mut buffer = [0; cubo::robot::PACKET];
        for _ in 0..ms {
            self.now += 1000;
            while let Some(datagram) = self.middle.poll(self.now) {
                let mut datagram = datagram.to_vec();
                let body = &mut Dispatch(&mut self.heard);
                self.robot
                    .receive(self.now, &mut datagram, body)
                    .expect("the robot takes it");
            }
            while let Some(size) = self
                .robot
                .poll(self.now, &mut buffer, &mut Dispatch(&mut self.heard))
            {
                let datagram = &mut buffer[..size];
                self.middle
                    .receive(self.now, datagram)
                    .expect("the middle takes it");
            }
            while let Some(notice) = self.middle.next_notice() {
                self.notices.push(notice);
            }
        }
    }
}

/// S5, S7, figure 4.
#[test]
fn typed_values_go_there_and_back() {
    let mut wire = Wire::new();
    wire.pass(100);
    assert!(wire.robot.is_up());
    let posture = Joints {
        left_arm: Deg(12.5),
        right_arm: Deg(-90.0),
        head_tilt: Deg(40.0),
    };
    let mut elements = Elements(&mut wire.middle);
    elements.left_wheel().write(MmPerS(-123.0)).unwrap();
    elements.joints().write(posture).unwrap();
    elements.speaker().write_bytes(&[7; 5]).unwrap();
    elements.gesture().send(9).unwrap();
    assert_eq!(elements.left_wheel().wanted(), Some(MmPerS(-123.0)));
    cubo::robot::tell_posture(&mut wire.robot, posture).unwrap();
    let pose = Pose {
        x: Mm(100.0),
        y: Mm(-200.0),
        heading: Deg(179.9),
    };
    cubo::robot::tell_pose(&mut wire.robot, pose).unwrap();
    cubo::robot::raise_service_button(&mut wire.robot).unwrap();
    let message = MessageRecorded {
        number: 3,
        length: S(4.5),
    };
    cubo::robot::raise_message_recorded(&mut wire.robot, message).unwrap();
    wire.pass(2000);

    assert_eq!(wire.heard.left_wheel, Some(MmPerS(-123.0)));
    assert_eq!(wire.heard.joints, Some(posture));
    assert_eq!(wire.heard.speaker, [7; 5]);
    assert_eq!(wire.heard.gestures, [9]);
    let mut elements = Elements(&mut wire.middle);
    assert_eq!(elements.posture().read().map(|known| known.value), Some(posture));
    assert_eq!(elements.pose().read().map(|known| known.value), Some(pose));
    assert_eq!(elements.pose().read_at(1), Some(-200.0));
    assert_eq!(elements.pose().read_at(3), None);
    assert_eq!(elements.pose().read_list(&[1, 0]), Some(vec![-200.0, 100.0]));
    assert_eq!(elements.surroundings().read_at(0), None);
    let confirmed = elements.left_wheel().confirmed().map(|known| known.value);
    assert_eq!(confirmed, Some(MmPerS(-123.0)));
    let raised: Vec<Raised> = wire.notices.iter().filter_map(Raised::of).collect();
    assert_eq!(raised, [Raised::ServiceButton, Raised::MessageRecorded(message)]);
}

/// S6, S7: activated is what is wanted, active what the robot has confirmed.
#[test]
fn a_module_is_deactivated_by_its_name() {
    let mut wire = Wire::new();
    wire.pass(100);
    let mut elements = Elements(&mut wire.middle);
    elements.left_wheel().write(MmPerS(50.0)).unwrap();
    wire.pass(1000);
    assert_eq!(wire.heard.left_wheel, Some(MmPerS(50.0)));
    Elements(&mut wire.middle).motion().set_activated(false).unwrap();
    assert!(!Elements(&mut wire.middle).motion().is_activated());
    wire.pass(100);
    let mut elements = Elements(&mut wire.middle);
    assert!(!elements.left_wheel().is_active() && elements.speaker().is_active());
    assert_eq!(wire.heard.left_wheel, Some(MmPerS(0.0)));
}

#[test]
fn values_outside_the_range_stay_here() {
    let mut wire = Wire::new();
    wire.pass(100);
    let mut elements = Elements(&mut wire.middle);
    for value in [500.1, -501.0, f64::NAN, f64::INFINITY] {
        assert_eq!(
            elements.left_wheel().write(MmPerS(value)),
            Err(Unsent::Range),
            "{value}"
        );
    }
    elements.left_wheel().write(MmPerS(500.0)).unwrap();
    assert_eq!(elements.gesture().send(16), Err(Unsent::Range));
    assert_eq!(elements.joints().write_at(2, 40.5), Err(Unsent::Range));
    assert_eq!(elements.joints().write_at(3, 0.0), Err(Unsent::Range));
    elements.joints().write_at(2, 30.0).unwrap();
    elements.joints().write_at(0, -45.0).unwrap();
    let wanted = elements.joints().wanted().unwrap();
    assert_eq!((wanted.left_arm, wanted.head_tilt), (Deg(-45.0), Deg(30.0)));
}

/// Whatever a middle says, a robot's program sees no value beyond the model's range.
#[test]
fn a_robot_never_sees_a_value_beyond_its_range() {
    let bytes = i16::MAX.to_be_bytes();
    assert_eq!(cubo::elements::LeftWheel::decode(&bytes), Some(MmPerS(500.0)));
    // Steps add up before they arrive, so that several are more than one may be.
    let turret = ir_robot::elements::Turret::decode(&bytes).unwrap();
    assert!((turret.0 - 3276.7).abs() < 1e-9);
    assert_eq!(cubo::elements::LeftWheel::decode(&[0]), None);
}

/// What came from the wire goes back there: for each number that an i16 can be, at a scale that no float has.
#[test]
fn numbers_go_there_and_back() {
    for wire in i16::MIN..=i16::MAX {
        let value = ir_robot::elements::Turret::decode(&wire.to_be_bytes()).unwrap();
        assert_eq!(
            ir_robot::elements::Turret::encode(value),
            Some(wire.to_be_bytes())
        );
    }
}
