//! What the reply to STATUS says, as a bit mask (W4, W6).

use mom_wheels::{Motors, Sensors};

/// The reply to STATUS: the paper gives none, so these bits are ours.
///
/// | bits | meaning |
/// |---|---|
/// | 0–3 | switches that are pressed: front left, front right, rear left, rear right |
/// | 4 | the motors are set to something |
/// | 5 | the watchdog has stopped them, and nothing has moved them since |
/// | 6 | on its way to a point (GOTO, VIA) |
/// | 7 | the last way to a point was given up |
/// | 8–14 | battery, in percent |
/// | 15 | the battery is being charged |
///
/// ```
/// use mom_linuxbot::Status;
///
/// let status = Status { switches: 0b0011, battery: 80, moving: true, ..Status::default() };
/// assert_eq!(status.bits(), 80 * 256 + 16 + 3);
/// assert_eq!(Status::from_bits(status.bits()), status);
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Status {
    /// The switches that are pressed, by the bits of [`mom_wheels::switch`].
    pub switches: u8,
    /// Whether the motors are set to something.
    pub moving: bool,
    /// Whether the watchdog has stopped the motors, and nothing has moved them since.
    pub expired: bool,
    /// Whether it is on its way to a point.
    pub on_its_way: bool,
    /// Whether the last way to a point was given up.
    pub gave_up: bool,
    /// What is left in the battery, percent.
    pub battery: u8,
    /// Whether it is being charged, as far as the robot knows.
    pub charging: bool,
}

impl Status {
    /// What sensors say.
    pub(crate) fn of(sensors: &Sensors) -> Self {
        Self {
            switches: sensors.switches,
            moving: sensors.motors != Motors::STOP,
            battery: sensors.battery,
            ..Self::default()
        }
    }

    /// As it stands in the reply.
    #[must_use]
    pub fn bits(self) -> i32 {
        let flag = |flag: bool, bit: u8| i32::from(flag) << bit;
        i32::from(self.switches & 0b1111)
            | flag(self.moving, 4)
            | flag(self.expired, 5)
            | flag(self.on_its_way, 6)
            | flag(self.gave_up, 7)
            | i32::from(self.battery & 0x7f) << 8
            | flag(self.charging, 15)
    }

    /// What a reply says; bits without a meaning are left out.
    #[must_use]
    pub fn from_bits(bits: i32) -> Self {
        let flag = |bit: u8| bits >> bit & 1 == 1;
        Self {
            switches: (bits & 0b1111) as u8,
            moving: flag(4),
            expired: flag(5),
            on_its_way: flag(6),
            gave_up: flag(7),
            battery: (bits >> 8 & 0x7f) as u8,
            charging: flag(15),
        }
    }
}
