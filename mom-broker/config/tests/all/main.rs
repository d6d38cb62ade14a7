//! Configuration files as people write them.

mod files;
mod review;
mod schema;
