//! A robot that exists only as numbers: a differential drive on a floor with walls, its battery, LEDs and bumpers.
//!
//! Wheels follow their motors with a lag (`motion.rs` has the formulas and their errors). A robot that meets a wall stops
//! there with both wheels, and the wall presses the half or halves of the bumper on its side. It stands there, stalled, as long as its
//! motors would drive it into the wall; any other motion takes it away, but not before the switch was pressed for
//! [`PRESSED`]. Robots do not meet each other, even on the same floor.
//!
//! Power is drawn by the electronics, by each LED that is lit, and by the wheels in proportion to their speed. An empty
//! battery sets the motors to 0 0, so that the robot runs out, and makes its LEDs dark; the driver still answers. A robot that has a
//! charger ([`Simulated::with_charger`]) is charged from when it stands there with its motors at 0 0 until they are set to something
//! else, also from 0 on. The motors are set to 0 0, too, at the time
//! that [`Driver::hold`] has given, also when nobody asks at that time.
//!
//! # Cost
//!
//! Nothing runs between two calls. A call computes what was commanded since the last one, in a number of steps that
//! does not depend on how much time has passed; what it gives does not depend on how often it was asked before.
//! `cargo run --release -p mom-wheels --example cost` measures it. On one core of a virtual machine it takes 0.1 µs to read
//! a robot at rest, 0.2 µs to read one that drives, and 3 to 4 µs to set its motors, look ahead for walls and an empty
//! battery, and read it; 21 µs, the most that was found, when it drives close beside a wall. So 1000 robots with 10 commands/s
//! each, the rate of W18, take 3 to 4 % of that core, and 21 % if all drive beside walls.

mod charge;
mod fittings;
mod motion;
#[cfg(test)]
mod tests;
mod walls;

use charge::{Charge, Load, friction, rims, seconds};
pub use fittings::Fittings;
use motion::{Motion, Speeds, Spot};
use walls::Limits;

use crate::wall::Wall;
use crate::{
    Chassis, Driver, DriverError, Fault, Floor, Motors, Parts, Point, Pose, Power, Sensors, SetupError,
    WheelTime,
};

/// mm/s: a robot stands when both wheels are slower.
pub const STANDING: f64 = 0.5;
/// µs, the shortest time for which a wall presses a switch.
pub const PRESSED: WheelTime = 50_000;
/// mm: so near its charger a robot that stands is charged.
pub const DOCKED: f64 = 100.0;
/// mm, the side of the square of floor in whose middle each robot of a fleet begins.
pub const CELL: f64 = 1000.0;

/// A simulated robot. It begins at the first time that is given to it; `next_wake` is `None` until then.
///
/// ```
/// use mom_wheels::{Chassis, Driver, Floor, Motors, Pose, Power, Simulated, switch};
///
/// // 400 mm in front of the east wall.
/// let pose = Pose::new(4500.0, 2500.0, 0.0);
/// let mut robot = Simulated::new(Chassis::LINUXBOT, Power::LINUXBOT, Floor::ARENA, pose)?;
/// robot.set_motors(Motors::new(500, 500), 0)?;
/// let sensors = robot.sensors(2_000_000)?;
/// assert_eq!(sensors.switches, switch::FRONT);
/// assert_eq!(sensors.pose, Some(Pose::new(4900.0, 2500.0, 0.0)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Simulated {
    chassis: Chassis,
    power: Power,
    limits: Limits,
    fittings: Fittings,
    /// Where its charger stands, if it has one.
    charger: Option<Point>,
    charging: bool,
    /// The latest time given; `None` before the first, at which it begins to be.
    begun: Option<WheelTime>,
    motors: Motors,
    /// When the motors stop by themselves.
    held: WheelTime,
    leds: u8,
    charge: Charge,
    course: Course,
    ahead: Option<Ahead>,
}

