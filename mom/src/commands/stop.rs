//! `mom stop` and `mom unstop`: all devices of a place, and what each of them says to it.

mod ready;

use std::collections::BTreeMap;
use std::time::Duration;

use mom_client::{
    Client, ClientError, Code, ContextKind, DeviceAnswer, ErrorKind, Path, Rest, Standing, StopReport,
    StopState, Stopping, ToldChannel, event,
};
use serde_json::{Value as Json, json};

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::style::{Tone, ink};
use crate::output::{Output, words};

/// Devices that are told to stop come to rest within so long, or are named.
const REST: Duration = Duration::from_secs(3);
/// Devices that are let go and say nothing for so long are silent.
const PATIENCE: Duration = Duration::from_secs(1);

/// What devices are told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Order {
    Stop,
    Unstop,
}

pub(crate) async fn stop(args: &cli::StopArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let stay = if args.ready { Stay::Ready } else { Stay::Once };
    let client = connect(global, stay)
        .await
        .map_err(|failure| failure.with("nothing was stopped"))?;
    let result = match args.ready {
        true => ready::run(&client, args, output).await,
        false => match stopping(&client, args).send().await {
            Ok(report) => stopped(&report, args.measured, output),
            Err(error) => Err(not_stopped(&args.path, error)),
        },
    };
    client.close().await;
    result
}

fn stopping(client: &Client, args: &cli::StopArgs) -> Stopping {
    let stopping = client.stop(&args.path).within(REST);
    match &args.reason {
        Some(reason) => stopping.reason(reason),
        None => stopping,
    }
}

/// Tells what came of a stop.
fn stopped(report: &StopReport, measured: bool, output: Output) -> Result<(), Failure> {
    tell(Order::Stop, report, &BTreeMap::new(), output)?;
    let has_measured = |(_, answer): &(String, DeviceAnswer)| {
        matches!(
            answer,
            DeviceAnswer::Obeys(Standing {
                rest: Some(Rest::Measured),
                ..
            })
        )
    };
    let mut devices = report.channels.iter().flat_map(|channel| &channel.devices);
    match !measured || devices.all(has_measured) {
        true => Ok(()),
        false => Err(Failure::Told),
    }
}

/// The words for a stop that was not answered.
fn not_stopped(path: &str, error: ClientError) -> Failure {
    let unknown = is_unknown(&error);
    let failure = failed(Order::Stop, path, error);
    match unknown {
        true => failure.with("it is unknown whether anything has stopped"),
        false => failure,
    }
}

/// Whether the hub may have carried out what it did not answer, or has not heard of it.
fn is_unknown(error: &ClientError) -> bool {
    matches!(
        error.kind(),
        ErrorKind::Connection | ErrorKind::TimedOut | ErrorKind::Unknown
    )
}

pub(crate) async fn unstop(
    args: &cli::UnstopArgs,
    global: &GlobalArgs,
    output: Output,
) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    // What holds now is what its user lifts; whatever is said from here on holds on.
    let stops = holding(&client, &args.path).await?;
    let numbers = stops.iter().map(|(path, stop)| (path, stop.number));
    let sent = client.unstop(&args.path, numbers).within(PATIENCE).send().await;
    let report = sent.map_err(|error| failed(Order::Unstop, &args.path, error))?;
    client.close().await;
    tell(Order::Unstop, &report, &stops, output)
}

fn failed(order: Order, path: &str, error: ClientError) -> Failure {
    match error.wire().is_some_and(|error| error.code == Code::WRONG_KIND) {
        true => Failure::usage(
            format!("{path} is a token; devices are in channels"),
            "see which channel it guards with: mom tree",
        ),
        false => Failure::of_client(format!("{} {path}", order.word()), error),
    }
}

