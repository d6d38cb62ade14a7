//! The simulated controller: what the hand pushes, presses and takes, and a link that fails.

use super::*;
use crate::pose::HOME;
use crate::pose::Pose;

/// A lab that does one instruction after the other.
struct Lab {
    controller: Simulated,
    now: ArmTime,
}

impl Lab {
    fn new(blocks: &[(&str, f64, f64)]) -> Self {
        let blocks = blocks
            .iter()
            .map(|(name, x, y)| Block::new(name, [0; 3], *x, *y, 0.0));
        Self {
            controller: Simulated::new(0, blocks),
            now: 0,
        }
    }

    /// Does it, and waits until all is at rest; the words of its error, if there is one.
    fn tell(&mut self, instruction: Instruction) -> Option<String> {
        self.controller.begin(&instruction, self.now).unwrap();
        let error = loop {
            self.now += 20_000;
            match self.controller.advance(self.now) {
                Progress::Busy => {}
                Progress::Done(_) => break None,
                Progress::Failed(_, error) => break Some(error.text().to_owned()),
            }
        };
        let end = self.now + 5_000_000;
        while self.controller.is_unsettled() {
            self.now += 20_000;
            assert!(self.now < end, "it never comes to rest");
            self.controller.advance(self.now);
        }
        error
    }

    fn go(&mut self, x: f64, y: f64, z: f64) -> Option<String> {
        self.tell(Instruction::Move(Pose::new(x, y, z, 0.0, 0.0)))
    }

    fn place(&self, name: &str) -> [f64; 3] {
        let reading = self.controller.reading();
        let block = reading.blocks.iter().find(|block| block.name == name).unwrap();
        [block.x, block.y, block.z].map(|mm| (mm * 10.0).round() / 10.0)
    }
}

#[test]
fn closed_jaws_push_a_block_but_do_not_press_it_down() {
    let mut lab = Lab::new(&[("red", 100.0, 0.0)]);
    assert_eq!(lab.tell(Instruction::Grip(Grip::Close)), None);
    assert_eq!(lab.go(0.0, 0.0, 300.0), None);
    assert_eq!(lab.go(0.0, 0.0, 20.0), None);
    assert_eq!(lab.go(150.0, 0.0, 20.0), None);
    let [x, y, z] = lab.place("red");
    assert!(
        (x - 178.0).abs() < 1.0 && y.abs() < 1.0 && z == 20.0,
        "{x} {y} {z}"
    );
    assert_eq!(lab.go(150.0, 0.0, 100.0), None);
    assert_eq!(lab.go(x, y, 100.0), None);
    let error = lab.go(x, y, 20.0).unwrap();
    assert!(error.contains("a finger met block red"), "{error}");
    let z = lab.controller.reading().posture.pose.z;
    assert!((38.0..=40.0).contains(&z), "{z}");
    assert_eq!(lab.go(x, y, 100.0), None, "it gets away");
}

#[test]
fn a_push_beside_the_middle_turns_the_block() {
    let mut lab = Lab::new(&[("red", 100.0, 12.0)]);
    lab.tell(Instruction::Grip(Grip::Close));
    lab.go(0.0, 0.0, 20.0);
    assert_eq!(lab.go(100.0, 0.0, 20.0), None);
    let red = &lab.controller.reading().blocks[0];
    assert!(red.yaw > 5.0, "pushed on its right side it turns left: {red:?}");
}

#[test]
fn a_tower_falls_when_its_middle_is_pushed_out() {
    let mut lab = Lab::new(&[("low", 100.0, 0.0), ("high", 100.0, 0.0)]);
    assert_eq!(lab.place("high")[2], 60.0);
    lab.tell(Instruction::Grip(Grip::Close));
    lab.go(0.0, 0.0, 65.0);
    assert_eq!(lab.go(110.0, 0.0, 65.0), None);
    assert_eq!(lab.place("low"), [100.0, 0.0, 20.0]);
    let high = lab.place("high");
    assert_eq!(high[2], 20.0, "{high:?}");
    assert!(high[0] >= 139.0, "it lies beside the other: {high:?}");
}

#[test]
fn a_row_is_pushed_over_the_edge_of_the_table() {
    let mut lab = Lab::new(&[("near", 290.0, 0.0), ("far", 335.0, 0.0)]);
    lab.tell(Instruction::Grip(Grip::Close));
    lab.go(240.0, 0.0, 300.0);
    lab.go(240.0, 0.0, 20.0);
    assert_eq!(lab.go(300.0, 0.0, 20.0), None);
    let far = lab.place("far");
    assert_eq!(far[2], 20.0, "near the edge, but on it: {far:?}");
    lab.tell(Instruction::Grip(Grip::Open));
    let far = lab.place("far");
    assert!(
        far[2] < -300.0 && far[0] > 375.0,
        "the opening jaw pushes it down: {far:?}"
    );
}

#[test]
fn jaws_that_close_bring_a_block_between_them() {
    let mut lab = Lab::new(&[("red", 10.0, 0.0)]);
    lab.go(0.0, 0.0, 20.0);
    assert_eq!(lab.tell(Instruction::Grip(Grip::Close)), None);
    assert_eq!(lab.controller.reading().holding.as_deref(), Some("red"));
    assert_eq!(lab.place("red"), [0.0, 0.0, 20.0]);
    lab.go(0.0, 0.0, 200.0);
    lab.tell(Instruction::Grip(Grip::Open));
    assert_eq!(
        (lab.place("red"), lab.controller.reading().holding),
        ([0.0, 0.0, 20.0], None)
    );
}

