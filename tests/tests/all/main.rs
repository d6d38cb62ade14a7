//! All tests of the whole system, in one binary.

mod attacks;
mod commands;
mod control;
mod device_keys;
mod dialogues;
mod faults;
mod first_hour;
mod late;
mod login;
mod losses;
mod order;
mod page;
mod programs;
mod protocol;
mod python;
mod room;
mod runs;
mod states;
mod stats;
mod stops;
mod thinning;
mod threats;
mod time;
mod tls;
mod told;
mod uplink;
