//! What `mom top` shows, and what its keys do.

use std::time::Instant;

use ratatui::Frame;
use ratatui::crossterm::event::{Event, KeyCode, KeyEventKind, KeyModifiers};
use ratatui::layout::{Alignment, Constraint, Layout, Rect};
use ratatui::style::{Modifier, Style, Stylize as _};
use ratatui::text::{Line, Span, Text};
use ratatui::widgets::{Cell, Paragraph, Row as TableRow, Table, TableState};

use super::rows::{self, COLUMNS, Column};
use super::sample::{Holds, Rates, Sample};
use crate::output::words;

const KEYS: &str = "1-9 ←→ sort   r reverse   ↑↓ scroll   q end";

/// The most letters of a cell: names are chosen by others, and a long one must not push the rest out of the picture.
const NAME: usize = 20;

/// A terminal of so many columns has a place for all.
const WIDE: u16 = 120;

/// How the connection to the hub is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum HubLink {
    Up,
    Down { since: Instant, attempt: u32 },
}

/// All that is shown.
#[derive(Debug)]
pub(super) struct View {
    hub: String,
    pub(super) link: HubLink,
    sample: Sample,
    rates: Option<Rates>,
    pub(super) holds: Holds,
    sort: Option<Column>,
    reversed: bool,
    table: TableState,
}

impl View {
    pub(super) fn new(hub: &str, sample: Sample) -> View {
        View {
            hub: words::visible(hub),
            link: HubLink::Up,
            sample,
            rates: None,
            holds: Holds::default(),
            sort: None,
            reversed: false,
            table: TableState::default(),
        }
    }

    /// Takes in the next answer of the hub.
    pub(super) fn update(&mut self, sample: Sample) {
        self.rates = Some(sample.rates_since(&self.sample));
        self.sample = sample;
    }

    /// Does what a key stands for; false if it ends the program.
    pub(super) fn on_event(&mut self, event: &Event) -> bool {
        let Event::Key(key) = event else { return true };
        if key.kind == KeyEventKind::Release {
            return true;
        }
        match key.code {
            KeyCode::Char('q') | KeyCode::Esc => return false,
            // A terminal in raw mode makes no signal of it.
            KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => return false,
            KeyCode::Char('r') => self.reversed = !self.reversed,
            KeyCode::Char(digit @ '1'..='9') => {
                let column = digit
                    .to_digit(10)
                    .and_then(|number| COLUMNS.get(number as usize - 1));
                self.sort_by(column.copied());
            }
            KeyCode::Left => self.move_sort(COLUMNS.len() - 1),
            KeyCode::Right => self.move_sort(1),
            KeyCode::Up => self.table.scroll_up_by(1),
            KeyCode::Down => self.table.scroll_down_by(1),
            KeyCode::PageUp => self.table.scroll_up_by(20),
            KeyCode::PageDown => self.table.scroll_down_by(20),
            KeyCode::Home => self.table.select_first(),
            KeyCode::End => self.table.select_last(),
            _ => {}
        }
        true
    }

    /// Sorts by a column, the other way round if that is how it is sorted already.
    fn sort_by(&mut self, column: Option<Column>) {
        self.reversed = self.sort == column && !self.reversed;
        self.sort = column;
    }

    fn move_sort(&mut self, by: usize) {
        let here = COLUMNS.iter().position(|column| Some(*column) == self.sort);
        // Nothing is left of the first column and right of the last.
        let next = match here {
            None if by == 1 => 0,
            None => COLUMNS.len() - 1,
            Some(here) => (here + by) % COLUMNS.len(),
        };
        self.reversed = false;
        self.sort = Some(COLUMNS[next]);
    }

    pub(super) fn draw(&mut self, frame: &mut Frame<'_>) {
        let [head, table, foot] =
            Layout::vertical([Constraint::Length(3), Constraint::Min(1), Constraint::Length(1)])
                .areas(frame.area());
        self.draw_head(frame, head);
        self.draw_table(frame, table);
        let more = rows::more(&self.sample).unwrap_or_default();
        frame.render_widget(Line::from(format!("{KEYS}   {more}")).dim(), foot);
    }

    fn draw_head(&self, frame: &mut Frame<'_>, area: Rect) {
        let [_, right] = Layout::horizontal([Constraint::Min(1), Constraint::Length(24)]).areas(area);
        let link = match &self.link {
            HubLink::Up => Span::default(),
            HubLink::Down { since, attempt } => {
                let since = words::duration(std::time::Duration::from_secs(since.elapsed().as_secs()));
                let text = format!(
                    "the connection is lost for {since}, connecting again (attempt {})",
                    attempt + 1
                );
                Span::from(text).red().bold()
            }
        };
        let lines = vec![
            Line::from(vec![
                Span::from("mom top  ").bold(),
                Span::from(self.hub.as_str()).blue(),
                Span::from("  "),
                link,
            ]),
            Line::from(rows::summary(&self.sample, self.rates)),
            Line::from(rows::stopped(&self.holds.stopped).unwrap_or_default())
                .red()
                .bold(),
        ];
        let clock = Paragraph::new(rows::clock(&self.sample)).alignment(Alignment::Right);
        // The second line may need all of the width.
        frame.render_widget(Paragraph::new(lines), area);
        if self.link == HubLink::Up {
            frame.render_widget(clock, Rect { height: 1, ..right });
        }
    }

    fn draw_table(&mut self, frame: &mut Frame<'_>, area: Rect) {
        let columns: Vec<Column> = match area.width {
            WIDE.. => COLUMNS.to_vec(),
            // Of the addresses most are known by their users, and the tokens would have no place.
            _ => COLUMNS
                .into_iter()
                .filter(|column| *column != Column::From)
                .collect(),
        };
        let rows = rows::rows(&self.sample, &self.holds.owned, self.sort, self.reversed);
        let cells: Vec<Vec<String>> = rows
            .iter()
            .map(|row| columns.iter().map(|column| row.cell(*column)).collect())
            .collect();
        let widths = columns.iter().enumerate().map(|(at, column)| {
            let cells = cells.iter().map(|cells| cells[at].chars().count());
            let most = cells
                .max()
                .unwrap_or_default()
                .min(NAME)
                .max(column.heading().len());
            match column {
                Column::Tokens => Constraint::Fill(1),
                _ => Constraint::Length(u16::try_from(most).unwrap_or(u16::MAX)),
            }
        });
        let aligned = |column: Column, text: String| match column.is_number() {
            true => Cell::from(Text::from(text).alignment(Alignment::Right)),
            false => Cell::from(text),
        };
        let heading = columns.iter().map(|&column| {
            let cell = aligned(column, column.heading().to_owned());
            match self.sort == Some(column) {
                true => cell.style(Style::new().add_modifier(Modifier::BOLD | Modifier::UNDERLINED)),
                false => cell,
            }
        });
        let widths: Vec<Constraint> = widths.collect();
        let body = cells.into_iter().map(|cells| {
            let cells = columns.iter().zip(cells);
            TableRow::new(cells.map(|(column, text)| aligned(*column, text)))
        });
        let table = Table::new(body, widths)
            .header(TableRow::new(heading).dim())
            .column_spacing(2)
            .row_highlight_style(Style::new().reversed());
        frame.render_stateful_widget(table, area, &mut self.table);
    }
}
