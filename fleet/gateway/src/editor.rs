//! The fleet's file in the hands of people at the hub (W12, W14): they see which robots there are, and add, change and remove some.
//!
//! Who may is the hub's to decide, by its rules for the channel `file` of the fleet's session, which its configuration has; a gateway makes
//! none. The gateway is that channel's device, so that only one program edits.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use mom_base_station::edit::{Change, ChangeError, Edit, EditError, change};
use mom_base_station::fleet::{Address, Fleet, FleetFault, Robot};
use mom_client::{Channel, Client, ClientError, Code, Event, Family, Map, Parcel, Value, from_value};
use mom_device::stay;
use serde::Deserialize;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::spawn_blocking;
use tokio::time::sleep;

use crate::site::{GatewayOptions, RobotSite};

/// Edits that may wait; one of them is a person's work of seconds.
const WAITING: usize = 32;

/// So often a spare looks whether it is to edit.
const LOOK_AGAIN: Duration = Duration::from_secs(2);

/// A fleet that is to be taken over.
#[derive(Debug)]
pub struct Taking {
    /// As the file says it.
    pub fleet: Fleet,
    /// Hears whether it was, or why not.
    pub told: Option<oneshot::Sender<Result<(), String>>>,
}

/// The file that people may edit.
#[derive(Debug)]
pub struct FleetFile {
    /// Where it is.
    pub path: PathBuf,
    /// Takes what it says after an edit.
    pub taken: mpsc::Sender<Taking>,
}

/// A robot, as messages name it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    unit: u32,
    address: String,
    name: Option<String>,
    group: Option<String>,
}

/// What a message `edit` asks for: `add`, or one of `change` and `remove` with the address that the robot `was` seen at.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Asked {
    add: Option<Entry>,
    change: Option<u32>,
    remove: Option<u32>,
    was: Option<String>,
    to: Option<Entry>,
}

/// Why an edit is refused.
#[derive(Debug)]
struct Refused {
    name: &'static str,
    text: String,
    /// What of the robot is at fault.
    field: Option<&'static str>,
}

impl Refused {
    fn new(name: &'static str, text: impl Into<String>) -> Refused {
        Refused {
            name,
            text: text.into(),
            field: None,
        }
    }
}

/// What the editor hears.
enum Heard {
    Edit(Box<Parcel>),
    /// The hub has begun anew: it knows nothing of what was told.
    Anew,
}

pub(crate) struct Editor {
    pub(crate) client: Client,
    pub(crate) options: Arc<GatewayOptions>,
    pub(crate) file: FleetFile,
    /// The fleet that is driven.
    pub(crate) present: watch::Receiver<Fleet>,
    /// The robots that the gateway's connections carry.
    pub(crate) most: usize,
}

impl Editor {
    /// Serves people for as long as the client lives; not at all where the hub has no channel for it.
    pub(crate) async fn serve(mut self) {
        let path = self.options.file();
        let Some(channel) = self.enter(&path).await else {
            return;
        };
        let (sender, mut heard) = mpsc::channel(WAITING);
        let (client, again) = (self.client.clone(), sender.clone());
        let enter = move || {
            let (client, path, again) = (client.clone(), path.clone(), again.clone());
            async move {
                let channel = client.channel_as_device(&path).await?;
                let _ = again.try_send(Heard::Anew);
                Ok(channel)
            }
        };
        let staying = stay(channel, enter, move |event| {
            let heard = match event {
                // What the channel has kept was done, or refused, before.
                Event::Message(parcel) if parcel.name() == "edit" && !parcel.is_history() => {
                    Heard::Edit(Box::new(parcel))
                }
                Event::Rejoined => Heard::Anew,
                _ => return,
            };
            // Whose edit finds no place says it again, as nothing has answered.
            let _ = sender.try_send(heard);
        });
        tokio::select! {
            () = staying => {}
            () = self.answer(&mut heard) => {}
        }
    }

    /// Becomes the channel's device, once no other gateway is; none where there is no channel for it, or two could edit at once.
    async fn enter(&self, path: &str) -> Option<Channel> {
        let mut is_told = false;
        loop {
            let entered = match self.client.info(path).await {
                Ok(info) if info.get("devices").and_then(Value::as_str) != Some("one") => {
                    tracing::error!(channel = %path, "the fleet's file is not edited from the hub: its channel has to say `devices = \"one\"`, or several gateways would edit");
                    return None;
                }
                Ok(_) => self.client.channel_as_device(path).await,
                Err(error) => Err(error),
            };
            match entered {
                Ok(channel) => return Some(channel),
                Err(error) if error.code() == Some(&Code::OCCUPIED) => {
                    if !std::mem::replace(&mut is_told, true) {
                        tracing::info!(channel = %path, "another gateway edits the fleet's file, and this one waits");
                    }
                    sleep(LOOK_AGAIN).await;
                }
                Err(error) if [Some(&Code::UNKNOWN_PATH), Some(&Code::DENIED)].contains(&error.code()) => {
                    tracing::info!(%error, channel = %path, "the fleet's file is not edited from the hub");
                    return None;
                }
                Err(error) => {
                    tracing::debug!(%error, channel = %path, "the channel of the fleet's file is tried again");
                    sleep(LOOK_AGAIN).await;
                }
            }
        }
    }

