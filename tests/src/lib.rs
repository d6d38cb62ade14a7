//! The whole system from outside: dialogues, end to end, threats.

pub mod asking;
pub mod assistant;
pub mod attacks;
pub mod audit;
pub mod bridge;
pub mod canary;
pub mod datagrams;
pub mod dialogue;
pub mod faulty;
pub mod lab;
pub mod linked;
pub mod load;
pub mod login;
#[cfg(target_os = "linux")]
pub mod machine;
#[cfg(target_os = "linux")]
pub mod network;
pub mod process;
pub mod programs;
#[cfg(target_os = "linux")]
pub mod proxies;
pub mod raw;
pub mod service;
pub mod tls;
pub mod web;
