//! Faults of the link between the program and the controller (M53), to be injected by configuration.

use crate::motion::ArmTime;

/// A link that fails again and again: each time after so long, for so long.
///
/// ```
/// use mom_arm::controller::LinkFault;
///
/// let fault = LinkFault { after: 30_000_000, lasting: 2_000_000 };
/// assert_eq!(fault.is_down(29_999_999), false);
/// assert_eq!(fault.is_down(31_000_000), true);
/// assert_eq!((fault.next_change(0), fault.next_change(30_000_000)), (30_000_000, 32_000_000));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinkFault {
    /// µs for which the link stands between two failures.
    pub after: ArmTime,
    /// µs for which it is down.
    pub lasting: ArmTime,
}

impl LinkFault {
    /// µs from one failure to the next, at least 1.
    const fn period(&self) -> ArmTime {
        let period = self.after.saturating_add(self.lasting);
        if period < 1 { 1 } else { period }
    }

    /// Whether the link is down so many µs after the start.
    #[must_use]
    pub const fn is_down(&self, time: ArmTime) -> bool {
        time.rem_euclid(self.period()) >= self.after
    }

    /// When it fails or comes back next, after this time.
    #[must_use]
    pub const fn next_change(&self, time: ArmTime) -> ArmTime {
        let within = time.rem_euclid(self.period());
        let next = if within < self.after {
            self.after
        } else {
            self.period()
        };
        time.saturating_add(next - within)
    }
}
