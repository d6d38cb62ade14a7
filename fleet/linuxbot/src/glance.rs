//! How a robot is at one moment, for those who only look: they ask, and the control shows it when it comes by.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use mom_wheels::{Motors, Pose};
use tokio::sync::{Notify, watch};
use tokio::time::{Instant, sleep_until, timeout};

use crate::Status;

/// Between two glances, at least: however many look, and however often, the control is asked no more than that.
const BETWEEN: Duration = Duration::from_millis(50);
/// So long a control that lives takes at most.
const PATIENCE: Duration = Duration::from_secs(1);

/// How a robot is at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Glance {
    /// Where it is by its odometry; `None` if it has none.
    pub pose: Option<Pose>,
    /// What the motors are set to.
    pub motors: Motors,
    /// The LEDs that are lit, a bit each.
    pub leds: u8,
    /// What the reply to STATUS would say.
    pub status: Status,
    /// The base station that drives.
    pub station: Option<SocketAddr>,
}

/// Looks at a robot, from any task.
#[derive(Debug, Clone)]
pub struct Observer {
    asked: Arc<Notify>,
    shown: watch::Receiver<Option<Glance>>,
}

/// The control's end: shows how the robot is to its readers, and waits for none.
#[derive(Debug)]
pub struct Observed {
    asked: Arc<Notify>,
    shown: watch::Sender<Option<Glance>>,
    /// Whether a client waits for the next one.
    wanted: bool,
    /// When that may be shown.
    next: Instant,
}

impl Observed {
    /// Both ends. [`serve_observed`](crate::serve_observed) takes this one.
    #[must_use]
    pub fn pair() -> (Observer, Self) {
        let asked = Arc::new(Notify::new());
        let (sender, shown) = watch::channel(None);
        let observed = Self {
            asked: Arc::clone(&asked),
            shown: sender,
            wanted: false,
            next: Instant::now(),
        };
        (Observer { asked, shown }, observed)
    }

    /// Waits until a client looks, and it is time. May be dropped at any time.
    pub(crate) async fn wanted(&mut self) {
        if !self.wanted {
            self.asked.notified().await;
            self.wanted = true;
        }
        sleep_until(self.next).await;
    }

    /// Shows how the robot is; `None` if its sensors cannot be read.
    pub(crate) fn show(&mut self, glance: Option<Glance>) {
        self.wanted = false;
        self.next = Instant::now() + BETWEEN;
        self.shown.send_replace(glance);
    }
}

impl Observer {
    /// How the robot is now, or will be within 50 ms; `None` if its sensors cannot be read, or its control has ended.
    pub async fn look(&self) -> Option<Glance> {
        let mut shown = self.shown.clone();
        shown.mark_unchanged();
        self.asked.notify_one();
        timeout(PATIENCE, shown.changed()).await.ok()?.ok()?;
        *shown.borrow_and_update()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GLANCE: Glance = Glance {
        pose: None,
        motors: Motors::STOP,
        leds: 3,
        status: Status {
            switches: 0,
            moving: false,
            expired: false,
            on_its_way: false,
            gave_up: false,
            battery: 80,
            charging: false,
        },
        station: None,
    };

    #[tokio::test(start_paused = true)]
    async fn however_many_look_the_control_is_asked_twenty_times_a_second() {
        let (observer, mut observed) = Observed::pair();
        let control = tokio::spawn(async move {
            let (begin, mut shown) = (Instant::now(), 0_u32);
            while begin.elapsed() < Duration::from_secs(1) {
                observed.wanted().await;
                observed.show(Some(GLANCE));
                shown += 1;
            }
            shown
        });
        let lookers: Vec<_> = (0..10)
            .map(|_| {
                let observer = observer.clone();
                tokio::spawn(async move {
                    let mut seen = 0_u32;
                    while observer.look().await == Some(GLANCE) {
                        seen += 1;
                    }
                    seen
                })
            })
            .collect();
        let shown = control.await.expect("no panic");
        assert!((20..=21).contains(&shown), "{shown}");
        for looker in lookers {
            let seen = looker.await.expect("it ends with the control");
            assert!(seen >= 10 && seen <= shown, "{seen} of {shown}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn who_looks_sees_what_is_shown_afterwards_only() {
        let (observer, mut observed) = Observed::pair();
        observed.show(Some(GLANCE));
        let looking = tokio::spawn(async move { observer.look().await });
        observed.wanted().await;
        let newer = Glance { leds: 4, ..GLANCE };
        observed.show(Some(newer));
        assert_eq!(looking.await.expect("no panic"), Some(newer));
    }

    #[tokio::test(start_paused = true)]
    async fn a_control_that_is_gone_or_stuck_is_not_waited_for() {
        let (observer, observed) = Observed::pair();
        assert_eq!(observer.look().await, None, "nobody shows anything");
        drop(observed);
        assert_eq!(observer.look().await, None);
    }
}
