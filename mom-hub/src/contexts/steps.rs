//! What would hold up others goes in steps: large deletions, and the ways out of large sessions.

use mom_proto::{Micros, Path};

use crate::world::steps::{Job, Leaving};
use crate::world::{Timer, World};
use crate::{Effect, PeerId};

/// Contexts that one step ends, removes or leaves, and peers that it tells.
pub(super) const STEP: usize = 32;
pub(super) const TOLD: usize = 256;

/// The time between two steps, in which others have their turns.
const PAUSE: Micros = 1_000;

impl World {
    /// Lets a job go on with its next step a little later.
    pub(super) fn begin_job(&mut self, job: Job) {
        if self.jobs.is_empty() {
            self.timers.insert((self.after(PAUSE), Timer::Step));
        }
        self.jobs.push_back(job);
    }

    /// Goes on with what is done in steps, each in its turn; gives a way out that has come to its end.
    pub(crate) fn go_on(&mut self, out: &mut Vec<Effect>) -> Option<Leaving> {
        let Some(job) = self.jobs.pop_front() else {
            return self.fault("nothing is done in steps");
        };
        let mut left = None;
        match job {
            Job::Delete(mut deletion) => match self.delete_step(&mut deletion, out) {
                true => {
                    self.doomed.remove(&deletion.path);
                }
                false => self.jobs.push_back(Job::Delete(deletion)),
            },
            Job::Leave(leaving) => match self.leave_step(&leaving, out) {
                true => {
                    self.end_leaving(&leaving);
                    left = Some(leaving);
                }
                false => self.jobs.push_back(Job::Leave(leaving)),
            },
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

/// How many are told by effects.
pub(super) fn told(effects: &[Effect]) -> usize {
    let one = |effect: &Effect| match effect {
        Effect::Deliver { to, .. } => to.len(),
        _ => 0,
    };
    effects.iter().map(one).sum()
}
