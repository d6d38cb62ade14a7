//! The program in README: one command to the lab's arm, by who holds its token.
use mom_client::Client;

#[rustfmt::skip]
#[tokio::main]
async fn main() -> Result<(), mom_client::ClientError> {
    let client = Client::builder(hub()).user("alice").password("alice").connect().await?;
    let (arm, token) = (client.channel("/robot/arm").await?, client.token("/robot/token").await?);
    let guard = token.grab().await?; // refused: held by bob at level 1, yours is 1; the lease ends in 179 s …
    arm.message("command").content("grip open").fence(guard.fence()).send_acknowledged().await?;
    guard.release().await // and the hub halts the arm
}

/// The lab's address in README; a test has another.
fn hub() -> String {
    std::env::var("MOM_HUB").unwrap_or_else(|_| "mom://localhost".to_owned())
}
