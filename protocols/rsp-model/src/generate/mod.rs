//! What is made of a model, as text: code for both ends, and the description of its packets (S4).

mod c;
mod c_robot;
mod code;
mod docs;
mod library;
mod names;
mod rust;
mod units;

pub use c::c;
pub use docs::markdown;
pub use library::library;
pub use rust::{Ends, rust, rust_for};

use mom_rsp::Kind;

use crate::model::{Direction, ModelElement};

/// What the payload of an element is in a packet of one direction (S5).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Content {
    /// Its bit is always 0.
    Never,
    /// Its bit says all.
    Bit,
    /// A value.
    Value,
    /// An id and data.
    Call,
    /// An id, the length of the data, and data.
    Held,
    /// The id that is acknowledged.
    Ack,
}

fn content(element: &ModelElement, direction: Direction) -> Content {
    match (element.kind, direction) {
        (Kind::Effector | Kind::Module, Direction::Up) => Content::Never,
        (Kind::Sensor | Kind::Monitor | Kind::Module, Direction::Down) => Content::Bit,
        (Kind::Effector, Direction::Down) | (Kind::Sensor | Kind::Monitor, Direction::Up) => Content::Value,
        (Kind::Command | Kind::MemoryCommand, Direction::Down) | (Kind::Event, Direction::Up) => {
            Content::Call
        }
        (Kind::MemoryEvent, Direction::Up) => Content::Held,
        (Kind::Command | Kind::MemoryCommand, Direction::Up)
        | (Kind::Event | Kind::MemoryEvent, Direction::Down) => Content::Ack,
    }
}
