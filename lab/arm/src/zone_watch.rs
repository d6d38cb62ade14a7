//! What the hub tells of the zones of a session (M33, M40): which there are, where they are, who owns them, and who is to be granted one.

use std::future::{Future, poll_fn};
use std::pin::Pin;
use std::task::Poll;
use std::time::Duration;

use mom_client::{
    Client, ClientError, Consult, Consults, ContextInfo, ContextKind, Event, Events, Map, Path, Session,
    Token,
};
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until};

use crate::zone_keeper::ZoneNews;

/// Between two questions for all zones.
const AGAIN: Duration = Duration::from_secs(5);

/// The zones of a session.
pub(crate) struct ZoneWatch {
    client: Client,
    session: Session,
    changes: Events,
    zones: Vec<(Token, Events)>,
    /// What the hub was asked for.
    asked: JoinSet<Answer>,
    /// When everything is asked for again: boxes may have moved with the configuration, and an answer may have failed.
    again: Instant,
    questions: Consults,
    /// What is to be told before anything else.
    pending: Vec<ZoneNews>,
}

/// What the hub answered.
enum Answer {
    Listed(Result<Vec<ContextInfo>, ClientError>),
    Joined(Path, Result<Token, ClientError>),
    Told(Path, Result<Map, ClientError>),
}

/// What has happened.
pub(crate) enum ZoneEvent {
    News(ZoneNews),
    /// May a peer be granted a zone?
    Question(Consult),
}

impl ZoneWatch {
    /// Joins the tokens of the session.
    pub(crate) async fn join(client: &Client, session: &str) -> Result<ZoneWatch, ClientError> {
        let session = client.session(session).await?;
        let mut watch = ZoneWatch {
            client: client.clone(),
            changes: session.events(),
            questions: client.consults(),
            session,
            zones: Vec::new(),
            asked: JoinSet::new(),
            again: Instant::now() + AGAIN,
            pending: Vec::new(),
        };
        for context in watch.session.list().await? {
            if context.kind == ContextKind::Token {
                watch.pending.push(ZoneNews::Added(context.path.clone()));
                let token = client.token(context.path.as_str()).await?;
                watch.watch(token);
            }
        }
        Ok(watch)
    }

    fn watch(&mut self, token: Token) {
        self.ask(&token);
        let events = token.events();
        self.zones.push((token, events));
    }

    /// Asks for what there is to know of a zone.
    fn ask(&mut self, token: &Token) {
        let token = token.clone();
        self.asked
            .spawn(async move { Answer::Told(token.path().clone(), token.info().await) });
    }

    /// Asks for all zones, and which there are.
    fn ask_all(&mut self) {
        self.again = Instant::now() + AGAIN;
        let tokens: Vec<Token> = self.zones.iter().map(|(token, _)| token.clone()).collect();
        for token in tokens {
            self.ask(&token);
        }
        let session = self.session.clone();
        self.asked
            .spawn(async move { Answer::Listed(session.list().await) });
    }

    /// There is a zone: closed from now on, and for good if it cannot be joined.
    fn add(&mut self, path: Path) {
        let client = self.client.clone();
        self.pending.push(ZoneNews::Added(path.clone()));
        self.asked.spawn(async move {
            let token = client.token(path.as_str()).await;
            Answer::Joined(path, token)
        });
    }

    /// What was under way tells of the time before.
    fn forget(&mut self) {
        self.asked = JoinSet::new();
        self.pending.push(ZoneNews::Forgotten);
    }

    /// What has happened next; none once the session is deleted, or the connection closed. A question comes after the news that the hub
    /// sent before it. Cancel safe.
    pub(crate) async fn next(&mut self) -> Option<ZoneEvent> {
        loop {
            if !self.pending.is_empty() {
                return Some(ZoneEvent::News(self.pending.remove(0)));
            }
            tokio::select! {
                biased;
                change = self.changes.next() => match change? {
                    Event::Created(context) if context.kind == ContextKind::Token => self.add(context.path),
                    Event::Deleted { path } => {
                        self.zones.retain(|(token, _)| *token.path() != path);
                        self.pending.push(ZoneNews::Removed(path));
                    }
                    Event::Rejoined | Event::Resumed | Event::Lagged(_) => {
                        self.forget();
                        self.ask_all();
                    }
                    Event::LinkDown => self.forget(),
                    _ => {}
                },
                (index, event) = any(&mut self.zones) => match event {
                    // Deleted, which the session tells; or the arm may be a member no more, and tries again.
                    None => {
                        let (token, _) = self.zones.swap_remove(index);
                        self.pending.push(ZoneNews::Unknown(token.path().clone()));
                    }
                    Some(Event::Grabbed { path, owner, fence, .. }) => {
                        let token = self.zones[index].0.clone();
                        self.ask(&token);
                        self.pending.push(ZoneNews::Grabbed(path, owner, fence));
                    }
                    Some(Event::Released { path, fence, .. }) => {
                        self.pending.push(ZoneNews::Released(path, fence));
                    }
                    Some(Event::Lagged(_)) => {
                        self.forget();
                        self.ask_all();
                    }
                    Some(_) => {}
                },
                () = sleep_until(self.again) => self.ask_all(),
                Some(answer) = self.asked.join_next() => match answer {
                    Ok(answer) => self.take(answer),
                    Err(error) => tracing::error!(%error, "a question to the hub broke down"),
                },
                question = self.questions.next() => return Some(ZoneEvent::Question(question?)),
            }
        }
    }

    fn take(&mut self, answer: Answer) {
        match answer {
            Answer::Listed(Ok(contexts)) => {
                for context in contexts {
                    let known = |(token, _): &(Token, Events)| *token.path() == context.path;
                    if context.kind == ContextKind::Token && !self.zones.iter().any(known) {
                        self.add(context.path);
                    }
                }
            }
            Answer::Joined(path, Ok(token)) => {
                self.zones.retain(|(known, _)| *known.path() != path);
                self.pending.push(ZoneNews::Added(path));
                self.watch(token);
            }
            Answer::Told(path, Ok(info)) => {
                if info.get("zone").is_none() {
                    tracing::warn!(%path, "the token tells no box, so its zone is closed; does a manager of kind zones know it?");
                }
                self.pending.push(ZoneNews::Told(path, info));
            }
            Answer::Joined(path, Err(error)) | Answer::Told(path, Err(error)) => {
                tracing::warn!(%path, %error, "where the zone is is not known, so it is closed; it is asked for again");
            }
            Answer::Listed(Err(error)) => tracing::warn!(%error, "which zones there are is not known"),
        }
    }
}

/// The next event of any zone.
async fn any(zones: &mut [(Token, Events)]) -> (usize, Option<Event>) {
    let mut waiting: Vec<Pin<Box<_>>> = zones
        .iter_mut()
        .map(|(_, events)| Box::pin(events.next()))
        .collect();
    poll_fn(|context| {
        let ready =
            waiting
                .iter_mut()
                .enumerate()
                .find_map(|(index, next)| match next.as_mut().poll(context) {
                    Poll::Ready(event) => Some((index, event)),
                    Poll::Pending => None,
                });
        ready.map_or(Poll::Pending, Poll::Ready)
    })
    .await
}
