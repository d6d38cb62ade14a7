//! When effectors are where they were set to: as the robot measures it, or after the time that they need by its model.

use mom_device::{DeviceError, DeviceTime, ErrorName};
use mom_rsp::{Kind, Motion};
use mom_rsp_model::ModelElement;

use crate::Simulacrum;
use crate::values::from_wire;

/// µs that an effector may need beyond the time by its model before it is taken for hindered.
const LATE: DeviceTime = 2_000_000;
/// A value is there when it is off by less than this share of its range.
pub(super) const NEAR: f64 = 0.01;
/// ms between two values of what measures motion, at most.
pub(super) const SLOWEST: u16 = 100;

/// Effectors on their way.
#[derive(Debug)]
pub(super) struct Arrival(Vec<Way>);

/// One of them.
#[derive(Debug)]
struct Way {
    place: u8,
    /// µs that it needs by its model once the robot has the value.
    needs: DeviceTime,
    /// When the robot was first known to have it.
    since: Option<DeviceTime>,
}

impl Arrival {
    /// Those of these places, before they are written: each is to have these bytes.
    pub(super) fn of(robot: &Simulacrum, settings: &[(u8, Vec<u8>)]) -> Arrival {
        let ways = settings.iter().map(|(place, bytes)| Way {
            place: *place,
            needs: needs(robot, *place, bytes),
            since: None,
        });
        Arrival(ways.collect())
    }

    /// Whether all are there.
    ///
    /// # Errors
    ///
    /// `obstacle` for one that does not come to where it was set to.
    pub(super) fn is_there(&mut self, robot: &Simulacrum, now: DeviceTime) -> Result<bool, DeviceError> {
        let mut all = true;
        for way in &mut self.0 {
            all &= way.is_there(robot, now)?;
        }
        Ok(all)
    }
}

impl Way {
    fn is_there(&mut self, robot: &Simulacrum, now: DeviceTime) -> Result<bool, DeviceError> {
        let has = robot.with(|middle| {
            let has = middle.confirmed(self.place).map(|has| has.value);
            middle.wanted(self.place).is_none_or(|wanted| has == Some(wanted))
        });
        if !has {
            return Ok(false);
        }
        let passed = now - *self.since.get_or_insert(now);
        let Some(element) = robot.model().elements().get(usize::from(self.place)) else {
            return Ok(true);
        };
        let is_absolute = matches!(element.motion, Motion::Absolute { .. });
        let Some((is, monitor)) = measured(robot, self.place).filter(|_| is_absolute) else {
            return Ok(passed >= self.needs);
        };
        let wanted = robot.wanted(self.place).unwrap_or_default();
        let is_near = wanted.iter().zip(&is).enumerate().all(|(part, (wanted, is))| {
            let quantity = element.quantity(part);
            let range = quantity.map_or(0.0, |quantity| quantity.max - quantity.min);
            (wanted - is).abs() <= range * NEAR
        });
        if !is_near && passed > self.needs + LATE {
            let text = format!(
                "{} does not come to {wanted:?}: `{}` says {is:?} {} ms after the robot took it",
                element.name,
                monitor.name,
                passed / 1000
            );
            return Err(DeviceError::new(ErrorName::Obstacle, text));
        }
        Ok(is_near)
    }
}

/// What an active monitor of an effector says, and which; one that speaks too seldom says nothing of now.
pub(super) fn measured(robot: &Simulacrum, effector: u8) -> Option<(Vec<f64>, &ModelElement)> {
    let mut monitors = (0..).zip(robot.model().elements());
    monitors.find_map(|(place, element)| {
        let is_its =
            element.kind == Kind::Monitor && element.of == Some(effector) && element.period <= SLOWEST;
        if !is_its || !robot.with(|middle| middle.active(place)) {
            return None;
        }
        Some((robot.read(place)?.values, element))
    })
}

/// µs that an effector needs to a value by the rate of its model; two periods where it has none.
fn needs(robot: &Simulacrum, place: u8, bytes: &[u8]) -> DeviceTime {
    let filter = 2000 * DeviceTime::from(robot.with(|middle| middle.period()));
    let Some(element) = robot.model().elements().get(usize::from(place)) else {
        return filter;
    };
    let Some(rate) = element.rate.filter(|rate| *rate > 0.0) else {
        return filter;
    };
    let to = from_wire(element, bytes);
    let from = match element.motion {
        Motion::Absolute { .. } => robot
            .wanted(place)
            .unwrap_or_else(|| from_wire(element, &element.safe)),
        Motion::Incremental { .. } => vec![0.0; to.len()],
    };
    let way = to.iter().zip(&from).map(|(to, from)| (to - from).abs());
    let longest = way.fold(0.0, f64::max);
    filter.saturating_add((longest / rate * 1e6) as DeviceTime)
}
