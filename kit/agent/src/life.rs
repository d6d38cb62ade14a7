//! The life of an agent: it hears tasks, has one at a time carried out, and ends.

use std::future::{Future, pending};
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use mom_client::{Channel, Client, ClientError, Code, Event, LinkState, Parcel, Value, WireError};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep_until, timeout};

use crate::Trade;
use crate::hired::{Ended, Hired, refuse};

/// How long a task may take to end when the agent does.
const LAST: Duration = Duration::from_secs(2);

/// How long the peer of a task may be away, as its connection is lost, before the task ends.
const AWAY: Duration = Duration::from_secs(5);

/// How long finding out whether a task can be done may take: who asks waits no longer for an answer.
const MET: Duration = Duration::from_secs(9);

/// The task under way.
struct Job<T> {
    hired: Hired<T>,
    cancel: watch::Sender<Option<String>>,
    /// How it ended; none if it was refused.
    work: JoinHandle<Option<Ended>>,
    /// When it ends, as the connection of its peer is lost.
    ends: Option<Instant>,
}

/// Runs an agent in its channel until `shutdown` is done; a task under way is cancelled then, and the token returned.
///
/// # Errors
///
/// [`ClientError`] if its channel cannot be joined, or the connection is closed for good.
pub async fn run<T: Trade>(
    client: Client,
    channel: &str,
    trade: T,
    shutdown: impl Future<Output = ()>,
) -> Result<(), ClientError> {
    let channel = client.channel(channel).await?;
    let mut events = channel.events();
    let (trade, mut shutdown) = (Arc::new(trade), pin!(shutdown));
    let mut job: Option<Job<T::Task>> = None;
    tracing::info!(peer = client.name(), channel = %channel.path(), "the agent is ready");
    loop {
        let absent = job
            .as_ref()
            .and_then(|job| Some((job.ends?, job.hired.peer.clone())));
        tokio::select! {
            () = &mut shutdown => break,
            peer = away(absent) => end_of(&mut job, &peer, "has lost its connection"),
            // It takes the next one when it says that this has ended.
            (hired, ended) = ended(&mut job) => if let Some(ended) = ended {
                hired.tell_end(ended).await;
            },
            event = events.next() => match event {
                Some(Event::Message(parcel)) => hear(&client, &channel, &trade, &mut job, &parcel).await,
                Some(Event::Left(member)) => end_of(&mut job, &member.peer, "has left"),
                Some(Event::Other(parcel)) => note_link(&mut job, &parcel),
                Some(Event::Lagged(count)) => tracing::warn!(count, "messages were lost"),
                Some(_) => {}
                None => return Err(closed(&client)),
            },
        }
    }
    if let Some(job) = job {
        job.cancel
            .send_replace(Some("the agent's program ends".to_owned()));
        match timeout(LAST, job.work).await {
            Ok(Ok(Some(ended))) => job.hired.tell_end(ended).await,
            Ok(_) => {}
            Err(_) => tracing::warn!("the task did not end in time; the hub takes the token back"),
        }
    }
    client.close().await;
    Ok(())
}

/// Has the task end if it is this peer's.
fn end_of<T>(job: &mut Option<Job<T>>, peer: &str, why: &str) {
    if let Some(job) = job.as_mut().filter(|job| job.hired.peer == peer) {
        job.ends = None;
        job.cancel.send_replace(Some(format!("{peer} {why}")));
    }
}

/// Takes in that the connection of the task's peer is lost, or back.
fn note_link<T>(job: &mut Option<Job<T>>, parcel: &Parcel) {
    let content = parcel.value();
    let peer = content.get("peer").and_then(Value::as_str);
    let Some(job) = job.as_mut().filter(|job| peer == Some(&*job.hired.peer)) else {
        return;
    };
    match parcel.name() {
        "lost" => job.ends = Some(Instant::now() + AWAY),
        "resumed" => job.ends = None,
        _ => {}
    }
}

/// Waits until the absent peer of a task is away for too long; gives its name.
async fn away(absent: Option<(Instant, String)>) -> String {
    match absent {
        Some((ends, peer)) => {
            sleep_until(ends).await;
            peer
        }
        None => pending().await,
    }
}

