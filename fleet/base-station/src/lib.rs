//! The base station of a fleet of mobile robots (W1, W10 to W17).
//!
//! Robots listen; the base station connects to each of them over TCP and speaks the protocol of [`mom_brs`]. It has a
//! state machine for each robot ([`circuit`], without IO and without a clock), a driver that runs those of a whole fleet
//! ([`station`]), the file that says which unit has which address ([`fleet`]), a log of both directions ([`log`]), and
//! scripts, as sequences belong to the base station ([`script`], [`play`]). The program `mom-base-station` is one user of
//! it.
//!
//! ```no_run
//! use mom_base_station::circuit::State;
//! use mom_base_station::fleet::Fleet;
//! use mom_base_station::station::{Settings, Station};
//! use mom_brs::{Command, Frame, file::EXTENDED};
//!
//! # async fn drive() -> Result<(), Box<dyn std::error::Error>> {
//! let fleet = Fleet::parse("[[robot]]\nunit = 1\naddress = \"127.0.0.1:4001\"\n")?;
//! let station = Station::new(&fleet, &EXTENDED, Settings::default());
//! let mut changes = station.subscribe();
//! station.connect_all();
//! station.watch(1)?.wait_for(|robot| robot.state == State::Writable).await?;
//! station.send(1, Frame::new(&Command::MOTOR, &[100, 100])?)?;
//! println!("{}", changes.recv().await?);
//! station.halt().await;
//! station.close().await;
//! # Ok(())
//! # }
//! ```
//!
//! # What a robot costs
//!
//! One task, which sleeps until bytes, a command or a time comes; nothing is polled. What waits for a robot, what is read of
//! it in a second and what is remembered of it is bounded, so that one robot harms no other.

pub mod circuit;
pub mod edit;
pub mod fleet;
pub mod log;
pub mod play;
pub mod program;
pub mod script;
pub mod station;

pub use mom_toml_faults::Spot;