/// The stops that hold in a channel, or in those below a session; of a channel also the one that holds no more, as its device may
/// not know.
async fn holding(client: &Client, path: &str) -> Result<BTreeMap<Path, StopState>, Failure> {
    let what = format!("unstop {path}");
    let top = client.lookup(path).await.doing(&what)?;
    let mut stops = BTreeMap::new();
    let mut sessions = match top.kind {
        ContextKind::Channel => {
            let state = client.stops(path).await.doing(&what)?;
            return Ok(BTreeMap::from([(top.path, state)]));
        }
        ContextKind::Session => vec![top.path],
        ContextKind::Token => Vec::new(),
    };
    while let Some(session) = sessions.pop() {
        let children = match client.list(session.as_str()).await {
            Ok(children) => children,
            Err(ClientError::Refused(_)) => continue,
            Err(error) => return Err(Failure::of_client(what, error)),
        };
        for child in children {
            match (child.kind, child.stop) {
                (ContextKind::Session, _) => sessions.push(child.path),
                (ContextKind::Channel, Some(stop)) => drop(stops.insert(child.path, stop)),
                _ => {}
            }
        }
    }
    Ok(stops)
}

impl Order {
    fn word(self) -> &'static str {
        match self {
            Order::Stop => event::STOP,
            Order::Unstop => event::UNSTOP,
        }
    }

    /// For how long devices are waited for.
    fn patience(self) -> Duration {
        match self {
            Order::Stop => REST,
            Order::Unstop => PATIENCE,
        }
    }
}

/// Tells what came of it; fails unless every device has obeyed.
fn tell(
    order: Order,
    report: &StopReport,
    lifted: &BTreeMap<Path, StopState>,
    output: Output,
) -> Result<(), Failure> {
    for channel in &report.channels {
        output.tell(
            || json_of(channel),
            || line(order, channel, lifted.get(&channel.path)),
        )?;
    }
    for path in &report.denied {
        output.tell(
            || json!({"path": path.as_str(), "denied": true}),
            || ink(format!("you may not {} {path}", order.word()), Tone::Bad),
        )?;
    }
    if report.channels.is_empty() && report.others == 0 {
        return match order {
            Order::Unstop if lifted.is_empty() => Err(Failure::new(
                "nothing is stopped there",
                "see what there is with: mom tree; whether the emergency stop of a device is pressed, its state says: mom watch PATH",
            )),
            _ => Err(Failure::new(
                format!("there is nothing here that you may {}", order.word()),
                "see what there is with: mom tree",
            )),
        };
    }
    if report.others > 0 && !output.is_json() {
        let others = words::count(report.others, "channel");
        output.human(ink(format!("and {others} without a device"), Tone::Faint))?;
    }
    if order == Order::Stop && report.channels.is_empty() && report.denied.is_empty() {
        return Err(Failure::new(
            "no device is there, so nothing is known to stand",
            "see what there is with: mom tree",
        ));
    }
    // What is held by its own emergency stop is not free, though the stop is lifted.
    let is_held = |(_, answer): &(String, DeviceAnswer)| {
        order == Order::Unstop && matches!(answer, DeviceAnswer::Obeys(Standing { estop: true, .. }))
    };
    let is_obeyed = |channel: &ToldChannel| channel.is_obeyed() && !channel.devices.iter().any(is_held);
    match report.denied.is_empty() && report.channels.iter().all(is_obeyed) {
        true => Ok(()),
        false => Err(Failure::Told),
    }
}

/// What a device does that has obeyed, and whether that is good.
fn obeys(order: Order, standing: Standing) -> (&'static str, Tone) {
    match (order, standing) {
        (Order::Unstop, Standing { estop: true, .. }) => (
            "does not move: reset its emergency stop there, then unstop it once more",
            Tone::Bad,
        ),
        (Order::Unstop, _) => ("may move", Tone::Good),
        (_, Standing { unreached: true, .. }) => ("obeys, and cannot reach what it moves", Tone::Bad),
        (_, Standing { moving: true, .. }) => ("obeys, and still moves", Tone::Bad),
        (
            _,
            Standing {
                rest: Some(Rest::Measured),
                ..
            },
        ) => ("stands", Tone::Good),
        (
            _,
            Standing {
                rest: Some(Rest::NotMeasured),
                ..
            },
        ) => (
            "stands, by the time in which it stops: it does not measure",
            Tone::Good,
        ),
        (_, Standing { rest: None, .. }) => ("obeys; whether it stands it does not say", Tone::Good),
    }
}

