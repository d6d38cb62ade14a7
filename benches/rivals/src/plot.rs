//! The bars of the comparison: a group for each scenario, a colour for each hub.

use mom_plots::{Bar, Bars, Group};

use crate::brokers::Kind;
use crate::metric::Metric;
use crate::run::Outcome;

fn colour(kind: Kind) -> &'static str {
    match kind {
        Kind::RawRelay => "#d9d9d9",
        Kind::Relay => "#a6a6a6",
        Kind::Mom | Kind::MomXml => "#c1272d",
        Kind::Nats => "#0072b2",
        Kind::Redis => "#e69f00",
        Kind::Mosquitto => "#009e73",
        Kind::Zenoh => "#56b4e9",
        Kind::Prosody => "#cc79a7",
    }
}

/// A plot of one quantity: a group of bars for each scenario that has it. None without any figure.
pub fn bars(title: &str, outcomes: &[&Outcome], metric: Metric) -> Option<String> {
    let of = |outcome: &Outcome| -> Vec<Bar<'static>> {
        let bar = |kind: Kind| {
            Some(Bar {
                name: kind.name(),
                colour: colour(kind),
                value: outcome.value(kind, metric)?,
            })
        };
        Kind::ALL.into_iter().filter_map(bar).collect()
    };
    let group = |outcome: &&Outcome| Group {
        name: outcome.row.name,
        bars: of(outcome),
    };
    let groups = outcomes.iter().map(group).filter(|group| !group.bars.is_empty());
    let bars = Bars {
        title,
        groups: groups.collect(),
    };
    bars.to_svg(|value| metric.show(value))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::metric::Sample;
    use crate::plan::ROWS;

    #[test]
    fn bars_end_where_their_figures_are() {
        let sample = |rate| vec![Sample::from([(Metric::Rate, rate)])];
        let outcome = Outcome {
            row: ROWS[0],
            samples: BTreeMap::from([(Kind::Mom, sample(1e6)), (Kind::Redis, sample(1e5))]),
            failures: BTreeMap::new(),
            notes: BTreeMap::new(),
        };
        let plot = bars("rates", &[&outcome], Metric::Rate).unwrap();
        assert!(plot.contains("<title>MOM: 1.00 M</title>"), "{plot}");
        assert!(plot.contains("<title>redis: 100 k</title>"), "{plot}");
        assert!(bars("delays", &[&outcome], Metric::P50).is_none());
    }
}
