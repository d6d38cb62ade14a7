//! All tests of the whole system, in one binary.

mod attacks;
mod browser;
mod calibrate;
mod cameras;
mod commands;
mod compression;
mod control;
mod device_keys;
mod dialogues;
mod doctor;
mod driving;
mod faults;
mod first_hour;

mod lab_page;
mod late;
mod link;
mod listen;
mod login;
mod losses;
mod order;
#[cfg(target_os = "linux")]
mod packages;
mod page;
mod programs;
mod protocol;
#[cfg(target_os = "linux")]
mod proxies;
mod python;
mod real_camera;
mod reports;
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
mod top;
mod traces;
mod tunnel;
mod uplink;
mod web;
mod zones;
