//! M34: how far the shown hand is from the real one, by the delay of its states, with and without prediction.

use std::fmt::Write as _;
use std::time::Duration;

use anyhow::{Context as _, Result};
use fastrand::Rng;
use mom_arm::{Arm, ArmEvent, Pose};
use mom_camera::{DrawnPose, PosePredictor};
use mom_client::{Family, Parcel, Time};
use mom_plots::{Axis, Plot, Series};

use super::{IMAGES, Section, Settings, quantile};

/// Delays from the robot to the viewer, ms.
const DELAYS: [i64; 10] = [0, 50, 100, 200, 300, 500, 700, 1000, 1500, 2000];
/// Those of the table.
const SHOWN: [i64; 6] = [0, 100, 300, 500, 1000, 2000];
/// Those of which the text tells.
const TOLD: [i64; 4] = [100, 500, 1000, 2000];
/// µs by which a state may be later than that, drawn evenly.
const JITTER: i64 = 50_000;
/// µs between two looks of the viewer: 10 Hz.
const LOOK: i64 = 100_000;
/// µs by which the horizon is longer than the delay: the jitter, and the time until the next state.
const SPARE: i64 = 150_000;
/// The horizon of the lab's camera, µs.
const LAB_HORIZON: i64 = 500_000;
/// µs between two velocities of a jog, and ms for which each of them holds.
const REPEAT: i64 = 100_000;
const HOLD: u32 = 300;
/// s of each motion.
const SECONDS: i64 = 600;

const MS: i64 = 1_000;
const SECOND: i64 = 1_000_000;

/// How the arm is moved.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Motion {
    /// Commands of one to three moves, with rests between the commands.
    Scripts,
    /// One command with moves and waits, as long as a command may be, and then another one.
    Waits,
    /// By hand: velocities that change.
    Jogs,
}

impl Motion {
    const ALL: [Motion; 3] = [Motion::Scripts, Motion::Waits, Motion::Jogs];

    fn name(self) -> &'static str {
        match self {
            Motion::Scripts => "scripts",
            Motion::Waits => "scripts with `wait`",
            Motion::Jogs => "jogging",
        }
    }
}

/// A state as the arm tells it.
#[derive(Clone, Copy, Debug)]
struct Told {
    at: i64,
    pose: Pose,
    moving: bool,
}

/// What the arm did, and what it said of it.
#[derive(Debug, Default)]
struct Recording {
    /// Where the hand was at each look.
    truth: Vec<Pose>,
    states: Vec<Told>,
}

/// Errors in mm of one way to show the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Errors {
    mean: f64,
    most_of_them: f64,
    largest: f64,
}

/// The errors at one delay.
#[derive(Clone, Copy, Debug)]
struct Point {
    delay: i64,
    without: Errors,
    with: Errors,
    lab: Errors,
}

pub(super) fn run(settings: &Settings) -> Result<Section> {
    let seconds = if settings.quick { SECONDS / 20 } else { SECONDS };
    let mut random = Rng::with_seed(settings.seed);
    let mut curves = Vec::new();
    for motion in Motion::ALL {
        let recording = record(motion, seconds * SECOND, &mut random)?;
        let points = DELAYS.map(|delay| {
            let arrivals = arrivals(&recording.states, delay * MS, &mut random);
            let [with, lab] = [delay * MS + SPARE, LAB_HORIZON].map(|horizon| {
                let horizon = Duration::from_micros(horizon.unsigned_abs());
                errors(&recording, &arrivals, Some(PosePredictor::new(horizon)))
            });
            Point {
                delay,
                without: errors(&recording, &arrivals, None),
                with,
                lab,
            }
        });
        curves.push((motion, points));
    }
    Ok(Section {
        markdown: markdown(&curves, seconds),
        plots: vec![("experiment-tracking.svg", plot(&curves))],
    })
}

