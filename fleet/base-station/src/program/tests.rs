//! The picture, drawn into memory, what keys do to it, and what the command line takes.

use crate::circuit::Note;
use crate::fleet::Fleet;
use crate::log::Entry;
use crate::station::{Settings, Station};
use clap::{CommandFactory as _, Parser as _};
use mom_brs::{Command, Frame, PAPER};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::crossterm::event::{Event, KeyCode, KeyEvent, KeyModifiers};

use super::args::{Args, Work};
use super::view::{Asked, View};

const FLEET: &str =
    "[[robot]]\nunit = 1\naddress = \"a:1\"\n[[robot]]\nunit = 7\naddress = \"b:1\"\nname = \"tall\"\n";

fn station() -> Station {
    let fleet = Fleet::parse(FLEET).expect("a fleet");
    Station::new(&fleet, &PAPER, Settings::default())
}

fn lines(view: &mut View) -> Vec<String> {
    let (width, height) = (80, 20);
    let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("it is memory");
    terminal.draw(|frame| view.draw(frame)).expect("it is memory");
    let buffer = terminal.backend().buffer();
    let row = |y| (0..width).map(|x| buffer[(x, y)].symbol()).collect::<String>();
    (0..height).map(|y| row(y).trim_end().to_owned()).collect()
}

fn press(view: &mut View, code: KeyCode) -> Asked {
    view.on_event(&Event::Key(KeyEvent::new(code, KeyModifiers::NONE)))
}

fn write(view: &mut View, text: &str) {
    for letter in text.chars() {
        assert_eq!(press(view, KeyCode::Char(letter)), Asked::Nothing);
    }
}

#[tokio::test]
async fn it_shows_robots_both_directions_and_the_line() {
    let mut view = View::new(station().snapshot());
    let sent = Frame::new(&Command::MOTOR, &[50, -50]).unwrap();
    let reply = Frame::reply(&Command::NULL, &[]).unwrap();
    for note in [Note::Sent(sent), Note::Received(reply, Some(6000))] {
        view.take(&Entry {
            time: 0,
            unit: 7,
            note,
        });
    }
    press(&mut view, KeyCode::Char('s'));
    write(&mut view, "leds 1");
    let picture = lines(&mut view).join("\n");
    for part in [
        "unit   robot",
        "7      tall",
        "disconnected",
        "00:00:00.000 7: 06 00050 -0050",
        "00:00:00.000 7: 00  6.00 ms  null",
        "│1 leds 1█",
        "Enter send",
    ] {
        assert!(picture.contains(part), "{part}:\n{picture}");
    }
}

#[tokio::test]
async fn keys_choose_connect_send_repeat_and_quit() {
    let mut view = View::new(station().snapshot());
    assert_eq!(press(&mut view, KeyCode::Char('c')), Asked::ConnectAll);
    assert_eq!(press(&mut view, KeyCode::Char('d')), Asked::Disconnect(1));
    press(&mut view, KeyCode::Down);
    press(&mut view, KeyCode::Down);
    assert_eq!(press(&mut view, KeyCode::Char('d')), Asked::Disconnect(7));
    assert_eq!(
        press(&mut view, KeyCode::Char('r')),
        Asked::Nothing,
        "there is no line yet"
    );
    press(&mut view, KeyCode::Char('s'));
    write(&mut view, "nullq");
    press(&mut view, KeyCode::Backspace);
    assert_eq!(press(&mut view, KeyCode::Enter), Asked::Send("7 null".to_owned()));
    assert_eq!(view.on_second(), Asked::Nothing);
    assert_eq!(
        press(&mut view, KeyCode::Char('r')),
        Asked::Send("7 null".to_owned())
    );
    assert_eq!(view.on_second(), Asked::Send("7 null".to_owned()));
    assert_eq!(press(&mut view, KeyCode::Char(' ')), Asked::Halt);
    assert_eq!(view.on_second(), Asked::Nothing, "to stop ends the repetition");
    assert_eq!(press(&mut view, KeyCode::Char('q')), Asked::Quit);
}

#[test]
fn the_command_line_takes_negative_values_beside_its_options() {
    Args::command().debug_assert();
    let words = "mom-base-station --fleet f send 1 motor 50 -50 --repeat 500ms --times 10";
    let args = Args::try_parse_from(words.split(' ')).unwrap();
    let Some(Work::Send(send)) = args.work else {
        panic!("send")
    };
    assert_eq!(send.statement, ["1", "motor", "50", "-50"]);
    assert_eq!(
        (send.repeat.map(|time| time.as_millis()), send.times),
        (Some(500), Some(10))
    );
    for wrong in ["", "5", "-1s", "99999999999999999999s", "86401s"] {
        let words = format!("mom-base-station --fleet f send 1 motor 50 -50 --repeat={wrong}");
        assert!(Args::try_parse_from(words.split(' ')).is_err(), "{wrong}");
    }
}
