//! From what is wanted of objects to moves of the arm.
//!
//! A block is taken from above, with the jaws turned to two of its faces, carried above everything else, and put down
//! on its goal. What cannot be done without touching something else is refused before anything moves, with the name
//! of what is in the way.

use mom_client::Time;
use mom_drive::Pose;

use crate::objects::known;
use crate::{Object, Objects};

/// An object that nobody has seen for longer is where it likes, ms.
pub const FRESH: i64 = 2000;

/// Where an object is to be.
#[derive(Debug, Clone, PartialEq)]
pub enum Goal {
    /// On another one, turned as that is.
    On(String),
    /// At a place on the table.
    At {
        /// mm.
        x: f64,
        /// mm.
        y: f64,
        /// Degrees about the vertical, of which a cube shows only the part of a quarter; none: as it is.
        yaw: Option<f64>,
    },
}

/// How an object comes to its goal.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Scripts that do it, the best first. The arm may be unable to reach some.
    pub scripts: Vec<String>,
    /// Where the object's middle will be, mm.
    pub place: [f64; 3],
    /// How it will be turned about the vertical, degrees, where that was asked for.
    pub yaw: Option<f64>,
    /// Above everything that stands there, mm.
    travel: f64,
}

impl Plan {
    /// Straight up from where the hand is, unless it is high enough: its jaws are not to open, nor to move aside,
    /// between things.
    #[must_use]
    pub fn rise_from(&self, hand: &Pose) -> Option<String> {
        let up = Pose {
            z: self.travel,
            ..*hand
        };
        (hand.z < self.travel).then(|| up.command())
    }
}

/// An object that is not where it was brought.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Missed {
    /// It is elsewhere.
    Place,
    /// It is there, but not turned as it was to be.
    Turn,
}

/// Why something cannot be done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlanError {
    /// What is wrong.
    pub text: String,
    /// What to do about it.
    pub hint: String,
}

/// The hand, as the arm's own contact rule has it, mm: the fingers and their middles when they are open, the palm and the
/// stalk of the marker above them.
const FINGER: [f64; 2] = [4.0, 8.0];
const FINGER_ASIDE: f64 = 44.0;
const PALM: [f64; 2] = [50.0, 20.0];
const STALK: [f64; 2] = [15.0, 72.0];
const STALK_ASIDE: f64 = -80.0;
/// mm from the fingertips up to the palm and the stalk.
const PALM_HEIGHT: f64 = 58.0;
/// mm of room that everything needs around it.
const ROOM: f64 = 3.0;
/// mm above everything at which a block is carried.
const ABOVE: f64 = 25.0;
/// The least and the greatest height of the hand on its way, mm.
const TRAVEL: [f64; 2] = [150.0, 440.0];
/// mm by which a block is let go above what it is put on: it is not pressed down.
const DROP: f64 = 1.0;
/// A place known worse than this is none to grip at, mm.
const VAGUE: f64 = 8.0;
/// Turns of the hand, degrees.
const TURNS: std::ops::RangeInclusive<f64> = -135.0..=135.0;

fn refused<T>(text: impl Into<String>, hint: impl Into<String>) -> Result<T, PlanError> {
    Err(PlanError {
        text: text.into(),
        hint: hint.into(),
    })
}

/// Plans how an object comes to its goal.
///
/// ```
/// use mom_client::Time;
/// use mom_model::plan::{Goal, plan};
/// use mom_model::{Object, Objects};
///
/// let lies_at = |name, x| Object { x, seen: Some(Time::default()), ..Object::new(name, 40.0, [200, 40, 40]) };
/// let objects = Objects::from_iter([lies_at("red", 0.0), lies_at("blue", 150.0)]);
/// let plan = plan(&objects, "red", &Goal::On("blue".to_owned()), Time::default()).unwrap();
/// assert_eq!(plan.place, [150.0, 0.0, 60.0]);
/// ```
///
/// # Errors
///
/// An object that is not there, is held, was not seen for 2 s or has something on it; no room for the hand or for the
/// object.
pub fn plan(objects: &Objects, what: &str, goal: &Goal, now: Time) -> Result<Plan, PlanError> {
    let object = usable(objects, what, now)?;
    if let Some(held) = objects.iter().find(|object| object.held) {
        return refused(
            format!("the jaws hold {} already", held.name),
            "open them first: echo 'grip open' | mom run -",
        );
    }
    free(objects, object)?;
    let from = [object.x, object.y, objects.level(object)];
    let (place, yaw) = place_of(objects, object, goal, now)?;
    let others: Vec<&Object> = objects.iter().filter(|other| other.name != what).collect();
    let tallest = others.iter().map(|other| other.top()).fold(0.0, f64::max);
    let travel = (tallest.max(place[2]).max(from[2]) + object.size / 2.0 + ABOVE).max(TRAVEL[0]);
    if travel > TRAVEL[1] {
        let text = format!("{what} would have to be carried at {travel:.0} mm, above all that stands there");
        return refused(text, format!("the hand reaches up to {:.0} mm", TRAVEL[1]));
    }
    if let Some(near) = others.iter().find(|other| meets(object, place, yaw, other)) {
        return refused(
            format!(
                "there is no room for {what} at {:.0} {:.0}: {} is too near",
                place[0], place[1], near.name
            ),
            format!(
                "choose another place, or put {what} on it: mom put {what} on {}",
                near.name
            ),
        );
    }
    let pairs = turns(objects, object, (from, place, yaw), &others)?;
    let script = |(spin, turned): &(f64, f64)| script(from, place, travel, *spin, *turned);
    Ok(Plan {
        scripts: pairs.iter().map(script).collect(),
        place,
        yaw: match goal {
            Goal::At { yaw, .. } => *yaw,
            Goal::On(_) => None,
        },
        travel,
    })
}