/// What it does since its motors were set, or since a wall or the battery stopped it.
#[derive(Debug, Clone, Copy)]
enum Course {
    Free {
        motion: Motion,
        began: WheelTime,
    },
    /// It stands at walls.
    Held {
        place: Spot,
        since: WheelTime,
        switches: u8,
    },
}

/// What will happen if nobody commands anything.
#[derive(Debug, Clone, Copy)]
struct Ahead {
    /// When it meets which wall.
    meets: Option<(WheelTime, Wall)>,
    /// When its motors take it away from a wall.
    leaves: Option<WheelTime>,
    /// When its battery is empty.
    empties: Option<WheelTime>,
    /// When it stands at its charger.
    docks: Option<WheelTime>,
}

/// Which of them comes first.
#[derive(Debug, Clone, Copy)]
enum Change {
    Meets(Wall),
    Leaves,
    Empties,
    Docks,
    /// Its motors were not to run for longer.
    Expires,
}

impl Simulated {
    /// A robot that stands at a pose, with a full battery, its LEDs dark.
    ///
    /// # Errors
    ///
    /// [`SetupError`] if there cannot be such a robot at such a place.
    pub fn new(chassis: Chassis, power: Power, floor: Floor, pose: Pose) -> Result<Self, SetupError> {
        chassis.check()?;
        power.check()?;
        floor.check()?;
        let Pose { x, y, heading } = pose;
        let limits = Limits::new(floor, chassis.radius);
        if !limits.holds(x, y) || !heading.is_finite() {
            let radius = chassis.radius;
            return Err(SetupError::OffFloor { x, y, radius, floor });
        }
        Ok(Self::at(chassis, power, limits, pose))
    }

    /// The robot of the second paper, in the middle of [`Floor::ARENA`], looking along x.
    #[must_use]
    pub fn linuxbot() -> Self {
        let Floor { width, depth } = Floor::ARENA;
        let limits = Limits::new(Floor::ARENA, Chassis::LINUXBOT.radius);
        let pose = Pose::new(width / 2.0, depth / 2.0, 0.0);
        Self::at(Chassis::LINUXBOT, Power::LINUXBOT, limits, pose)
    }

    /// So many robots of the second paper on one floor, each in the middle of its own cell of a square grid, looking along x.
    /// They begin row by row from the corner at x = 0, y = 0, and the floor is as large as the grid.
    ///
    /// ```
    /// use mom_wheels::{Driver, Pose, Simulated};
    ///
    /// let mut fleet = Simulated::fleet(10);
    /// let last = fleet[9].sensors(0)?;
    /// assert_eq!(last.pose, Some(Pose::new(1500.0, 2500.0, 0.0)));
    /// # Ok::<(), mom_wheels::DriverError>(())
    /// ```
    #[must_use]
    pub fn fleet(n: u16) -> Vec<Self> {
        let floor = fleet_floor(n);
        let limits = Limits::new(floor, Chassis::LINUXBOT.radius);
        let columns = columns(n);
        let place = |index: u16| Pose::new(middle(index % columns), middle(index / columns), 0.0);
        (0..n)
            .map(|index| Self::at(Chassis::LINUXBOT, Power::LINUXBOT, limits, place(index)))
            .collect()
    }

    /// The same with so many percent in its battery; more than 100 are 100.
    #[must_use]
    pub fn with_battery(mut self, percent: u8) -> Self {
        self.fill(percent);
        self
    }

    /// The same without odometry, as the paper has it: its pose is not among what it senses. [`Self::pose`] still tells it.
    #[must_use]
    pub fn without_odometry(mut self) -> Self {
        self.fittings.odometry = false;
        self
    }

    /// Fills or empties the battery to so many percent; more than 100 are 100. Motors that an empty battery has stopped wait for a
    /// command.
    pub fn recharge(&mut self, percent: u8, at: WheelTime) {
        self.advance(at);
        self.fill(percent);
    }

    /// What it is like.
    #[must_use]
    pub const fn chassis(&self) -> Chassis {
        self.chassis
    }

