//! What the view shows (W13), and what its keys do.

use std::collections::VecDeque;

use crate::circuit::{Note, State};
use crate::fleet::Unit;
use crate::log::{Entry, millis, time_of_day};
use crate::station::Snapshot;
use ratatui::Frame;
use ratatui::crossterm::event::{Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Style, Stylize as _};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Cell, List, Row, Table, TableState};

const KEYS: &str =
    "↑↓ unit   c connect all   d disconnect   s send   r repeat each second   space stop all   q quit";
const TYPING: &str = "Enter send   Esc leave";

/// How many lines of each direction it remembers.
const REMEMBERED: usize = 500;

/// The most characters of a statement.
const LONGEST_LINE: usize = 1000;

/// What a key asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Asked {
    Nothing,
    Quit,
    ConnectAll,
    Disconnect(Unit),
    /// Stop all that moves.
    Halt,
    Send(String),
}

/// All that is shown.
#[derive(Debug)]
pub(super) struct View {
    robots: Vec<Snapshot>,
    chosen: TableState,
    outgoing: VecDeque<String>,
    incoming: VecDeque<String>,
    line: String,
    typing: bool,
    repeating: bool,
    said: String,
}

impl View {
    pub(super) fn new(robots: Vec<Snapshot>) -> View {
        View {
            robots,
            chosen: TableState::default().with_selected(0),
            outgoing: VecDeque::new(),
            incoming: VecDeque::new(),
            line: String::new(),
            typing: false,
            repeating: false,
            said: "c connects to the robots".to_owned(),
        }
    }

    pub(super) fn update(&mut self, robots: Vec<Snapshot>) {
        self.robots = robots;
    }

    /// Takes in what happened.
    pub(super) fn take(&mut self, entry: &Entry) {
        // Narrower than the log's lines, as both lists stand side by side.
        let (list, frame, trip) = match &entry.note {
            Note::Sent(frame) => (&mut self.outgoing, frame, None),
            Note::Received(frame, trip) => (&mut self.incoming, frame, *trip),
            Note::Ended(_) => return self.say(entry.to_string()),
            Note::State(_) => return,
        };
        let (time, unit) = (time_of_day(entry.time), entry.unit);
        let trip = trip.map(|micros| format!("  {}", millis(micros)));
        if list.len() == REMEMBERED {
            list.pop_front();
        }
        list.push_back(format!(
            "{time} {unit}: {frame}{}  {frame:#}",
            trip.unwrap_or_default()
        ));
    }

    /// Shows a message until the next one.
    pub(super) fn say(&mut self, said: String) {
        self.said = said;
    }

    /// Each second the line is sent again, if that was asked for.
    pub(super) fn on_second(&mut self) -> Asked {
        match self.repeating && !self.typing {
            true => self.send(),
            false => Asked::Nothing,
        }
    }