/// An object that is there, was seen lately, and is free.
fn usable<'a>(objects: &'a Objects, name: &str, now: Time) -> Result<&'a Object, PlanError> {
    let Some(object) = objects.get(name) else {
        return refused(objects.no_such(name, now), "see what is there: mom objects");
    };
    if object.held {
        let text = format!("{name} is in the jaws already");
        return refused(text, "put it down first: echo 'grip open' | mom run -");
    }
    let age = object.seen.and_then(|_| object.age_at(now));
    if object.written_by.is_some() || age.is_none_or(|age| age > FRESH) {
        let hint = "something may hide it from the cameras; see what they see: mom snap top";
        return refused(objects.too_old(object, now), hint);
    }
    if object.error > VAGUE {
        let text = format!(
            "the position of {name} is known only to within {:.0} mm",
            object.error
        );
        return refused(text, "see what hides it from the cameras: mom snap top");
    }
    if object.z < 0.0 {
        return refused(
            format!("{name} has fallen off the table"),
            "put the lab back: echo reset | mom run -",
        );
    }
    Ok(object)
}

/// Nothing lies on an object.
fn free(objects: &Objects, object: &Object) -> Result<(), PlanError> {
    match objects.upon(object) {
        Some(upon) => refused(
            format!("{} lies on {}", upon.name, object.name),
            format!("bring it elsewhere first: mom bring {} to X Y", upon.name),
        ),
        None => Ok(()),
    }
}

/// Where an object is to be, mm, and how it is to be turned.
fn place_of(
    objects: &Objects,
    object: &Object,
    goal: &Goal,
    now: Time,
) -> Result<([f64; 3], f64), PlanError> {
    match goal {
        Goal::At { x, y, yaw } => Ok(([*x, *y, object.size / 2.0], yaw.unwrap_or(object.yaw))),
        Goal::On(name) if *name == object.name => refused(
            format!("{name} cannot lie on itself"),
            "name another one: mom objects",
        ),
        Goal::On(name) => {
            let under = usable(objects, name, now)?;
            if let Some(upon) = objects.upon(under) {
                let text = match upon.name == object.name {
                    true => format!("{} lies on {name} already", upon.name),
                    false => format!("{} lies on {name}", upon.name),
                };
                return refused(text, "see how they lie: mom objects");
            }
            let height = objects.level(under) + (under.size + object.size) / 2.0;
            Ok(([under.x, under.y, height], under.yaw))
        }
    }
}

/// From where it is to where it will be, mm, and how it will be turned.
type Way = ([f64; 3], [f64; 3], f64);

/// The turns of the hand where it takes the object and where it lets it go: those with room for the open jaws, the least
/// turned first.
fn turns(
    objects: &Objects,
    object: &Object,
    (from, to, yaw): Way,
    others: &[&Object],
) -> Result<Vec<(f64, f64)>, PlanError> {
    // A cube has no front: a quarter more or less is the same.
    let quarters = |yaw: f64| {
        (-2..=2)
            .map(move |i| yaw.rem_euclid(90.0) + 90.0 * f64::from(i))
            .filter(|turn| TURNS.contains(turn))
    };
    let mut pairs = Vec::new();
    let mut in_the_way = None;
    for take in quarters(object.yaw) {
        for leave in quarters(yaw) {
            let mut obstacles = [(from, take), (to, leave)]
                .into_iter()
                .filter_map(|(place, turn)| {
                    let near = others.iter().find(|other| hand_meets(place, turn, other))?;
                    Some((place, near.name.as_str()))
                });
            match obstacles.next() {
                None => pairs.push((take, leave)),
                found => in_the_way = in_the_way.or(found),
            }
        }
    }
    let effort = |(take, leave): &(f64, f64)| (leave - take).abs() + 0.1 * take.abs();
    pairs.sort_by(|a, b| effort(a).total_cmp(&effort(b)));
    match (pairs.is_empty(), in_the_way) {
        (true, Some(([x, y, _], near))) => {
            let name = objects.get(near).map_or(near, |near| near.name.as_str());
            refused(
                format!("the open jaws have no room at {x:.0} {y:.0}: {name} is too near"),
                format!("bring it further away first: mom bring {name} to X Y"),
            )
        }
        (true, None) => refused(
            format!("the hand cannot turn to the sides of {}", object.name),
            format!(
                "it turns from {:.0} to {:.0} degrees; ask for another yaw",
                TURNS.start(),
                TURNS.end()
            ),
        ),
        (false, _) => Ok(pairs),
    }
}

