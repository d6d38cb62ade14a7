//! The picture, drawn into memory, and what keys do to it.

use std::time::Instant;

use mom_client::{ChannelStats, ConnectedPeer, Counts, MemoryStats, Path, Stats, StopState, Time};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::crossterm::event::{Event, KeyCode, KeyEvent, KeyModifiers};

use super::*;

pub(super) fn peer(name: &str, change: impl FnOnce(&mut ConnectedPeer)) -> ConnectedPeer {
    let mut peer = ConnectedPeer {
        peer: name.to_owned(),
        user: name.to_owned(),
        form: "binary".to_owned(),
        door: "tcp".to_owned(),
        tls: false,
        from: Some("127.0.0.1".to_owned()),
        since: Time::default(),
        heard: Duration::ZERO,
        round_trip: None,
        queued: 0,
        sent: 0,
        received: 0,
        dropped: 0,
    };
    change(&mut peer);
    peer
}

pub(super) fn stats(peers: Vec<ConnectedPeer>) -> Stats {
    Stats {
        time: Time::default(),
        channels: vec![ChannelStats {
            path: Path::parse("/chat").unwrap(),
            members: 0,
            all: Counts::default(),
            peers: Vec::new(),
        }],
        more: false,
        memory: Some(MemoryStats {
            used: 1 << 20,
            bound: Some(2 << 20),
            users: Vec::new(),
        }),
        peers,
        more_peers: 0,
    }
}

fn lines(view: &mut View, width: u16, height: u16) -> Vec<String> {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| view.draw(frame)).unwrap();
    let buffer = terminal.backend().buffer();
    let row = |y| (0..width).map(|x| buffer[(x, y)].symbol()).collect::<String>();
    (0..height).map(|y| row(y).trim_end().to_owned()).collect()
}

fn press(view: &mut View, code: KeyCode) -> bool {
    view.on_event(&Event::Key(KeyEvent::new(code, KeyModifiers::NONE)))
}

fn view(peers: Vec<ConnectedPeer>) -> View {
    View::new("bin://lab", Sample::new(stats(peers), Instant::now()))
}

#[test]
fn the_picture() {
    let mut view = view(vec![
        peer("alice", |peer| peer.round_trip = Some(Duration::from_micros(420))),
        peer("evil\u{1b}]0;x", |peer| {
            (peer.user, peer.queued) = ("guest".to_owned(), 2048);
            (peer.door, peer.form, peer.tls) = ("websocket".to_owned(), "json".to_owned(), true);
        }),
    ]);
    view.holds.owned = [("alice".to_owned(), vec![Path::parse("/robot/token").unwrap()])].into();
    let stop = StopState {
        stopped: true,
        by: Some("bob".to_owned()),
        ..StopState::default()
    };
    view.holds.stopped = [(Path::parse("/robot/arm").unwrap(), stop)].into();
    assert_eq!(
        lines(&mut view, 120, 8),
        [
            "mom top  bin://lab                                                                               1970-01-01 00:00:00 UTC",
            "2 connections   hub keeps 1.0 MiB of at most 2.0 MiB",
            "/robot/arm: stopped by bob",
            "peer            user   door                from        silent  round trip    queue  drops  tokens",
            "alice           alice  tcp binary          127.0.0.1  0.00 ms     0.42 ms      0 B      0  /robot/token",
            "evil\\u{1b}]0;x  guest  websocket tls json  127.0.0.1  0.00 ms           -  2.0 KiB      0",
            "",
            "1-9 ←→ sort   r reverse   ↑↓ scroll   q end",
        ]
    );
}

#[test]
fn keys_sort_scroll_and_end() {
    let peers = ["b", "a", "c"].map(|name| peer(name, |peer| peer.dropped = u64::from(name == "c")));
    let mut view = view(peers.to_vec());
    let order = |view: &mut View| -> String {
        let lines = lines(view, 100, 8);
        lines[4..7].iter().map(|line| &line[..1]).collect()
    };
    assert_eq!(order(&mut view), "bac", "as they came");
    for (key, expected) in [
        (KeyCode::Char('1'), "abc"),
        (KeyCode::Char('1'), "cba"),
        (KeyCode::Char('r'), "abc"),
        // Those that are equal stay in the order in which they came.
        (KeyCode::Char('8'), "cba"),
        (KeyCode::Right, "bac"),
        (KeyCode::Right, "abc"),
        (KeyCode::Down, "abc"),
    ] {
        assert!(press(&mut view, key));
        assert_eq!(order(&mut view), expected, "{key:?}");
    }
    assert!(!press(&mut view, KeyCode::Char('q')) && !press(&mut view, KeyCode::Esc));
    let ctrl_c = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
    assert!(!view.on_event(&Event::Key(ctrl_c)));
}

#[test]
fn it_fits_any_terminal_and_says_that_it_connects_again() {
    let mut view = view(vec![peer(&"long".repeat(40), |_| {}), peer("bob", |_| {})]);
    view.link = HubLink::Down {
        since: Instant::now(),
        attempt: 2,
    };
    let shown = lines(&mut view, 100, 10);
    assert!(shown[0].contains("connecting again (attempt 3)"), "{shown:?}");
    assert!(
        shown[3].contains("round trip"),
        "a long name leaves room for the rest: {shown:?}"
    );
    for (width, height) in [(20, 4), (1, 1), (300, 100)] {
        lines(&mut view, width, height);
    }
}
