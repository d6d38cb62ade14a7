//! All tests of the whole system, in one binary.

mod access;
mod agents;
mod agents_end;
mod answers;
mod attacks;
mod browser;
mod calibrate;
mod cameras;
mod commands;
mod completion;
mod compression;
mod console;
mod contention;
mod control;
mod device_keys;
mod dialogues;
mod doctor;
mod driving;
#[cfg(target_os = "linux")]
mod endurance;
mod faults;
mod first_hour;
mod fleet;
mod fleet_file;
mod fleet_web;
mod gateways;
mod guards;
mod heartbeat;
mod hire;

mod lab_page;
mod late;
mod link;
mod listen;
mod login;
mod losses;
mod mcp;
mod mcp_card;
mod newcomer;
mod objects;
mod occupied;
#[cfg(target_os = "linux")]
mod oracle;
mod order;
mod own_contexts;
#[cfg(target_os = "linux")]
mod packages;
mod page;
mod pan_tilt;
mod programs;
mod protocol;
#[cfg(target_os = "linux")]
mod proxies;
mod python;
mod real_camera;
mod reports;
mod room;
mod rover;
mod runs;
mod servo;
mod simulacrum;
mod simulacrum_stops;
mod states;
mod stats;
mod status;
mod stops;
mod streams;
mod swarm;
#[cfg(target_os = "linux")]
mod terminals;
mod thinning;
mod threats;
mod time;
mod tls;
mod told;
mod top;
mod traces;
mod tunnel;
mod tunnel_login;
mod two_arms;
mod uplink;
mod web;
mod zones;
