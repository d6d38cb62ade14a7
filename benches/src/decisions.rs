//! What the hub decides by itself: no socket, no codec, one thread.

use std::sync::Arc;

use mom_hub::{Admission, ContextSpec, Effect, Hub, Ingress, Input, PeerId, Route, Settings, User, admit};
use mom_managers::Registry;
use mom_proto::{Code, Content, Family, Map, Parcel, Path, Time, Value, WireError, from_value};

/// A hub with one session, one channel and one token that all may use, and peers that are members of them.
///
/// ```
/// let mut decisions = mom_benches::decisions::Decisions::new(3)?;
/// assert_eq!(decisions.send(), 1, "a decision");
/// # Ok::<(), mom_proto::WireError>(())
/// ```
pub struct Decisions {
    hub: Hub,
    now: u64,
    effects: Vec<Effect>,
    channel: Path,
    token: Path,
    message: Parcel,
}

const FIRST: PeerId = PeerId(1);

impl Decisions {
    /// So many peers, at least one, all members of the channel and the token.
    ///
    /// # Errors
    /// A hub that cannot be made so.
    pub fn new(members: u64) -> Result<Decisions, WireError> {
        let spec = |path: &str, kind: &str| {
            let map = Map::new().with("path", path).with("kind", kind);
            from_value::<ContextSpec>(map.with("presence", "none").into())
        };
        let contexts = [
            spec("/robot", "session")?,
            spec("/robot/arm", "channel")?,
            spec("/robot/token", "token")?,
        ];
        let hub = Hub::new(
            Settings::default(),
            Registry::builtin(),
            &Value::from("open"),
            &contexts,
        );
        let channel = Path::parse("/robot/arm")?;
        let message = Parcel::new(Family::Message, "state").context(channel.clone());
        let mut decisions = Decisions {
            hub: hub.map_err(|failed| failed.error)?,
            now: 0,
            effects: Vec::new(),
            channel,
            token: Path::parse("/robot/token")?,
            message: message.content(Content::Encoded(vec![0xc0].into())),
        };
        for peer in 1..=members.max(1) {
            decisions.add(PeerId(peer))?;
        }
        Ok(decisions)
    }

    fn add(&mut self, peer: PeerId) -> Result<(), WireError> {
        let user = User {
            name: format!("peer{}", peer.0),
            level: 1,
            groups: Vec::new(),
            details: Map::new(),
        };
        let login = Input::Login {
            peer,
            user,
            nickname: None,
            id: Some(0),
        };
        self.decide(login);
        for path in ["/robot", "/robot/arm", "/robot/token"] {
            let path = Path::parse(path)?;
            self.request(peer, Family::Context, "join", &path);
            let replied = self.effects.iter().any(
                |effect| matches!(effect, Effect::Reply { parcel, .. } if parcel.is(Family::Reply, "ok")),
            );
            if !replied {
                return Err(WireError::new(Code::DENIED, format!("{path} cannot be joined")));
            }
        }
        Ok(())
    }

    /// The first peer leaves the channel and joins it again; decisions made.
    pub fn leave_join(&mut self) -> u64 {
        let channel = self.channel.clone();
        self.request(FIRST, Family::Context, "leave", &channel);
        self.request(FIRST, Family::Context, "join", &channel);
        2
    }

    /// The first peer grabs the token and gives it back; decisions made.
    pub fn grab_release(&mut self) -> u64 {
        let token = self.token.clone();
        self.request(FIRST, Family::Token, "grab", &token);
        self.request(FIRST, Family::Token, "release", &token);
        2
    }

    /// A message by way of the hub, as where no verdict stands; decisions made.
    pub fn send(&mut self) -> u64 {
        self.decide(Input::Request {
            peer: FIRST,
            parcel: Box::new(self.message.clone()),
            clock: None,
        });
        1
    }

    /// What the last decision came to.
    pub fn effects(&self) -> &[Effect] {
        &self.effects
    }

    /// The route of the channel once a verdict stands for the first peer, for [`Admissions`].
    fn into_route(mut self) -> Option<Arc<Route>> {
        self.send();
        let channel = self.channel;
        self.hub.routes().into_iter().find(|route| route.path == channel)
    }

    fn request(&mut self, peer: PeerId, family: Family, name: &str, path: &Path) {
        let parcel = Parcel::new(family, name).context(path.clone()).id(1);
        self.decide(Input::Request {
            peer,
            parcel: Box::new(parcel),
            clock: None,
        });
    }

    fn decide(&mut self, input: Input) {
        self.now += 1;
        self.effects.clear();
        self.hub.handle(self.now, input, &mut self.effects);
    }
}

/// Messages that a route admits without the hub.
pub struct Admissions {
    route: Arc<Route>,
    message: Parcel,
}

impl Admissions {
    /// A channel with so many members, and a message to all of them, or to the last one by its name.
    ///
    /// # Errors
    /// A hub that cannot be made so, or a message that it does not admit.
    pub fn new(members: u64, addressed: bool) -> Result<Admissions, WireError> {
        let decisions = Decisions::new(members)?;
        let mut message = decisions.message.clone();
        if addressed {
            message.address = Some(vec![format!("peer{members}").into()]);
        }
        let route = decisions.into_route();
        let route = route.ok_or_else(|| WireError::new(Code::UNKNOWN_PATH, "the channel is gone"))?;
        let mut admissions = Admissions { route, message };
        match admissions.admit() {
            Ok(Admission::Pass(..)) => Ok(admissions),
            Ok(Admission::Consult) => Err(WireError::new(Code::DENIED, "no verdict stands")),
            Err(error) => Err(error),
        }
    }

    /// Admits and stamps the message once.
    ///
    /// # Errors
    /// Not after [`Admissions::new`] was content.
    pub fn admit(&mut self) -> Result<Admission, WireError> {
        admit(
            &self.route,
            FIRST,
            &mut self.message,
            &Ingress {
                now: 1,
                wall: Time::default(),
                clock: None,
                waited: 0,
            },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_hub::Receivers;

    fn check(decisions: &mut Decisions, turn: fn(&mut Decisions) -> u64, last: &str) {
        for _ in 0..3 {
            turn(decisions);
            let effects = format!("{:?}", decisions.effects());
            assert!(
                effects.contains(last) && !effects.contains("family: Error"),
                "{effects}"
            );
        }
    }

    #[test]
    fn every_turn_decides_what_it_says() {
        let mut decisions = Decisions::new(3).unwrap();
        check(&mut decisions, Decisions::leave_join, "\"ok\"");
        check(&mut decisions, Decisions::grab_release, "\"released\"");
        check(&mut decisions, Decisions::send, "Send {");
    }

    #[test]
    fn routes_admit() {
        for (members, addressed, receivers) in [
            (1, false, Receivers::All),
            (100, false, Receivers::All),
            (100, true, Receivers::These(vec![99])),
        ] {
            let admitted = Admissions::new(members, addressed).unwrap().admit();
            assert_eq!(admitted, Ok(Admission::Pass(receivers, None)));
        }
    }
}
