//! The peer at the hub: what it knows of the robot, and the token while it holds it.

use std::sync::Arc;
use std::time::Duration;

use mom_client::{Card, Client, Event, LinkState, Loan, Lost, Parcel, Token, TokenGuard, TokenInfo};
use mom_drive::{DeviceChannel, Doing as _, VerbFailure, beyond_scope, scope_end_words};
use parking_lot::Mutex;
use tokio::sync::{Notify, watch};
use tokio::time::{Instant, sleep, timeout};

use crate::answer::Answer;
use crate::device::DeviceState;

/// Between two attempts to come back to the token.
const AGAIN: Duration = Duration::from_millis(500);
/// So long an offer may take to become ours.
const ACCEPTED: Duration = Duration::from_secs(5);
/// So long joining the token again may take.
const JOINED: Duration = Duration::from_secs(5);
/// So long the hub may take to show the card of the robot.
const CARD: Duration = Duration::from_secs(1);
/// So long the hub may take to have the token back.
const END: Duration = Duration::from_secs(2);

/// How long a token is kept that a person gave or handed over without a limit, and for how many scripts.
pub(crate) const UNSCOPED: (Duration, u64) = (Duration::from_secs(120), 20);

/// Where everything is.
#[derive(Debug, Clone)]
pub(crate) struct Places {
    pub(crate) robot: String,
    pub(crate) token: String,
    pub(crate) cameras: String,
    pub(crate) objects: String,
}

/// A state of the robot as it came.
#[derive(Debug, Clone)]
pub(crate) struct SeenState {
    pub(crate) parcel: Parcel,
    pub(crate) state: DeviceState,
}

/// The token while it is ours, or how it was lost.
#[derive(Debug, Default)]
struct Hand {
    guard: Option<TokenGuard>,
    lost: Option<Lost>,
}

/// What this program keeps to where the token came without a scope: what was asked for, or [`UNSCOPED`].
#[derive(Debug, Clone, Copy)]
struct Limit {
    fence: u64,
    until: Instant,
    commands: u64,
}

impl Limit {
    fn is_over(&self) -> bool {
        self.commands == 0 || self.until <= Instant::now()
    }
}

/// Why the token was given back after the last script.
const ALL: &str = "what you asked for is over";

/// A peer that is logged in.
#[derive(Debug)]
pub(crate) struct Assistant {
    pub(crate) client: Client,
    pub(crate) places: Places,
    pub(crate) robot: DeviceChannel,
    seen: watch::Receiver<Option<SeenState>>,
    /// None while it is joined again.
    token: watch::Sender<Option<Token>>,
    hand: Mutex<Hand>,
    limit: Mutex<Option<Limit>>,
    /// The newest fence whose time is over though the hub has not taken it, and why.
    over: watch::Sender<Option<(u64, String)>>,
    /// The state of the robot that the model was told of last, by the id of its message.
    told: Mutex<Option<u64>>,
    /// Told when the hand has something in it.
    taken: Notify,
}

impl Assistant {
    /// Joins what there is, and keeps up with it in tasks that end with the client.
    ///
    /// # Errors
    /// The hub's refusal, a lost connection.
    pub(crate) async fn begin(client: Client, places: Places) -> Result<Arc<Assistant>, VerbFailure> {
        let robot = DeviceChannel::join(&client, &places.robot).await?;
        let first = client.token(&places.token).await;
        let first = first.doing(format!("join {}", places.token))?;
        let (see, seen) = watch::channel(None);
        tokio::spawn(watch_robot(robot.events(), see));
        let assistant = Arc::new(Assistant {
            client,
            places,
            robot,
            seen,
            token: watch::Sender::new(Some(first.clone())),
            hand: Mutex::default(),
            limit: Mutex::default(),
            over: watch::Sender::new(None),
            told: Mutex::default(),
            taken: Notify::new(),
        });
        tokio::spawn(accept_offers(Arc::clone(&assistant), first));
        Ok(assistant)
    }

