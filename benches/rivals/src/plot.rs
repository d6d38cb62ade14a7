//! Bars in groups, as SVG, on a logarithmic scale: rates and delays here differ by powers of ten.

use std::fmt::Write as _;

use crate::brokers::Kind;
use crate::metric::Metric;
use crate::run::Outcome;

const WIDTH: f64 = 900.0;
const TOP: f64 = 60.0;
const HEIGHT: f64 = 320.0;
const LEFT: f64 = 70.0;
const BOTTOM: f64 = 80.0;

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
    let has = |kind: &Kind| {
        outcomes
            .iter()
            .any(|outcome| outcome.value(*kind, metric).is_some())
    };
    let hubs: Vec<Kind> = Kind::ALL.into_iter().filter(has).collect();
    let groups: Vec<&Outcome> = outcomes
        .iter()
        .copied()
        .filter(|outcome| hubs.iter().any(|kind| outcome.value(*kind, metric).is_some()))
        .collect();
    let figures = groups
        .iter()
        .flat_map(|outcome| hubs.iter().filter_map(|kind| outcome.value(*kind, metric)))
        .filter(|value| *value > 0.0);
    let (least, most) = figures.fold((f64::INFINITY, 0.0_f64), |(least, most), value| {
        (least.min(value), most.max(value))
    });
    if !least.is_finite() {
        return None;
    }
    let decades = Decades {
        first: least.log10().floor(),
        last: most.log10().ceil().max(least.log10().floor() + 1.0),
    };
    let mut out = head(title);
    decades.lines(&mut out, metric);
    let group = (WIDTH - LEFT) / groups.len() as f64;
    let figures = |outcome: &Outcome| -> Vec<(Kind, f64)> {
        let with = |kind: &Kind| Some((*kind, outcome.value(*kind, metric)?));
        hubs.iter()
            .filter_map(with)
            .filter(|(_, value)| *value > 0.0)
            .collect()
    };
    let most = groups.iter().map(|outcome| figures(outcome).len()).max();
    let bar = group * 0.85 / most.unwrap_or(1).max(1) as f64;
    for (number, outcome) in groups.iter().enumerate() {
        let x = LEFT + group * number as f64;
        for (place, (kind, value)) in figures(outcome).into_iter().enumerate() {
            let y = decades.y(value);
            // Writing to a String cannot fail.
            let _ = writeln!(
                out,
                "<rect x=\"{:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{}\"><title>{}: {}</title></rect>",
                x + bar * place as f64,
                bar * 0.92,
                TOP + HEIGHT - y,
                colour(kind),
                kind.name(),
                metric.show(value)
            );
        }
        // One line for each part of the name, so that neighbours do not meet.
        for (line, part) in outcome.row.name.split(", ").enumerate() {
            let _ = writeln!(
                out,
                "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{part}</text>",
                x + group * 0.42,
                TOP + HEIGHT + 16.0 + 12.0 * line as f64
            );
        }
    }
    legend(&mut out, &hubs);
    Some(out + "</svg>\n")
}

fn head(title: &str) -> String {
    let height = TOP + HEIGHT + BOTTOM;
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" font-family=\"sans-serif\" \
         font-size=\"11\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <text x=\"{LEFT}\" y=\"24\" font-size=\"15\">{title}</text>\n"
    )
}

fn legend(out: &mut String, hubs: &[Kind]) {
    for (place, kind) in hubs.iter().enumerate() {
        let x = LEFT + 95.0 * place as f64;
        let y = TOP + HEIGHT + 58.0;
        let _ = writeln!(
            out,
            "<rect x=\"{x}\" y=\"{y}\" width=\"11\" height=\"11\" fill=\"{}\"/><text x=\"{}\" y=\"{}\">{}</text>",
            colour(*kind),
            x + 16.0,
            y + 10.0,
            kind.name()
        );
    }
}

/// The powers of ten between which all figures lie.
struct Decades {
    first: f64,
    last: f64,
}

impl Decades {
    fn y(&self, value: f64) -> f64 {
        let part = (value.log10() - self.first) / (self.last - self.first);
        TOP + HEIGHT * (1.0 - part)
    }

    fn lines(&self, out: &mut String, metric: Metric) {
        let mut power = self.first;
        while power <= self.last {
            let value = 10_f64.powf(power);
            let y = self.y(value);
            let _ = writeln!(
                out,
                "<line x1=\"{LEFT}\" y1=\"{y:.1}\" x2=\"{WIDTH}\" y2=\"{y:.1}\" stroke=\"#dddddd\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                LEFT - 6.0,
                y + 4.0,
                metric.show(value)
            );
            power += 1.0;
        }
    }
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
        assert!(plot.contains(&format!("y=\"{TOP:.1}\" width")), "{plot}");
        assert!(bars("delays", &[&outcome], Metric::P50).is_none());
    }
}
