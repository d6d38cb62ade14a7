//! From what the cameras see to where objects are.

use mom_client::{Path, Time};
use mom_vision::pose::{BlockPose, View, agrees, locate};

use super::{Kind, ModelServer};
use crate::{Look, Object};

/// Images without the robot's state belong together if they were taken within so many µs.
const TOGETHER: i64 = 1_500_000;
/// Whatever the robot's state says, images that lie further apart may show different things, µs.
const APART: i64 = 3_000_000;
/// A camera that has shown nothing for so many µs counts as none.
const BLIND: i64 = 4_000_000;
/// A place that has moved less is where it was, mm; a turn, degrees.
const STILL: f64 = 1.0;
const UNTURNED: f64 = 2.0;
/// A place known better than this needs no better measurement while it agrees with what is seen, mm.
const GOOD: f64 = 1.0;
/// What one camera alone says is not known better, mm.
const ALONE: f64 = 2.0;

impl ModelServer {
    /// Brings the objects up to date with a camera's new look and those of the others that show the same.
    pub(super) fn fuse(&mut self, camera: usize, now: Time) {
        let Some(newest) = self.eyes.get(camera).and_then(|eye| eye.look.clone()) else {
            return;
        };
        let looks: Vec<(String, Look)> = self
            .eyes
            .iter()
            .zip(&self.options.cameras)
            .filter_map(|(eye, path)| Some((last_name(path), eye.look.clone()?)))
            .filter(|(_, look)| shows_the_same(look, &newest))
            .collect();
        let alone = self.is_alone(camera, now);
        for (name, _) in &newest.seen {
            let Some(kind) = self.kind(name) else { continue };
            let known = self.objects.get(name).cloned();
            if let Some(object) = measured(&kind, known.as_ref(), &looks, alone) {
                self.objects.insert(Object {
                    held: self.holding.as_ref() == Some(name),
                    ..object
                });
            }
        }
    }

    /// What an object is like: as it was written, or as it was configured.
    fn kind(&self, name: &str) -> Option<Kind> {
        let known = self.objects.get(name).map(|object| Kind {
            name: object.name.clone(),
            size: object.size,
            colour: object.colour,
        });
        known.or_else(|| self.options.kinds.iter().find(|kind| kind.name == name).cloned())
    }

    /// Whether no other camera shows anything, though there was time enough.
    fn is_alone(&self, camera: usize, now: Time) -> bool {
        let long_ago = |time: Time| now.micros() - time.micros() > BLIND;
        let mut others = self.eyes.iter().enumerate().filter(|(index, _)| *index != camera);
        others.all(|(_, eye)| {
            let last = eye.look.as_ref().map(|look| look.taken);
            last.or(self.begun).is_some_and(long_ago)
        })
    }
}

/// The camera's name: the last part of its channel's path.
fn last_name(path: &Path) -> String {
    path.to_string().rsplit('/').next().unwrap_or_default().to_owned()
}

fn shows_the_same(look: &Look, newest: &Look) -> bool {
    let apart = (look.taken.micros() - newest.taken.micros()).abs();
    match (look.state, newest.state) {
        // A block may move without the robot.
        (Some(a), Some(b)) => a == b && apart < APART,
        _ => apart < TOGETHER,
    }
}

/// An object as these looks show it, if they do.
fn measured(kind: &Kind, known: Option<&Object>, looks: &[(String, Look)], alone: bool) -> Option<Object> {
    // What was written holds until something newer is seen.
    let written = known.and_then(|object| object.written);
    let seen: Vec<(&str, &Look, View<'_>)> = looks
        .iter()
        .filter(|(_, look)| written.is_none_or(|written| look.taken > written))
        .filter_map(|(name, look)| {
            let sighting = look.sighting(&kind.name)?;
            let projection = &look.projection;
            Some((name.as_str(), look, View { projection, sighting }))
        })
        .collect();
    let agree = |object: &Object| -> Vec<(&str, Time)> {
        let place = [object.x, object.y, object.z];
        let same = seen
            .iter()
            .filter(|(.., view)| agrees(kind.size, place, object.yaw, view));
        same.map(|(name, look, _)| (*name, look.taken)).collect()
    };
    let still = known.map(&agree).unwrap_or_default();
    let good =
        known.filter(|object| object.seen.is_some() && object.written.is_none() && object.error < GOOD);
    if let Some(object) = good
        && still.len() >= 2
    {
        return Some(again(object, &still));
    }
    let was_seen = known.is_some_and(|object| object.seen.is_some() && object.written.is_none());
    let views: Vec<View<'_>> = seen.iter().map(|(.., view)| *view).collect();
    let found = match views.len() {
        0 => None,
        1 if !alone => None,
        // One camera alone does not tell the height: it is the known one while the block seems to lie where it did, and
        // otherwise that of the table.
        1 if was_seen && !still.is_empty() => None,
        1 => locate(kind.size, &views, Some(kind.size / 2.0))
            .ok()
            .map(|pose| BlockPose {
                error: pose.error.max(ALONE),
                ..pose
            }),
        _ => locate(kind.size, &views, None).ok(),
    };
    match found {
        Some(pose) => Some(located(kind, known, &pose, &seen)),
        // The others do not see enough of it; what one sees is where it was.
        None => known
            .filter(|object| !still.is_empty() && object.written.is_none())
            .map(|object| again(object, &still)),
    }
}

/// The object, seen again where it was.
fn again(object: &Object, by: &[(&str, Time)]) -> Object {
    Object {
        seen: by.iter().map(|(_, taken)| *taken).max().max(object.seen),
        ..object.clone()
    }
}

/// The object at a place that was measured.
fn located(
    kind: &Kind,
    known: Option<&Object>,
    pose: &BlockPose,
    seen: &[(&str, &Look, View<'_>)],
) -> Object {
    let used: Vec<_> = seen
        .iter()
        .zip(&pose.seen)
        .filter(|(_, part)| **part > 0.0)
        .map(|(seen, _)| seen)
        .collect();
    let [x, y, z] = pose.place;
    let new = Object {
        x,
        y,
        z,
        yaw: pose.yaw,
        error: pose.error,
        seen: used.iter().map(|(_, look, _)| look.taken).max(),
        cameras: used.iter().map(|(name, ..)| (*name).to_owned()).collect(),
        ..Object::new(&kind.name, kind.size, kind.colour)
    };
    match known.filter(|known| known.written.is_none() && is_still(known, &new)) {
        // The numbers stand still while the block does.
        Some(known) if known.error <= new.error => Object {
            seen: new.seen.max(known.seen),
            ..known.clone()
        },
        _ => new,
    }
}

fn is_still(known: &Object, new: &Object) -> bool {
    let apart = (known.yaw - new.yaw).rem_euclid(90.0);
    let moved = [known.x - new.x, known.y - new.y, known.z - new.z];
    moved.iter().all(|part| part.abs() <= STILL) && apart.min(90.0 - apart) <= UNTURNED
}
