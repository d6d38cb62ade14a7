//! M58: who reaches the hub. Of 1339 hosts 177 could not open a socket to the paper's.

use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context as _, Result};
use mom_client::{Address, NetError, Probe};
use mom_plots::{Bar, Bars, Group, plain};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio::time::timeout;

use super::faults::{Fault, Faults};
use super::{IMAGES, Section, Settings};
use mom_benches::{broker_folder, start_broker};

/// Hosts of the paper.
const HOSTS: usize = 1339;
/// The doors without a tunnel, in the order in which a client tries them.
const DIRECT: [&str; 2] = ["bin", "tcp"];
/// The tunnel, where the client has one.
const TUNNEL: &str = "http";
/// How long a client waits at a door.
const PATIENCE: Duration = Duration::from_secs(1);
/// Clients at once.
const AT_ONCE: usize = 32;

/// What a tunnel through HTTP is taken to heal: a firewall that blocks a port, silently or by a refusal, lets HTTP pass.
const HEALED: [Fault; 2] = [Fault::TimedOut, Fault::Refused];

/// How clients fared: none = well.
type Fared = Vec<Option<Fault>>;

pub(super) fn run(settings: &Settings) -> Result<Section> {
    let (folder, faults) = (broker_folder()?, Arc::new(Faults::new()?));
    let broker = start_broker(&settings.broker, &folder)?;
    let inputs = inputs(settings);
    let hub = broker.address().to_owned();
    let runtime = super::runtime()?;
    let fare = |tunnel| runtime.block_on(all(&inputs, &hub, &faults, tunnel));
    let direct = fare(false)?;
    // Until the client has that door there is nothing to measure.
    let tunnel = format!("{TUNNEL}://{hub}").parse::<Address>().is_ok();
    let tunnelled = tunnel.then(|| fare(true)).transpose()?;
    Ok(Section {
        markdown: markdown(&inputs, &direct, tunnelled.as_ref()),
        plots: plot(&direct, tunnelled.as_ref())
            .map(|plot| ("experiment-reach.svg", plot))
            .into_iter()
            .collect(),
    })
}

/// What is in the way of each client, shuffled.
fn inputs(settings: &Settings) -> Fared {
    let share = if settings.quick { 16 } else { 1 };
    let faults = Fault::ALL.into_iter();
    let mut inputs: Fared = faults
        .flat_map(|fault| std::iter::repeat_n(Some(fault), fault.in_paper().div_ceil(share)))
        .collect();
    inputs.resize(HOSTS / share, None);
    fastrand::Rng::with_seed(settings.seed).shuffle(&mut inputs);
    inputs
}

/// Has every client try its doors.
async fn all(inputs: &Fared, hub: &str, faults: &Arc<Faults>, tunnel: bool) -> Result<Fared> {
    let places = Arc::new(Semaphore::new(AT_ONCE));
    let mut clients = JoinSet::new();
    for (number, fault) in inputs.iter().copied().enumerate() {
        let (places, faults, hub) = (Arc::clone(&places), Arc::clone(faults), hub.to_owned());
        clients.spawn(async move {
            let _place = places.acquire().await;
            let host = fault.map_or_else(|| hub.clone(), |fault| faults.host(fault, number));
            let mut doors: Vec<String> = DIRECT.iter().map(|scheme| format!("{scheme}://{host}")).collect();
            if tunnel {
                let heals = fault.is_some_and(|fault| HEALED.contains(&fault));
                doors.push(format!("{TUNNEL}://{}", if heals { &hub } else { &host }));
            }
            fare(&doors).await
        });
    }
    let mut fared = Fared::new();
    while let Some(client) = clients.join_next().await {
        fared.push(client??);
    }
    Ok(fared)
}

/// Tries one door after the other; gives what was in the way of the first, if none opens.
async fn fare(doors: &[String]) -> Result<Option<Fault>> {
    let mut first = None;
    for door in doors {
        let address: Address = door.parse()?;
        let tried = timeout(PATIENCE, async {
            Probe::connect(&address, None).await?.ping(0).await
        });
        let fault = match tried.await {
            Ok(Ok(_)) => return Ok(None),
            Ok(Err(NetError::Io(error))) => {
                Fault::seen(&error).with_context(|| format!("{door} fails in no known way: {error}"))?
            }
            Ok(Err(error)) => return Err(error).context(door.clone()),
            Err(_) => Fault::TimedOut,
        };
        first = first.or(Some(fault));
    }
    Ok(first)
}

fn count(fared: &Fared, fault: Option<Fault>) -> usize {
    fared.iter().filter(|fared| **fared == fault).count()
}