fn script(from: [f64; 3], to: [f64; 3], travel: f64, take: f64, leave: f64) -> String {
    let at = |[x, y, _]: [f64; 3], z: f64, turn: f64| {
        let number = |value: f64| (value * 10.0).round() / 10.0 + 0.0;
        format!(
            "move {} {} {} {} 0",
            number(x),
            number(y),
            number(z),
            number(turn)
        )
    };
    [
        "grip open".to_owned(),
        at(from, travel, take),
        at(from, from[2], take),
        "grip close".to_owned(),
        at(from, travel, take),
        at(to, travel, leave),
        at(to, to[2] + DROP, leave),
        "grip open".to_owned(),
        at(to, travel, leave),
    ]
    .join("; ")
}

/// A rectangle on the level: its middle, half its edges, and its turn in degrees.
#[derive(Debug, Clone, Copy)]
struct Rectangle {
    middle: [f64; 2],
    half: [f64; 2],
    turn: f64,
}

impl Rectangle {
    /// Of an object, with room around it.
    fn of(object: &Object) -> Rectangle {
        Rectangle {
            middle: [object.x, object.y],
            half: [object.size / 2.0; 2],
            turn: object.yaw,
        }
    }

    fn axes(&self) -> [[f64; 2]; 2] {
        let (sin, cos) = self.turn.to_radians().sin_cos();
        [[cos, sin], [-sin, cos]]
    }

    /// Half its extent along a direction of length 1.
    fn reach(&self, [x, y]: [f64; 2]) -> f64 {
        let along = self.axes().map(|[a, b]| (a * x + b * y).abs());
        along[0] * self.half[0] + along[1] * self.half[1]
    }

    /// Whether they overlap: none of the four directions of their edges parts them.
    fn overlaps(&self, other: &Rectangle) -> bool {
        let way = [other.middle[0] - self.middle[0], other.middle[1] - self.middle[1]];
        let mut axes = self.axes().into_iter().chain(other.axes());
        axes.all(|axis| (way[0] * axis[0] + way[1] * axis[1]).abs() < self.reach(axis) + other.reach(axis))
    }
}

/// Whether an object at a place would be in another one.
fn meets(object: &Object, [x, y, z]: [f64; 3], yaw: f64, other: &Object) -> bool {
    let there = Rectangle {
        middle: [x, y],
        half: [object.size / 2.0 + ROOM; 2],
        turn: yaw,
    };
    let (bottom, top) = (z - object.size / 2.0, z + object.size / 2.0);
    let beside = other.top() > bottom + object.size / 4.0 && other.z - other.size / 2.0 < top;
    beside && there.overlaps(&Rectangle::of(other))
}

/// Whether the hand with open jaws would be in an object, with its tip at a place.
fn hand_meets([x, y, z]: [f64; 3], turn: f64, other: &Object) -> bool {
    let (sin, cos) = turn.to_radians().sin_cos();
    let part = |[along, across]: [f64; 2], half: [f64; 2]| Rectangle {
        middle: [x + along * cos - across * sin, y + along * sin + across * cos],
        half: half.map(|edge| edge + ROOM),
        turn,
    };
    let there = Rectangle::of(other);
    let fingers = [-FINGER_ASIDE, FINGER_ASIDE].map(|aside| part([aside, 0.0], FINGER));
    let above = [part([0.0, 0.0], PALM), part([0.0, STALK_ASIDE], STALK)];
    let touches = |parts: &[Rectangle; 2]| parts.iter().any(|part| part.overlaps(&there));
    (other.top() > z && touches(&fingers)) || (other.top() > z + PALM_HEIGHT && touches(&above))
}

/// How far an object is from its goal, mm.
///
/// # Errors
///
/// It is somewhere else, or turned otherwise than it was to be.
pub fn arrived(object: &Object, plan: &Plan) -> Result<f64, Missed> {
    const NEAR: f64 = 10.0;
    const TURNED: f64 = 10.0;
    let [x, y, z] = plan.place;
    let level = (object.x - x).hypot(object.y - y);
    if level >= NEAR || (object.z - z).abs() >= NEAR {
        return Err(Missed::Place);
    }
    let apart = plan.yaw.map_or(0.0, |yaw| (object.yaw - yaw).rem_euclid(90.0));
    match apart.min(90.0 - apart) <= TURNED {
        true => Ok(level),
        false => Err(Missed::Turn),
    }
}

/// `red lies at 100 50 at a height of 20 mm (seen 0.3 s ago)`, by its middle.
#[must_use]
pub fn lies_at(object: &Object, now: Time) -> String {
    let Object { name, x, y, z, .. } = object;
    let since = known(object, now);
    let since = since.strip_prefix(name.as_str()).unwrap_or(&since);
    format!("{name} lies at {x:.0} {y:.0}, its middle {z:.0} mm high{since}")
}

#[cfg(test)]
mod tests;
