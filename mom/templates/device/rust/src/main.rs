//! A robot on two wheels: what it can do, how it stands still, where it is. The kit does the rest.

mod driver;

use std::time::Duration;

use driver::Motors;
use mom_client::{Card, CardArg, CardVerb, Client, Map};
use mom_device::{Call, Device, DeviceError, ErrorName, obey};

struct Robot(Motors);

impl Device for Robot {
    const NAME: &str = "newbot";
    const DOES: &str = "A robot on two wheels";
    const STOPS_WITHIN: Duration = Duration::from_millis(500);

    fn verbs() -> Vec<CardVerb> {
        let number = |name, unit, most: f64| CardArg::number(name, unit).within(-most..=most);
        vec![
            CardVerb::motion("drive", "Drives straight on")
                .relative()
                .args([number("way", "mm", 2000.0)]),
            CardVerb::motion("turn", "Turns on the spot")
                .relative()
                .args([number("angle", "degrees", 360.0)]),
            CardVerb::motion("jog", "Drives on for 300 ms")
                .velocity()
                .args([number("speed", "mm/s", 300.0), number("rate", "degrees/s", 90.0)]),
        ]
    }

    fn describe(card: Card) -> Card {
        card.measures("x", "mm", "")
            .measures("y", "mm", "")
            .measures("heading", "degrees", "")
            .measures("battery", "%", "")
    }

    fn begin(&mut self, call: &Call) -> Result<(), DeviceError> {
        match call.name() {
            "drive" => self.0.drive(call.number("way")?),
            "turn" => self.0.turn(call.number("angle")?),
            _ => self.0.set_speed(call.number("speed")?, call.number("rate")?),
        }
        Ok(())
    }

    fn is_done(&mut self) -> Result<bool, DeviceError> {
        Ok(self.0.is_there())
    }

    fn halt(&mut self) {
        self.0.brake();
    }

    fn keep_alive(&mut self) {
        self.0.keep_alive();
    }

    fn position(&self) -> Map {
        let (x, y, heading) = self.0.pose();
        Map::new().with("x", x).with("y", y).with("heading", heading)
    }

    fn report(&self) -> Map {
        Map::new().with("battery", self.0.battery())
    }

    fn estop(&self) -> Option<bool> {
        Some(self.0.estop())
    }

    fn plan(&mut self, _calls: &[(&Call, u32)]) -> Result<(), DeviceError> {
        match self.0.battery() {
            ..5 => Err(DeviceError::new(
                ErrorName::Battery,
                "the battery is empty: charge it",
            )),
            _ => Ok(()),
        }
    }
}

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let hub = std::env::var("MOM_HUB").unwrap_or_else(|_| "bin://127.0.0.1:7666".to_owned());
    let client = Client::builder(&hub)
        .user("newbot")
        .key_file("newbot.key")
        .heartbeat(Duration::from_millis(500))
        // Started again, it takes the place of its earlier start: nothing else may be called so.
        .installation("newbot")
        .connect()
        .await?;
    let robot = Robot(Motors::find()?);
    obey(&client, "/newbot/robot", robot, mom_program::shutdown()?).await?;
    client.close().await;
    Ok(())
}
