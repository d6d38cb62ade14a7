//! From keys to velocities.

use std::time::Duration;

use mom_arm::Velocity;
use ratatui::crossterm::event::{Event, KeyCode, KeyEventKind, KeyModifiers};
use tokio::time::Instant;

/// mm/s at the beginning, and the bounds.
const SPEED: f64 = 50.0;
const SLOWEST: f64 = 5.0;
const FASTEST: f64 = 150.0;

/// Degrees/s for each mm/s.
const TURN: f64 = 0.6;

/// A key counts as held for so long after the terminal has told of it: it tells again while it is.
const HELD: Duration = Duration::from_millis(160);

/// What a key does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Action {
    Nothing,
    Move(Velocity),
    /// Come to rest.
    Rest,
    Say(&'static str),
    End,
}

/// What the keys say.
#[derive(Debug)]
pub(super) struct Hand {
    speed: f64,
    held: Option<(Velocity, Instant)>,
}

impl Default for Hand {
    fn default() -> Hand {
        Hand {
            speed: SPEED,
            held: None,
        }
    }
}

impl Hand {
    /// mm/s.
    pub(super) fn speed(&self) -> f64 {
        self.speed
    }

    /// What follows from something typed.
    pub(super) fn on_event(&mut self, event: &Event, now: Instant) -> Action {
        let Event::Key(key) = event else {
            return Action::Nothing;
        };
        if key.kind == KeyEventKind::Release {
            return match self.held.take() {
                Some(_) => Action::Rest,
                None => Action::Nothing,
            };
        }
        if key.modifiers.contains(KeyModifiers::CONTROL) {
            return match key.code {
                KeyCode::Char('c' | 'd') => Action::End,
                _ => Action::Nothing,
            };
        }
        if let Some(velocity) = self.velocity(key.code) {
            self.held = Some((velocity, now + HELD));
            return Action::Move(velocity);
        }
        match key.code {
            KeyCode::Esc | KeyCode::Char('x') => Action::End,
            KeyCode::Char(' ') => {
                self.held = None;
                Action::Rest
            }
            KeyCode::Char('o') => Action::Say("grip open"),
            KeyCode::Char('c') => Action::Say("grip close"),
            KeyCode::Char('h') => Action::Say("home"),
            KeyCode::Char('+') => self.change_speed(1.5),
            KeyCode::Char('-') => self.change_speed(1.0 / 1.5),
            _ => Action::Nothing,
        }
    }

    /// What is to be said again while a key is held.
    pub(super) fn again(&mut self, now: Instant) -> Action {
        match self.held {
            Some((velocity, until)) if now < until => Action::Move(velocity),
            Some(_) => {
                self.held = None;
                Action::Rest
            }
            None => Action::Nothing,
        }
    }

    fn change_speed(&mut self, factor: f64) -> Action {
        self.speed = (self.speed * factor).clamp(SLOWEST, FASTEST);
        Action::Nothing
    }

    fn velocity(&self, code: KeyCode) -> Option<Velocity> {
        let (way, turn) = (self.speed, self.speed * TURN);
        let numbers = match code {
            KeyCode::Right => [way, 0.0, 0.0, 0.0, 0.0],
            KeyCode::Left => [-way, 0.0, 0.0, 0.0, 0.0],
            KeyCode::Up => [0.0, way, 0.0, 0.0, 0.0],
            KeyCode::Down => [0.0, -way, 0.0, 0.0, 0.0],
            KeyCode::PageUp | KeyCode::Char('r') => [0.0, 0.0, way, 0.0, 0.0],
            KeyCode::PageDown | KeyCode::Char('f') => [0.0, 0.0, -way, 0.0, 0.0],
            KeyCode::Char('q') => [0.0, 0.0, 0.0, turn, 0.0],
            KeyCode::Char('e') => [0.0, 0.0, 0.0, -turn, 0.0],
            KeyCode::Char('t') => [0.0, 0.0, 0.0, 0.0, turn],
            KeyCode::Char('g') => [0.0, 0.0, 0.0, 0.0, -turn],
            _ => return None,
        };
        Some(Velocity::of(numbers))
    }
}

#[cfg(test)]
mod tests {
    use ratatui::crossterm::event::KeyEvent;

    use super::*;

    fn press(code: KeyCode) -> Event {
        Event::Key(KeyEvent::new(code, KeyModifiers::NONE))
    }

    #[test]
    fn a_key_moves_while_it_is_held() {
        let (mut hand, now) = (Hand::default(), Instant::now());
        let right = Velocity {
            x: SPEED,
            ..Velocity::default()
        };
        assert_eq!(hand.again(now), Action::Nothing);
        assert_eq!(hand.on_event(&press(KeyCode::Right), now), Action::Move(right));
        assert_eq!(hand.again(now + HELD / 2), Action::Move(right));
        // The terminal tells of it again.
        assert_eq!(
            hand.on_event(&press(KeyCode::Right), now + HELD / 2),
            Action::Move(right)
        );
        assert_eq!(hand.again(now + HELD), Action::Move(right));
        assert_eq!(hand.again(now + HELD * 2), Action::Rest);
        assert_eq!(hand.again(now + HELD * 2), Action::Nothing);
        hand.on_event(&press(KeyCode::Right), now);
        let released = KeyEvent::new_with_kind(KeyCode::Right, KeyModifiers::NONE, KeyEventKind::Release);
        assert_eq!(
            hand.on_event(&Event::Key(released), now),
            Action::Rest,
            "where the terminal tells of it"
        );
    }

    #[test]
    fn the_speed_stays_within_what_the_arm_can() {
        let (mut hand, now) = (Hand::default(), Instant::now());
        for (key, most) in [('+', FASTEST), ('-', SLOWEST)] {
            for _ in 0..20 {
                assert_eq!(hand.on_event(&press(KeyCode::Char(key)), now), Action::Nothing);
            }
            assert_eq!(hand.speed(), most);
            let Action::Move(turning) = hand.on_event(&press(KeyCode::Char('q')), now) else {
                panic!("it turns");
            };
            assert!(turning.spin <= 90.0);
        }
    }

    #[test]
    fn keys_that_end_it() {
        let (mut hand, now) = (Hand::default(), Instant::now());
        let control_c = Event::Key(KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL));
        for event in [press(KeyCode::Esc), press(KeyCode::Char('x')), control_c] {
            assert_eq!(hand.on_event(&event, now), Action::End);
        }
        assert_eq!(
            hand.on_event(&press(KeyCode::Char('c')), now),
            Action::Say("grip close")
        );
    }
}
