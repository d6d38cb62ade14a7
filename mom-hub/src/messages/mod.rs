//! What is sent to channels.

pub(crate) mod admit;
pub(crate) mod age;
pub(crate) mod rate;
pub(crate) mod route;

#[cfg(test)]
mod tests;
