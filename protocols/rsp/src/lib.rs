//! The robot simulacrum protocol (S3 to S24): a thin robot and the computer that thinks for it, the middle, exchange what differs, in
//! packets whose format follows from a model of the robot. `docs/rsp.md` describes the wire.
//!
//! By default there is the robot's end ([`robot`]), which is `no_std`, without alloc and without dependencies. The feature `middle` adds
//! the other end, which allocates; `cipher` adds keys to both. Neither does IO or has a clock: time is an argument, u64 µs of any monotonic
//! clock.
//!
//! # Both ends
//!
//! ```
//! # #[cfg(feature = "middle")] {
//! use mom_rsp::middle::{Middle, Notice};
//! use mom_rsp::robot::{self, Body, Robot};
//! use mom_rsp::{Element, Kind, Layout, Motion, Number, Payload};
//!
//! const MOTOR: Element<'_> = Element {
//!     name: "motor",
//!     kind: Kind::Effector,
//!     payload: Payload::Numbers(Number::I16, 1),
//!     motion: Motion::Absolute { interpolate: false, rate: None },
//!     safe: &[0, 0],
//!     period: 0,
//!     module: None,
//!     of: None,
//!     digest: 1,
//! };
//! static LAYOUT: Layout<'static> =
//!     Layout::new(1, [0; 32], &[MOTOR, Element { name: "bumper", kind: Kind::Sensor, safe: &[], ..MOTOR }]);
//!
//! struct Motors(i16);
//!
//! impl Body for Motors {
//!     fn random(&mut self, bytes: &mut [u8]) {
//!         bytes.fill(4);
//!     }
//!
//!     fn effector(&mut self, _: u8, value: &[u8]) {
//!         self.0 = i16::from_be_bytes([value[0], value[1]]);
//!     }
//!
//!     fn command(&mut self, _: u8, _: &[u8]) {}
//! }
//!
//! let mut motors = Motors(0);
//! let mut robot: Robot<'_, 2, { robot::values(&LAYOUT) }, 0, { robot::slot(&LAYOUT) }> =
//!     Robot::new(&LAYOUT, robot::Settings::default())?;
//! let mut middle = Middle::new(&LAYOUT, Default::default(), |bytes: &mut [u8]| bytes.fill(4))?;
//! robot.set(1, &[0, 9])?;
//! middle.start(0);
//! let mut out = [0; LAYOUT.largest()];
//! for ms in 0..100 {
//!     let now = ms * 1000;
//!     while let Some(datagram) = middle.poll(now).map(<[u8]>::to_vec) {
//!         let _ = robot.receive(now, &mut datagram.clone(), &mut motors);
//!     }
//!     while let Some(len) = robot.poll(now, &mut out, &mut motors) {
//!         let _ = middle.receive(now, &mut out[..len]);
//!     }
//!     while let Some(notice) = middle.next_notice() {
//!         if notice == Notice::Up {
//!             middle.write(0, &300_i16.to_be_bytes())?;
//!         }
//!     }
//! }
//! assert_eq!(motors.0, 300);
//! assert_eq!(middle.confirmed(0).map(|confirmed| confirmed.value), Some(&[1, 44][..]));
//! assert_eq!(middle.read(1).map(|bumper| bumper.value), Some(&[0, 9][..]));
//! # }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Fuzzing
//!
//! The test `properties` gives any bytes to the codec and to both ends. Its bodies are fuzz targets too, in a workspace of its own
//! (`protocols/rsp/fuzz`):
//!
//! ```sh
//! cargo install cargo-fuzz
//! cd protocols/rsp
//! cargo fuzz run any_packet --sanitizer none -- -max_total_time=60     # header, map and payload; with the stable compiler
//! cargo fuzz run any_datagram --sanitizer none -- -max_total_time=60   # the robot's end
//! cargo fuzz run any_uplink --sanitizer none -- -max_total_time=60     # the middle's end
//! ```

#![no_std]

#[cfg(feature = "middle")]
extern crate alloc;
#[cfg(test)]
extern crate std;

mod fragment;
mod handshake;
mod header;
mod layout;
#[cfg(feature = "middle")]
pub mod middle;
mod number;
mod packet;
mod refused;
pub mod robot;
mod seal;
mod sequence;
mod sound;
mod traffic;
pub mod typed;

pub use fragment::{FRAGMENT, Fragment};
pub use header::{Counters, Direction, Dropped, Header, Type, VERSION};
pub use layout::{Element, Kind, Layout, LayoutFault, Motion, Number, Payload};
pub use packet::{Item, Items, Writer};
pub use refused::Refused;
pub use sequence::is_newer;
pub use sound::{AudioCodec, Sound};

/// A key that both ends share.
pub type Key = [u8; 32];

/// The time between two data packets of an end, ms (S10).
pub const PERIODS: core::ops::RangeInclusive<u16> = 1..=200;

/// The key that 64 hexadecimal digits say; `None` if they are no such digits.
///
/// ```
/// assert_eq!(mom_rsp::key(&"0f".repeat(32)), Some([15; 32]));
/// assert_eq!(mom_rsp::key("0f"), None);
/// ```
#[must_use]
pub fn key(digits: &str) -> Option<Key> {
    let mut key = [0; 32];
    let mut pairs = digits.as_bytes().chunks_exact(2);
    if digits.len() != 2 * key.len() {
        return None;
    }
    for byte in &mut key {
        let [high, low] = pairs.next()? else { return None };
        let digit = |digit: u8| char::from(digit).to_digit(16);
        *byte = (digit(*high)? * 16 + digit(*low)?) as u8;
    }
    Some(key)
}
