//! Models of robots (S4 to S6), and what is made of them.