    /// Why nothing can be asked now, if so.
    pub(crate) fn disconnected(&self) -> Option<Answer> {
        let state = self.client.state().borrow().clone();
        match state {
            LinkState::Connected | LinkState::Stale { .. } => None,
            LinkState::Closed(why) => {
                let why = why.map(|why| format!(": {}", why.text)).unwrap_or_default();
                Some(Answer::bad(
                    "disconnected",
                    format!("the hub has closed the connection{why}"),
                ))
            }
            LinkState::Resuming { since, .. } | LinkState::Trying { since, .. } => Some(Answer::bad(
                "disconnected",
                format!(
                    "the connection to the hub was lost {:.0} s ago, and every token with it, so the robot was halted; \
                     the next attempt to connect is under way: call again in some seconds",
                    since.elapsed().as_secs_f64()
                ),
            )),
        }
    }

    /// The newest state of the robot; waits a moment for the first.
    pub(crate) async fn robot_state(&self, patience: Duration) -> Option<SeenState> {
        self.robot_state_when(patience, |_| true).await.ok()
    }

    /// The newest state of the robot as soon as it is so; the newest of all if it does not become so.
    pub(crate) async fn robot_state_when(
        &self,
        patience: Duration,
        is: impl Fn(&DeviceState) -> bool,
    ) -> Result<SeenState, Option<SeenState>> {
        let mut seen = self.seen.clone();
        let is_so = |seen: &Option<SeenState>| seen.as_ref().is_some_and(|seen| is(&seen.state));
        let found = timeout(patience, seen.wait_for(is_so)).await;
        if let Ok(Ok(found)) = &found
            && let Some(found) = found.as_ref()
        {
            return Ok(found.clone());
        }
        drop(found);
        Err(self.seen.borrow().clone())
    }

    /// What the robot says of itself; none of one that has no card, or does not answer soon.
    pub(crate) async fn card(&self) -> Option<Card> {
        let card = timeout(CARD, self.client.card(&self.places.robot)).await;
        card.ok()?.ok()?.map(|(_, card)| card)
    }

    /// The number of the newest state of the robot.
    pub(crate) fn newest(&self) -> Option<i64> {
        self.seen.borrow().as_ref().map(|seen| seen.state.seq)
    }

    /// The model is told of this state: what it says relative to it is refused once the robot has moved (M35).
    pub(crate) fn tell(&self, seen: &SeenState) {
        *self.told.lock() = seen.parcel.id;
    }

    /// The state that the model was told of last.
    pub(crate) fn told(&self) -> Option<u64> {
        *self.told.lock()
    }

    /// Who owns the token.
    pub(crate) async fn token_info(&self) -> Result<TokenInfo, Answer> {
        let path = &self.places.token;
        let info = self.client.info(path).await;
        let info = info.map_err(|error| Answer::of_client(&format!("look at {path}"), &error))?;
        Ok(TokenInfo::read(&info))
    }

    /// The token, once it is joined.
    pub(crate) async fn token(&self) -> Option<Token> {
        let mut token = self.token.subscribe();
        let joined = timeout(JOINED, token.wait_for(Option::is_some)).await;
        joined.ok().and_then(Result::ok).and_then(|token| token.clone())
    }

    /// Takes the token into the hand.
    pub(crate) fn put(&self, guard: TokenGuard) {
        let mut hand = self.hand.lock();
        *hand = Hand {
            guard: Some(guard),
            lost: None,
        };
        drop(hand);
        self.taken.notify_waiters();
        self.taken.notify_one();
    }