fn json_of(channel: &ToldChannel) -> Json {
    let those = |is_meant: &dyn Fn(DeviceAnswer) -> bool| -> Vec<&str> {
        let devices = channel.devices.iter().filter(|(_, said)| is_meant(*said));
        devices.map(|(name, _)| name.as_str()).collect()
    };
    let standing = |is_meant: &dyn Fn(Standing) -> bool| {
        those(&|said| matches!(said, DeviceAnswer::Obeys(standing) if is_meant(standing)))
    };
    let newer = channel
        .newer
        .iter()
        .map(|stop| json!({"by": stop.by, "number": stop.number, "reason": stop.reason}));
    json!({
        "path": channel.path.as_str(),
        "number": channel.number,
        "obeyed": standing(&|_| true),
        "measured": standing(&|standing| standing.rest == Some(Rest::Measured)),
        "moving": standing(&|standing| standing.moving),
        "unreached": standing(&|standing| standing.unreached),
        "estop": standing(&|standing| standing.estop),
        "silent": those(&|said| said == DeviceAnswer::Silent),
        "lost": those(&|said| said == DeviceAnswer::Lost),
        "kept": channel.kept,
        "newer": newer.collect::<Vec<_>>(),
        "error": channel.error,
    })
}

fn line(order: Order, channel: &ToldChannel, lifted: Option<&StopState>) -> String {
    let those = |is_meant: &dyn Fn(DeviceAnswer) -> bool| {
        let devices = channel.devices.iter().filter(|(_, said)| is_meant(*said));
        let names: Vec<String> = devices.map(|(name, _)| words::visible(name)).collect();
        (!names.is_empty()).then(|| names.join(", "))
    };
    let named = |answer: DeviceAnswer| those(&|said| said == answer);
    let mut parts = Vec::new();
    if let Some(error) = &channel.error {
        let text = match order {
            Order::Stop => format!("it cannot be kept ({error}): a restart of the hub forgets it"),
            Order::Unstop => format!("stays stopped: {error}"),
        };
        parts.push(ink(text, Tone::Bad));
    }
    for stop in &channel.newer {
        let text = format!("stays stopped: {} again meanwhile", words::stopped_by(stop));
        parts.push(ink(text, Tone::Bad));
    }
    if let Some(names) = named(DeviceAnswer::Silent) {
        parts.push(ink(
            format!("{names} said nothing within {:?}", order.patience()),
            Tone::Bad,
        ));
    }
    if let Some(names) = named(DeviceAnswer::Lost) {
        let text = format!(
            "the connection of {names} is lost; {}",
            finds(order, channel.kept)
        );
        parts.push(ink(text, Tone::Bad));
    }
    let mut told = BTreeMap::new();
    for (_, said) in &channel.devices {
        if let DeviceAnswer::Obeys(standing) = said {
            let (words, tone) = obeys(order, *standing);
            told.insert(words, tone);
        }
    }
    for (words, tone) in told {
        let says = |said| matches!(said, DeviceAnswer::Obeys(standing) if obeys(order, standing).0 == words);
        let names = those(&says).unwrap_or_default();
        parts.push(ink(format!("{names} {words}"), tone));
    }
    let nobody = channel.devices.is_empty() && (order == Order::Stop || channel.error.is_none());
    if nobody && channel.newer.is_empty() {
        parts.push(ink(
            format!("no device is there; {}", finds(order, channel.kept)),
            Tone::Bad,
        ));
    }
    if let Some(stop) = lifted.filter(|stop| stop.stopped && channel.newer.is_empty()) {
        parts.push(ink(format!("was {}", words::stopped_by(stop)), Tone::Faint));
    }
    format!("{}: {}", ink(&channel.path, Tone::Place), parts.join("; "))
}

