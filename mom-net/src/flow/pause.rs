//! How long a writer waits before it looks again whether the network has room.

use std::time::Duration;

use super::Flow;

/// The pauses of a writer that waits for the network.
#[derive(Debug)]
pub struct Pause {
    time: Duration,
    /// What the other side had taken when we last looked, and for how long it has taken no more.
    taken: u64,
    quiet: Duration,
}

impl Pause {
    /// While the other side takes something: timers have turns of a millisecond, and a whole one becomes two.
    const USUAL: Duration = Duration::from_micros(250);
    /// For one that takes nothing.
    const LONGEST: Duration = Duration::from_millis(16);

    /// The time to wait.
    pub fn time(&self) -> Duration {
        self.time
    }

    /// Looks after a wait: a receiver that takes nothing for longer than the way there and back is looked at less and less
    /// often.
    pub fn look(&mut self, flow: &Flow) {
        if flow.acknowledged != self.taken {
            *self = Pause {
                taken: flow.acknowledged,
                ..Pause::default()
            };
            return;
        }
        self.quiet += self.time;
        if self.quiet > flow.quiet() {
            self.time = (self.time * 2).min(Pause::LONGEST);
        }
    }
}

impl Default for Pause {
    fn default() -> Pause {
        Pause {
            time: Pause::USUAL,
            taken: 0,
            quiet: Duration::ZERO,
        }
    }
}
