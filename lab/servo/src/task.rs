//! What the agent is to do: one block beside another.

use std::fmt;
use std::str::FromStr;

use mom_client::{Map, Value};
use mom_nearest::nearest;
use mom_vision::blocks::Coloured;

/// mm of a block's edges: all are cubes of this size.
pub const SIZE: f64 = 40.0;
/// The narrowest and the widest gap between two blocks, mm.
pub const GAPS: std::ops::RangeInclusive<f64> = 5.0..=200.0;

/// The colours by whose names blocks are called: red, green and blue in full light.
pub const NAMES: [(&str, [u8; 3]); 6] = [
    ("red", [200, 40, 40]),
    ("green", [40, 150, 60]),
    ("blue", [40, 80, 190]),
    ("yellow", [241, 196, 40]),
    ("purple", [132, 82, 176]),
    ("cyan", [44, 172, 190]),
];

/// The side of the second block on which the first is to stand: that of the face which looks most that way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Side {
    /// Towards greater x.
    #[default]
    Right,
    /// Towards lesser x.
    Left,
    /// Towards the viewer: lesser y.
    Front,
    /// Away from the viewer: greater y.
    Back,
}

impl Side {
    /// All sides.
    pub const ALL: [Side; 4] = [Side::Right, Side::Left, Side::Front, Side::Back];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Side::Right => "right",
            Side::Left => "left",
            Side::Front => "front",
            Side::Back => "back",
        }
    }

    /// Its direction, degrees counter-clockwise from x, seen from above.
    #[must_use]
    pub const fn degrees(self) -> f64 {
        match self {
            Side::Right => 0.0,
            Side::Back => 90.0,
            Side::Left => 180.0,
            Side::Front => 270.0,
        }
    }
}

impl fmt::Display for Side {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Side {
    type Err = String;

    fn from_str(name: &str) -> Result<Side, String> {
        let found = Side::ALL.into_iter().find(|side| side.name() == name);
        found.ok_or_else(|| format!("{name:?} is not a side: right, left, front or back"))
    }
}

/// One block is to stand beside another.
#[derive(Debug, Clone, PartialEq)]
pub struct Task {
    /// The block that is moved, by the place of its colour in [`NAMES`].
    pub first: usize,
    /// The block beside which it is put.
    pub second: usize,
    /// On which side.
    pub side: Side,
    /// mm between their faces.
    pub gap: f64,
}

impl Task {
    /// A task by the names of its blocks.
    ///
    /// # Errors
    /// In words: a name that no colour has, with the nearest; twice the same block; a gap outside [`GAPS`].
    pub fn new(first: &str, second: &str, side: Side, gap: f64) -> Result<Task, String> {
        let (first, second) = (named(first)?, named(second)?);
        if first == second {
            let name = NAMES[first].0;
            return Err(format!("{name} cannot stand beside itself; name two blocks"));
        }
        if !GAPS.contains(&gap) {
            let (least, most) = (GAPS.start(), GAPS.end());
            return Err(format!("the gap is {gap} mm; it must be {least} to {most} mm"));
        }
        Ok(Task {
            first,
            second,
            side,
            gap,
        })
    }

    /// The task as the content of `align`.
    #[must_use]
    pub fn to_map(&self) -> Map {
        Map::new()
            .with("first", NAMES[self.first].0)
            .with("second", NAMES[self.second].0)
            .with("side", self.side.name())
            .with("gap", Value::Double(self.gap))
    }

    /// Reads the content of `align`; side and gap may be left out.
    ///
    /// # Errors
    /// In words, with the key.
    pub fn read(content: &Value) -> Result<Task, String> {
        let text = |key: &str| {
            let value = content.get(key).and_then(Value::as_str);
            value.ok_or_else(|| format!("{key} is missing: the name of a block"))
        };
        let side = match content.get("side") {
            None => Side::default(),
            Some(side) => side.as_str().ok_or("side is not a word")?.parse()?,
        };
        let gap = match content.get("gap") {
            None => 20.0,
            Some(Value::Double(gap)) => *gap,
            Some(Value::Int(gap)) => *gap as f64,
            Some(_) => return Err("gap is not a number of mm".to_owned()),
        };
        Task::new(text("first")?, text("second")?, side, gap)
    }
}

/// What the eyes look for.
#[must_use]
pub fn palette() -> Vec<Coloured> {
    let coloured = |(name, colour): (&str, [u8; 3])| Coloured {
        name: name.to_owned(),
        colour,
    };
    NAMES.map(coloured).to_vec()
}

fn named(name: &str) -> Result<usize, String> {
    let wanted = name.trim().to_lowercase();
    if let Some(found) = NAMES.iter().position(|(known, _)| *known == wanted) {
        return Ok(found);
    }
    let nearest = nearest(&wanted, NAMES.iter().map(|(known, _)| *known));
    let name: String = name.chars().take(40).collect();
    Err(match nearest {
        Some(near) => format!("no block is called {name:?}; did you mean {near}?"),
        None => format!(
            "no block is called {name:?}; blocks are called {}",
            NAMES.map(|(name, _)| name).join(", ")
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_task_is_told() {
        for (first, second, gap, words) in [
            (
                "rde",
                "green",
                20.0,
                "no block is called \"rde\"; did you mean red?",
            ),
            (
                "red",
                "pyramid",
                20.0,
                "no block is called \"pyramid\"; blocks are called red, green, blue",
            ),
            ("red", "red", 20.0, "red cannot stand beside itself"),
            ("red", "green", 3.0, "the gap is 3 mm; it must be 5 to 200 mm"),
            ("red", "green", f64::NAN, "the gap is NaN mm"),
        ] {
            let error = Task::new(first, second, Side::Right, gap).unwrap_err();
            assert!(error.starts_with(words), "{error}");
        }
    }

    #[test]
    fn a_task_goes_out_and_in_again() {
        let task = Task::new("Red", "blue", Side::Front, 12.5).unwrap();
        assert_eq!(Task::read(&task.to_map().into()), Ok(task));
        let short = Map::new().with("first", "red").with("second", "green");
        let task = Task::read(&short.into()).unwrap();
        assert_eq!((task.side, task.gap), (Side::Right, 20.0));
        for (key, value, words) in [
            ("side", "above", "\"above\" is not a side"),
            ("gap", "wide", "gap is not a number of mm"),
            ("first", "", "no block is called"),
        ] {
            let map = Map::new()
                .with("first", "red")
                .with("second", "green")
                .with(key, value);
            assert!(Task::read(&map.into()).unwrap_err().starts_with(words));
        }
        assert!(
            Task::read(&Value::default())
                .unwrap_err()
                .starts_with("first is missing")
        );
    }
}