/// What who is not there will find.
fn finds(order: Order, kept: bool) -> &'static str {
    match (order, kept) {
        (Order::Stop, true) => "it will find it stopped",
        (Order::Stop, false) => "it will find it stopped, unless the hub restarts before",
        (Order::Unstop, _) => "it will find it free",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(devices: &[(&str, DeviceAnswer)]) -> ToldChannel {
        ToldChannel {
            path: Path::parse("/robot/arm").expect("a path"),
            number: 7,
            guarded: true,
            kept: true,
            devices: devices
                .iter()
                .map(|(name, answer)| ((*name).to_owned(), *answer))
                .collect(),
            newer: Vec::new(),
            error: None,
        }
    }

    /// The line without its colours, which another test may have turned on.
    fn line(order: Order, channel: &ToldChannel, lifted: Option<&StopState>) -> String {
        let line = super::line(order, channel, lifted);
        anstream::adapter::strip_str(&line).to_string()
    }

    /// That it rests, as measured.
    fn measured() -> DeviceAnswer {
        DeviceAnswer::Obeys(Standing {
            rest: Some(Rest::Measured),
            ..Standing::default()
        })
    }

    #[test]
    fn what_obeys_is_not_said_to_stand_before_it_does() {
        for (standing, words) in [
            (Standing::default(), "obeys; whether it stands it does not say"),
            (
                Standing {
                    rest: Some(Rest::NotMeasured),
                    ..Standing::default()
                },
                "stands, by the time in which it stops: it does not measure",
            ),
            (
                Standing {
                    moving: true,
                    ..Standing::default()
                },
                "obeys, and still moves",
            ),
            (
                Standing {
                    moving: true,
                    unreached: true,
                    ..Standing::default()
                },
                "obeys, and cannot reach what it moves",
            ),
        ] {
            let channel = told(&[("arm", DeviceAnswer::Obeys(standing)), ("hand", measured())]);
            let told = line(Order::Stop, &channel, None);
            assert!(
                told.contains(&format!("arm {words}")) && told.contains("hand stands"),
                "{told}"
            );
            assert_eq!(channel.is_obeyed(), !standing.moving, "{told}");
        }
    }

    #[test]
    fn a_line_says_what_is_known() {
        let bob = StopState {
            stopped: true,
            by: Some("bob".to_owned()),
            reason: Some("smoke".to_owned()),
            ..StopState::default()
        };
        let measured = measured();
        let obeys = told(&[("arm", measured)]);
        assert_eq!(line(Order::Stop, &obeys, None), "/robot/arm: arm stands");
        assert_eq!(
            line(Order::Unstop, &obeys, Some(&bob)),
            "/robot/arm: arm may move; was stopped by bob (smoke)"
        );
        let pressed = DeviceAnswer::Obeys(Standing {
            estop: true,
            ..Standing::default()
        });
        assert_eq!(
            line(Order::Unstop, &told(&[("arm", pressed)]), None),
            "/robot/arm: arm does not move: reset its emergency stop there, then unstop it once more"
        );
        let some = told(&[("arm", measured), ("mute", DeviceAnswer::Silent)]);
        assert_eq!(
            line(Order::Stop, &some, None),
            "/robot/arm: mute said nothing within 3s; arm stands"
        );
        let lost = told(&[("arm", DeviceAnswer::Lost)]);
        assert_eq!(
            line(Order::Stop, &lost, None),
            "/robot/arm: the connection of arm is lost; it will find it stopped"
        );
        let mut nobody = told(&[]);
        assert_eq!(
            line(Order::Stop, &nobody, None),
            "/robot/arm: no device is there; it will find it stopped"
        );
        nobody.kept = false;
        assert_eq!(
            line(Order::Stop, &nobody, None),
            "/robot/arm: no device is there; it will find it stopped, unless the hub restarts before"
        );
        nobody.newer = vec![bob.clone()];
        assert_eq!(
            line(Order::Unstop, &nobody, Some(&bob)),
            "/robot/arm: stays stopped: stopped by bob (smoke) again meanwhile"
        );
        assert!(!nobody.is_obeyed() && !some.is_obeyed() && !lost.is_obeyed() && obeys.is_obeyed());
    }
}