/// Drives the arm for so many µs.
fn record(motion: Motion, end: i64, random: &mut Rng) -> Result<Recording> {
    let mut arm = Arm::with_blocks(0, []);
    let mut recording = Recording::default();
    let (mut now, mut look, mut command, mut rest, mut id) = (0, 0, 0, 0, 0);
    let mut hand = Hand::default();
    while now < end {
        let mut events = Vec::new();
        arm.advance(now, &mut events);
        if now >= look {
            recording.truth.push(arm.state().pose);
            look += LOOK;
        }
        if now >= command {
            command = now + REPEAT;
            let script = match motion {
                Motion::Jogs => hand.jog(now, &arm.state().pose, random),
                // First the rest, then the next command.
                Motion::Scripts if !arm.is_busy() && rest > 0 => {
                    command = now + std::mem::take(&mut rest);
                    None
                }
                Motion::Scripts if !arm.is_busy() => {
                    rest = random.i64(1..2 * SECOND);
                    Some(moves(random, 1, 3, ""))
                }
                // A wait at the end, so that it rests within the command.
                Motion::Waits if !arm.is_busy() => Some(moves(random, 20, 20, "; wait 1000")),
                Motion::Scripts | Motion::Waits => None,
            };
            if let Some(script) = script {
                id += 1;
                let refused = || format!("the arm refuses `{script}`");
                arm.submit(id, &script, now, &mut events).with_context(refused)?;
            }
        }
        recording
            .states
            .extend(events.into_iter().filter_map(|event| match event {
                ArmEvent::State(state) => Some(Told {
                    at: now,
                    pose: state.pose,
                    moving: state.moving,
                }),
                ArmEvent::Command { .. } => None,
            }));
        let due = arm.next_wake().unwrap_or(look).max(now + 1);
        now = due.min(look).min(command);
    }
    Ok(recording)
}

/// A script of moves to random poses; `after` follows each of them.
fn moves(random: &mut Rng, least: usize, most: usize, after: &str) -> String {
    let count = random.usize(least..=most);
    let mut one = || {
        let [x, y] = [(); 2].map(|()| random.i32(-250..=250));
        let (z, spin) = (random.i32(10..=300), random.i32(-60..=60));
        format!("move {x} {y} {z} {spin} 0{after}")
    };
    (0..count).map(|_| one()).collect::<Vec<_>>().join("; ")
}

/// A peer that jogs.
#[derive(Debug, Default)]
struct Hand {
    /// mm/s.
    velocity: [f64; 3],
    until: i64,
}

impl Hand {
    /// What is said now; nothing while no key is held.
    fn jog(&mut self, now: i64, pose: &Pose, random: &mut Rng) -> Option<String> {
        if now >= self.until {
            self.until = now + random.i64(300 * MS..2 * SECOND);
            // Towards some place of the workspace, so that it does not end at an edge; one time in four it rests.
            let to = [
                random.f64() * 400.0 - 200.0,
                random.f64() * 400.0 - 200.0,
                random.f64() * 300.0 + 50.0,
            ];
            let way = [to[0] - pose.x, to[1] - pose.y, to[2] - pose.z];
            let length = way[0].hypot(way[1]).hypot(way[2]).max(1.0);
            let speed = if random.u8(..4) == 0 {
                0.0
            } else {
                30.0 + 119.0 * random.f64()
            };
            self.velocity = way.map(|part| part / length * speed);
        }
        let [x, y, z] = self.velocity;
        (self.velocity != [0.0; 3]).then(|| format!("jog {x:.1} {y:.1} {z:.1} 0 0 {HOLD}"))
    }
}

/// When each state arrives: delayed, with jitter, in order.
fn arrivals(states: &[Told], delay: i64, random: &mut Rng) -> Vec<i64> {
    let mut last = i64::MIN;
    let arrive = states.iter().map(|state| {
        last = last.max(state.at + delay + random.i64(0..=JITTER));
        last
    });
    arrive.collect()
}

/// The errors of a viewer at all its looks; without a predictor it shows the last state.
fn errors(recording: &Recording, arrivals: &[i64], mut predictor: Option<PosePredictor>) -> Errors {
    let mut coming = recording.states.iter().zip(arrivals).peekable();
    let mut shown = None;
    let mut errors = Vec::with_capacity(recording.truth.len());
    for (number, truth) in (0..).zip(&recording.truth) {
        let now = number * LOOK;
        while let Some((state, arrived)) = coming.next_if(|(_, arrived)| **arrived <= now) {
            shown = Some(state.pose.position());
            if let Some(predictor) = &mut predictor {
                predictor.observe(
                    &parcel(state.at, *arrived),
                    &drawn(&state.pose),
                    Some(state.moving),
                );
            }
        }
        let hub = Time::from_micros(epoch(now));
        let predicted = predictor
            .as_ref()
            .zip(hub)
            .and_then(|(predictor, hub)| predictor.at(hub));
        let place = predicted.map(|pose| [pose.x, pose.y, pose.z]).or(shown);
        errors.extend(place.map(|[x, y, z]| (x - truth.x).hypot(y - truth.y).hypot(z - truth.z)));
    }
    Errors::of(errors)
}

