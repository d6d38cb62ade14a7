//! A log on its way through a hub, with a store and links that take their time.

use mom_hub::Input;

use crate::lab::ADMIN;
use crate::log::Log;
use crate::observer::{Observer, Past, Start};
use crate::steps::{Script, Step};

/// Longer than anything lasts, µs.
const LONG: u64 = 3_000_000_000_000;

/// A run of a log.
pub(crate) struct Run {
    pub(crate) observer: Observer,
    log: Log,
    count: usize,
}

impl Run {
    pub(crate) fn new(durable: bool, gated: bool) -> Run {
        Run {
            observer: Observer::new(Start::new(durable), gated),
            log: Log::new(),
            count: 0,
        }
    }

    /// Takes a whole log.
    pub(crate) fn play(&mut self, script: &Script) {
        self.observer.look_away(true);
        script.before().iter().for_each(|step| self.take(step));
        self.observer.look_away(false);
        script.steps.iter().for_each(|step| self.take(step));
    }

    /// Takes a step, and what the store has to say by then.
    fn take(&mut self, step: &Step) {
        self.count += 1;
        self.observer.store = (self.count + step.disk.after, step.disk.ok);
        let (now, input) = self.log.next(step);
        self.give(now, &input);
        while let Some((ticket, ok)) = self.observer.disk.answer(self.count) {
            self.give(now, &Input::Stored { ticket, ok });
        }
        self.observer.link(step.link);
    }

    /// Gives the hub an input; whether it had an effect.
    fn give(&mut self, now: u64, input: &Input) -> bool {
        let effects = self.observer.take(now, input, self.log.variant);
        self.log.learn(effects);
        !effects.is_empty()
    }

    /// Kills the hub, and begins another with what is found of its store.
    pub(crate) fn restart(&mut self, luck: u64) -> Past {
        let fresh = Observer::new(Start::new(false), false);
        let old = std::mem::replace(&mut self.observer, fresh);
        let (next, past) = old.restart(luck);
        self.log.restart(next.start.epoch);
        self.observer = next;
        past
    }

    /// Lets a very long time pass, then all connections end: every request was answered, and nothing is left.
    pub(crate) fn end(mut self) -> Past {
        self.observer.store = (self.count, true);
        self.observer.link((true, true));
        let mut now = self.log.now();
        self.settle(&mut now);
        self.observer.answers.check_end();
        for peer in self.log.peers().into_iter().chain([ADMIN]) {
            self.observer
                .hub
                .handle(now, Input::Gone { peer }, &mut Vec::new());
            self.observer.hub.check();
        }
        Past {
            start: self.observer.start,
            inputs: self.observer.inputs,
            effects: self.observer.effects,
        }
    }

    fn settle(&mut self, now: &mut u64) {
        // Each turn may begin another one, as long as a peer waits.
        for _ in 0..1000 {
            while let Some((ticket, ok)) = self.observer.disk.answer(usize::MAX) {
                self.give(*now, &Input::Stored { ticket, ok });
            }
            *now += LONG;
            let more = self.give(*now, &Input::Tick);
            self.observer.link((true, true));
            if !more {
                return;
            }
        }
        panic!("something goes on and on");
    }
}
