//! The hand-over interlock over random changes of the owner, with the link lost at any moment of them: no statement of an older
//! owner begins after a change, and none of the new one before the arm has said that it rests.

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::stage::{Stage, check};
use mom_client::{Parcel, Value};
use mom_device::STATE;

use crate::motion::ArmTime;
use crate::state::CommandState;
use crate::status::Status;

/// How the owner changes.
#[derive(Clone, Copy, Debug)]
enum Change {
    /// A user of a higher level takes it.
    Preempted,
    /// Nobody renewed it, its owner broke it or was cut off: the hub halts the arm.
    Lapsed,
    /// The hub halts the arm, and moves it to a safe place.
    Safe,
    /// By agreement, without a halt.
    Given,
    Returned,
}

#[derive(Clone, Debug)]
enum Step {
    Command(usize),
    /// By who owned the token before.
    OldCommand(usize),
    Pass(ArmTime),
    /// The link is lost before the nth event of the change, and comes back with the same membership or a new one.
    Change(Change, Option<(usize, bool)>),
    Stop,
    Unstop,
}

const SCRIPTS: [&str; 5] = [
    "move 0 0 270 0 0; wait 50; move 0 0 300 0 0; wait 20",
    "wait 30; wait 30; wait 30",
    "grip close; grip open",
    "home",
    "jog 100 0 -50 20 0 150",
];

fn step() -> impl Strategy<Value = Step> {
    let change = prop_oneof![
        Just(Change::Preempted),
        Just(Change::Lapsed),
        Just(Change::Safe),
        Just(Change::Given),
        Just(Change::Returned),
    ];
    prop_oneof![
        4 => (0..SCRIPTS.len()).prop_map(Step::Command),
        1 => (0..SCRIPTS.len()).prop_map(Step::OldCommand),
        4 => (0..150_i64).prop_map(Step::Pass),
        3 => (change, proptest::option::of((0..4_usize, any::<bool>()))).prop_map(|(change, drop)| Step::Change(change, drop)),
        1 => Just(Step::Stop),
        1 => Just(Step::Unstop),
    ]
}

/// What was heard of the arm, by the fences of commands.
#[derive(Default)]
struct Witness {
    /// The newest fence that the arm has heard of, before what it says next.
    fence: u64,
    /// The newest one of a state that tells of rest.
    rested: u64,
    /// Of each command that was taken: the last statement that has begun, and whether it has ended.
    begun: BTreeMap<(u64, u64), (u32, bool)>,
}

impl Witness {
    fn hear(&mut self, parcels: impl Iterator<Item = Parcel>) -> Result<(), TestCaseError> {
        for parcel in parcels {
            let content = parcel.value();
            if parcel.name() == STATE {
                let fence = content.get("fence").and_then(Value::as_int).unwrap_or_default();
                if content.get("rest").is_some() {
                    self.rested = self.rested.max(fence as u64);
                }
                continue;
            }
            let status: Status = mom_client::from_value(content).unwrap();
            let (Ok(fence), Some(id)) = (status.peer.parse::<u64>(), status.id) else {
                continue;
            };
            let known = self.begun.get(&(fence, id)).copied();
            match status.state {
                CommandState::Waiting => {
                    prop_assert_eq!(known, None);
                    prop_assert!(fence >= self.fence, "{} is taken under {}", fence, self.fence);
                    self.begun.insert((fence, id), (0, false));
                }
                CommandState::Executing => {
                    let (statement, ended) = known.expect("it was taken");
                    prop_assert!(!ended && status.statement == statement + 1);
                    prop_assert!(fence >= self.fence, "{} begins under {}", fence, self.fence);
                    prop_assert!(
                        self.rested >= fence,
                        "{} begins, and the arm rested under {}",
                        fence,
                        self.rested
                    );
                    self.begun.insert((fence, id), (status.statement, false));
                }
                CommandState::Finished | CommandState::Error => {
                    if let Some((statement, ended)) = known {
                        prop_assert!(!ended, "it ends once");
                        self.begun.insert((fence, id), (statement, true));
                    }
                }
                CommandState::Sending => unreachable!("the arm does not send commands"),
            }
        }
        Ok(())
    }
}

/// The events of one change, in the order in which the hub tells of them.
fn events_of(change: Change, fence: u64) -> Vec<String> {
    let (old, new) = (fence, fence + 1);
    let lines: &[String] = &match change {
        Change::Preempted => [vec!["hub halt".to_owned()], vec![format!("grabbed {new}")]].concat(),
        Change::Lapsed => vec![
            "hub halt".to_owned(),
            format!("released {old}"),
            format!("grabbed {new}"),
        ],
        Change::Safe => vec![
            "hub halt".to_owned(),
            "hub command - -: move 0 0 280 0 0".to_owned(),
            format!("released {old}"),
            format!("grabbed {new}"),
        ],
        Change::Given => vec![format!("given {old}"), format!("grabbed {new}")],
        Change::Returned => vec![format!("returned {old}"), format!("grabbed {new}")],
    };
    lines.to_vec()
}