impl Errors {
    fn of(mut errors: Vec<f64>) -> Errors {
        errors.sort_by(f64::total_cmp);
        Errors {
            mean: errors.iter().sum::<f64>() / errors.len().max(1) as f64,
            most_of_them: quantile(&errors, 0.95),
            largest: quantile(&errors, 1.0),
        }
    }
}

/// The stamps of a state: the hub had it half-way, and knows its age by the robot's clock.
fn parcel(created: i64, arrived: i64) -> Parcel {
    let half = (arrived - created) / 2;
    let mut parcel = Parcel::new(Family::Message, "state");
    parcel.received = Time::from_micros(epoch(created + half));
    parcel.age = Some(half);
    parcel
}

/// The hub's time: any beginning that is not 0.
fn epoch(now: i64) -> i64 {
    SECOND + now
}

fn drawn(pose: &Pose) -> DrawnPose {
    let Pose { x, y, z, spin, tilt } = *pose;
    DrawnPose { x, y, z, spin, tilt }
}

type Curve = (Motion, [Point; DELAYS.len()]);

fn markdown(curves: &[Curve], seconds: i64) -> String {
    let mut text = format!(
        "The paper says that a measured delay gives the age of information, \"and therefore allowing predictions of the current state to be made\"; it measures none. \
         Here the simulated arm moves for {seconds} s in each of three ways and tells its state 20 times a second while it moves; a viewer looks 10 times a second at where the hand is said to be, \
         and the error is its distance from where it is. *Without* is the last state that has arrived; *with* is what the cameras' predictor makes of the states, \
         with a horizon of the delay and {} ms; the last column is the same with the {} ms of the lab's cameras.\n\n\
         **Inputs:** the delay, the same for all states but for a jitter of up to {} ms, in order, nothing lost; clocks without error, so the age of each state is known. *Scripts*: one to three moves \
         to random places by the path rule, up to 2 s at rest between two commands. *Scripts with `wait`*: the rests, 1 s, are within the command. *Jogging*: velocities of 30 to 149 mm/s \
         towards random places, which change every 0.3 to 2 s, at rest one time in four.\n",
        SPARE / MS,
        LAB_HORIZON / MS,
        JITTER / MS
    );
    for (motion, points) in curves {
        let _ = write!(
            text,
            "\n| {}, mm; delay | without: mean | 95 % | max | with: mean | 95 % | max | lab's horizon: mean |\n|---|---:|---:|---:|---:|---:|---:|---:|\n",
            motion.name()
        );
        for point in points.iter().filter(|point| SHOWN.contains(&point.delay)) {
            let three = |errors: Errors| {
                format!(
                    "{:.1} | {:.1} | {:.1}",
                    errors.mean, errors.most_of_them, errors.largest
                )
            };
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "| {} ms | {} | {} | {:.1} |",
                point.delay,
                three(point.without),
                three(point.with),
                point.lab.mean
            );
        }
    }
    text += &verdict(curves);
    let _ = writeln!(text, "\n![Tracking error](images/{IMAGES}-tracking.svg)");
    text
}

fn verdict(curves: &[Curve]) -> String {
    let mut text = "\nThe mean error with prediction, beside that without:\n\n".to_owned();
    for (motion, points) in curves {
        let changes = |wanted: fn(&Point) -> Errors| {
            let points = points.iter().filter(|point| TOLD.contains(&point.delay));
            let change = |point: &Point| {
                let change = change(wanted(point).mean, point.without.mean);
                format!("{change} at {} ms", point.delay)
            };
            points.map(change).collect::<Vec<_>>().join(", ")
        };
        let (with, lab) = (changes(|point| point.with), changes(|point| point.lab));
        // Writing to a String cannot fail.
        let _ = writeln!(text, "- {}: {with}; with the lab's horizon {lab}.", motion.name());
    }
    text += "\nPrediction is good for delays that are short beside the time for which a motion goes on as it was. A corner, a stop or another key is not known before the state that tells of it has come: until then the hand is \
             shown on its old course, in the worst case (it turned back) twice the velocity times the delay away, so from some hundred milliseconds on the largest errors are larger with prediction than without. A horizon as long as a delay of \
             seconds does harm; one of half a second costs little below and bounds the harm above.\n";
    text
}

/// A mean beside another one, in words.
fn change(mean: f64, other: f64) -> String {
    let percent = 100.0 * (mean / other - 1.0);
    let word = if percent > 0.0 { "larger" } else { "smaller" };
    format!("{:.0} % {word}", percent.abs())
}

