//! A person with a program: grabs, drives, gives, stops and lets go, as chance has it, and has the program's patience.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use mom_client::{Channel, Client, ClientError, DeviceAnswer, Event, Events, Token, TokenGuard, Value};
use tokio::time::{sleep, timeout};

use crate::log::{Fact, Log};

/// What no answer takes, whatever happens: a request's time-out, and the way to a hub that comes back.
const PATIENCE: Duration = Duration::from_secs(60);

/// The numbers of commands, which are never used twice.
pub type Numbers = Arc<AtomicU64>;

/// Who drives.
pub struct Operator {
    /// Its name.
    pub name: String,
    /// How it is connected.
    pub client: Client,
    /// Where it writes.
    pub log: Log,
    /// Its luck.
    pub random: fastrand::Rng,
    /// The numbers of commands.
    pub numbers: Numbers,
    /// How many devices there are.
    pub devices: usize,
    /// Whether the faults are over, and everything has to come about.
    pub is_healed: Arc<AtomicBool>,
}

/// A device as its operator has it.
struct Reached {
    device: usize,
    channel: Channel,
    token: Token,
    events: Events,
}

/// The channel of a device.
#[must_use]
pub fn channel_of(device: usize) -> String {
    format!("/d{device}/robot")
}

/// The token of a device.
#[must_use]
pub fn token_of(device: usize) -> String {
    format!("/d{device}/token")
}

impl Operator {
    /// Works for as long as its program runs; once the faults are over, drives each device once.
    pub async fn work(mut self) {
        loop {
            let device = self.random.usize(..self.devices);
            let errand = self.random.u32(..100);
            // What fails is told by an error; what does not come to an end is a fault.
            let done = timeout(10 * PATIENCE, self.errand(device, errand)).await;
            if done.is_err() {
                let text = format!(
                    "{} has waited for {} s for errand {errand} at device {device}",
                    self.name, 600
                );
                self.log.note(Fact::Broken(text));
            }
            if self.is_healed.load(Ordering::Relaxed) {
                return self.finish().await;
            }
            sleep(Duration::from_millis(self.random.u64(50..1500))).await; // tidy: its time is virtual, and it has a person's pace
        }
    }

    async fn errand(&mut self, device: usize, errand: u32) -> Result<(), ClientError> {
        match errand {
            0..55 => self.drive(device).await,
            55..65 => self.stop(device).await,
            65..95 => self.unstop(device).await,
            _ => self.client.info(&channel_of(device)).await.map(drop),
        }
    }

    async fn reach(&self, device: usize) -> Result<Reached, ClientError> {
        let channel = self.client.channel(&channel_of(device)).await?;
        let events = channel.events();
        Ok(Reached {
            device,
            channel,
            token: self.client.token(&token_of(device)).await?,
            events,
        })
    }

    /// Has the token for some commands, and gives it back, or forgets it.
    async fn drive(&mut self, device: usize) -> Result<(), ClientError> {
        let mut reached = self.reach(device).await?;
        let wait = Duration::from_millis(self.random.u64(..8000));
        let guard = reached.token.grab().wait(wait).await?;
        self.note_granted(&reached, &guard);
        for _ in 0..self.random.u32(..6) {
            if guard.is_lost() {
                break;
            }
            self.send(&mut reached, &guard).await?;
            sleep(Duration::from_millis(self.random.u64(..1200))).await; // tidy: as above
        }
        let fence = guard.fence();
        let released = match self.random.u32(..10) {
            0 => {
                drop(guard);
                Ok(())
            }
            _ => guard.release().await,
        };
        self.log.note(Fact::Lost {
            by: self.name.clone(),
            device,
            fence,
        });
        released
    }

    fn note_granted(&self, reached: &Reached, guard: &TokenGuard) {
        self.log.note(Fact::Granted {
            by: self.name.clone(),
            device: reached.device,
            fence: guard.fence(),
        });
    }