    /// What an event asks for.
    pub(super) fn on_event(&mut self, event: &Event) -> Asked {
        let Event::Key(key) = event else {
            return Asked::Nothing;
        };
        if key.kind == KeyEventKind::Release {
            return Asked::Nothing;
        }
        // A terminal in raw mode makes no signal of it.
        if key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL) {
            return Asked::Quit;
        }
        match self.typing {
            true => self.on_letter(key),
            false => self.on_key(key),
        }
    }

    fn on_key(&mut self, key: &KeyEvent) -> Asked {
        match key.code {
            KeyCode::Char('q') => return Asked::Quit,
            KeyCode::Char('c') => return Asked::ConnectAll,
            KeyCode::Char(' ') => {
                self.repeating = false;
                return Asked::Halt;
            }
            KeyCode::Char('d') => {
                if let Some(unit) = self.chosen_unit() {
                    return Asked::Disconnect(unit);
                }
            }
            KeyCode::Char('r') => {
                self.repeating = !self.repeating && !self.line.is_empty();
                return self.on_second();
            }
            KeyCode::Char('s') | KeyCode::Enter => {
                self.typing = true;
                if self.line.is_empty()
                    && let Some(unit) = self.chosen_unit()
                {
                    self.line = format!("{unit} ");
                }
            }
            KeyCode::Up => self.choose(-1),
            KeyCode::Down => self.choose(1),
            KeyCode::PageUp => self.choose(-20),
            KeyCode::PageDown => self.choose(20),
            _ => {}
        }
        Asked::Nothing
    }

    fn on_letter(&mut self, key: &KeyEvent) -> Asked {
        match key.code {
            KeyCode::Esc => self.typing = false,
            KeyCode::Enter => {
                self.typing = false;
                return self.send();
            }
            KeyCode::Backspace => {
                self.line.pop();
            }
            KeyCode::Char('u') if key.modifiers.contains(KeyModifiers::CONTROL) => self.line.clear(),
            KeyCode::Char(letter) if self.line.chars().count() < LONGEST_LINE => self.line.push(letter),
            _ => {}
        }
        Asked::Nothing
    }

    fn send(&mut self) -> Asked {
        if self.line.trim().is_empty() {
            return Asked::Nothing;
        }
        self.said.clear();
        Asked::Send(self.line.clone())
    }

    fn chosen_unit(&self) -> Option<Unit> {
        let chosen = self.robots.get(self.chosen.selected()?)?;
        Some(chosen.robot.unit)
    }

    fn choose(&mut self, by: isize) {
        let last = self.robots.len().saturating_sub(1);
        let chosen = self.chosen.selected().unwrap_or_default();
        self.chosen
            .select(Some(chosen.saturating_add_signed(by).min(last)));
    }

    pub(super) fn draw(&mut self, frame: &mut Frame<'_>) {
        let [robots, lists, line, foot] = Layout::vertical([
            Constraint::Fill(1),
            Constraint::Fill(1),
            Constraint::Length(3),
            Constraint::Length(2),
        ])
        .areas(frame.area());
        self.draw_robots(frame, robots);
        let [left, right] = Layout::horizontal([Constraint::Fill(1), Constraint::Fill(1)]).areas(lists);
        draw_list(frame, left, "outgoing", &self.outgoing);
        draw_list(frame, right, "incoming", &self.incoming);
        let title = match self.repeating {
            true => "statement, each second",
            false => "statement",
        };
        let mut text = Line::from(self.line.as_str());
        if self.typing {
            text.push_span(Span::from("█"));
        }
        // A long line shows its end, where the user types.
        let width = usize::from(line.width.saturating_sub(2));
        let hidden = text.width().saturating_sub(width);
        let text: String = text.to_string().chars().skip(hidden).collect();
        let block = Block::bordered().title(title);
        frame.render_widget(ratatui::widgets::Paragraph::new(text).block(block), line);
        let keys = if self.typing { TYPING } else { KEYS };
        let foot_lines = vec![Line::from(self.said.as_str()), Line::from(keys).dim()];
        frame.render_widget(ratatui::widgets::Paragraph::new(foot_lines), foot);
    }

    fn draw_robots(&mut self, frame: &mut Frame<'_>, area: Rect) {
        let rows = self.robots.iter().map(|snapshot| {
            let robot = &snapshot.robot;
            let state = Cell::from(match snapshot.state {
                State::Writable => snapshot.state.word().green(),
                State::Connected => snapshot.state.word().yellow(),
                State::Trying => snapshot.state.word().red(),
                State::Disconnected => snapshot.state.word().dim(),
            });
            let status = snapshot.status.map(|bits| format!("bits {bits}"));
            let moving = if snapshot.in_motion { "moving" } else { "" };
            Row::new([
                Cell::from(robot.unit.to_string()),
                Cell::from(robot.name.clone().unwrap_or_else(|| robot.address.to_string())),
                state,
                Cell::from(snapshot.round_trip.map(millis).unwrap_or_default()),
                Cell::from(status.unwrap_or_default()),
                Cell::from(moving),
            ])
        });
        let widths = [
            Constraint::Length(5),
            Constraint::Fill(1),
            Constraint::Length(12),
            Constraint::Length(10),
            Constraint::Length(14),
            Constraint::Length(6),
        ];
        let heading = Row::new(["unit", "robot", "state", "round trip", "status", ""]).dim();
        let table = Table::new(rows, widths)
            .header(heading)
            .column_spacing(2)
            .row_highlight_style(Style::new().reversed())
            .block(Block::bordered().title("connect status"));
        frame.render_stateful_widget(table, area, &mut self.chosen);
    }
}

/// The latest lines that there is a place for.
fn draw_list(frame: &mut Frame<'_>, area: Rect, title: &str, lines: &VecDeque<String>) {
    let places = usize::from(area.height.saturating_sub(2));
    let hidden = lines.len().saturating_sub(places);
    let shown = lines.iter().skip(hidden).map(|line| Line::from(line.as_str()));
    let list = List::new(shown).block(Block::bordered().title(title));
    frame.render_widget(list, area);
}
