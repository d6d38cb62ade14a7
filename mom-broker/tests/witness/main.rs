//! What a broker writes down: its audit log, and recordings that are decided again.

mod audit;
mod lab;
mod program;
mod secrets;
mod store;
mod what_if;