/// Waits for the end of the task, if there is one.
async fn ended<T>(job: &mut Option<Job<T>>) -> (Hired<T>, Option<Ended>) {
    let worked = match job.as_mut() {
        Some(job) => (&mut job.work).await,
        None => pending().await,
    };
    let Some(job) = job.take() else {
        return pending().await;
    };
    let ended = worked.unwrap_or_else(|error| {
        // It has lost its token with its guard.
        tracing::error!(%error, "the task failed with an internal error");
        Some(Ended::new("failed", "the agent failed with an internal error"))
    });
    (job.hired, ended)
}

/// Why there are no more events.
fn closed(client: &Client) -> ClientError {
    match &*client.state().borrow() {
        LinkState::Closed(error) => ClientError::Closed(error.clone()),
        _ => WireError::new(Code::UNKNOWN_PATH, "the hub deleted the agent's channel").into(),
    }
}

/// Hears what a peer asks for.
async fn hear<T: Trade>(
    client: &Client,
    channel: &Channel,
    trade: &Arc<T>,
    job: &mut Option<Job<T::Task>>,
    parcel: &Parcel,
) {
    let Some(peer) = parcel.sender.as_deref().map(str::to_owned) else {
        return;
    };
    // What was asked before it came was asked of nobody.
    if parcel.is_history() {
        return;
    }
    let error = match (parcel.name(), &*job) {
        (name, Some(job)) if name == T::VERB => busy::<T>(job),
        (name, None) if name == T::VERB => match trade.read(&parcel.value()) {
            Ok(task) => {
                let (cancel, cancelled) = watch::channel(None);
                let hired = Hired {
                    peer,
                    task,
                    client: client.clone(),
                    channel: channel.clone(),
                    id: parcel.id,
                    since: Instant::now(),
                    cancelled,
                };
                tracing::info!(peer = hired.peer, task = T::words(&hired.task), "a task");
                let work = tokio::spawn(carry_out(Arc::clone(trade), hired.clone()));
                *job = Some(Job {
                    hired,
                    cancel,
                    work,
                    ends: None,
                });
                return;
            }
            Err(error) => error,
        },
        ("cancel", Some(job)) if job.hired.peer == peer => {
            job.cancel.send_replace(Some(format!("{peer} cancelled it")));
            return;
        }
        ("cancel", Some(job)) => {
            let text = format!("the task is {0}'s; only {0} cancels it", job.hired.peer);
            WireError::new(Code::DENIED, text)
        }
        ("cancel", None) => WireError::new(Code::TRY_LATER, "there is no task to cancel"),
        _ => return,
    };
    let name = format!("{}-refused", parcel.name());
    refuse(channel, &peer, parcel.id, &name, &error).await;
}

fn busy<T: Trade>(job: &Job<T::Task>) -> WireError {
    let text = format!(
        "busy: {} has had it {} for {} s",
        job.hired.peer,
        T::words(&job.hired.task),
        job.hired.since.elapsed().as_secs()
    );
    WireError::new(Code::TRY_LATER, text)
}

/// Carries a task out, or refuses it; how it ended.
async fn carry_out<T: Trade>(trade: Arc<T>, hired: Hired<T::Task>) -> Option<Ended> {
    let met = tokio::select! {
        met = timeout(MET, trade.meet(&hired)) => met.unwrap_or_else(|_| {
            let text = format!("it could not be found out within {} s whether that can be done", MET.as_secs());
            Err(WireError::new(Code::TRY_LATER, text))
        }),
        why = hired.ends() => Err(WireError::new(Code::TRY_LATER, why)),
    };
    let (tools, token) = match met {
        Ok(met) => met,
        Err(error) => {
            tracing::info!(peer = hired.peer, %error, "refused");
            let name = format!("{}-refused", T::VERB);
            refuse(&hired.channel, &hired.peer, hired.id, &name, &error).await;
            return None;
        }
    };
    // Before anything is asked for, so that no offer is missed.
    let offers = token.events();
    hired.accept().await;
    let offered = tokio::select! {
        offered = hired.offered(&token, offers) => offered,
        why = hired.ends() => Err(Ended::new("cancelled", why)),
    };
    Some(match offered {
        Ok(holding) => trade.work(&hired, tools, holding).await,
        Err(ended) => ended,
    })
}
