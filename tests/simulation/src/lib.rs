//! The whole in simulation: the broker, links that fail, devices of the kit and operators, each on a runtime of its own, in virtual time,
//! by one seed.
//!
//! A [`World`](world::World) has hosts: the hub's machine and those of its peers. Each turn of 5 ms it lets each of them go on for 5 ms of
//! its own time, in an order of the seed's. A host may be killed, frozen and started again; the [`network`] between may delay, stall, cut
//! and half-open. What happens is written into a [`log`], and the [`oracle`] says afterwards which promise of docs/safety.md was broken.
//!
//! All of it is the real code, down to the bytes of the wire: what is simulated is time, the network and the machines.

pub mod chance;
pub mod device;
pub mod log;
pub mod network;
pub mod operator;
pub mod oracle;
pub mod run;
pub mod world;