fn plot(curves: &[Curve]) -> String {
    let plot = Plot::new(
        "Mean distance of the shown hand from the real one (M34)",
        Axis::linear("delay of the states, ms"),
        Axis::linear("mm"),
    );
    let plot = curves.iter().fold(plot, |plot, (motion, points)| {
        let line = |of: fn(&Point) -> f64| {
            points
                .iter()
                .map(|point| (point.delay as f64, of(point)))
                .collect()
        };
        let name = motion.name().replace('`', "");
        plot.with(Series::line(
            format!("{name}: without"),
            line(|point| point.without.mean),
        ))
        .with(Series::line(
            format!("{name}: with"),
            line(|point| point.with.mean),
        ))
    });
    plot.to_svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hand that goes along x at 100 mm/s.
    fn straight() -> Recording {
        let at = |at: i64| Pose::new(at as f64 / 1e4, 0.0, 100.0, 0.0, 0.0);
        Recording {
            truth: (0..50).map(|look| at(look * LOOK)).collect(),
            states: (0..100)
                .map(|state| Told {
                    at: state * 50_000,
                    pose: at(state * 50_000),
                    moving: true,
                })
                .collect(),
        }
    }

    #[test]
    fn a_straight_line_is_predicted_and_without_lags_by_the_delay() {
        let recording = straight();
        let arrivals: Vec<i64> = recording.states.iter().map(|state| state.at + 300_000).collect();
        let without = errors(&recording, &arrivals, None);
        assert!(
            (without.mean - 30.0).abs() < 1e-9 && (without.largest - 30.0).abs() < 1e-9,
            "{without:?}"
        );
        let long = PosePredictor::new(Duration::from_millis(450));
        let with = errors(&recording, &arrivals, Some(long));
        // The first state tells no velocity.
        assert!(
            with.most_of_them < 1e-6 && (with.largest - 30.0).abs() < 1e-9,
            "{with:?}"
        );
        let short = PosePredictor::new(Duration::from_millis(100));
        let short = errors(&recording, &arrivals, Some(short));
        assert!(
            (short.most_of_them - 20.0).abs() < 1e-6,
            "held at its horizon: {short:?}"
        );
    }

    #[test]
    fn the_arm_moves_and_tells_in_each_way() {
        for motion in Motion::ALL {
            let recording = record(motion, 20 * SECOND, &mut Rng::with_seed(1)).unwrap();
            assert_eq!(recording.truth.len(), 200, "{motion:?}");
            let way: f64 = recording
                .truth
                .windows(2)
                .map(|pair| pair[0].distance(&pair[1]))
                .sum();
            assert!(way > 500.0, "{motion:?} {way}");
            let states = &recording.states;
            assert!(states.len() > 150, "{motion:?} {}", states.len());
            assert!(states.windows(2).all(|pair| pair[0].at <= pair[1].at));
            assert!(states.iter().any(|state| state.moving), "{motion:?}");
            let rests = states.iter().any(|state| !state.moving && state.at > SECOND);
            assert!(motion == Motion::Waits || rests, "{motion:?}");
        }
    }

    #[test]
    fn states_arrive_in_order_and_not_too_soon() {
        let states = straight().states;
        let arrivals = arrivals(&states, 200_000, &mut Rng::with_seed(2));
        assert!(arrivals.is_sorted());
        for (state, arrived) in states.iter().zip(&arrivals) {
            assert!((200_000..=200_000 + JITTER).contains(&(arrived - state.at)));
        }
        let parcel = parcel(1_000, 5_000);
        assert_eq!(
            (parcel.received, parcel.age),
            (Time::from_micros(epoch(3_000)), Some(2_000))
        );
    }

    #[test]
    fn gains_are_told_with_their_sign() {
        let of = |mean| Errors {
            mean,
            most_of_them: mean,
            largest: mean,
        };
        let points = DELAYS.map(|delay| Point {
            delay,
            without: of(10.0),
            with: of(if delay > 1000 { 15.0 } else { 5.0 }),
            lab: of(7.0),
        });
        let text = markdown(&[(Motion::Jogs, points)], 600);
        assert!(
            text.contains("| 300 ms | 10.0 | 10.0 | 10.0 | 5.0 | 5.0 | 5.0 | 7.0 |"),
            "{text}"
        );
        assert!(
            text.contains("- jogging: 50 % smaller at 100 ms, 50 % smaller at 500 ms, 50 % smaller at 1000 ms, 50 % larger at 2000 ms;"),
            "{text}"
        );
    }
}