fn play(steps: &[Step]) -> Result<(), TestCaseError> {
    let mut stage = Stage::new();
    let mut witness = Witness {
        fence: 5,
        rested: 5,
        ..Witness::default()
    };
    let (mut fence, mut id) = (5_u64, 0_u64);
    stage.guard("5", "5");
    for step in steps {
        id += 1;
        match step {
            Step::Command(script) => {
                stage.act(&format!("{fence} command {id} {fence}: {}", SCRIPTS[*script]));
            }
            Step::OldCommand(script) => {
                let old = fence - 1;
                stage.act(&format!("{old} command {id} {old}: {}", SCRIPTS[*script]));
            }
            Step::Pass(ms) => stage.pass(*ms),
            Step::Stop => stage.act("carol stop"),
            Step::Unstop => stage.act("carol unstop"),
            Step::Change(change, drop) => {
                for (place, line) in events_of(*change, fence).iter().enumerate() {
                    if let Some((_, same)) = drop.filter(|(at, _)| *at == place) {
                        stage.act("down");
                        stage.act(if same { "resumed" } else { "rejoined" });
                        stage.act("told 0");
                    }
                    if line.starts_with("grabbed") {
                        // The client's gate knows before the device hears.
                        fence += 1;
                        stage.guard(&fence.to_string(), &fence.to_string());
                        // What the old owner had under way comes before the event, and after it.
                        let old = fence - 1;
                        stage.act(&format!("{old} command {} {old}: wait 1", 1000 + id));
                        witness.hear(stage.out.drain(..))?;
                        witness.fence = fence;
                    }
                    stage.act(line);
                    witness.hear(stage.out.drain(..))?;
                }
            }
        }
        witness.hear(stage.out.drain(..))?;
    }
    // In the end all is over, and the arm stands for who owns it.
    stage.pass(120_000);
    witness.hear(stage.out.drain(..))?;
    prop_assert_eq!(witness.rested, fence);
    prop_assert!(
        witness.begun.values().all(|(_, ended)| *ended),
        "{:?}",
        witness.begun
    );
    Ok(())
}

/// Without the hub's halt, the old owner's present statement comes to its end; nothing else of it begins, and nothing of the
/// new owner before the arm has said that it stands.
#[test]
fn a_hand_over_by_agreement_lets_the_statement_end_and_the_arm_stand() {
    for word in ["given", "returned"] {
        let begun = "alice command 1 5: move 0 0 270 0 0; move 0 0 300 0 0
             > status alice/1 waiting 0/2
             > status alice/1 executing 1/2
             alice command 2 5: home
             > status alice/2 waiting 0/1";
        check(&format!(
            "{begun}
             after 100
             {word} 5
             > status alice/2 error 0/1 halted 5101
             bob command 1 6: wait 10
             > status bob/1 error 0/0 changing-hands 5105
             grabbed 6
             bob command 2 6: wait 10
             > status bob/2 error 0/0 changing-hands 5105
             after 99
             after 1
             > state free moving, fence 6
             > status alice/1 error 1/2 halted 5101
             bob command 1 6: wait 10
             > status bob/1 waiting 0/1
             after 299
             > state free moving
             after 1
             > state free at rest
             > status bob/1 executing 1/1"
        ));
        // What comes meanwhile and takes control away ends it at once, regardless of who ordered it.
        for (line, fence) in [("hub halt", 6), ("released 6", 6), ("grabbed 7", 7)] {
            check(&format!(
                "{begun}
                 after 100
                 {word} 5
                 > status alice/2 error 0/1 halted 5101
                 grabbed 6
                 {line}
                 > state free moving, fence {fence}
                 > status alice/1 error 1/2 halted 5101"
            ));
        }
        // A wait is not waited for.
        check(&format!(
            "alice command 1 5: wait 60000; home
             > status alice/1 waiting 0/2
             > status alice/1 executing 1/2
             {word} 5
             > state free moving
             > status alice/1 error 1/2 halted 5101
             grabbed 6
             > state free moving, fence 6"
        ));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]
    #[test]
    fn nothing_of_an_older_owner_begins_after_a_change(steps in proptest::collection::vec(step(), 1..40)) {
        play(&steps)?;
    }
}