#[test]
fn a_block_that_is_caught_by_the_edge_is_not_taken() {
    let mut lab = Lab::new(&[("red", 0.0, 17.0)]);
    lab.go(0.0, 0.0, 20.0);
    let error = lab.tell(Instruction::Grip(Grip::Close)).unwrap();
    assert!(error.contains("a finger met block red"), "{error}");
    assert_eq!(lab.controller.reading().holding, None);
}

#[test]
fn a_held_block_pushes_others_and_is_not_pressed_on_them() {
    let mut lab = Lab::new(&[("red", 0.0, 0.0), ("blue", 100.0, 0.0)]);
    lab.go(0.0, 0.0, 20.0);
    lab.tell(Instruction::Grip(Grip::Close));
    assert_eq!(lab.go(100.0, 0.0, 20.0), None);
    let [x, ..] = lab.place("blue");
    assert!((x - 148.0).abs() < 2.0, "the jaw is between them: {x}");
    lab.go(100.0, 0.0, 200.0);
    lab.go(x, 0.0, 200.0);
    let error = lab.go(x, 0.0, 40.0).unwrap();
    assert!(error.contains("block red in the jaws met block blue"), "{error}");
    assert_eq!(lab.go(x, 0.0, 200.0), None);
    lab.go(-100.0, 0.0, 200.0);
    let error = lab.go(-100.0, 0.0, 0.0).unwrap();
    assert!(error.contains("block red in the jaws met the table"), "{error}");
}

#[test]
fn a_tower_of_two_is_carried_by_the_lower_and_set_down_again() {
    let mut lab = Lab::new(&[("low", 0.0, 0.0), ("high", 2.0, 3.0)]);
    lab.go(0.0, 0.0, 20.0);
    lab.tell(Instruction::Grip(Grip::Close));
    assert_eq!(lab.go(0.0, 0.0, 120.0), None);
    // The fingers are long enough to have shifted the upper one as well.
    let heights = |lab: &Lab| [lab.place("low")[2], lab.place("high")[2]];
    assert_eq!(heights(&lab), [120.0, 160.0]);
    lab.go(100.0, 0.0, 120.0);
    lab.go(100.0, 0.0, 20.0);
    assert_eq!(lab.tell(Instruction::Grip(Grip::Open)), None);
    lab.go(100.0, 0.0, 300.0);
    assert_eq!(
        (lab.place("low"), heights(&lab)),
        ([100.0, 0.0, 20.0], [20.0, 60.0])
    );
}

/// What the hand holds on a tower is borne by the hand: it does not tip the tower, nor topple later from where it was.
#[test]
fn a_block_that_is_only_held_on_others_does_not_tip_them() {
    let mut lab = Lab::new(&[("blue", 100.0, 0.0), ("red", 115.0, 0.0), ("green", -100.0, 0.0)]);
    lab.go(-100.0, 0.0, 20.0);
    lab.tell(Instruction::Grip(Grip::Close));
    lab.go(-100.0, 0.0, 200.0);
    lab.go(130.0, 0.0, 200.0);
    assert_eq!(lab.go(130.0, 0.0, 100.0), None);
    assert!(!lab.controller.is_unsettled());
    assert_eq!(
        (lab.place("blue"), lab.place("red")),
        ([100.0, 0.0, 20.0], [115.0, 0.0, 60.0])
    );
    lab.go(130.0, 0.0, 200.0);
    lab.go(-100.0, 100.0, 200.0);
    lab.go(-100.0, 100.0, 20.0);
    lab.tell(Instruction::Grip(Grip::Open));
    assert_eq!(lab.place("green"), [-100.0, 100.0, 20.0]);
}

/// An instruction that is under way when the link fails ends with an error; the controller stands after its watchdog, and the program hears
/// of that when the link is back.
#[test]
fn a_link_fails_and_recovers() {
    let fault = LinkFault {
        after: 1_000_000,
        lasting: 2_000_000,
    };
    let mut controller = Simulated::new(0, []).failing(fault);
    let far = Pose { x: 300.0, ..HOME };
    controller.begin(&Instruction::Move(far), 0).unwrap();
    assert_eq!(controller.advance(500_000), Progress::Busy);
    assert_eq!(controller.next_wake(), Some(1_000_000));
    let Progress::Failed(at, error) = controller.advance(1_500_000) else {
        panic!("the link is down");
    };
    assert_eq!((at, error.name()), (1_000_000, ErrorName::Link));
    controller.advance(1_500_000);
    assert!(!controller.is_linked());
    assert_eq!(
        controller.reading().posture.pose.x,
        150.0,
        "the last that is known"
    );
    let refused = controller.begin(&Instruction::Move(HOME), 1_500_000).unwrap_err();
    assert_eq!(refused.name(), ErrorName::Link);
    controller.halt(1_500_000);
    assert_eq!(controller.next_wake(), Some(3_000_000));
    controller.advance(3_000_000);
    assert!(controller.is_linked());
    let x = controller.reading().posture.pose.x;
    assert!(
        (x - 180.0).abs() < 1e-6,
        "the watchdog halted it 200 ms later: {x}"
    );
    controller.begin(&Instruction::Move(HOME), 3_000_000).unwrap();
    assert_eq!(controller.advance(3_900_000), Progress::Busy);
    assert!(matches!(
        controller.advance(9_000_000),
        Progress::Failed(4_000_000, _)
    ));
}
