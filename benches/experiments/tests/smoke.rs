//! Each experiment, small: figures mean nothing here, what the page says of them does.

use std::path::PathBuf;

use mom_experiments::{ALL, Section, Settings};

/// An experiment of this name, small, with the real broker; none where it needs what only root may make.
fn experiment(name: &str) -> Option<Section> {
    small(name, mom_tests::programs::program("mom-broker"))
}

/// One that has no use for a broker, whose programs need not be built for it.
fn without_broker(name: &str) -> Section {
    small(name, PathBuf::new()).expect("it needs no links")
}

fn small(name: &str, broker: PathBuf) -> Option<Section> {
    let settings = Settings {
        seed: 1,
        quick: true,
        broker,
    };
    let experiment = ALL.iter().find(|experiment| experiment.name == name);
    let section = (experiment.expect("it is one of them").run)(&settings);
    let allowed = |error: &String| assert!(error.contains("only root"), "{error}");
    section
        .map_err(|error| format!("{error:#}"))
        .inspect_err(allowed)
        .ok()
}

#[test]
fn clients_see_the_papers_faults_at_real_sockets() {
    let section = experiment("reach").expect("it needs no links");
    for row in [
        "| connected | 1162 (86.78 %) | 70 (84.34 %) |",
        "| timed out | 56 (4.18 %) | 4 (4.82 %) |",
        "| reset (SocketException) | 6 (0.45 %) | 1 (1.20 %) |",
    ] {
        assert!(section.markdown.contains(row), "{row}: {}", section.markdown);
    }
}

#[test]
fn messages_come_back_over_every_link() {
    let Some(section) = experiment("round-trip") else {
        return;
    };
    for link in ["33.6 kbit/s", "64 kbit/s", "1.5 Mbit/s", "10 Mbit/s"] {
        assert!(
            section.markdown.contains(&format!("| {link} |")),
            "{}",
            section.markdown
        );
    }
    assert!(!section.markdown.contains("NaN"), "{}", section.markdown);
}

#[test]
fn experiments_without_a_network_come_to_something() {
    for (name, row) in [
        ("path", "| all, 5 to 150 mm | 200 |"),
        ("tracking", "- jogging: "),
        ("token-table", "34 of 36 decisions are the paper's"),
        ("calibration", "| 50 | "),
        ("servo", "| 300 ms | 1 of 1 | "),
    ] {
        let section = experiment(name).expect("it needs no links");
        assert!(section.markdown.contains(row), "{row}: {}", section.markdown);
        assert!(!section.markdown.contains("NaN"), "{}", section.markdown);
        assert!(section.plots.iter().all(|(_, plot)| plot.starts_with("<svg")));
    }
}

/// The lab's own programs, without a link.
#[test]
fn an_operator_looks_and_stops() {
    let section = experiment("lab-link").expect("loopback needs no namespaces");
    assert!(
        section.markdown.contains("| loopback, images |"),
        "{}",
        section.markdown
    );
}

/// A fleet over the radio model: exact, as nothing depends on the machine.
#[test]
fn a_fleet_over_the_radio_model_keeps_what_it_promises() {
    for (name, rows) in [
        (
            "fleet-trips",
            &[
                "| paper, 1 to 2 Mbit/s | | | 6 |",
                "| 2 Mbit/s, with computers | 1 | none | 6.0",
            ][..],
        ),
        ("fleet-rates", &["| 1 | 166.7 | 10.00/s", "| 10 | 16.7 | "]),
        (
            "fleet-lost",
            &[
                "| paper | never | never | never | never | never | never | ",
                "| watchdog 500 ms | 0.4",
                "| 0 % | 7 | 0 of ",
            ],
        ),
    ] {
        let section = experiment(name).expect("it needs no links");
        for row in rows {
            assert!(section.markdown.contains(row), "{row}: {}", section.markdown);
        }
        assert!(!section.markdown.contains("NaN"), "{}", section.markdown);
        assert!(section.plots.iter().all(|(_, plot)| plot.starts_with("<svg")));
    }
}

/// A thin robot over a modelled link: exact, as nothing depends on the machine.
#[test]
fn a_thin_robot_over_a_modelled_link_is_the_papers() {
    for (name, rows) in [
        (
            "rsp-sizes",
            &[
                "| paper mode, the packet | 34 | 1992 | 1221.9 | 1992 | 38.66 % |",
                "| paper mode, with IP and UDP | 62 | 2040 |",
                "| 0 % | 0.00 ± 0.00 |",
            ][..],
        ),
        ("rsp-filter", &["| none | 4", "| 100 ms, then a burst | "]),
        (
            "rsp-acks",
            &[
                "| memory command | 20 % | 80 | 80 | 0 | 0 |",
                "In own mode none was carried out another number",
            ],
        ),
    ] {
        let section = without_broker(name);
        for row in rows {
            assert!(section.markdown.contains(row), "{row}: {}", section.markdown);
        }
        assert!(!section.markdown.contains("NaN"), "{}", section.markdown);
        assert!(section.plots.iter().all(|(_, plot)| plot.starts_with("<svg")));
    }
}

/// The same at real sockets; those that need namespaces are left out where there are none.
#[test]
fn a_thin_robot_at_real_sockets_is_commanded() {
    for (name, rows) in [
        ("rsp-path", &["The square, 0.1 m", "| base | "][..]),
        (
            "rsp-delay",
            &["| encode | no | ", "| the motion filter's wait for T | no | "],
        ),
    ] {
        let section = without_broker(name);
        for row in rows {
            assert!(section.markdown.contains(row), "{row}: {}", section.markdown);
        }
        assert!(!section.markdown.contains("NaN"), "{}", section.markdown);
    }
}

/// The same over real sockets of this machine, which may be busy: only what does not depend on that is looked at.
#[test]
fn a_fleet_over_real_sockets_is_commanded() {
    for (name, rows) in [
        ("fleet-many", &["| 10 | ", "| 41 | "][..]),
        (
            "fleet-beside",
            &[
                "| nothing | ",
                "| file transfer | ",
                "| web server | ",
                "| both | ",
            ],
        ),
    ] {
        let section = experiment(name).expect("it needs no links");
        for row in rows {
            assert!(section.markdown.contains(row), "{row}: {}", section.markdown);
        }
        assert!(!section.markdown.contains("NaN"), "{}", section.markdown);
    }
}
