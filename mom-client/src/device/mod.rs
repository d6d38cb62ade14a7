//! What a device obeys, without IO: stops, fences and states; and the prediction that compensates age.

pub(crate) mod gate;
pub(crate) mod installation;
pub(crate) mod latch;
pub(crate) mod predict;
pub(crate) mod state_gate;
