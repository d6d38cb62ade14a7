//! Measures what simulated robots cost: `cost [ROBOTS]`, a fleet of 1000 by default, in ns for each robot and 100 ms.

use std::hint::black_box;
use std::io::{self, Write as _};
use std::time::Instant;

use mom_wheels::{
    Chassis, Driver as _, DriverError, Floor, Motors, Pose, Power, SetupError, Simulated, WheelTime,
};

/// µs between two rounds.
const ROUND: WheelTime = 100_000;
/// Rounds that are measured.
const ROUNDS: i16 = 100;

/// What one robot does in one round.
type Deed = fn(&mut Simulated, i16, WheelTime) -> Result<(), DriverError>;

fn main() -> io::Result<()> {
    let given = std::env::args().nth(1).and_then(|text| text.parse().ok());
    let robots: u16 = given.unwrap_or(1000);
    let kinds: [(&str, Deed); 5] = [
        ("reading one at rest", |robot, _, at| read(robot, at)),
        ("reading one that drives an arc", |robot, round, at| {
            if round == 0 {
                robot.set_motors(Motors::new(100, 110), at)?;
            }
            read(robot, at)
        }),
        ("setting its motors and reading it", |robot, round, at| {
            robot.set_motors(motors(round), at)?;
            read(robot, at)
        }),
        ("the same, and asking when it wakes", |robot, round, at| {
            robot.set_motors(motors(round), at)?;
            black_box(robot.next_wake());
            read(robot, at)
        }),
        ("setting and reading it 1 mm beside a wall", |robot, round, at| {
            if round == 0 {
                *robot = beside_a_wall().unwrap_or_else(|_| Simulated::linuxbot());
            }
            let speed = motors(round).left();
            robot.set_motors(Motors::new(speed, speed), at)?;
            read(robot, at)
        }),
    ];
    let size = size_of::<Simulated>();
    writeln!(io::stdout(), "{robots} robots of {size} bytes, each each 100 ms:")?;
    for (name, deed) in kinds {
        let nanoseconds = measure(robots, deed).map_err(io::Error::other)?;
        writeln!(io::stdout(), "{nanoseconds:7.0} ns  {name}")?;
    }
    Ok(())
}

/// Forward and back by turns, and never twice the same.
fn motors(round: i16) -> Motors {
    let speed = if round % 2 == 0 { 200 } else { -200 };
    Motors::new(speed + round % 7, speed - round % 5)
}

fn beside_a_wall() -> Result<Simulated, SetupError> {
    let pose = Pose::new(2500.0, Chassis::LINUXBOT.radius + 1.0, 0.0);
    Simulated::new(Chassis::LINUXBOT, Power::LINUXBOT, Floor::ARENA, pose)
}

fn read(robot: &mut Simulated, at: WheelTime) -> Result<(), DriverError> {
    black_box(robot.sensors(at)?);
    Ok(())
}

/// ns for one robot and one round.
fn measure(robots: u16, deed: Deed) -> Result<f64, DriverError> {
    let mut fleet = Simulated::fleet(robots);
    let begin = Instant::now();
    for round in 0..ROUNDS {
        for robot in &mut fleet {
            deed(robot, round, WheelTime::from(round) * ROUND)?;
        }
    }
    let count = f64::from(robots) * f64::from(ROUNDS);
    Ok(begin.elapsed().as_secs_f64() * 1e9 / count)
}
