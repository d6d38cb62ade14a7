//! The robot as judge: every member of a guarded channel obeys what reaches it, as a device would.
//!
//! Effects go the way that they go in a broker: into one outbox per peer, control before data; out of it into a
//! socket, past the channel's gate; out of that to the robot, which has a gate of its own. Without either of the
//! two gates the other has to do.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use mom_hub::{Effect, PeerId, Receivers, Route};
use mom_proto::{ContextNumber, Family, Parcel, Path, Value};

use crate::links::gate;
use crate::seen::Seen;

/// All robots, and the way to them.
#[derive(Debug, Default)]
pub(crate) struct Robots {
    /// Whether outboxes look at the gate of a channel.
    pub(crate) gated: bool,
    channels: BTreeMap<ContextNumber, Channel>,
    links: BTreeMap<PeerId, Link>,
    /// Who is lost: what is for it waits, commands aside.
    lost: BTreeSet<PeerId>,
    /// Who was obeyed under which fence of which token.
    obeyed: BTreeMap<(Path, u64), PeerId>,
}

#[derive(Debug)]
struct Channel {
    path: Path,
    token: Option<Path>,
    /// The fence that passes now, and how often its owner was lost; none = nobody owns the token.
    open: Option<(u64, u64)>,
}

#[derive(Debug, Default)]
struct Link {
    control: VecDeque<Item>,
    data: VecDeque<Item>,
    socket: VecDeque<Item>,
    robots: BTreeMap<ContextNumber, Robot>,
}

#[derive(Clone, Debug)]
enum Item {
    Joined {
        number: ContextNumber,
        token: Path,
        fence: u64,
        owned: bool,
    },
    Grabbed {
        token: Path,
        fence: u64,
        /// As of a loss, where the new owner is lost.
        safe: Option<Scope>,
    },
    /// The owner is lost.
    Lost {
        token: Path,
        safe: Option<Scope>,
    },
    Released {
        token: Path,
        fence: u64,
        /// The channels that had to hear the safe state first; none = no channel had to.
        safe: Option<Scope>,
    },
    Shared {
        token: Path,
        by: usize,
    },
    Safe {
        number: ContextNumber,
        /// What passes from then on.
        open: Option<(u64, u64)>,
    },
    /// The channel was deleted.
    Gone {
        number: ContextNumber,
    },
    Command {
        number: ContextNumber,
        fence: u64,
        /// How often its sender was lost under that fence before.
        halts: u64,
        from: PeerId,
    },
}

/// Where the safe state of a token is heard.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Scope {
    Everywhere,
    Only(Path),
}

/// A device in one channel.
#[derive(Debug)]
struct Robot {
    token: Path,
    /// The highest fence heard of, and whether its owner still is.
    fence: u64,
    owned: bool,
    /// Under which fence it moves, since the last safe state.
    moves: Option<u64>,
    /// What passed when the latest safe state was sent: nothing that was let in before it moves the device after it.
    open: (u64, u64),
    obeyed: u64,
    holders: usize,
}

impl Robots {
    /// Begins with the routes of a new hub.
    pub(crate) fn begin(&mut self, routes: impl Iterator<Item = impl AsRef<Route>>) {
        routes.for_each(|route| self.route(route.as_ref()));
    }

    /// Takes an effect in, in its order. `safe` = where the safe state had to be heard, for a loss.
    pub(crate) fn take(&mut self, effect: &Effect, joined: bool, safe: Option<Scope>, seen: &mut Seen) {
        match effect {
            Effect::Route(route) => self.route(route),
            Effect::RouteGone(number) => {
                self.channels.remove(number);
                let gone = Item::Gone { number: *number };
                self.links
                    .values_mut()
                    .for_each(|link| link.control.push_back(gone.clone()));
            }
            Effect::Deliver { to, parcel } => {
                if let Some(item) = self.control(parcel, safe) {
                    to.iter()
                        .for_each(|peer| self.link(*peer).control.push_back(item.clone()));
                }
            }
            Effect::Reply { to, parcel } if joined => {
                if let Some(item) = join(parcel) {
                    self.link(*to).control.push_back(item);
                }
            }
            Effect::Send {
                from,
                parcel,
                receivers,
                route,
                ..
            } => {
                let Some(fence) = parcel.fence else { return };
                seen.note("command sent");
                let number = route.number;
                let item = Item::Command {
                    number,
                    fence,
                    halts: gate(route).map_or(0, |(_, (_, halts))| halts),
                    from: *from,
                };
                for place in places(receivers, route.members.len()) {
                    let peer = route.members[place].peer;
                    if !self.lost.contains(&peer) {
                        self.link(peer).data.push_back(item.clone());
                    }
                }
            }
            _ => {}
        }
    }

