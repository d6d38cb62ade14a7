//! `mom jog`: the robot's hand moves while a key is held, or for a time that is told.

mod hand;
mod view;
mod way;

use std::io::{self, IsTerminal as _};
use std::time::Duration;

use mom_arm::{ArmState, Status, Velocity};
use mom_client::{
    Client, ClientError, Code, Delivery, Event, Events, Family, LinkState, Parcel, Path, TokenGuard,
    from_value,
};
use mom_screen::{Screen, keys};
use tokio::time::{Instant, MissedTickBehavior, interval};

use self::hand::{Action, Hand};
use self::view::View;
use self::way::Way;
use super::drive;
use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::Output;
use mom_drive::{error_words, loss_words};
use mom_pages::Interrupt;

/// How often a velocity is said again.
const AGAIN: Duration = Duration::from_millis(80);

/// For how long each holds: what is late on the way is dropped, and the hand rests soon after the last.
const HOLDS: Duration = Duration::from_millis(250);

/// So long the hub may take to measure this program's clock, without which it passes on no command that expires.
const MEASURED: Duration = Duration::from_secs(3);

/// What `mom jog` drives.
struct Drive {
    client: Client,
    channel: Path,
    events: Events,
    guard: TokenGuard,
}

pub(crate) async fn run(args: &cli::JogArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let terminal = io::stdout().is_terminal() && io::stdin().is_terminal();
    if args.velocity.is_empty() && !terminal {
        return Err(Failure::usage(
            "there is no terminal to take keys from",
            "tell a velocity and a time instead: mom jog --for 500ms 50 0 0 0 0",
        ));
    }
    let client = connect(global, Stay::Driving).await?;
    let mut interrupt = Interrupt::install()?;
    let (channel, _, guard) = drive(&client, &args.channel, &args.token).await?;
    let mut drive = Drive {
        client: client.clone(),
        channel: channel.path().clone(),
        events: channel.events(),
        guard,
    };
    let result = match <[f64; 5]>::try_from(&args.velocity[..]) {
        Ok(velocity) => {
            drive
                .told(Velocity::of(velocity), args.time, &mut interrupt, output)
                .await
        }
        Err(_) => drive.by_keys(&args.channel, &mut interrupt).await,
    };
    let lost = drive.guard.is_lost();
    let released = match lost {
        true => Ok(()),
        false => drive
            .guard
            .release()
            .await
            .doing(format!("release {}", args.token)),
    };
    client.close().await;
    result?;
    released
}

impl Drive {
    /// Moves at a velocity for a time, and says where the hand is then.
    async fn told(
        &mut self,
        velocity: Velocity,
        time: Duration,
        interrupt: &mut Interrupt,
        output: Output,
    ) -> Result<(), Failure> {
        let begin = Instant::now();
        let mut end = begin + time;
        let mut again = interval(AGAIN);
        again.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let (mut state, mut way) = (None, Way::new(velocity, time));
        loop {
            tokio::select! {
                () = interrupt.wait() => return Err(Failure::plain("interrupted; the hand comes to rest")),
                lost = self.guard.lost() => return Err(Failure::plain(format!("the token is lost: {}", loss_words(&lost)))),
                event = self.events.next() => {
                    let event = event.ok_or_else(|| Failure::plain("the connection to the hub is closed"))?;
                    self.refusal(&event)?;
                    way.see(&event);
                    if is_unmeasured(&event) && begin.elapsed() < MEASURED {
                        // Nothing moves before that, so the time begins anew.
                        end = Instant::now() + time;
                        way.begin_anew();
                    }
                    state = state_in(&event).or(state);
                    // At rest, and no more is to come.
                    if let Some(state) = state.as_ref().filter(|state| Instant::now() >= end && !state.moving) {
                        let pose = state.pose;
                        output.tell(
                            || serde_json::json!({"x": pose.x, "y": pose.y, "z": pose.z, "spin": pose.spin, "tilt": pose.tilt}),
                            || format!("at rest at {:.1} {:.1} {:.1} {:.1} {:.1}", pose.x, pose.y, pose.z, pose.spin, pose.tilt),
                        )?;
                        return way.end(&pose, output);
                    }
                }
                _ = again.tick(), if Instant::now() < end => {
                    way.said += 1;
                    let left = end.saturating_duration_since(Instant::now());
                    self.say(&jog(velocity, HOLDS.min(left))).await?;
                }
            }
        }
    }

