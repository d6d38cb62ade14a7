//! The experiments of the papers, run again: one entry of [`ALL`] each, with what they take as given labelled as such.

mod calibration;
mod connect;
mod far_hub;
mod faults;
mod fleet;
mod hand;
mod lab_link;
mod links;
mod path;
mod reach;
mod rsp;
mod servo;
mod stop_in_image;
mod token_table;
mod tracking;
mod trips;

use std::path::PathBuf;

use anyhow::Result;
use tokio::runtime::{Builder, Runtime};

/// How an experiment is run.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The same seed draws the same inputs.
    pub seed: u64,
    /// Less of everything, to see that it still works.
    pub quick: bool,
    /// The broker's program.
    pub broker: PathBuf,
}

/// What an experiment came to.
#[derive(Debug)]
pub struct Section {
    /// Its text, with the plots.
    pub markdown: String,
    /// Its plots, by the names of their files.
    pub plots: Vec<(&'static str, String)>,
}

/// One experiment.
#[derive(Debug)]
pub struct Experiment {
    /// Its name, also that of its part of the document.
    pub name: &'static str,
    /// Runs it.
    pub run: fn(&Settings) -> Result<Section>,
}

/// All experiments, in the order of the document.
pub const ALL: [Experiment; 20] = [
    Experiment {
        name: "reach",
        run: reach::run,
    },
    Experiment {
        name: "connect",
        run: connect::run,
    },
    Experiment {
        name: "round-trip",
        run: trips::run,
    },
    Experiment {
        name: "path",
        run: path::run,
    },
    Experiment {
        name: "tracking",
        run: tracking::run,
    },
    Experiment {
        name: "token-table",
        run: token_table::run,
    },
    Experiment {
        name: "calibration",
        run: calibration::run,
    },
    Experiment {
        name: "stop-in-image",
        run: stop_in_image::run,
    },
    Experiment {
        name: "servo",
        run: servo::run,
    },
    Experiment {
        name: "lab-link",
        run: lab_link::run,
    },
    Experiment {
        name: "fleet-trips",
        run: fleet::trips::run,
    },
    Experiment {
        name: "fleet-rates",
        run: fleet::rates::run,
    },
    Experiment {
        name: "fleet-lost",
        run: fleet::lost::run,
    },
    Experiment {
        name: "fleet-many",
        run: fleet::many::run,
    },
    Experiment {
        name: "fleet-beside",
        run: fleet::beside::run,
    },
    Experiment {
        name: "rsp-sizes",
        run: rsp::sizes::run,
    },
    Experiment {
        name: "rsp-path",
        run: rsp::path::run,
    },
    Experiment {
        name: "rsp-filter",
        run: rsp::filter::run,
    },
    Experiment {
        name: "rsp-acks",
        run: rsp::acks::run,
    },
    Experiment {
        name: "rsp-delay",
        run: rsp::delay::run,
    },
];

/// How the plots of all experiments begin their names.
pub const IMAGES: &str = "experiment";

/// What stands before an experiment's part of the document, and after it.
pub fn marks(name: &str) -> (String, String) {
    let mark = |word| format!("<!-- experiment {name}: {word} -->");
    (mark("begin"), mark("end"))
}

/// A runtime of this thread alone.
fn runtime() -> std::io::Result<Runtime> {
    Builder::new_current_thread().enable_all().build()
}

/// The value that this share of the sorted values does not exceed.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let at = (sorted.len() as f64 * share).ceil() as usize;
    let at = at.clamp(1, sorted.len().max(1)) - 1;
    sorted.get(at).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles() {
        let sorted = [1.0, 2.0, 3.0, 4.0];
        assert_eq!(
            [0.0, 0.5, 0.75, 1.0].map(|share| quantile(&sorted, share)),
            [1.0, 2.0, 3.0, 4.0]
        );
        assert!(quantile(&[], 0.5).is_nan());
    }

    #[test]
    fn names_are_unique() {
        let mut names = ALL.map(|experiment| experiment.name).to_vec();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), ALL.len());
    }
}
