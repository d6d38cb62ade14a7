//! What a broker keeps and goes by over time: the wall clock, the state directory, the files that it reads again.

mod epoch;
mod wall;
