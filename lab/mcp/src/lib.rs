//! Tools for language models over the Model Context Protocol: an ordinary peer of the hub, which drives only under a
//! person's grant. All of it is [`program`].

mod answer;
mod assistant;
mod device;
mod drive;
mod id_of;
pub mod program;
mod progress;
mod script;
mod server;
mod sight;
mod stdio;
mod tools;
