//! What one permitted peer, or a stranger, must not make everybody pay for.
//!
//! Each attack runs beside the canary of `mom_tests`, which loses nothing and answers on; the attacker hears the code that
//! PROTOCOL.md names, and what the hub holds stays under its bound. Times are measured in the benches, not here.

mod devices;
mod doors;
mod load;
mod logs;
mod memory;
mod opened;
mod permitted;
mod resident;
mod state;
