//! The whole system from outside: dialogues, end to end, threats.

pub mod attacks;
pub mod audit;
pub mod canary;
pub mod dialogue;
pub mod lab;
pub mod load;
pub mod login;
pub mod programs;
pub mod raw;
pub mod service;
