//! An agent: it asks for the arm, works, reports, gives the token back, and is interrupted at any moment.
use mom_client::{Client, Event};
use mom_drive::{Commander, DeviceChannel, Doing as _, Holding, WorkEnd, lost_words};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (hub, password) = (std::env::var("MOM_HUB")?, std::env::var("MOM_PASSWORD")?);
    let client = Client::builder(hub).user("assistant").password(password);
    let client = client.connect().await?;
    let (chat, token) = (
        client.channel("/chat").await?,
        client.token("/robot/token").await?,
    );
    let (mut offers, mut quit) = (token.events(), std::pin::pin!(tokio::signal::ctrl_c()));
    // Ask. A person answers by: mom give assistant /robot/token --for 1m --commands 5
    chat.send("chat", "may I have the arm, to wave?").await?;
    while let Some(event) = offers.next().await {
        if matches!(event, Event::Offer { to, .. } if to == client.name()) {
            break;
        }
    }
    let mut holding = Holding::accept(token).await?;
    let mut arm = Commander::new(DeviceChannel::join(&client, "/robot/arm").await?, holding.fence());
    let work = async {
        for height in [350, 250, 300] {
            // Work, and report.
            let end = arm.carry_out(format!("move 0 0 {height} 0 0")).await;
            let words = match end.unreachable()? {
                None => format!("I am at {height} mm"),
                Some(why) => format!("I cannot go to {height} mm: {why}"),
            };
            chat.send("chat", words).await.doing("report")?;
        }
        Ok(())
    };
    // Be interrupted: by a peer that takes the token, by the end of the scope, by Ctrl-C.
    let words = match holding.during(async { drop((&mut quit).await) }, work).await {
        WorkEnd::Ended(Ok(())) => "I am done, thank you".to_owned(),
        WorkEnd::Ended(Err(failure)) => format!("I stop: {failure}"),
        WorkEnd::Lost(lost) => format!("I stop: {}", lost_words("/robot/token", &lost)),
        WorkEnd::Interrupted => "I stop, as I was told to".to_owned(),
    };
    // Return the token, which goes back to the peer that gave it.
    let returned = holding.end(&mut arm).await;
    chat.message("chat").content(words).send_acknowledged().await?;
    client.close().await;
    Ok(returned?)
}