    /// Keeps to the limits of the token in the hand: to its scope and who lent it; where it has none, to what was asked for, or to
    /// [`UNSCOPED`]. What runs then is ended.
    pub(crate) fn keep_to(self: &Arc<Self>, token: &Token, time: Option<Duration>, commands: Option<u64>) {
        let Some((fence, loan)) = self.held(|guard| (guard.fence(), guard.delegation().cloned())) else {
            return;
        };
        let time = time.unwrap_or(UNSCOPED.0);
        if loan.is_none() {
            *self.limit.lock() = Some(Limit {
                fence,
                until: Instant::now() + time,
                commands: commands.unwrap_or(UNSCOPED.1),
            });
        }
        let (assistant, token) = (Arc::clone(self), token.clone());
        tokio::spawn(async move {
            let why = ended(&token, loan.as_ref(), time).await;
            // The end of an earlier token, whose time ran on after it was returned, says nothing of this one.
            assistant.over.send_if_modified(|over| {
                let newer = over.as_ref().is_none_or(|(ended, _)| *ended < fence);
                if newer {
                    *over = Some((fence, why.clone()));
                }
                newer
            });
            // The task that drives under it gives it back, and nobody else has it in the hand.
            if assistant.held(TokenGuard::fence) == Some(fence)
                && let Ok(guard) = assistant.take().await
            {
                assistant.give_back(guard, why).await;
            }
        });
    }

    /// Waits until the time of this fence is over though the hub has not taken it; why.
    pub(crate) async fn over(&self, fence: u64) -> String {
        let mut over = self.over.subscribe();
        let is_over = |over: &Option<(u64, String)>| over.as_ref().is_some_and(|(ended, _)| *ended == fence);
        let why = over
            .wait_for(is_over)
            .await
            .map(|over| over.as_ref().map(|(_, why)| why.clone()));
        match why {
            Ok(why) => why.unwrap_or_default(),
            // The assistant itself holds the sender.
            Err(_) => std::future::pending().await,
        }
    }

    /// Whether the token in the hand came without a scope.
    pub(crate) fn is_unscoped(&self, fence: u64) -> bool {
        self.limit.lock().is_some_and(|limit| limit.fence == fence)
    }

    /// Puts the token back after a command, or gives it back if that was the last that was asked for; whether it was.
    pub(crate) async fn put_after_command(&self, guard: TokenGuard) -> bool {
        let over = {
            let mut limit = self.limit.lock();
            let limit = limit.as_mut().filter(|limit| limit.fence == guard.fence());
            limit.is_some_and(|limit| {
                limit.commands = limit.commands.saturating_sub(1);
                limit.is_over()
            })
        };
        match over {
            true => self.give_back(guard, ALL.to_owned()).await,
            false => self.put(guard),
        }
        over
    }

    async fn give_back(&self, guard: TokenGuard, why: String) {
        if let Err(error) = guard.release().await {
            tracing::warn!("the token was not given back: {error}");
        }
        self.lose(Lost {
            reason: format!("{why}, so it was given back"),
            by: None,
        });
    }

    /// Takes the token out of the hand, for a tool whose turn it is; if it is not there, how it was lost.
    pub(crate) async fn take(&self) -> Result<TokenGuard, Option<String>> {
        let (guard, lost) = {
            let mut hand = self.hand.lock();
            (hand.guard.take(), hand.lost.clone())
        };
        let loan = guard.as_ref().and_then(|guard| guard.delegation().cloned());
        let lost = match guard {
            Some(guard) if !guard.is_lost() => return Ok(guard),
            // It is lost already, so this waits for nothing.
            Some(mut guard) => Some(guard.lost().await),
            None => lost,
        };
        self.hand.lock().lost.clone_from(&lost);
        Err(lost.map(|lost| loss_words(&self.places.token, &lost, loan.as_ref())))
    }

    /// What the token in the hand tells; none if there is none.
    pub(crate) fn held<T>(&self, tell: impl FnOnce(&TokenGuard) -> T) -> Option<T> {
        let hand = self.hand.lock();
        hand.guard.as_ref().filter(|guard| !guard.is_lost()).map(tell)
    }

    /// Remembers why the token was lost.
    pub(crate) fn lose(&self, lost: Lost) {
        self.hand.lock().lost = Some(lost);
    }

    /// Forgets it: the token was given back.
    pub(crate) fn forget_loss(&self) {
        self.hand.lock().lost = None;
    }

    /// Waits until the token is in the hand.
    pub(crate) async fn taken(&self) {
        loop {
            let notified = self.taken.notified();
            if self.held(|_| ()).is_some() {
                return;
            }
            notified.await;
        }
    }