    /// The floor that it drives on, within its walls.
    #[must_use]
    pub fn floor(&self) -> Floor {
        self.limits.floor()
    }

    /// Where it is, whether it senses that or not.
    pub fn pose(&mut self, at: WheelTime) -> Pose {
        self.advance(at);
        let Spot { x, y, heading } = self.place();
        Pose::new(x, y, heading.to_degrees())
    }

    /// mm/s of the wheels, left and right.
    pub fn wheel_speeds(&mut self, at: WheelTime) -> [f64; 2] {
        self.advance(at);
        self.speeds().wheels(self.chassis.wheel_base)
    }

    /// Whether both wheels are slower than [`STANDING`].
    pub fn is_standing(&mut self, at: WheelTime) -> bool {
        self.wheel_speeds(at).iter().all(|speed| speed.abs() < STANDING)
    }

    /// The LEDs that are lit, a bit each.
    pub fn leds(&mut self, at: WheelTime) -> u8 {
        self.advance(at);
        self.leds
    }

    /// J that are left in the battery.
    pub fn charge(&mut self, at: WheelTime) -> f64 {
        self.advance(at);
        self.left().joules
    }

    fn at(chassis: Chassis, power: Power, limits: Limits, pose: Pose) -> Self {
        let place = Spot {
            x: pose.x,
            y: pose.y,
            heading: pose.heading.to_radians(),
        };
        Self {
            chassis,
            power,
            limits,
            fittings: Fittings::LINUXBOT,
            charger: None,
            charging: false,
            begun: None,
            motors: Motors::STOP,
            held: WheelTime::MAX,
            leds: 0,
            charge: Charge::of(100, &power, 0),
            course: Course::Free {
                motion: Motion::new(place, Speeds::NONE, Speeds::NONE, &chassis),
                began: 0,
            },
            ahead: None,
        }
    }

    /// Lets time pass until `at`, or not at all if that is over.
    fn advance(&mut self, at: WheelTime) {
        if self.begun.is_none() {
            self.begin(at);
        }
        while let Some((time, event)) = self.first().filter(|(time, _)| *time <= at) {
            self.begun = Some(time.max(self.now()));
            self.happen(event);
        }
        self.begun = Some(at.max(self.now()));
    }

    fn begin(&mut self, at: WheelTime) {
        self.begun = Some(at);
        self.charge.since = at;
        if let Course::Free { began, .. } = &mut self.course {
            *began = at;
        }
        self.ahead = None;
    }

    fn now(&self) -> WheelTime {
        self.begun.unwrap_or(0)
    }

    /// What changes its course first.
    fn first(&mut self) -> Option<(WheelTime, Change)> {
        let Ahead {
            meets,
            leaves,
            empties,
            docks,
        } = self.look_ahead();
        let expires = (self.motors != Motors::STOP && self.held < WheelTime::MAX).then_some(self.held);
        let events = [
            expires.map(|time| (time, Change::Expires)),
            empties.map(|time| (time, Change::Empties)),
            leaves.map(|time| (time, Change::Leaves)),
            docks.map(|time| (time, Change::Docks)),
            meets.map(|(time, wall)| (time, Change::Meets(wall))),
        ];
        events.into_iter().flatten().min_by_key(|(time, _)| *time)
    }

    fn look_ahead(&mut self) -> Ahead {
        if let Some(ahead) = self.ahead {
            return ahead;
        }
        let empties = (!self.charge.is_empty()).then(|| self.charge.empties(&self.load()));
        let ahead = Ahead {
            meets: self.meets(),
            leaves: self.leaves(),
            empties: empties.flatten(),
            docks: self.docks(),
        };
        self.ahead = Some(ahead);
        ahead
    }

    fn meets(&self) -> Option<(WheelTime, Wall)> {
        let Course::Free { motion, began } = &self.course else {
            return None;
        };
        let contact = self.limits.contact(motion)?;
        // Rounded down, so that it is not in the wall.
        let time = began.saturating_add((contact.after * 1e6).floor() as WheelTime);
        Some((time, contact.wall))
    }

