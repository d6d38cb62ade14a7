//! What is done in a trial, by its seed.

use fastrand::Rng;

use super::world::Kind;

/// What is done in a trial.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Deed {
    /// The owner sends a command, which moves after so many ms, for so many.
    Drive(u64, u64),
    Stop,
    Unstop,
    /// Another peer becomes the owner: the old one lets go, or gives it, or the operator takes it.
    HandOver(Way),
    Link(bool),
    Sever,
    Wire(bool),
    /// A network of datagrams that loses, doubles and reorders.
    Rough,
    Pause(usize),
    GoOn(usize),
    Kill(usize),
    Restart(usize),
    Reload,
    /// A reload after which the channel is guarded, or is not.
    Guard(bool),
    Nothing,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Way {
    LetGo,
    Give,
    Take,
}

/// What a seed does to this kind of device, in the order of times in ms: one of some plain plots, and then anything.
pub(super) fn plan(kind: Kind, seed: u64) -> Vec<(u64, Deed)> {
    let mut chance = Rng::with_seed(seed);
    let (mut plan, mut at) = plot(kind, seed, &mut chance);
    let more = if plan.len() > 2 {
        chance.u64(0..3)
    } else {
        chance.u64(3..8)
    };
    for _ in 0..more {
        at += chance.u64(20..600);
        let deed = match chance.u32(..100) {
            0..30 => drive(&mut chance),
            30..47 => Deed::Stop,
            47..55 => Deed::Unstop,
            55..73 => Deed::HandOver(way(&mut chance)),
            73..96 => {
                fault(kind, at, &mut plan, &mut chance);
                continue;
            }
            _ => Deed::Reload,
        };
        // What was stopped is often let go after a while, or only driven after the unstop.
        if matches!(deed, Deed::Stop) && chance.bool() {
            let later = at + chance.u64(400..4000);
            plan.push((later, Deed::Unstop));
            plan.push((later + chance.u64(10..200), drive(&mut chance)));
        }
        if matches!(deed, Deed::HandOver(_)) {
            plan.push((at + chance.u64(1..60), drive(&mut chance)));
        }
        plan.push((at, deed));
    }
    // Late consequences are waited for.
    let last = plan.iter().map(|(at, _)| *at).max().unwrap_or(0);
    plan.push((last + chance.u64(100..2200), Deed::Nothing));
    plan.sort_by_key(|(at, _)| *at);
    plan
}

/// A peer drives, and then what is most asked of a device happens, or nothing yet. Also when that is over.
fn plot(kind: Kind, seed: u64, chance: &mut Rng) -> (Vec<(u64, Deed)>, u64) {
    let mut plan = vec![(0, Deed::HandOver(Way::LetGo)), (20, drive(chance))];
    // Each in its turn; of a planted fault it is to be shown soon that it is found.
    let plots = if matches!(kind, Kind::Planted(_)) { 7 } else { 10 };
    let plot = seed % plots;
    if plot < 5 {
        plan.push((30, Deed::Drive(1, chance.u64(1200..2000))));
    }
    let at = 20 + chance.u64(100..1200);
    let over = match plot {
        0 => {
            plan.push((at, Deed::Link(true)));
            plan.push((at + 3200, Deed::Link(false)));
            at + 3200
        }
        1 => {
            plan.push((at, Deed::Stop));
            at + chance.u64(1000..4500)
        }
        2 => {
            plan.push((at, Deed::Stop));
            plan.push((at + chance.u64(50..2000), Deed::Sever));
            at + 3200
        }
        3 | 4 => {
            plan.push((at, Deed::HandOver(way(chance))));
            plan.push((at + chance.u64(1..60), drive(chance)));
            at + chance.u64(1000..2500)
        }
        5 => {
            let last = drive(chance);
            let Deed::Drive(pause, lasts) = last else {
                return (plan, at);
            };
            plan.truncate(1);
            plan.push((20, last));
            let over = 20 + 2 * lasts + pause + 4000;
            plan.push((over, Deed::Nothing));
            over
        }
        6 if kind.has_guard() => {
            let (open, at) = (chance.u64(200..400), 400 + chance.u64(100..1200));
            plan = vec![(0, Deed::Guard(false)), (open, drive(chance))];
            plan.push((open + 10, Deed::Drive(1, chance.u64(1200..2000))));
            plan.push((at, Deed::Guard(true)));
            at + chance.u64(1500..3000)
        }
        _ => 20,
    };
    (plan, over)
}

fn drive(chance: &mut Rng) -> Deed {
    Deed::Drive([1, 200, 500][chance.usize(..3)], chance.u64(200..1000))
}

fn way(chance: &mut Rng) -> Way {
    [Way::LetGo, Way::Give, Way::Take][chance.usize(..3)]
}

/// Something is hindered for a while.
fn fault(kind: Kind, at: u64, plan: &mut Vec<(u64, Deed)>, chance: &mut Rng) {
    let end = at + chance.u64(100..3500);
    let programs = match kind {
        Kind::Planted(_) => 1,
        Kind::Linuxbot | Kind::Cubo => 3,
        _ => 2,
    };
    let (begin, over) = match chance.u32(..100) {
        0..30 => (Deed::Link(true), Deed::Link(false)),
        30..45 => (Deed::Sever, Deed::Sever),
        45..60 if programs == 3 => (Deed::Wire(true), Deed::Wire(false)),
        60..65 if kind == Kind::Cubo => (Deed::Rough, Deed::Wire(false)),
        65..70 if programs > 1 => {
            let which = chance.usize(1..programs);
            (Deed::Kill(which), Deed::Restart(which))
        }
        // A gateway would have to make the channels again before anybody could join them.
        70..78 if kind.has_guard() => (Deed::Kill(0), Deed::Restart(0)),
        _ => {
            let which = chance.usize(..programs);
            (Deed::Pause(which), Deed::GoOn(which))
        }
    };
    plan.push((at, begin));
    plan.push((end, over));
}

#[test]
fn what_each_run_tries_contains_all_that_may_happen() {
    let all: Vec<Deed> = (1..=100)
        .flat_map(|seed| plan(Kind::Cubo, seed))
        .map(|(_, deed)| deed)
        .collect();
    let programs = (0..3).map(Deed::Pause).chain([Deed::Kill(1), Deed::Kill(2)]);
    let links = [Deed::Link(true), Deed::Sever, Deed::Wire(true), Deed::Rough];
    let words = [Deed::Stop, Deed::Unstop, Deed::Reload];
    let hands = [Way::LetGo, Way::Give, Way::Take].map(Deed::HandOver);
    for deed in programs.chain(links).chain(words).chain(hands) {
        assert!(all.contains(&deed), "{deed:?}");
    }
    let of_arm: Vec<Deed> = (1..=100)
        .flat_map(|seed| plan(Kind::Arm, seed))
        .map(|(_, deed)| deed)
        .collect();
    for deed in [
        Deed::Guard(false),
        Deed::Guard(true),
        Deed::Kill(0),
        Deed::Kill(1),
    ] {
        assert!(of_arm.contains(&deed), "{deed:?}");
    }
}