    /// One command; gives its number.
    async fn send(&mut self, reached: &mut Reached, guard: &TokenGuard) -> Result<u64, ClientError> {
        let command = self.numbers.fetch_add(1, Ordering::Relaxed);
        let x = self.random.i32(-900..900);
        self.log.note(Fact::Sent {
            by: self.name.clone(),
            device: reached.device,
            command,
            fence: guard.fence(),
        });
        let message = reached.channel.message("command").fence(guard.fence());
        let message = message.content(Value::from(format!("go {x} {command}")));
        if self.random.bool() {
            let receipt = message.send_acknowledged().await?;
            if receipt.dropped.is_empty() {
                self.log.note(Fact::Taken { command });
            }
        } else {
            message.send().await?;
        }
        Ok(command)
    }

    async fn stop(&mut self, device: usize) -> Result<(), ClientError> {
        self.log.note(Fact::StopAsked {
            by: self.name.clone(),
            device,
        });
        let within = Duration::from_millis(self.random.u64(..3000));
        let report = self
            .client
            .stop(&channel_of(device))
            .within(within)
            .send()
            .await?;
        for channel in &report.channels {
            let obeyed = |(_, answer): &(String, DeviceAnswer)| matches!(answer, DeviceAnswer::Obeys(_));
            if !channel.devices.is_empty() && channel.devices.iter().all(obeyed) {
                self.log.note(Fact::StopObeyed {
                    by: self.name.clone(),
                    device,
                    number: channel.number,
                });
            }
        }
        Ok(())
    }

    async fn unstop(&mut self, device: usize) -> Result<(), ClientError> {
        let path = channel_of(device);
        let state = self.client.stops(&path).await?;
        if !state.stopped {
            return Ok(());
        }
        let number = state.number;
        self.log.note(Fact::UnstopAsked {
            by: self.name.clone(),
            device,
            number,
        });
        let path = mom_client::Path::parse(&path)?;
        self.client
            .unstop(path.as_str(), [(&path, number)])
            .send()
            .await
            .map(drop)
    }

    /// Drives each device once: nothing hinders it any more but who has the token, and a stop.
    async fn finish(&mut self) {
        for device in 0..self.devices {
            let served = timeout(5 * PATIENCE, async {
                loop {
                    match self.drive_to_end(device).await {
                        Ok(()) => return,
                        Err(_) => sleep(Duration::from_millis(self.random.u64(200..900))).await, // tidy: as above
                    }
                }
            });
            if served.await.is_err() {
                let text = format!(
                    "{} could not drive device {device} within 300 s of a world without faults",
                    self.name
                );
                self.log.note(Fact::Broken(text));
                continue;
            }
            self.log.note(Fact::Served {
                by: self.name.clone(),
                device,
            });
        }
    }

    async fn drive_to_end(&mut self, device: usize) -> Result<(), ClientError> {
        let mut reached = self.reach(device).await?;
        let guard = reached.token.grab().wait(PATIENCE).await?;
        self.note_granted(&reached, &guard);
        self.unstop(device).await?;
        let command = self.send(&mut reached, &guard).await?;
        let ended = timeout(Duration::from_secs(20), async {
            while let Some(event) = reached.events.next().await {
                if let Event::Message(parcel) = event
                    && parcel.name() == "status"
                    && is_end(&parcel.value(), &self.client.name())
                {
                    return parcel.value().get("state").and_then(Value::as_str) == Some("finished");
                }
            }
            false
        });
        let finished = ended.await;
        let fence = guard.fence();
        guard.release().await?;
        self.log.note(Fact::Lost {
            by: self.name.clone(),
            device,
            fence,
        });
        match finished {
            Ok(true) => Ok(()),
            Ok(false) => Err(ClientError::Connection(format!("{command} has failed"))),
            Err(_) => Err(ClientError::Connection(format!("nothing was said of {command}"))),
        }
    }
}

/// Whether a command of this peer has ended by this.
fn is_end(status: &Value, peer: &str) -> bool {
    let word = |key: &str| status.get(key).and_then(Value::as_str);
    word("peer") == Some(peer) && matches!(word("state"), Some("finished" | "error"))
}
