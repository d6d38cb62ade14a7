//! `context explain`: what the hub would answer now, and in which line the rule stands.

use mom_config::{Asking, Config, Explanation, message_of};
use mom_hub::{About, Case, ContextOutline, Explain, Judgement, PeerId, User};
use mom_proto::{Code, ContextKind, Map, Time, Value, Verb, WireError};

use super::{Answering, MOST_BYTES, int, size};

/// Requests of one user that one reply tells of: a file may have rules for any number of messages.
const MOST: usize = 128;

/// After so many questions to the hub others have their turn.
const TURN: usize = 16;

/// Whom it is about.
struct Subject {
    peer: Option<PeerId>,
    name: Option<String>,
    user: User,
}

/// One user, and what the hub would answer to each request.
struct Judged {
    subject: Subject,
    answers: Vec<(Asking, Judgement)>,
}

impl Answering {
    pub(super) async fn explain(&self, to: PeerId, asked: Explain) -> Result<Map, WireError> {
        let place = self.board.ask_hub(|hub, _| hub.place(&asked.path));
        let (about, path, there) = (asked.about.clone(), asked.path.clone(), place.clone());
        let single = asked.verb.map(|verb| Asking {
            verb,
            context: asked.path.clone(),
            message: asked.message.clone(),
        });
        let plan = self.with_config(move |config| plan(config, about, single, &path, there.as_ref()));
        let (subjects, askings, more) = plan.await??;
        let mut all = Vec::new();
        for (peer, user) in subjects {
            if let Some(subject) = self.subject(peer, user) {
                let answers = self.judge(to, &subject, &askings, asked.kind).await;
                all.push(Judged { subject, answers });
            }
        }
        let anchor = self.board.clock.anchor();
        let one = asked.verb.is_some();
        self.with_config(move |config| {
            match (one, all.len()) {
                (true, 1) => all.pop().map(|judged| answer(config, judged, anchor)),
                _ => None,
            }
            .unwrap_or_else(|| table(config, all, place.as_ref(), more, anchor))
        })
        .await
    }

    fn subject(&self, peer: Option<PeerId>, user: Option<User>) -> Option<Subject> {
        let Some(peer) = peer else {
            return Some(Subject {
                peer: None,
                name: None,
                user: user?,
            });
        };
        self.board.ask_hub(|hub, _| {
            Some(Subject {
                peer: Some(peer),
                name: hub.peer_name(peer).map(|name| name.to_string()),
                user: hub.user_of(peer)?,
            })
        })
    }

    /// Asks the hub, which answers others in between.
    async fn judge(
        &self,
        to: PeerId,
        subject: &Subject,
        askings: &[Asking],
        kind: Option<ContextKind>,
    ) -> Vec<(Asking, Judgement)> {
        let mut answers = Vec::new();
        for (index, asking) in askings.iter().enumerate() {
            if index % TURN == TURN - 1 {
                tokio::task::yield_now().await;
            }
            let case = Case {
                user: &subject.user,
                verb: asking.verb,
                path: &asking.context,
                kind,
                message: message_of(asking.verb, asking.message.as_deref()),
                owners: &[],
                invited: false,
            };
            let judgement = self
                .board
                .ask_hub(|hub, now| hub.appraise(now, to, subject.peer, &case));
            answers.extend(judgement.map(|judgement| (asking.clone(), judgement)));
        }
        answers
    }
}

type Plan = (Vec<(Option<PeerId>, Option<User>)>, Vec<Asking>, bool);

/// Whom to ask about, what to ask, and whether there would be more.
fn plan(
    config: &Config,
    about: Vec<About>,
    single: Option<Asking>,
    path: &mom_proto::Path,
    place: Option<&ContextOutline>,
) -> Result<Plan, WireError> {
    let subjects = about.into_iter().map(|about| match about {
        About::Peer(peer) => Ok((Some(peer), None)),
        About::User(name) => match config.user(&name) {
            Ok(user) => Ok((None, Some(user))),
            Err(error) => {
                let text = format!("{}, and no peer of that name is here", error.text);
                Err(WireError::new(Code::UNKNOWN_PEER, text).slot("content/user"))
            }
        },
    });
    let subjects = subjects.collect::<Result<Vec<_>, _>>()?;
    let mut askings = match single {
        Some(mut single) => {
            single.message = match single.verb {
                Verb::Send => message_of(Verb::Send, single.message.as_deref()).map(str::to_owned),
                _ => None,
            };
            vec![single]
        }
        None => config.askings(path, place),
    };
    let more = askings.len() > MOST;
    askings.truncate(MOST);
    Ok((subjects, askings, more))
}