    fn leaves(&self) -> Option<WheelTime> {
        let Course::Held { place, since, .. } = &self.course else {
            return None;
        };
        let leads_away = self.motors != Motors::STOP && self.pushed(*place).next().is_none();
        leads_away.then(|| since.saturating_add(PRESSED).max(self.now()))
    }

    /// The walls at which it stands that its motors would drive it into.
    fn pushed(&self, place: Spot) -> impl Iterator<Item = Wall> {
        let (limits, ahead) = (self.limits, Speeds::of(self.motors, &self.chassis).ahead);
        Wall::ALL
            .into_iter()
            .filter(move |wall| limits.is_at(place, *wall) && wall.is_pushed(place.heading, ahead))
    }

    fn happen(&mut self, event: Change) {
        match event {
            Change::Meets(wall) => self.meet(wall),
            Change::Leaves => self.go(self.place(), Speeds::NONE),
            Change::Expires => self.drive(Motors::STOP),
            Change::Docks => {
                self.spend();
                self.charging = true;
                self.ahead = None;
            }
            Change::Empties => {
                self.charge = Charge {
                    since: self.now(),
                    joules: 0.0,
                    ..self.charge
                };
                self.die();
            }
        }
    }

    /// Stops at a wall.
    fn meet(&mut self, wall: Wall) {
        let speeds = self.speeds();
        let place = self.limits.touch(self.place(), wall);
        self.spend();
        let met = Wall::ALL.into_iter().filter(|other| {
            let also = self.limits.is_at(place, *other) && other.is_pushed(place.heading, speeds.ahead);
            *other == wall || also
        });
        let switches = met.fold(0, |switches, wall| switches | wall.presses(place.heading));
        self.course = Course::Held {
            place,
            since: self.now(),
            switches,
        };
        self.ahead = None;
    }

    fn fill(&mut self, percent: u8) {
        self.charge = Charge::of(percent, &self.power, self.now());
        self.ahead = None;
        if self.charge.is_empty() {
            self.die();
        }
    }

    /// The battery is empty: motors and LEDs go off.
    fn die(&mut self) {
        self.ahead = None;
        self.leds = 0;
        self.drive(Motors::STOP);
    }

    /// Sets the motors now.
    fn drive(&mut self, motors: Motors) {
        if self.motors == motors {
            return;
        }
        let (place, speeds) = (self.place(), self.speeds());
        self.spend();
        self.motors = motors;
        // Not at 0 0, as they were.
        self.charging = false;
        self.ahead = None;
        if matches!(self.course, Course::Free { .. }) {
            self.go(place, speeds);
            return;
        }
        // Against another wall of a corner it presses other switches.
        let pressed = self
            .pushed(place)
            .fold(0, |switches, wall| switches | wall.presses(place.heading));
        if let Course::Held { switches, .. } = &mut self.course
            && pressed != 0
        {
            *switches = pressed;
        }
    }

    /// Moves by its motors from now on.
    fn go(&mut self, place: Spot, speeds: Speeds) {
        self.spend();
        let targets = Speeds::of(self.motors, &self.chassis);
        self.course = Course::Free {
            motion: Motion::new(place, speeds, targets, &self.chassis),
            began: self.now(),
        };
        self.ahead = None;
    }

    /// Draws from the battery what was used until now.
    fn spend(&mut self) {
        self.charge = self.left();
    }

