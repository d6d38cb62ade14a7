//! Configuration files as people write them.

mod faults;
mod files;
mod review;
mod schema;
