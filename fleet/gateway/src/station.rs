//! The wires of a base station.

use std::collections::VecDeque;

use mom_base_station::circuit::{Note, Options, State, Taken};
use mom_base_station::log::Entry;
use mom_base_station::station::{Settings, Station};
use mom_brs::{Code, Frame};
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};

/// What is heard of a robot over its wire.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum News {
    /// It takes commands.
    Linked,
    /// It does not any more, for this reason.
    Lost(String),
    /// It never did since, for this reason, which is told once until it is another one.
    Unreached(String),
    /// It has said this.
    Reply(Frame),
}

/// The wire to one robot.
pub struct RobotWire {
    /// The robot's number.
    pub unit: u32,
    /// With whom it is driven together.
    pub group: Option<String>,
    /// What is heard of it, in order.
    pub(crate) heard: Heard,
    /// Sends it a frame; why it was not sent.
    pub send: Box<dyn Fn(Frame) -> Result<(), String> + Send + Sync>,
    /// Ends its connection, and drops what is under way on it.
    pub give_up: Box<dyn Fn() + Send + Sync>,
    /// Connects it (true), or leaves it to others: a robot has one base station at a time.
    pub connect: Box<dyn Fn(bool) + Send + Sync>,
}

/// How a gateway's base station behaves: it asks robots each second whether they are there, and gives one up that does not answer for
/// three, as people wait for it; the paper asks each 10 s (W8).
#[must_use]
pub fn settings() -> Settings {
    let second = 1_000_000;
    Settings {
        circuit: Options {
            null_period: second,
            ..Options::default()
        },
        ..Settings::default()
    }
}

/// The wires to all robots of a base station. A caller that does so before [`Station::connect_all`] misses nothing.
#[must_use]
pub fn lines(station: &Station) -> Vec<RobotWire> {
    let robots = station.snapshot();
    robots
        .iter()
        .filter_map(|known| line(station, &known.robot))
        .collect()
}

/// The wire to one robot; none if the base station does not have it.
pub(crate) fn line(station: &Station, robot: &mom_base_station::fleet::Robot) -> Option<RobotWire> {
    let unit = robot.unit;
    // Before its state is read, so that no change is missed.
    let (Ok(entries), Ok(now)) = (station.subscribe_to(unit), station.watch(unit)) else {
        return None;
    };
    let is_up = now.borrow().state == State::Writable;
    let (station, other, third) = (station.clone(), station.clone(), station.clone());
    Some(RobotWire {
        unit,
        group: robot.group.clone(),
        heard: Heard::new(entries, is_up),
        send: Box::new(move |frame| {
            let taken = station.send(unit, frame).map_err(|error| error.to_string())?;
            // A stop is there to override what waits, and is said again.
            if let (Taken::Replaced(dropped), false) = (taken, is_stop(&frame)) {
                tracing::warn!(unit, dropped, %frame, "commands that waited for the robot are not sent: this one overrides them");
            }
            Ok(())
        }),
        give_up: Box::new(move || {
            // It is one of them.
            let _ = other.give_up(unit);
        }),
        connect: Box::new(move |connects| {
            let _ = match connects {
                true => third.connect(unit),
                false => third.disconnect(unit),
            };
        }),
    })
}

/// Whether a frame has a robot stand.
pub(crate) fn is_stop(frame: &Frame) -> bool {
    frame.code() == Code::MOTOR && frame.values() == [0, 0]
}

/// What is heard of a robot.
#[derive(Debug)]
pub(crate) struct Heard {
    entries: Receiver<Entry>,
    linked: bool,
    /// Why it is not linked, as it was told, and who holds it, as it has said.
    why: String,
    holder: Option<String>,
    /// What is to be told before more is heard.
    next: VecDeque<News>,
}

impl Heard {
    fn new(entries: Receiver<Entry>, linked: bool) -> Self {
        let next = linked.then_some(News::Linked).into_iter().collect();
        Self {
            entries,
            linked,
            why: String::new(),
            holder: None,
            next,
        }
    }

    /// What is heard next; none once the base station is gone. Nothing is lost if it is not awaited to its end.
    pub(crate) async fn next(&mut self) -> Option<News> {
        loop {
            if let Some(news) = self.next.pop_front() {
                return Some(news);
            }
            let entry = self.entries.recv().await;
            if matches!(entry, Err(RecvError::Closed)) {
                return None;
            }
            self.take(entry.map_err(|error| match error {
                RecvError::Lagged(missed) => missed,
                RecvError::Closed => 0,
            }));
        }
    }