    fn load(&self) -> Load<'_> {
        let watts = self.power.idle + self.power.led * f64::from(self.leds.count_ones());
        if self.charging {
            return Load::Steady(watts - self.power.charger);
        }
        if self.charge.is_empty() {
            return Load::Steady(0.0);
        }
        let friction = friction(&self.power, &self.chassis);
        let wheel_base = self.chassis.wheel_base;
        match &self.course {
            Course::Free { motion, began } => Load::Moving {
                watts,
                friction,
                motion,
                began: *began,
                wheel_base,
            },
            Course::Held { .. } => {
                let stalled = rims(Speeds::of(self.motors, &self.chassis), wheel_base);
                Load::Steady(watts + friction * stalled)
            }
        }
    }

    /// What is in the battery now.
    fn left(&self) -> Charge {
        self.charge.at(&self.load(), self.now())
    }

    fn place(&self) -> Spot {
        match &self.course {
            Course::Free { motion, began } => self.limits.keep(motion.place(seconds(*began, self.now()))),
            Course::Held { place, .. } => *place,
        }
    }

    fn speeds(&self) -> Speeds {
        match &self.course {
            Course::Free { motion, began } => motion.speeds(seconds(*began, self.now())),
            Course::Held { .. } => Speeds::NONE,
        }
    }

    /// When both wheels have what they are set to, within [`STANDING`]; `None` if they have it.
    fn reaches(&self) -> Option<WheelTime> {
        let Course::Free { motion, began } = &self.course else {
            return None;
        };
        let time = began.saturating_add((motion.within(STANDING) * 1e6).ceil() as WheelTime);
        (time > self.now()).then_some(time)
    }
}

impl Driver for Simulated {
    fn set_motors(&mut self, motors: Motors, at: WheelTime) -> Result<(), DriverError> {
        self.advance(at);
        if self.left().is_empty() && motors != Motors::STOP {
            let text = format!("the battery is empty, so the motors stay at 0 0 instead of {motors}");
            return Err(DriverError::new(Fault::Battery, text));
        }
        self.drive(motors);
        self.advance(at);
        Ok(())
    }

    fn hold(&mut self, until: WheelTime, at: WheelTime) -> Result<(), DriverError> {
        self.advance(at);
        self.held = until;
        Ok(())
    }

    fn set_leds(&mut self, leds: u8, at: WheelTime) -> Result<(), DriverError> {
        self.advance(at);
        self.fittings.check_leds(leds)?;
        if self.left().is_empty() && leds != 0 {
            let text = format!("the battery is empty, so the LEDs stay dark instead of {leds:#010b}");
            return Err(DriverError::new(Fault::Battery, text));
        }
        if self.leds != leds {
            self.spend();
            self.leds = leds;
            self.ahead = None;
        }
        Ok(())
    }

    fn sensors(&mut self, at: WheelTime) -> Result<Sensors, DriverError> {
        let pose = self.pose(at);
        let switches = match self.course {
            Course::Free { .. } => 0,
            Course::Held { switches, .. } => switches,
        };
        Ok(Sensors {
            switches: switches & self.fittings.switches,
            battery: self.left().percent(&self.power),
            motors: self.motors,
            pose: self.fittings.odometry.then_some(pose),
        })
    }

    fn parts(&mut self, at: WheelTime) -> Result<Parts, DriverError> {
        let pose = self.pose(at);
        Ok(Parts {
            charging: self.charger.map(|_| self.charging),
            light: self.fittings.light_at(self.floor(), pose),
        })
    }

    fn next_wake(&mut self) -> Option<WheelTime> {
        self.begun?;
        let event = self
            .first()
            .map(|(time, _)| time.max(self.now().saturating_add(1)));
        [event, self.reaches()].into_iter().flatten().min()
    }
}

/// The floor of [`Simulated::fleet`]: whole cells of [`CELL`], as many columns as rows or one more.
#[must_use]
pub fn fleet_floor(n: u16) -> Floor {
    let columns = columns(n);
    Floor {
        width: f64::from(columns) * CELL,
        depth: f64::from(n.div_ceil(columns).max(1)) * CELL,
    }
}

/// The columns of a grid that is as square as it can be; 1 at least.
fn columns(n: u16) -> u16 {
    let root = n.isqrt();
    let columns = if root.saturating_mul(root) < n {
        root + 1
    } else {
        root
    };
    columns.max(1)
}

/// mm, of the middle of a cell.
fn middle(cell: u16) -> f64 {
    (f64::from(cell) + 0.5) * CELL
}
