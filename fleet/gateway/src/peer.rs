//! The gateway as a peer: each robot's contexts, and the robot between its channel and its wire.

use std::future::Future;
use std::sync::Arc;

use mom_client::{Boxed, Client, ClientError, Code};
use mom_wheeled::{ensure_session, enter_status, stay};
use tokio::task::JoinSet;

use crate::crew::{Changes, Crew};
use crate::editor::Editor;
use crate::site::{GatewayOptions, ROBOTS_PER_CONNECTION};
use crate::station::RobotWire;

/// Has the robots of these lines obey at the hub, until `shutdown` is done. Then they stand, and are waited for, a second at most.
///
/// What is missing of their contexts is made first. There are as many clients as [`connections`](crate::connections) says; they share the
/// robots. A robot whose channel is gone, as it was deleted or the hub began anew, stands until that is back, and the others go on; the
/// gateway makes it if it can. What comes of `changes` is taken over meanwhile.
///
/// # Errors
///
/// A context that cannot be made or joined at the beginning, or connections that are closed for good.
pub fn run(
    clients: Vec<Client>,
    lines: Vec<RobotWire>,
    options: GatewayOptions,
    changes: Option<Changes>,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Boxed<'static, Result<(), ClientError>> {
    Box::pin(run_until(clients, lines, options, changes, Box::pin(shutdown)))
}

async fn run_until(
    clients: Vec<Client>,
    lines: Vec<RobotWire>,
    options: GatewayOptions,
    changes: Option<Changes>,
    mut shutdown: Boxed<'static, ()>,
) -> Result<(), ClientError> {
    let Some(first) = clients.first() else {
        return Err(ClientError::Connection(
            "the gateway has no connection".to_owned(),
        ));
    };
    let options = Arc::new(options);
    let Some(made) = unless(&mut shutdown, ensure_session(first, &options.session)).await else {
        return Ok(());
    };
    made?;
    // Each stays in it for as long as this lives.
    let mut statuses = JoinSet::new();
    for client in &clients {
        let Some(status) = unless(&mut shutdown, enter_status(client, &options.status())).await else {
            return Ok(());
        };
        let (client, path) = (client.clone(), options.status());
        statuses.spawn(stay(
            status?,
            move || {
                let (client, path) = (client.clone(), path.clone());
                async move { enter_status(&client, &path).await }
            },
            drop,
        ));
    }
    let mut changes = changes;
    if let Some(changes) = &mut changes
        && let Some(file) = changes.file.take()
    {
        let editor = Editor {
            client: first.clone(),
            options: Arc::clone(&options),
            file,
            present: changes.present.subscribe(),
            most: clients.len() * ROBOTS_PER_CONNECTION,
        };
        statuses.spawn(editor.serve());
    }
    let mut crew = Crew::new(clients.clone(), Arc::clone(&options), lines.len());
    let entered = enter_all(&mut crew, lines, clients.len(), &mut shutdown).await;
    let result = match entered {
        Some(Ok(())) => {
            tracing::info!(peer = first.name(), connections = clients.len(), robots = crew.len(), session = %options.session, "the gateway is ready");
            crew.serve(changes, shutdown).await
        }
        Some(Err(error)) => Err(error),
        None => Ok(()),
    };
    crew.end().await;
    drop(statuses);
    for client in clients {
        client.close().await;
    }
    result
}

/// Has each robot join its channel, and live. None if the program is to end before.
async fn enter_all(
    crew: &mut Crew,
    lines: Vec<RobotWire>,
    clients: usize,
    shutdown: &mut Boxed<'static, ()>,
) -> Option<Result<(), ClientError>> {
    let share = lines.len().div_ceil(clients).max(1);
    for (line, number) in lines.into_iter().zip(0..) {
        let Some(place) = crew.place(&line, number / share) else {
            continue;
        };
        let channel = match unless(shutdown, place.enter()).await {
            Some(Ok(channel)) => Some(channel),
            // The others need not wait for that one's end.
            Some(Err(error)) if error.code() == Some(&Code::OCCUPIED) => None,
            Some(Err(error)) => return Some(Err(error)),
            None => return None,
        };
        crew.live(place, line, number / share, channel);
    }
    Some(Ok(()))
}

/// What is done of this, unless the program is to end before: a hub that stands still answers nothing.
async fn unless<T>(shutdown: &mut Boxed<'static, ()>, work: impl Future<Output = T>) -> Option<T> {
    tokio::select! {
        biased;
        () = shutdown => None,
        done = work => Some(done),
    }
}
