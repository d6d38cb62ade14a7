//! The base station against robots that were written in another language, from the paper's words alone (`robot.py`), over
//! real sockets.

mod robot;
mod station;
