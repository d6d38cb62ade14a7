//! Ways to log in, through real sockets, the client crate and the programs.
