//! The parts of a wheeled robot (W20): two motors, eight LEDs, switches, a battery, and odometry where there is one.
//!
//! [`Driver`] is the seam between a robot's program and its hardware. [`Simulated`] is a driver of a robot that exists
//! only as numbers: a differential drive on a floor with walls, and its battery. [`Pilot`] drives any driver that knows
//! its pose along a list of points (W17), and [`Watchdog`] says when motors must stop because no command comes (W9). [`eye`] draws what
//! a simulated robot sees (W22).
//!
//! Nothing here does any IO, reads a clock or is random: time is a parameter, in µs since any beginning. A simulated
//! robot is computed on request, and `next_wake` says when something will change by itself, so
//! that an idle robot costs nothing.
//!
//! # Units and numbers
//!
//! mm, mm/s, seconds inside and µs outside, joules and watts; degrees counterclockwise from the x axis, within (−180, 180].
//! Motors are set in per mille of full speed, and the floor's corner is at x = 0, y = 0.
//!
//! | parameter | value | source |
//! |---|---|---|
//! | motors, [`MOTOR_LIMIT`] | −1000 to 1000 per mille, 0 0 stops | W5 |
//! | LEDs | 8, a bit each | W4; their number is assumed |
//! | switches, [`switch`] | front left, front right, rear left, rear right: bits 0 to 3 | W4, W20; their places are assumed |
//! | [`Chassis::full_speed`] | 1000 mm/s | the second paper, section 7: "easily capable of moving at 1 m/s" |
//! | [`Chassis::wheel_base`] | 150 mm | assumed, for a robot that carries cards of 90 mm × 95 mm (section 3) |
//! | [`Chassis::radius`] | 100 mm, a round body about the middle of the axle | assumed |
//! | [`Chassis::lag`] | 0.1 s, the time constant of each wheel | assumed |
//! | [`Power::capacity`] | 72 000 J (20 Wh) | assumed |
//! | [`Power::idle`] | 8 W | assumed, for processor, disk (0.375 W in section 3) and radio |
//! | [`Power::wheel`] | 4 W for each wheel at full speed, in proportion to its speed | assumed |
//! | [`Power::led`] | 0.1 W for each LED that is lit | assumed, 20 mA at 5 V |
//! | [`Power::charger`] | 40 W, so that an empty battery is full after 38 minutes at rest | assumed; W20 says only "battery monitor" |
//! | [`simulated::DOCKED`] | 100 mm: so near its charger a robot that stands is charged | assumed |
//! | [`simulated::STANDING`] | below 0.5 mm/s at both wheels a robot stands | assumed |
//! | [`simulated::PRESSED`] | 50 ms, the shortest time for which a switch is pressed | assumed |
//! | [`simulated::CELL`] | 1000 mm × 1000 mm of floor for each robot of a fleet | assumed |
//! | [`pilot::PERIOD`] | 50 ms between two settings of the motors | assumed |
//! | [`pilot::HOLD`] | 500 ms, [`Driver::hold`] of a pilot | assumed |
//! | [`pilot::TOLERANCE`] | 10 mm | assumed |
//! | [`pilot::AIMED`], [`pilot::ASTRAY`] | it goes when it looks within 1° of its point, and turns again from 20° on | assumed |
//! | [`pilot::SPEED`], [`pilot::TURN_SPEED`] | 0.6 and 0.25 of full speed while it goes and turns, at most | assumed |
//! | [`Watchdog::LIMIT`] | 500 ms; the paper has no watchdog | W9; the time is assumed |

mod driver;
pub mod eye;
mod parameters;
pub mod pilot;
pub mod simulated;
mod traced;
mod wall;
mod watchdog;

pub use driver::{Driver, DriverError, Fault, MOTOR_LIMIT, Motors, Parts, Pose, Sensors, switch};
pub use parameters::{Chassis, Floor, Power, SetupError};
pub use pilot::{GiveUp, Pilot, PilotEnd, Point};
pub use simulated::{Fittings, Simulated};
pub use traced::Traced;
pub use watchdog::Watchdog;

/// A time or a duration in int microseconds.
pub type WheelTime = i64;
