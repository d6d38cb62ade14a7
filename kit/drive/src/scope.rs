//! How long an agent may work: as long as its scope, and its principal, who lent it the token.

use std::future::pending;
use std::time::Duration;

use mom_client::{Event, Loan, Lost, Token};
use tokio::time::{Instant, sleep_until};

use crate::lost_words;

/// So long the hub may need to say that a scope is used up.
const HUB: Duration = Duration::from_millis(500);

/// Waits until what was lent since then is at its end though the hub has not said so: its time is over by our own clock, or who lent it
/// has left. Gives the reason in words. Never done for a token that was not lent.
pub async fn beyond_scope(token: &Token, loan: Option<&Loan>, since: Instant) -> String {
    let Some(loan) = loan else {
        return pending().await;
    };
    let over = async {
        match loan.time {
            Some(time) => sleep_until(since + time + HUB).await,
            None => pending().await,
        }
    };
    tokio::select! {
        () = over => format!("{}; the hub has not said so", used_up(loan)),
        () = orphaned(token, &loan.from) => format!("{}, who lent {}, has left", loan.from, token.path()),
    }
}

/// Waits until who lent the token has left it: then it returns to nobody.
async fn orphaned(token: &Token, from: &str) {
    let mut events = token.events();
    loop {
        // Of a loan without a giver the hub names none. A question that fails tells nothing; a lost link ends the work otherwise.
        if let Ok(info) = token.info().await
            && mom_client::TokenInfo::read(&info).delegated.is_none()
        {
            return;
        }
        loop {
            match events.next().await {
                Some(Event::Left(member)) if member.peer == from => return,
                // Where many are, the hub tells how many.
                Some(Event::Count(_) | Event::Lagged(_)) => break,
                Some(_) => {}
                None => return pending().await,
            }
        }
    }
}

/// Why a token is gone, in words; that a scope is used up, where the hub took it back by itself.
#[must_use]
pub fn scope_end_words(token: &str, lost: &Lost, loan: Option<&Loan>) -> String {
    match loan.filter(|_| lost.reason == "returned" && lost.by.is_none()) {
        Some(loan) => format!("lost {token}: returned, as {}", used_up(loan)),
        None => lost_words(token, lost),
    }
}

fn used_up(loan: &Loan) -> String {
    let limits = [
        loan.time.map(|time| format!("{} s", time.as_secs_f64())),
        loan.commands.map(|count| format!("{count} commands")),
    ];
    let limits: Vec<String> = limits.into_iter().flatten().collect();
    format!("the scope is used up: {}", limits.join(" or "))
}
