//! The kinds of manager that come with MOM: one file each, and one line here.

use crate::{
    Factory, Registry, chain, closed, first_come, level_or_lease, moderated, open, queue, quota, roles,
    schedule, self_managed, zones,
};

impl Registry {
    /// The built-in kinds, without named managers.
    pub fn builtin() -> Registry {
        let kinds: [(&'static str, Factory); 12] = [
            ("open", open::make),
            ("closed", closed::make),
            ("roles", roles::make),
            ("first-come", first_come::make),
            ("level-or-lease", level_or_lease::make),
            ("queue", queue::make),
            ("moderated", moderated::make),
            ("schedule", schedule::make),
            ("quota", quota::make),
            ("self", self_managed::make),
            ("zones", zones::make),
            ("chain", chain::make),
        ];
        Registry::of(kinds)
    }
}
