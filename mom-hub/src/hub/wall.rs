//! The wall clock steps: what is decided by the time of day is decided by the new one.

use std::sync::Arc;

use crate::world::World;
use crate::{Audit, Effect};

/// Follows the wall clock. Leases, limits of grants and stamps go on as if nothing had happened; verdicts that stand up
/// to some time of day are asked for again.
pub(super) fn step(world: &mut World, ahead: i64, out: &mut Vec<Effect>) {
    let by = ahead.saturating_sub(world.ahead);
    if by == 0 {
        return;
    }
    world.ahead = ahead;
    for context in world
        .tree
        .iter_mut()
        .filter(|context| context.channel().is_some())
    {
        let mut changed = false;
        for member in context.members.values_mut() {
            if let Some(timeless) = member.timeless() {
                *member = Arc::new(timeless);
                changed = true;
            }
        }
        if changed {
            world.changed.insert(context.number);
        }
    }
    let (sign, millis) = (if by < 0 { '-' } else { '+' }, by.unsigned_abs() / 1000);
    let fact = Audit {
        text: Some(format!(
            "the wall clock has stepped by {sign}{}.{:03} s",
            millis / 1000,
            millis % 1000
        )),
        ..Audit::new("clock-stepped")
    };
    world.audit(fact, out);
}