    async fn answer(&mut self, heard: &mut mpsc::Receiver<Heard>) {
        self.tell().await;
        loop {
            tokio::select! {
                changed = self.present.changed() => match changed {
                    Ok(()) => self.tell().await,
                    Err(_) => return,
                },
                next = heard.recv() => match next {
                    Some(Heard::Edit(parcel)) => self.take(&parcel).await,
                    Some(Heard::Anew) => self.tell().await,
                    None => return,
                },
            }
        }
    }

    /// Tells which robots there are.
    async fn tell(&mut self) {
        let robots: Vec<Value> = self
            .present
            .borrow_and_update()
            .robots()
            .iter()
            .map(|robot| to_map(robot).into())
            .collect();
        self.say(Parcel::new(Family::Message, "robots").content(Map::new().with("robots", robots)))
            .await;
    }

    async fn say(&self, parcel: Parcel) {
        let Ok(path) = mom_client::Path::parse(&self.options.file()) else {
            return;
        };
        if let Err(error) = self.client.send(parcel.context(path)).await {
            tracing::debug!(%error, "not told in the channel of the fleet's file");
        }
    }

    /// Does what was asked for, and tells everybody there what was done, or who has asked why not.
    async fn take(&self, parcel: &Parcel) {
        let by = parcel.sender.as_deref().unwrap_or_default().to_owned();
        let answer = |content: Map| {
            let mut answer = Parcel::new(Family::Message, "edited").content(content.with("by", by.as_str()));
            answer.reference = parcel.id;
            answer
        };
        match self.edit(parcel, &by).await {
            Ok(done) => {
                tracing::info!(by, done, "the fleet's file is changed");
                self.say(answer(Map::new().with("ok", true).with("text", done)))
                    .await;
            }
            Err(refused) => {
                tracing::info!(
                    by,
                    code = refused.name,
                    text = refused.text,
                    "an edit of the fleet's file is refused"
                );
                let mut content = Map::new()
                    .with("ok", false)
                    .with("name", refused.name)
                    .with("text", refused.text);
                if let Some(field) = refused.field {
                    content.set("field", field);
                }
                let mut answer = answer(content);
                answer.address = Some(vec![by.as_str().into()]);
                self.say(answer).await;
            }
        }
    }

    /// Gives what was done, in words.
    async fn edit(&self, parcel: &Parcel, by: &str) -> Result<String, Refused> {
        let asked: Asked = from_value(parcel.value()).map_err(|error| {
            let text = format!("an edit is {{add}}, {{change, was, to}} or {{remove, was}}: {error}");
            Refused::new("bad-content", text)
        })?;
        let (edit, done) = self.plan(asked, by).await?;
        let path = self.file.path.clone();
        let changed = spawn_blocking(move || change(Path::new(&path), &edit)).await;
        let fleet = match changed {
            Ok(Ok(fleet)) => fleet,
            Ok(Err(error)) => return Err(refusal(&error)),
            Err(error) => return Err(Refused::new("file", error.to_string())),
        };
        let (told, taken) = oneshot::channel();
        let taking = Taking {
            fleet,
            told: Some(told),
        };
        // Its taker is gone when the program ends.
        let _ = self.file.taken.send(taking).await;
        match taken.await {
            Ok(Ok(())) => Ok(done),
            Ok(Err(why)) => Err(Refused::new(
                "file",
                format!("the file is changed, but the gateway drives on as before: {why}"),
            )),
            Err(_) => Err(Refused::new("try-later", "the gateway ends")),
        }
    }

    /// What is to be done, and that in words.
    async fn plan(&self, asked: Asked, by: &str) -> Result<(Edit, String), Refused> {
        match asked {
            Asked {
                add: Some(add),
                change: None,
                remove: None,
                was: None,
                to: None,
            } => {
                if self.present.borrow().robots().len() >= self.most {
                    let text = format!(
                        "this gateway's connections carry {} robots, and all places are taken; add it by mom-base-station and start the gateway again",
                        self.most
                    );
                    return Err(Refused::new("full", text));
                }
                let robot = robot_of(add)?;
                let done = format!("unit {} at {} was added", robot.unit, robot.address);
                Ok((Edit::Add(robot), done))
            }
            Asked {
                change: Some(unit),
                was: Some(was),
                to: Some(to),
                add: None,
                remove: None,
            } => {
                let before = self.known(unit, &was)?;
                let to = robot_of(to)?;
                // Its name is nothing to the gateway.
                if (to.unit, &to.address, &to.group) != (before.unit, &before.address, &before.group) {
                    self.is_free(&before, by).await?;
                }
                if (to.unit, &to.address) != (before.unit, &before.address) {
                    self.may_move(&before).await?;
                }
                let name = to.name.as_deref().map(|name| format!(", {name}"));
                let done = format!(
                    "unit {unit} at {was} is unit {} at {} now{}",
                    to.unit,
                    to.address,
                    name.unwrap_or_default()
                );
                let change = change_of(&before, to);
                Ok((Edit::Change(unit, change), done))
            }
            Asked {
                remove: Some(unit),
                was: Some(was),
                add: None,
                change: None,
                to: None,
            } => {
                let before = self.known(unit, &was)?;
                self.is_free(&before, by).await?;
                self.may_move(&before).await?;
                let done = format!("unit {unit} at {was} was removed");
                Ok((Edit::Remove(vec![unit]), done))
            }
            _ => {
                let text = "an edit is {add}, {change, was, to} or {remove, was}, and one of them";
                Err(Refused::new("bad-content", text))
            }
        }
    }