    /// What was heard already.
    pub(crate) fn ready(&mut self) -> Option<News> {
        loop {
            if let Some(news) = self.next.pop_front() {
                return Some(news);
            }
            match self.entries.try_recv() {
                Ok(entry) => self.take(Ok(entry)),
                Err(TryRecvError::Lagged(missed)) => self.take(Err(missed)),
                // Its end is for the next wait to see.
                Err(TryRecvError::Empty | TryRecvError::Closed) => return None,
            }
        }
    }

    /// Takes an entry, or how many were missed.
    fn take(&mut self, entry: Result<Entry, u64>) {
        match entry {
            Ok(entry) => {
                let news = self.of(entry.note);
                self.next.extend(news);
            }
            // Which replies are missing is not known, so the robot is met anew.
            Err(missed) if self.linked => {
                self.next
                    .push_back(News::Lost(format!("{missed} of its replies were missed")));
                self.next.push_back(News::Linked);
            }
            Err(_) => {}
        }
    }

    fn of(&mut self, note: Note) -> Option<News> {
        match note {
            Note::Received(frame, _) if frame.code() == Code::HOLDER => {
                let bytes: Vec<String> = frame.values().iter().map(ToString::to_string).collect();
                self.holder = Some(bytes.join("."));
                Some(News::Reply(frame))
            }
            Note::Received(frame, _) => Some(News::Reply(frame)),
            // One that takes no more bytes for a moment is not lost.
            Note::State(State::Writable) if !self.linked => {
                self.linked = true;
                (self.why, self.holder) = (String::new(), None);
                Some(News::Linked)
            }
            Note::State(State::Trying | State::Disconnected) if self.linked => {
                Some(self.lost("its connection has ended".to_owned()))
            }
            Note::Ended(end) if self.linked => Some(self.lost(end.to_string())),
            // That one is silent, floods or is not understood is known here alone: nothing else tells of it.
            Note::Ended(end) => {
                let why = match self.holder.take() {
                    Some(holder) => format!("it has another base station, {holder}"),
                    None => end.to_string(),
                };
                (why != self.why).then(|| {
                    self.why.clone_from(&why);
                    News::Unreached(why)
                })
            }
            _ => None,
        }
    }

    fn lost(&mut self, why: String) -> News {
        self.linked = false;
        self.why.clone_from(&why);
        News::Lost(why)
    }
}

#[cfg(test)]
mod tests {
    use mom_base_station::circuit::End;
    use mom_brs::file::EXTENDED;
    use tokio::sync::broadcast;

    use super::*;

    fn entry(note: Note) -> Entry {
        Entry {
            time: 0,
            unit: 1,
            note,
        }
    }

    #[tokio::test]
    async fn a_robot_of_which_replies_were_missed_is_met_anew() {
        let (say, entries) = broadcast::channel(2);
        let mut heard = Heard::new(entries, false);
        say.send(entry(Note::State(State::Writable)))
            .expect("it is heard");
        assert_eq!(heard.next().await, Some(News::Linked));
        let reply = Frame::reply(&mom_brs::Command::STATUS, &[5]).expect("a reply");
        for _ in 0..5 {
            say.send(entry(Note::Received(reply, None))).expect("it is heard");
        }
        let lost = News::Lost("3 of its replies were missed".to_owned());
        let reply = News::Reply(reply);
        for expected in [&lost, &News::Linked, &reply, &reply] {
            assert_eq!(heard.next().await.as_ref(), Some(expected));
        }
        // One that was never there is not lost.
        drop(say);
        assert_eq!(heard.next().await, None);
    }

    #[tokio::test]
    async fn why_a_robot_is_not_reached_is_told_once_for_each_reason() {
        let (say, entries) = broadcast::channel(64);
        let mut heard = Heard::new(entries, false);
        let holder = Frame::reply(EXTENDED.command("holder").expect("ours"), &[192, 168, 1, 20]);
        let notes = [
            Note::Ended(End::Silent),
            Note::Ended(End::Silent),
            Note::Ended(End::Flooding),
            Note::Received(holder.expect("a frame"), None),
            Note::Ended(End::Closed),
            Note::Ended(End::Flooding),
            Note::State(State::Writable),
            Note::Ended(End::Silent),
            Note::Ended(End::Silent),
        ];
        for note in notes {
            say.send(entry(note)).expect("it is heard");
        }
        let mut told = Vec::new();
        while let Some(news) = heard.ready() {
            told.push(match news {
                News::Unreached(why) => why,
                News::Lost(why) => format!("lost: {why}"),
                News::Linked => "linked".to_owned(),
                News::Reply(_) => continue,
            });
        }
        let floods = "the robot sent more than was requested";
        let expected = [
            "the robot is silent",
            floods,
            "it has another base station, 192.168.1.20",
            floods,
            "linked",
            "lost: the robot is silent",
        ];
        assert_eq!(told, expected);
    }
}