    /// Writes all outboxes.
    pub(crate) fn write(&mut self, seen: &mut Seen) {
        for (_, link) in there(&mut self.links, &self.lost) {
            link.socket.append(&mut link.control);
            for item in link.data.drain(..) {
                let Item::Command {
                    number, fence, halts, ..
                } = &item
                else {
                    unreachable!("data are commands")
                };
                let open = self.channels.get(number).and_then(|channel| channel.open);
                // Robots know nothing of losses: here no other gate would do.
                if open.is_some_and(|(open, now)| open == *fence && now != *halts) {
                    seen.note("stopped after a loss");
                    continue;
                }
                if self.gated && open != Some((*fence, *halts)) {
                    seen.note("stopped by the broker's gate");
                    continue;
                }
                link.socket.push_back(item);
            }
        }
    }

    /// Lets all robots obey what has reached them.
    pub(crate) fn read(&mut self, seen: &mut Seen) {
        for (peer, link) in there(&mut self.links, &self.lost) {
            for item in link.socket.drain(..) {
                let Item::Command {
                    number,
                    fence,
                    halts,
                    from,
                } = item
                else {
                    hear(&mut link.robots, &self.channels, item, *peer);
                    continue;
                };
                let Some(robot) = link.robots.get_mut(&number) else {
                    continue;
                };
                if !robot.owned || robot.fence != fence {
                    assert!(
                        !self.gated,
                        "{peer:?} hears under {fence} what no gate should let out: {robot:?}"
                    );
                    seen.note("stopped by the robot's gate");
                    continue;
                }
                seen.note("command obeyed");
                robot.obey((fence, halts));
                let first = *self.obeyed.entry((robot.token.clone(), fence)).or_insert(from);
                assert_eq!(
                    first, from,
                    "two owners of {} under one fence {fence}",
                    robot.token
                );
            }
        }
    }

    /// Forgets all connections; what was obeyed stays.
    pub(crate) fn disconnect(&mut self) {
        self.links.clear();
        self.lost.clear();
        self.channels.clear();
    }

    /// A peer is lost: commands do not wait for it, and what it has not read of them is not said again.
    pub(crate) fn lose(&mut self, peer: PeerId) {
        self.lost.insert(peer);
        if let Some(link) = self.links.get_mut(&peer) {
            link.data.clear();
            link.socket.retain(|item| !matches!(item, Item::Command { .. }));
        }
    }

    /// It is back.
    pub(crate) fn resume(&mut self, peer: PeerId) {
        self.lost.remove(&peer);
    }

    fn link(&mut self, peer: PeerId) -> &mut Link {
        self.links.entry(peer).or_default()
    }

    fn control(&self, parcel: &Parcel, safe: Option<Scope>) -> Option<Item> {
        let content = parcel.value();
        let token = parcel.context.clone()?;
        let fence = || u64::try_from(content.get("fence").and_then(Value::as_int).unwrap()).unwrap();
        match (parcel.family, parcel.name()) {
            (Family::Message, _) => {
                let number = parcel.number.unwrap();
                let open = self.channels.get(&number).and_then(|channel| channel.open);
                Some(Item::Safe { number, open })
            }
            (Family::Event, "grabbed") => Some(Item::Grabbed {
                token,
                fence: fence(),
                safe,
            }),
            (Family::Event, "lost") => Some(Item::Lost { token, safe }),
            (Family::Event, "released") => Some(Item::Released {
                token,
                fence: fence(),
                safe,
            }),
            (Family::Event, "inhibited" | "uninhibited") => Some(Item::Shared {
                token,
                by: content.get("holders").and_then(Value::as_list).unwrap().len(),
            }),
            _ => None,
        }
    }

    fn route(&mut self, route: &Route) {
        let guard = route.guard.as_ref();
        let channel = Channel {
            path: route.path.clone(),
            token: guard.map(|guard| guard.token.clone()),
            open: gate(route).map(|(_, open)| open),
        };
        let known = self.channels.insert(route.number, channel);
        let same = known.is_some_and(|known| known.token == guard.map(|guard| guard.token.clone()));
        for (peer, link) in &mut self.links {
            if !same || route.member(*peer).is_none() {
                link.robots.remove(&route.number);
            }
        }
    }
}