fn markdown(inputs: &Fared, direct: &Fared, tunnelled: Option<&Fared>) -> String {
    let of = |number: usize, all: usize| format!("{number} ({:.2} %)", 100.0 * number as f64 / all as f64);
    let mut text = format!(
        "{} virtual clients, each with the fault that is drawn for it, try the doors {}{} of a broker in this order; a client waits \
         {} s at each. A fault is a socket that behaves so: a name that no resolver knows, a listener with a full queue, a port \
         where nobody listens, an address without a route, a connection that is reset.\n\n",
        inputs.len(),
        DIRECT.map(|scheme| format!("`{scheme}://`")).join(", "),
        if tunnelled.is_some() {
            format!(", `{TUNNEL}://`")
        } else {
            String::new()
        },
        PATIENCE.as_secs(),
    );
    text += "**Inputs:** the paper's counts of faults";
    if tunnelled.is_some() {
        text += ", and which of them the tunnel heals: *timed out* and *refused*. A firewall that blocks a port, in silence or with \
                 a refusal, lets HTTP through, by which all of the paper's clients had fetched the applet before. A name that is \
                 unknown stays unknown; *unreachable* and *reset* are taken to stay as well, though some of them are firewalls";
    }
    text += ".\n\n| | paper | without tunnel |";
    text += if tunnelled.is_some() {
        " with tunnel |\n|---|---:|---:|---:|\n"
    } else {
        "\n|---|---:|---:|\n"
    };
    let rows = std::iter::once(None).chain(Fault::ALL.into_iter().map(Some));
    for fault in rows {
        let (name, paper) = match fault {
            None => (
                "connected",
                HOSTS - Fault::ALL.iter().map(|fault| fault.in_paper()).sum::<usize>(),
            ),
            Some(fault) => (fault.name(), fault.in_paper()),
        };
        let columns = [Some(direct), tunnelled].into_iter().flatten();
        let columns: String = columns
            .map(|fared| format!(" {} |", of(count(fared, fault), fared.len())))
            .collect();
        // Writing to a String cannot fail.
        let _ = writeln!(text, "| {name} | {} |{columns}", of(paper, HOSTS));
    }
    text += "\nThe column without tunnel shows that clients see each fault as what it is; how many there are is the paper's count.\n";
    if tunnelled.is_none() {
        text +=
            "The client has no tunnel yet; its column is measured through that door as soon as it has one.\n";
    }
    let _ = writeln!(text, "\n![Clients by how they fared](images/{IMAGES}-reach.svg)");
    text
}

fn plot(direct: &Fared, tunnelled: Option<&Fared>) -> Option<String> {
    let bar = |name, colour, value: usize| Bar {
        name,
        colour,
        value: value as f64,
    };
    let faults = std::iter::once(None).chain(Fault::ALL.into_iter().map(Some));
    let groups = faults.map(|fault| {
        let paper = match fault {
            None => 1162,
            Some(fault) => fault.in_paper(),
        };
        let mut bars = vec![
            bar("paper", "#a6a6a6", paper),
            bar("without tunnel", "#c1272d", count(direct, fault)),
        ];
        bars.extend(tunnelled.map(|fared| bar("with tunnel", "#0083cc", count(fared, fault))));
        Group {
            name: fault.map_or("connected", Fault::name),
            bars,
        }
    });
    let bars = Bars {
        title: "Clients by how they fared (M58)",
        groups: groups.collect(),
    };
    bars.to_svg(plain)
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    fn settings(quick: bool) -> Settings {
        Settings {
            seed: 1,
            quick,
            broker: PathBuf::new(),
        }
    }

    #[test]
    fn inputs_are_the_papers() {
        let inputs = inputs(&settings(false));
        assert_eq!(inputs.len(), HOSTS);
        assert_eq!(count(&inputs, None), 1162);
        for fault in Fault::ALL {
            assert_eq!(count(&inputs, Some(fault)), fault.in_paper());
        }
        assert_ne!(inputs.first(), inputs.iter().find(|input| **input != inputs[0]));
    }

    #[test]
    fn the_table_is_beside_the_paper() {
        let inputs = inputs(&settings(false));
        let text = markdown(&inputs, &inputs, None);
        assert!(
            text.contains("| connected | 1162 (86.78 %) | 1162 (86.78 %) |\n"),
            "{text}"
        );
        assert!(
            text.contains("| refused | 39 (2.91 %) | 39 (2.91 %) |\n"),
            "{text}"
        );
        assert!(!text.contains("with tunnel |"), "{text}");
        let healed: Fared = inputs
            .iter()
            .map(|fault| fault.filter(|fault| !HEALED.contains(fault)))
            .collect();
        let text = markdown(&inputs, &inputs, Some(&healed));
        assert!(
            text.contains("| connected | 1162 (86.78 %) | 1162 (86.78 %) | 1257 (93.88 %) |"),
            "{text}"
        );
    }
}