/// The answer to one request.
fn answer(config: &Config, judged: Judged, anchor: Time) -> Map {
    let mut reply = person(&judged.subject);
    let Some((asking, judgement)) = judged.answers.into_iter().next() else {
        return reply;
    };
    reply.set("verb", asking.verb.word());
    if let Some(message) = &asking.message {
        reply.set("message", message.as_str());
    }
    reply.set("context", asking.context.as_str());
    if let Some(place) = &judgement.place {
        reply.set("kind", place.kind.word());
    }
    let told = told(config, &judged.subject.user, asking, &judgement, anchor);
    told.iter().for_each(|(key, value)| reply.set(key, value.clone()));
    reply
}

/// The answers to all requests, by user.
fn table(
    config: &Config,
    all: Vec<Judged>,
    place: Option<&ContextOutline>,
    mut more: bool,
    anchor: Time,
) -> Map {
    let mut reply = Map::new();
    if let Some(place) = place {
        reply.set("context", place.path.as_str());
        reply.set("kind", place.kind.word());
        reply.set("managed-at", place.managed_at.as_str());
        reply.set("manager", place.manager.as_str());
    }
    if let Some(file) = config.file().name {
        reply.set("file", file);
    }
    let (mut users, mut bytes) = (Vec::new(), 0);
    for Judged { subject, answers } in all {
        let (mut verbs, mut messages) = (Map::new(), Map::new());
        for (asking, judgement) in answers {
            if bytes > MOST_BYTES {
                more = true;
                break;
            }
            let (word, message) = (asking.verb.word(), asking.message.clone());
            let told = told(config, &subject.user, asking, &judgement, anchor);
            bytes += size(&told);
            match message {
                Some(name) => messages.set(&name, told),
                None => verbs.set(word, told),
            }
        }
        let mut user = person(&subject).with("verbs", verbs);
        if !messages.is_empty() {
            user.set("messages", messages);
        }
        users.push(Value::from(user));
    }
    reply.set("users", users);
    if more {
        reply.set("more", true);
    }
    reply
}

fn person(subject: &Subject) -> Map {
    let groups = subject
        .user
        .groups
        .iter()
        .map(|group| Value::from(group.as_str()));
    let mut map = Map::new().with("user", subject.user.name.as_str());
    if let Some(name) = &subject.name {
        map.set("peer", name.as_str());
    }
    map.with("level", subject.user.level)
        .with("groups", groups.collect::<Vec<Value>>())
}

/// What the hub would answer, as it is told.
fn told(config: &Config, user: &User, asking: Asking, judgement: &Judgement, anchor: Time) -> Map {
    let explained = config.explained(user.clone(), asking, judgement, anchor);
    let Explanation {
        answer,
        rule,
        uncovered,
        place,
        manager,
        managed_at,
        error,
        asks,
        displaces,
        until,
        stands,
        needs,
        ..
    } = explained;
    let mut map = Map::new().with("allow", answer == "allow").with("answer", answer);
    if let Some(rule) = rule {
        map.set("rule", rule);
    }
    if uncovered {
        map.set("uncovered", true);
    }
    if let Some(place) = place {
        map.set("file", place.file_name());
        map.set("line", int(place.line as u64));
        map.set("key", place.key);
    }
    map.set("manager", manager);
    map.set("managed-at", managed_at);
    for (key, value) in error.iter().flat_map(Map::iter) {
        match key {
            "name" => map.set("code", value.clone()),
            "code" | "rule" => {}
            key => map.set(key, value.clone()),
        }
    }
    if let Some(guard) = &judgement.guard {
        map.set("guard", guard.as_str());
        if let Some(owner) = &judgement.guard_owner {
            map.set("guard-owner", &**owner);
        }
    }
    if !needs.is_empty() {
        map.set("needs", list(needs));
    }
    if let Some(asks) = asks {
        let asked = Map::new()
            .with("who", asks.who)
            .with("users", list(asks.users))
            .with("within", int(asks.within));
        map.set("asks", asked);
    }
    if displaces {
        map.set("displaces", true);
    }
    if let Some(until) = until {
        map.set("until", until);
    }
    map.with("stands", stands)
}

fn list(texts: Vec<String>) -> Vec<Value> {
    texts.into_iter().map(Value::from).collect()
}
