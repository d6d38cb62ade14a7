//! What would hold up others goes in steps: large deletions, and the ways out of large sessions.

use mom_proto::Path;

use crate::world::steps::{Budget, Job, Leaving, PAUSE};
use crate::world::{Timer, World};
use crate::{Effect, PeerId};

impl World {
    /// Goes on with what is done in steps, each in its turn; gives the ways out that have come to their ends.
    pub(crate) fn go_on(&mut self, out: &mut Vec<Effect>) -> Vec<Leaving> {
        let Some(job) = self.jobs.pop_front() else {
            return self.fault("continuing a job in steps where there is none");
        };
        let mut left = Vec::new();
        match job {
            Job::Delete(mut deletion) => match self.delete_step(&mut deletion, out) {
                true => {
                    self.doomed.remove(&deletion.path);
                }
                false => self.jobs.push_back(Job::Delete(deletion)),
            },
            Job::Leave(leaving) => left = self.leave_together(leaving, out),
            Job::Stop(mut sweep) => {
                if !self.sweep_step(&mut sweep, out) {
                    self.queue_job(Job::Stop(sweep));
                }
            }
            Job::Link(mut news) => {
                if !self.link_step(&mut news, out) {
                    self.jobs.push_back(Job::Link(news));
                }
            }
        }
        if !self.jobs.is_empty() {
            self.timers.insert((self.after(PAUSE), Timer::Step));
        }
        left
    }

    /// A step of a way out, and what follows it at once if that is the way of others whose connections have ended.
    fn leave_together(&mut self, first: Leaving, out: &mut Vec<Effect>) -> Vec<Leaving> {
        let mut budget = Budget::new(out);
        let mut left = Vec::new();
        let mut next = Some(first);
        while let Some(leaving) = next {
            match self.leave_step(&leaving, &mut budget, out) {
                true => {
                    self.end_leaving(&leaving);
                    left.push(leaving);
                }
                false => {
                    self.jobs.push_back(Job::Leave(leaving));
                    break;
                }
            }
            let another = self.jobs.front().is_some_and(Job::is_departure) && !budget.is_spent(false, out);
            next = match another.then(|| self.jobs.pop_front()).flatten() {
                Some(Job::Leave(leaving)) => Some(leaving),
                _ => None,
            };
        }
        left
    }

    /// Whether a peer is on its way out of a path, or of what is above it.
    pub(crate) fn is_leaving(&self, peer: PeerId, path: &Path) -> bool {
        let tops = self.leaving.get(&peer);
        tops.is_some_and(|tops| tops.iter().any(|top| path.is_within(top)))
    }

    fn end_leaving(&mut self, leaving: &Leaving) {
        if let Some(tops) = self.leaving.get_mut(&leaving.peer) {
            if let Some(at) = tops.iter().position(|top| *top == leaving.top) {
                tops.swap_remove(at);
            }
            if tops.is_empty() {
                self.leaving.remove(&leaving.peer);
            }
        }
    }
}
