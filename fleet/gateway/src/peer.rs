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
    shutdown: Boxed<'static, ()>,
) -> Result<(), ClientError> {
    let Some(first) = clients.first() else {
        return Err(ClientError::Connection(
            "the gateway has no connection".to_owned(),
        ));
    };
    let options = Arc::new(options);
    ensure_session(first, &options.session).await?;
    // Each stays in it for as long as this lives.
    let mut statuses = JoinSet::new();
    for client in &clients {
        let status = enter_status(client, &options.status()).await?;
        let (client, path) = (client.clone(), options.status());
        statuses.spawn(stay(
            status,
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
    let share = lines.len().div_ceil(clients.len()).max(1);
    let mut entered = Ok(());
    for (line, number) in lines.into_iter().zip(0..) {
        let Some(place) = crew.place(&line, number / share) else {
            continue;
        };
        let channel = match place.enter().await {
            Ok(channel) => Some(channel),
            // The others need not wait for that one's end.
            Err(error) if error.code() == Some(&Code::OCCUPIED) => None,
            Err(error) => {
                entered = Err(error);
                break;
            }
        };
        crew.live(place, line, number / share, channel);
    }
    let result = match entered {
        Ok(()) => {
            tracing::info!(peer = first.name(), connections = clients.len(), robots = crew.len(), session = %options.session, "the gateway is ready");
            crew.serve(changes, shutdown).await
        }
        Err(error) => Err(error),
    };
    crew.end().await;
    drop(statuses);
    for client in clients {
        client.close().await;
    }
    result
}
