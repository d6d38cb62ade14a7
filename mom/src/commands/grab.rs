//! `mom grab`: a token, held until Ctrl-C.

use std::future::pending;
use std::time::Duration;

use mom_client::{Lost, Token, TokenGuard};
use serde_json::json;
use tokio::time::{Instant, sleep, sleep_until};

use crate::cli::{self, Global};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::interrupt::Interrupt;
use crate::output::event::lost_words;
use crate::output::style::{Ink, ink};
use crate::output::{Output, words};

/// The hub is asked for the lease so often in its course, but not too often.
const LOOKS_PER_LEASE: u32 = 12;
const SOONEST: Duration = Duration::from_millis(100);
const LATEST: Duration = Duration::from_secs(10);

pub(crate) async fn run(args: &cli::Grab, global: &Global, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let mut interrupt = Interrupt::install()?;
    let token = client
        .token(&args.token)
        .await
        .doing(format!("join {}", args.token))?;
    let mut guard = token.grab().await.doing(format!("grab {}", args.token))?;
    tell_grabbed(&args.token, &guard, output)?;
    let until = args.time.map(|time| Instant::now() + time);
    let end = tokio::select! {
        lost = guard.lost() => Err(lost),
        () = interrupt.wait() => Ok(()),
        () = wait(until) => Ok(()),
        error = watch_renewals(&token, output) => {
            // Only writing can fail there; nobody listens any more.
            return Err(error.into());
        }
    };
    let result = match end {
        Ok(()) => {
            guard.release().await.doing(format!("release {}", args.token))?;
            let path = &args.token;
            output.tell(
                || json!({"state": "released", "path": path}),
                || format!("released {path}"),
            )?;
            Ok(())
        }
        Err(lost) => tell_lost(&args.token, &lost, output),
    };
    client.close().await;
    result
}

fn tell_grabbed(path: &str, guard: &TokenGuard, output: Output) -> Result<(), Failure> {
    let fence = words::fence(guard.fence());
    output.tell(
        || {
            let lease = guard
                .lease()
                .map(|lease| u64::try_from(lease.as_millis()).unwrap_or(u64::MAX));
            json!({"state": "grabbed", "path": path, "fence": guard.fence(), "number": fence, "lease": lease})
        },
        || {
            let lease = match guard.lease() {
                Some(lease) => format!(
                    "lease {}, renewed every {}",
                    words::duration(lease),
                    words::duration(lease / 3)
                ),
                None => "no lease".to_owned(),
            };
            let head = ink(format_args!("holding {path}"), Ink::Good);
            format!("{head}  fence {fence}, {lease}")
        },
    )?;
    output.remark(ink("Ctrl-C releases it", Ink::Faint));
    Ok(())
}

fn tell_lost(path: &str, lost: &Lost, output: Output) -> Result<(), Failure> {
    output.tell(
        || json!({"state": "lost", "path": path, "reason": lost.reason, "by": lost.by}),
        || {
            format!(
                "{} {}",
                ink(format_args!("lost {path}:"), Ink::Bad),
                lost_words(lost)
            )
        },
    )?;
    Err(Failure::Told)
}

/// Tells each renewal, as the hub's answer about the lease shows it; ends only if that cannot be written.
async fn watch_renewals(token: &Token, output: Output) -> std::io::Error {
    let mut before: Option<Duration> = None;
    loop {
        let Ok(info) = token.info().await else {
            // Who may not ask does without; a lost link ends the guard.
            return pending().await;
        };
        let Some(lease) = words::millis(info.get("lease")) else {
            return pending().await;
        };
        let left = words::millis(info.get("lease-left")).unwrap_or_default();
        if before.is_some_and(|before| left > before) {
            let told = output.tell(
                || json!({"state": "renewed", "path": token.path().as_str(), "lease-left": left.as_millis() as u64}),
                || ink(format_args!("renewed, {} left", words::duration(left)), Ink::Faint),
            );
            if let Err(error) = told {
                return error;
            }
        }
        before = Some(left);
        sleep((lease / LOOKS_PER_LEASE).clamp(SOONEST, LATEST)).await;
    }
}

async fn wait(until: Option<Instant>) {
    match until {
        Some(until) => sleep_until(until).await,
        None => pending().await,
    }
}
