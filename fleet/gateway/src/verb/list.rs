//! `mom fleet list`.

use std::collections::BTreeSet;
use std::collections::btree_map::{BTreeMap, Entry};
use std::time::Duration;

use mom_client::{Client, ContextKind, Event, Value};
use mom_drive::{Doing as _, Tell, VerbFailure};
use serde_json::{Value as Json, json};
use tokio::time::{Instant, timeout_at};

use super::SAID;
use super::units::Known;

/// For so long no more of what is kept comes where all of it has come.
const QUIET: Duration = Duration::from_millis(100);

/// The numbers of the robots that are there.
pub(super) async fn units(fleet: &str, client: &Client) -> Result<BTreeSet<u32>, VerbFailure> {
    let below = client.list(fleet).await.doing(format!("list {fleet}"))?;
    let units: BTreeSet<u32> = below
        .iter()
        .filter(|context| context.kind == ContextKind::Session)
        .filter_map(|context| context.path.name().parse().ok())
        .collect();
    match units.is_empty() {
        true => Err(VerbFailure::new(
            format!("there are no robots in {fleet}"),
            "start some: mom lab --fleet 10",
        )),
        false => Ok(units),
    }
}

/// What is known of a robot, and how old it is.
struct Row {
    content: Value,
    age_ms: Option<f64>,
}

impl Row {
    /// An unknown age is older than any.
    fn is_newer_than(&self, other: &Row) -> bool {
        match (self.age_ms, other.age_ms) {
            (Some(mine), Some(theirs)) => mine < theirs,
            (mine, _) => mine.is_some(),
        }
    }
}

pub(super) async fn run(fleet: &str, client: &Client, tell: Tell<'_>) -> Result<(), VerbFailure> {
    let units = units(fleet, client).await?;
    let rows = rows(fleet, client, &units).await?;
    for unit in units {
        let row = rows.get(&unit);
        tell(json_of(unit, row), line(unit, row))?;
    }
    Ok(())
}

/// The robots that are there, and those of each group.
pub(super) async fn groups(fleet: &str, client: &Client) -> Result<Known, VerbFailure> {
    let units = units(fleet, client).await?;
    let mut groups: BTreeMap<String, BTreeSet<u32>> = BTreeMap::new();
    for (unit, row) in rows(fleet, client, &units).await? {
        if let Some(group) = row.content.get("group").and_then(Value::as_str) {
            groups.entry(group.to_owned()).or_default().insert(unit);
        }
    }
    Ok(Known { units, groups })
}

/// What is known of each robot.
async fn rows(
    fleet: &str,
    client: &Client,
    units: &BTreeSet<u32>,
) -> Result<BTreeMap<u32, Row>, VerbFailure> {
    let path = format!("{fleet}/status");
    let channel = client.channel(&path).await.doing(format!("join {path}"))?;
    let mut events = channel.events();
    let mut rows: BTreeMap<u32, Row> = BTreeMap::new();
    let patience = Instant::now() + SAID;
    // What is kept comes first and at once; a robot of which nothing is kept has never been heard of. Of one there may be several: what a
    // gateway said that has been killed, or replaced by another, is kept beside what its successor says.
    loop {
        let until = match rows.len() < units.len() {
            true => patience,
            false => patience.min(Instant::now() + QUIET),
        };
        let Ok(Some(event)) = timeout_at(until, events.next()).await else {
            break;
        };
        if let Event::Message(parcel) = event
            && let content = parcel.value()
            && let Some(unit) = content.get("unit").and_then(Value::as_int)
            && let Some(unit) = u32::try_from(unit).ok().filter(|unit| units.contains(unit))
        {
            let age = client.clock().age(&parcel);
            let age_ms = age.map(|age| age.duration().as_secs_f64() * 1000.0);
            let row = Row { content, age_ms };
            match rows.entry(unit) {
                Entry::Occupied(known) if known.get().is_newer_than(&row) => {}
                Entry::Occupied(mut known) => {
                    known.insert(row);
                }
                Entry::Vacant(place) => {
                    place.insert(row);
                }
            }
        }
        if Instant::now() >= patience {
            break;
        }
    }
    Ok(rows)
}

fn json_of(unit: u32, row: Option<&Row>) -> Json {
    let mut json = json!({"unit": unit});
    if let (Some(row), Some(map)) = (row, json.as_object_mut()) {
        if let Ok(Json::Object(content)) = serde_json::to_value(&row.content) {
            map.extend(content);
        }
        map.insert("age-ms".to_owned(), json!(row.age_ms));
    }
    json
}

/// `  7  standing   battery  80 %   2.1 ms  owner alice  at 2500 2500 mm, 90°, 12 ms ago`
fn line(unit: u32, row: Option<&Row>) -> String {
    let Some(Row { content, age_ms }) = row else {
        return format!("{unit:>5}  nothing is known of it");
    };
    let int = |key: &str| content.get(key).and_then(Value::as_int);
    let is = |key: &str| content.get(key).and_then(Value::as_bool) == Some(true);
    let state = match () {
        () if !is("linked") => "lost",
        () if is("stopped") => "stopped",
        () if is("moving") => "moving",
        () => "standing",
    };
    let mut line = format!("{unit:>5}  {state:<8}");
    if let Some(battery) = int("battery") {
        line += &format!("  battery {battery:>3} %");
    }
    if let Some(micros) = int("round-trip") {
        line += &format!("  {:>6.1} ms", micros as f64 / 1000.0);
    }
    if let Some(group) = content.get("group").and_then(Value::as_str) {
        line += &format!("  {group:<8}");
    }
    let owner = content.get("owner").and_then(Value::as_str);
    line += &format!("  {:<12}", owner.unwrap_or("free"));
    match (int("x"), int("y"), int("heading")) {
        // It may have been carried away since.
        _ if !is("linked") => line += "  place unknown, lost",
        (Some(x), Some(y), Some(heading)) => line += &format!("  at {x} {y} mm, {heading}°,"),
        _ => {}
    }
    if let Some(age) = age_ms {
        line += &format!(" {age:.0} ms ago");
    }
    line
}

#[cfg(test)]
mod tests {
    use mom_client::Map;

    use super::*;

    #[test]
    fn nobody_is_told_where_a_lost_robot_was() {
        let row = |linked: bool| Row {
            content: Map::new()
                .with("linked", linked)
                .with("x", 2500)
                .with("y", 500)
                .with("heading", 90)
                .into(),
            age_ms: Some(12.0),
        };
        let said = |linked| line(7, Some(&row(linked)));
        assert_eq!(
            said(true),
            "    7  standing  free          at 2500 500 mm, 90°, 12 ms ago"
        );
        assert_eq!(
            said(false),
            "    7  lost      free          place unknown, lost 12 ms ago"
        );
    }
}