    /// Waits for an offer that is being accepted.
    pub(crate) async fn taken_soon(&self) -> bool {
        timeout(ACCEPTED, self.taken()).await.is_ok()
    }

    /// Accepts what the owner offers.
    async fn accept(self: &Arc<Self>, token: &Token) {
        match token.accept().await {
            Ok(guard) => {
                let by = guard.delegation().map(|loan| format!(" by {}", loan.from));
                tracing::info!("{} is given{}", self.places.token, by.unwrap_or_default());
                self.put(guard);
                self.keep_to(token, None, None);
            }
            Err(error) => tracing::warn!("the offer failed: {error}"),
        }
    }

    /// Takes a request to the owner back: who leaves a token asks for it no more. The token is joined again.
    pub(crate) async fn withdraw(&self) {
        let Some(token) = self.token.send_replace(None) else {
            return;
        };
        if let Err(error) = token.leave().await {
            tracing::warn!("the request cannot be taken back: {error}");
        }
    }

    /// Gives everything back and logs out.
    pub(crate) async fn end(&self) {
        if let Ok(guard) = self.take().await {
            match timeout(END, guard.release()).await {
                Ok(Ok(())) => tracing::info!("{} is given back", self.places.token),
                Ok(Err(error)) => tracing::warn!("{} is not given back: {error}", self.places.token),
                Err(_) => tracing::warn!("the hub does not answer"),
            }
        }
        self.client.clone().close().await;
    }
}

/// Waits for the end of what may be done under a token, which the hub does not bring about: of its scope where the hub is silent, of who
/// lent it, or of the time that it is kept for. Why, in words.
async fn ended(token: &Token, loan: Option<&Loan>, time: Duration) -> String {
    let since = Instant::now();
    tokio::select! {
        why = beyond_scope(token, loan, since) => why,
        () = sleep(time), if loan.is_none() => format!("the {} s for which you may keep it are over", time.as_secs_f64()),
    }
}

/// How the token was lost, in words.
pub(crate) fn loss_words(token: &str, lost: &Lost, loan: Option<&Loan>) -> String {
    match lost.reason.as_str() {
        // The client gives back what it may not renew.
        "denied" => format!(
            "lost {token}: a third of its lease is over, and the hub does not let this user `renew` it (denied)"
        ),
        _ => scope_end_words(token, lost, loan),
    }
}

/// Keeps the newest state of the robot.
async fn watch_robot(mut events: mom_client::Events, see: watch::Sender<Option<SeenState>>) {
    while let Some(event) = events.next().await {
        match event {
            Event::Message(parcel) if parcel.name() == "state" => {
                if let Some(state) = DeviceState::of(&parcel) {
                    see.send_replace(Some(SeenState { parcel, state }));
                }
            }
            // What it does meanwhile is not known.
            Event::LinkDown => {
                see.send_replace(None);
            }
            _ => {}
        }
    }
}

/// Accepts the token whenever its owner offers it: the offer is the grant. Joins it again when it was left.
async fn accept_offers(assistant: Arc<Assistant>, first: Token) {
    let mut next = Some(first);
    loop {
        let token = match next.take() {
            Some(token) => token,
            None => match assistant.client.token(&assistant.places.token).await {
                Ok(token) => token,
                Err(error) => {
                    if matches!(*assistant.client.state().borrow(), LinkState::Closed(_)) {
                        return;
                    }
                    tracing::debug!("cannot join {}: {error}", assistant.places.token);
                    sleep(AGAIN).await;
                    continue;
                }
            },
        };
        let mut events = token.events();
        assistant.token.send_replace(Some(token.clone()));
        // What was offered before it was joined.
        let offer = token.status().await.ok().and_then(|info| info.offer);
        if offer.is_some_and(|offer| offer.to == assistant.client.name()) {
            assistant.accept(&token).await;
        }
        while let Some(event) = events.next().await {
            if let Event::Offer { to, .. } = event
                && to == assistant.client.name()
            {
                assistant.accept(&token).await;
            }
        }
        assistant.token.send_replace(None);
    }
}
