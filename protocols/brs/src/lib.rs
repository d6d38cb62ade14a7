//! The wire between a base station and its mobile robots (W1 to W8, W17): ASCII of fixed length over a stream of bytes.
//!
//! A frame is a code of two digits, then for each parameter one space and five characters, the sign among them: what
//! `printf("%02d %05d %05d", 6, 50, -50)` writes in C, and `"%02d %05d %05d" % (6, 50, -50)` in Python, the paper's own form.
//! There is no terminator, no length and no checksum; the code implies how many parameters follow (W3).
//!
//! | command | code | parameters | bytes | reply |
//! |---|---|---|---|---|
//! | NULL | `00` | none | 2 | `00` |
//! | STATUS | `04` | none | 2 | `04 ddddd`, a bit mask |
//! | MOTOR | `06` | left, right: −1000 to 1000 | 14 | none |
//! | LEDS | `07` | data: 0 to 255, a bit mask | 8 | none |
//!
//! `06 00100 00100` is forward, `06 00050 -0050` turns on the spot, `06 00000 00000` stops (W5). These four are [`PAPER`];
//! other commands come from a table of yours ([`Table::new`], checked when it is compiled) or from a file (`file`, with the
//! feature of that name), as those of our own robots do.
//!
//! # On a robot
//!
//! By default this is `no_std`, without alloc and without dependencies. A [`Parser`] takes the bytes as they come, one by one or
//! in pieces, and gives a [`Frame`] at the last byte of each. It needs about 100 bytes of memory, and whatever comes it
//! cannot panic, grow or hang.
//!
//! ```
//! use mom_brs::{Code, Command, Direction, Frame, PAPER, Parser};
//!
//! # fn drive(left: i32, right: i32) { assert_eq!((left, right), (50, -50)); }
//! # let mut replies: Vec<u8> = Vec::new();
//! let mut parser = Parser::new(&PAPER, Direction::Command);
//! for byte in *b"0006 00050 -005004" {
//!     let Some(frame) = parser.push(byte) else { continue };
//!     match (frame.code(), frame.values()) {
//!         (Code::MOTOR, &[left, right]) => drive(left, right),
//!         (Code::NULL, _) => replies.extend(Frame::reply(&Command::NULL, &[])?.encode().iter()),
//!         (Code::STATUS, _) => replies.extend(Frame::reply(&Command::STATUS, &[0b101])?.encode().iter()),
//!         _ => {}
//!     }
//! }
//! assert_eq!(replies, b"0004 00005");
//! # Ok::<(), mom_brs::FrameFault>(())
//! ```
//!
//! # At the base station
//!
//! ```
//! use mom_brs::{Command, Direction, Frame, PAPER, Parser};
//!
//! let frame = Frame::new(&Command::MOTOR, &[100, 2000])?;
//! assert_eq!(frame.encode().as_bytes(), b"06 00100 01000");
//! assert!(frame.is_clamped(), "a motor takes no more than 1000");
//! assert_eq!(format!("{frame:#}"), "motor left=100 right=1000");
//!
//! let mut parser = Parser::new(&PAPER, Direction::Reply);
//! let replies: Vec<String> = parser.feed(b"0004 00005").map(|reply| format!("{reply:#}")).collect();
//! assert_eq!(replies, ["null", "status bits=5"]);
//! # Ok::<(), mom_brs::FrameFault>(())
//! ```
//!
//! # Fuzzing
//!
//! The test `properties` gives the parser random bytes and compares it with a second one, written differently. Its body is a
//! fuzz target too, in a workspace of its own (`protocols/brs/fuzz`):
//!
//! ```sh
//! cargo install cargo-fuzz
//! cd protocols/brs
//! cargo fuzz run any_bytes --sanitizer none -- -max_total_time=60   # a minute, with the stable compiler
//! cargo +nightly fuzz run any_bytes                                 # until it is interrupted, with the address sanitizer
//! ```

#![no_std]

#[cfg(any(test, feature = "file"))]
extern crate std;

#[cfg(feature = "file")]
pub mod file;
mod frame;
mod number;
mod parser;
mod table;

pub use frame::{Encoded, Frame, FrameFault};
pub use number::{HIGHEST, LOWEST};
pub use parser::{Faults, Feed, MOST_ASTRAY, Parser, SILENCE};
pub use table::{Code, Command, Direction, PAPER, Parameter, Table, TableFault};

/// The most parameters of a command or a reply.
pub const MOST: usize = 8;

/// The bytes of the longest frame: a code with [`MOST`] parameters.
pub const LONGEST: usize = number::CODE + MOST * number::GROUP;
