//! The canary: an operator that stops, commands and renews fifty times a second, and the robot that hears it.

use std::cell::RefCell;
use std::time::{Duration, Instant};

use mom_net::{Reader, Writer};
use mom_proto::codec::Frame;
use mom_proto::{Family, Map, Parcel, Value, WireError};
use tokio::time::MissedTickBehavior;

use crate::control::{Peer, about, net};
use crate::{Delays, Error};

const ROBOT: &str = "/robot";
const TOKEN: &str = "/robot/token";
const ARM: &str = "/robot/arm";

/// From one stop, command and renewal to the next.
const BEAT: Duration = Duration::from_millis(20);

/// What has not come so long after the last was sent does not.
const LATE: Duration = Duration::from_secs(20);

/// An operator and a robot.
pub struct Canary {
    operator: Peer,
    robot: Peer,
}

/// What both felt for a while.
#[derive(Clone, Debug, Default)]
pub struct Song {
    /// From a stop to the robot; of those that a newer one replaced, until that came.
    pub stops: Delays,
    /// From a command to the robot.
    pub commands: Delays,
    /// From a renewal to its answer.
    pub renewals: Delays,
    /// Of all of these, those that never came.
    pub missing: usize,
}

/// What was sent of one kind, and what of it has come.
#[derive(Default)]
struct Trips {
    sent: RefCell<Vec<Instant>>,
    took: RefCell<Vec<Option<Duration>>>,
}

impl Trips {
    fn send(&self) -> i64 {
        self.sent.borrow_mut().push(Instant::now());
        let mut took = self.took.borrow_mut();
        took.push(None);
        i64::try_from(took.len() - 1).unwrap_or(i64::MAX)
    }

    /// This one has come, and with it those before it if a newer one stands for them.
    fn arrive(&self, number: Option<i64>, stands_for_older: bool) {
        let Some(last) = number.and_then(|number| usize::try_from(number).ok()) else {
            return;
        };
        let (sent, mut took) = (self.sent.borrow(), self.took.borrow_mut());
        let first = if stands_for_older { 0 } else { last };
        for at in (first..=last.min(took.len().saturating_sub(1))).rev() {
            if took[at].is_some() {
                break;
            }
            took[at] = Some(sent[at].elapsed());
        }
    }

    fn missing(&self) -> usize {
        self.took.borrow().iter().filter(|took| took.is_none()).count()
    }

    /// What never came took as long as it was waited for.
    fn delays(&self) -> Delays {
        let (sent, took) = (self.sent.borrow(), self.took.borrow());
        let all = sent.iter().zip(took.iter());
        Delays::of(
            all.map(|(sent, took)| took.unwrap_or_else(|| sent.elapsed()))
                .collect(),
        )
    }
}

#[derive(Default)]
struct Sheet {
    stops: Trips,
    commands: Trips,
    renewals: Trips,
}

impl Sheet {
    fn missing(&self) -> usize {
        self.stops.missing() + self.commands.missing() + self.renewals.missing()
    }
}

impl Canary {
    /// Connects both, and takes the token.
    ///
    /// # Errors
    /// A broker that refuses it.
    pub async fn start(address: &str) -> Result<Canary, Error> {
        let mut robot = Peer::enter(address, "arm", &[ROBOT]).await?;
        let device = Map::new().with("device", true);
        robot
            .ask(about(Family::Context, "join", ARM)?.content(device))
            .await?;
        let mut operator = Peer::enter(address, "alice", &[ROBOT, ARM]).await?;
        operator.ask(about(Family::Token, "grab", TOKEN)?).await?;
        Ok(Canary { operator, robot })
    }

    /// Stops, commands and renews for so long, and waits for what is still on its way.
    ///
    /// # Errors
    /// A refusal, or a connection that ends.
    pub async fn sing(&mut self, time: Duration) -> Result<Song, Error> {
        let sheet = Sheet::default();
        let (robot, operator) = (&mut self.robot.link, &mut self.operator.link);
        let all = async {
            send(&mut operator.writer, &sheet, time).await?;
            let late = Instant::now() + LATE;
            while sheet.missing() > 0 && Instant::now() < late {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
            Ok(())
        };
        tokio::select! {
            sent = all => sent?,
            heard = hear_as_robot(&mut robot.reader, &sheet) => heard?,
            heard = hear_as_operator(&mut operator.reader, &sheet) => heard?,
        }
        Ok(Song {
            stops: sheet.stops.delays(),
            commands: sheet.commands.delays(),
            renewals: sheet.renewals.delays(),
            missing: sheet.missing(),
        })
    }
}

async fn send(writer: &mut Writer, sheet: &Sheet, time: Duration) -> Result<(), Error> {
    let mut beat = tokio::time::interval(BEAT);
    beat.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let end = Instant::now() + time;
    while Instant::now() < end {
        beat.tick().await;
        for (name, trips) in [("stop", &sheet.stops), ("command", &sheet.commands)] {
            let mut parcel = about(Family::Message, name, ARM)?.content(Map::new());
            parcel.echo = Some(false);
            parcel = parcel.content(Value::Int(trips.send()));
            let sent = writer.send(parcel).await;
            sent.map_err(|error| net("saying", &error))?;
        }
        let id = u64::try_from(sheet.renewals.send()).unwrap_or_default();
        let sent = writer.send(about(Family::Token, "renew", TOKEN)?.id(id)).await;
        sent.map_err(|error| net("renewing", &error))?;
    }
    Ok(())
}

async fn next(reader: &mut Reader) -> Result<Parcel, Error> {
    let heard = reader.next().await;
    match heard.map_err(|error| net("hearing", &error))? {
        Some(Frame::Parcel(parcel)) if parcel.family == Family::Error => Err(Error::Hub {
            what: "what the canary does".to_owned(),
            error: WireError::from_parcel(&parcel),
        }),
        Some(Frame::Parcel(parcel)) => Ok(*parcel),
        other => Err(Error::Unexpected(format!("{other:?} in place of a parcel"))),
    }
}

async fn hear_as_robot(reader: &mut Reader, sheet: &Sheet) -> Result<(), Error> {
    loop {
        let parcel = next(reader).await?;
        let number = parcel.value().as_int();
        match (parcel.family, parcel.name()) {
            (Family::Message, "stop") => sheet.stops.arrive(number, true),
            (Family::Message, "command") => sheet.commands.arrive(number, false),
            _ => {}
        }
    }
}

async fn hear_as_operator(reader: &mut Reader, sheet: &Sheet) -> Result<(), Error> {
    loop {
        let parcel = next(reader).await?;
        let number = parcel.reference.and_then(|id| i64::try_from(id).ok());
        if parcel.family == Family::Reply {
            sheet.renewals.arrive(number, false);
        }
    }
}
