//! A cart on a rail, as the kit has it: what it begins goes into the log.

use std::time::Duration;

use mom_client::{Card, CardArg, CardVerb, Map, Value};
use mom_device::{Call, Device, DeviceError, DeviceTime};

use crate::log::{Fact, Log};

/// mm/s.
const SPEED: f64 = 200.0;
/// mm from the middle to an end.
const END: f64 = 1000.0;

/// A cart.
#[derive(Debug)]
pub struct Cart {
    number: usize,
    log: Log,
    now: DeviceTime,
    x: f64,
    to: Option<f64>,
}

impl Cart {
    /// The cart of this number.
    #[must_use]
    pub fn new(number: usize, log: &Log) -> Cart {
        log.note(Fact::Started { device: number });
        Cart {
            number,
            log: log.clone(),
            now: 0,
            x: 0.0,
            to: None,
        }
    }
}

impl Device for Cart {
    const NAME: &str = "the cart";
    const STOPS_WITHIN: Duration = Duration::from_millis(100);

    fn verbs() -> Vec<CardVerb> {
        let x = CardArg::number("x", "mm").within(-END..=END);
        let command = CardArg::number("command", "");
        vec![CardVerb::motion("go", "Drives to a place").args([x, command])]
    }

    fn describe(card: Card) -> Card {
        card.measures("x", "mm", "Where it is")
    }

    fn begin(&mut self, call: &Call) -> Result<(), DeviceError> {
        self.to = Some(call.number("x")?);
        let command = call.number("command")? as u64;
        self.log.note(Fact::Began {
            device: self.number,
            command,
        });
        Ok(())
    }

    fn is_done(&mut self) -> Result<bool, DeviceError> {
        Ok(self.to.is_none())
    }

    fn halt(&mut self) {
        if self.to.take().is_some() {
            self.log.note(Fact::Halted { device: self.number });
        }
    }

    fn position(&self) -> Map {
        Map::new().with("x", Value::Double(self.x))
    }

    fn advance(&mut self, now: DeviceTime) {
        let way = SPEED * (now - self.now) as f64 / 1e6;
        self.now = now;
        if let Some(to) = self.to {
            let left = to - self.x;
            if left.abs() <= way {
                (self.x, self.to) = (to, None);
            } else {
                self.x += way * left.signum();
            }
        }
    }
}