    /// The robot that is meant, if it is still what was seen: numbers are given anew.
    fn known(&self, unit: u32, was: &str) -> Result<Robot, Refused> {
        let present = self.present.borrow();
        let robot = present.robots().iter().find(|robot| robot.unit == unit);
        let robot =
            robot.ok_or_else(|| Refused::new("stale", format!("there is no unit {unit} any more")))?;
        match robot.address.to_string() == was {
            true => Ok(robot.clone()),
            false => {
                let text = format!(
                    "unit {unit} is at {} now, and no more at {was}: look again",
                    robot.address
                );
                Err(Refused::new("stale", text))
            }
        }
    }

    /// A stopped robot keeps its number and address: the stop holds for its channel.
    async fn may_move(&self, robot: &Robot) -> Result<(), Refused> {
        let place = RobotSite {
            client: self.client.clone(),
            options: Arc::clone(&self.options),
            unit: robot.unit,
            group: robot.group.clone(),
        };
        match place.stopped().await {
            Ok(None) => Ok(()),
            Ok(Some(stopped)) => {
                let text = format!("{stopped}, and would be free as another unit; have it let go first");
                Err(Refused::new("stopped", text))
            }
            Err(error) => {
                let text = format!(
                    "the hub does not say whether unit {} is stopped: {error}",
                    robot.unit
                );
                Err(Refused::new("try-later", text))
            }
        }
    }

    /// A robot that another peer drives is left to it: it would halt.
    async fn is_free(&self, robot: &Robot, by: &str) -> Result<(), Refused> {
        let token = self.options.token(robot.unit, robot.group.as_deref());
        match self.client.info(&token).await {
            Ok(info) => match info.get("owner").and_then(Value::as_str) {
                Some(owner) if owner != by => {
                    let text = format!(
                        "{owner} holds {token}, and unit {} would halt; ask for the token, or take it, and try again",
                        robot.unit
                    );
                    Err(Refused::new("held", text))
                }
                _ => Ok(()),
            },
            Err(ClientError::Refused(error)) if error.code == Code::UNKNOWN_PATH => Ok(()),
            Err(error) => {
                let text = format!("nobody can say whether {token} is held: {error}");
                Err(Refused::new("try-later", text))
            }
        }
    }
}

fn robot_of(entry: Entry) -> Result<Robot, Refused> {
    let address = Address::parse(&entry.address).map_err(|text| Refused {
        name: "bad-content",
        text,
        field: Some("address"),
    })?;
    Ok(Robot {
        unit: entry.unit,
        address,
        name: entry.name.filter(|name| !name.is_empty()),
        group: entry.group.filter(|group| !group.is_empty()),
    })
}

/// What is other than before.
fn change_of(before: &Robot, to: Robot) -> Change {
    Change {
        unit: (to.unit != before.unit).then_some(to.unit),
        address: (to.address != before.address).then_some(to.address),
        name: (to.name != before.name).then_some(to.name),
        group: (to.group != before.group).then_some(to.group),
    }
}

fn to_map(robot: &Robot) -> Map {
    let mut map = Map::new()
        .with("unit", i64::from(robot.unit))
        .with("address", robot.address.to_string());
    for (key, word) in [("name", &robot.name), ("group", &robot.group)] {
        if let Some(word) = word {
            map.set(key, word.as_str());
        }
    }
    map
}

fn refusal(error: &ChangeError) -> Refused {
    let text = error.to_string();
    match error {
        ChangeError::Edit(EditError::After(after)) => Refused {
            name: "bad-content",
            text: after.words().to_owned(),
            field: match after.fault() {
                FleetFault::Unit | FleetFault::UnitTwice => Some("unit"),
                FleetFault::Address | FleetFault::AddressTwice => Some("address"),
                FleetFault::Name => Some("name"),
                FleetFault::Group => Some("group"),
                _ => None,
            },
        },
        ChangeError::Edit(EditError::NoUnit(_)) => Refused::new("stale", text),
        ChangeError::Edit(_) | ChangeError::File(..) => Refused::new("file", text),
    }
}
