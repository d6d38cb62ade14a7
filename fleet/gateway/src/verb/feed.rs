//! `mom fleet feed`: hands out commands to a robot that asks for them (W22).

use std::collections::VecDeque;
use std::future::Future;
use std::path::Path;
use std::time::Duration;

use mom_client::Client;
use mom_device::Script;
use mom_drive::{
    Command, Commander, DeviceChannel, Holding, How, Next, Progress, Tell, VerbFailure, WorkEnd, both,
};
use serde_json::json;

use crate::Unit;

/// What is fed to whom.
pub(super) struct Feeding<'a> {
    /// The robot's session.
    pub(super) robot: &'a str,
    pub(super) statements: VecDeque<String>,
    /// For how long each is good.
    pub(super) within: Duration,
}

/// The statements of a file, one each, if all of them can be read.
pub(super) fn statements(file: &Path) -> Result<VecDeque<String>, VerbFailure> {
    let (name, text) = super::steps::text(file)?;
    Script::read::<Unit>(&text).map_err(|error| {
        let (line, column) = error.place().unwrap_or((1, 1));
        VerbFailure::new(
            format!("{name}:{line}:{column}: {error}"),
            "mom fleet send --help lists the statements",
        )
    })?;
    let lines = text
        .lines()
        .map(|line| line.split('#').next().unwrap_or_default());
    let statements = lines.flat_map(|line| line.split(';')).map(str::trim);
    Ok(statements
        .filter(|statement| !statement.is_empty())
        .map(str::to_owned)
        .collect())
}

impl Feeding<'_> {
    /// Grabs the token, hands out one statement after the other, and gives the token back.
    pub(super) async fn run(
        self,
        client: &Client,
        interrupt: impl Future<Output = ()>,
        tell: Tell<'_>,
    ) -> Result<(), VerbFailure> {
        let channel = DeviceChannel::join(client, &format!("{}/robot", self.robot)).await?;
        let token = channel.token()?;
        let token = token.as_str();
        let mut holding = Holding::grab(client, token, None).await?;
        let mut robot = Commander::new(channel, holding.fence());
        let fed = match holding.during(interrupt, self.feed(&mut robot, tell)).await {
            WorkEnd::Ended(fed) => fed,
            WorkEnd::Interrupted => Err(VerbFailure::plain("interrupted; the token is released")),
            WorkEnd::Lost(lost) => return Err(holding.loss(&lost, &mut robot).await),
        };
        both(fed, holding.end(&mut robot).await)
    }

    async fn feed(self, robot: &mut Commander, tell: Tell<'_>) -> Result<(), VerbFailure> {
        for statement in &self.statements {
            robot.begin(Command::from(&**statement).expires(self.within).when_asked());
            let end = loop {
                match robot.next().await {
                    Next::End(end) => break end,
                    Next::Progress(Progress::Again { why, .. }) if why == "late" => tell(
                        json!({"state": "late", "statement": statement}),
                        format!("late      {statement}: not begun in time, handed out again"),
                    )?,
                    // As long as this program's clock is not measured; the robot asks again.
                    Next::Progress(Progress::Again { why, .. }) if why == "try-later" => {}
                    Next::Progress(Progress::Again { why, text }) => tell(
                        json!({"state": "expired", "statement": statement, "error": text}),
                        format!("expired   {statement}: {why}: {text}"),
                    )?,
                    Next::Progress(Progress::Device { .. }) => {}
                }
            };
            match end.how {
                How::Finished(_) => {}
                How::Failed(report) => {
                    let what = format!("have {} do {statement:?}", self.robot);
                    let error = report.wire_error();
                    return Err(VerbFailure::Refused { what, error });
                }
                _ => return end.done(),
            }
            tell(
                json!({"state": "finished", "statement": statement}),
                format!("finished  {statement}"),
            )?;
        }
        Ok(())
    }
}
