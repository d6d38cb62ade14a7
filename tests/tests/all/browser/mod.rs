//! Pages in headless Chromium: a peer through each door that a browser has, if its origin is on the hub's list.

mod client;
mod doors;
mod site;