    /// Moves while keys are held.
    async fn by_keys(&mut self, channel: &str, interrupt: &mut Interrupt) -> Result<(), Failure> {
        let mut screen = Screen::take()?;
        let (mut hand, mut view) = (Hand::default(), View::new(channel, self.guard.fence()));
        let (mut keys, mut link) = (keys(), self.client.state());
        let mut again = interval(AGAIN);
        again.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            view.speed = hand.speed();
            screen.terminal.draw(|frame| view.draw(frame))?;
            let action = tokio::select! {
                () = interrupt.wait() => Action::End,
                lost = self.guard.lost() => return Err(Failure::plain(format!("the token is lost: {}", loss_words(&lost)))),
                Some(event) = keys.recv() => hand.on_event(&event?, Instant::now()),
                event = self.events.next() => {
                    let event = event.ok_or_else(|| Failure::plain("the connection to the hub is closed"))?;
                    if let Some(state) = state_in(&event) {
                        view.state = Some(state);
                    }
                    if let Some(text) = self.refused(&event) {
                        view.refusal = Some(text);
                    }
                    Action::Nothing
                }
                Ok(()) = link.changed() => {
                    view.link = link.borrow_and_update().clone();
                    match &view.link {
                        LinkState::Closed(error) => return Err(ClientError::Closed(error.clone())).doing("drive"),
                        _ => Action::Nothing,
                    }
                }
                _ = again.tick() => hand.again(Instant::now()),
            };
            match action {
                Action::Nothing => {}
                Action::End => return Ok(()),
                Action::Move(velocity) => {
                    view.refusal = None;
                    self.say(&jog(velocity, HOLDS)).await?;
                }
                Action::Rest => {
                    self.say(&jog(Velocity::default(), Duration::from_millis(1)))
                        .await?;
                }
                Action::Say(script) => {
                    view.refusal = None;
                    self.say(script).await?;
                }
            }
        }
    }

    /// Sends a command that is worthless a moment later.
    async fn say(&self, script: &str) -> Result<(), Failure> {
        let mut parcel = Parcel::new(Family::Message, "command")
            .context(self.channel.clone())
            .content(script);
        parcel.echo = Some(false);
        if script.starts_with("jog") {
            parcel.delivery = Some(Delivery::Latest);
            parcel.expires = u64::try_from(HOLDS.as_millis()).ok();
        }
        let sent = self.client.send(parcel).await;
        match sent {
            // The guard tells better why.
            Err(_) if self.guard.is_lost() => Ok(()),
            sent => sent.doing(format!("send to {}", self.channel)),
        }
    }

    /// What the robot refuses of ours.
    fn refused(&self, event: &Event) -> Option<String> {
        let Event::Message(parcel) = event else {
            return None;
        };
        let status = from_value::<Status>(parcel.value())
            .ok()
            .filter(|_| parcel.name() == "status")?;
        let error = status.error.filter(|_| status.peer == self.client.name())?;
        Some(error_words(&error))
    }

    fn refusal(&self, event: &Event) -> Result<(), Failure> {
        match self.refused(event) {
            Some(text) => Err(Failure::plain(text)),
            None => Ok(()),
        }
    }
}

fn jog(velocity: Velocity, time: Duration) -> String {
    let [x, y, z, spin, tilt] = velocity.numbers();
    format!("jog {x} {y} {z} {spin} {tilt} {}", time.as_millis().max(1))
}

/// Whether the hub refuses what expires, as it does not know yet how old it is.
fn is_unmeasured(event: &Event) -> bool {
    matches!(event, Event::Refused(error, _) if error.code == Code::TRY_LATER)
}

fn state_in(event: &Event) -> Option<ArmState> {
    match event {
        Event::Message(parcel) if parcel.name() == "state" => from_value(parcel.value()).ok(),
        _ => None,
    }
}