impl Robot {
    fn obey(&mut self, (fence, halts): (u64, u64)) {
        assert!(
            self.obeyed <= fence,
            "fences that are obeyed do not fall: {self:?}"
        );
        assert!(
            self.open <= (fence, halts),
            "nothing of before moves it after its safe state: {fence}, {halts}, {self:?}"
        );
        assert_eq!(self.holders, 0, "nobody drives what several hold: {self:?}");
        self.obeyed = fence;
        self.moves = Some(fence);
    }

    /// Where the safe state had to be heard it was.
    fn check_safe(&self, channel: Option<&Channel>, safe: Option<&Scope>) {
        let path = channel.map(|channel| &channel.path);
        let here = match safe {
            None => false,
            Some(Scope::Everywhere) => true,
            Some(Scope::Only(channel)) => path == Some(channel),
        };
        assert!(
            !here || self.moves.is_none(),
            "{path:?} was safe before its token was lost: {self:?}"
        );
    }
}

fn join(reply: &Parcel) -> Option<Item> {
    let content = reply.value();
    let guard = content.get("guard")?;
    Some(Item::Joined {
        number: ContextNumber(u64::try_from(content.get("number")?.as_int()?).ok()?),
        token: Path::parse(guard.get("token")?.as_str()?).ok()?,
        // A guard whose token is not there yet has none.
        fence: guard
            .get("fence")
            .and_then(Value::as_int)
            .map_or(0, |fence| u64::try_from(fence).unwrap()),
        owned: guard.get("owner").is_some(),
    })
}

fn hear(
    robots: &mut BTreeMap<ContextNumber, Robot>,
    channels: &BTreeMap<ContextNumber, Channel>,
    item: Item,
    peer: PeerId,
) {
    let of = |token: &Path| {
        let token = token.clone();
        move |(_, robot): &(&ContextNumber, &mut Robot)| robot.token == token
    };
    match item {
        Item::Joined {
            number,
            token,
            fence,
            owned,
        } => {
            // Who joins again knows what it knew.
            let obeyed = robots.get(&number).map_or(0, |robot| robot.obeyed);
            let moves = robots.get(&number).and_then(|robot| robot.moves);
            let open = robots.get(&number).map_or((0, 0), |robot| robot.open);
            let robot = Robot {
                token,
                fence,
                owned,
                moves,
                open,
                obeyed,
                holders: 0,
            };
            robots.insert(number, robot);
        }
        Item::Grabbed { token, fence, safe } => {
            for (number, robot) in robots.iter_mut().filter(of(&token)) {
                assert!(fence > robot.fence, "{peer:?} hears of rising fences: {robot:?}");
                (robot.fence, robot.owned) = (fence, true);
                robot.check_safe(channels.get(number), safe.as_ref());
            }
        }
        Item::Lost { token, safe } => {
            for (number, robot) in robots.iter_mut().filter(of(&token)) {
                robot.check_safe(channels.get(number), safe.as_ref());
            }
        }
        Item::Released { token, fence, safe } => {
            for (number, robot) in robots.iter_mut().filter(of(&token)) {
                assert!(
                    fence >= robot.fence,
                    "{peer:?} hears of the present loss: {robot:?}"
                );
                (robot.fence, robot.owned) = (fence, false);
                robot.check_safe(channels.get(number), safe.as_ref());
            }
        }
        Item::Shared { token, by } => {
            for (_, robot) in robots.iter_mut().filter(of(&token)) {
                robot.holders = by;
            }
        }
        Item::Safe { number, open } => {
            if let Some(robot) = robots.get_mut(&number) {
                robot.moves = None;
                robot.open = open.unwrap_or(robot.open);
            }
        }
        Item::Gone { number } => drop(robots.remove(&number)),
        Item::Command { .. } => unreachable!("commands are obeyed"),
    }
}

/// The links that are not lost.
fn there<'a>(
    links: &'a mut BTreeMap<PeerId, Link>,
    lost: &BTreeSet<PeerId>,
) -> impl Iterator<Item = (&'a PeerId, &'a mut Link)> {
    links.iter_mut().filter(|(peer, _)| !lost.contains(*peer))
}

/// The places of the receivers among the members.
fn places(receivers: &Receivers, members: usize) -> Vec<usize> {
    match receivers {
        Receivers::All => (0..members).collect(),
        Receivers::AllBut(place) => (0..members).filter(|other| other != place).collect(),
        Receivers::These(places) => places.clone(),
    }
}
