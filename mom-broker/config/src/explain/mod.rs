//! Explains a configuration: how its hub would answer a hypothetical request.

mod askings;
mod words;

use mom_hub::{Case, Judgement, Settings, User};
use mom_login::{GUEST, UserEntry, guest};
use mom_managers::{Answer, Ask, Defer};
use mom_proto::nearest::nearest;
use mom_proto::{ContextKind, Family, Map, Path, Time, Verb, WireError};
use mom_system::Clock;
use serde::Serialize;

use super::{Config, ConfigError, Location};

pub use askings::{Asking, message_of};

use words::{later, needs, stands};

/// A hypothetical request.
#[derive(Clone, Debug)]
pub struct Supposed {
    /// The user.
    pub user: String,
    /// Its level and groups, instead of those in the users file.
    pub level: Option<i32>,
    /// As `level`.
    pub groups: Option<Vec<String>>,
    /// The context; for `create` the new path.
    pub context: Path,
    /// The new context's kind, for `create`.
    pub kind: Option<ContextKind>,
    /// Who owns which token meanwhile: token and user.
    pub owners: Vec<(Path, String)>,
    /// Whether a member has invited the user there.
    pub invited: bool,
    /// The time; none = now.
    pub at: Option<Time>,
}

/// The answer, and the rule that decides.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct Explanation {
    /// The user.
    pub user: String,
    /// Its level.
    pub level: i32,
    /// Its groups.
    pub groups: Vec<String>,
    /// The verb.
    pub verb: &'static str,
    /// The message, for sends; `*` = any that no rule names.
    pub message: Option<String>,
    /// Where.
    pub context: String,
    /// The context's kind; none = no such context.
    pub kind: Option<&'static str>,
    /// `allow`, `deny`, `ask` (peers have to be asked first) or `wait` (there is a queue).
    pub answer: &'static str,
    /// The rule that decided; none = the manager as a whole, or the hub itself if `place` is none, too.
    pub rule: Option<String>,
    /// Whether no rule covers the request, so that the manager's default decided.
    pub uncovered: bool,
    /// Its location.
    pub place: Option<Location>,
    /// The name of the manager.
    pub manager: String,
    /// The context that it manages.
    pub managed_at: String,
    /// The error that the peer would get: its name, and all its content.
    pub error: Option<Map>,
    /// The peers that it would ask first.
    pub asks: Option<Asked>,
    /// Whether the owner loses the token.
    pub displaces: bool,
    /// When the ownership would end, whatever the lease.
    pub until: Option<Time>,
    /// How long the answer stands.
    pub stands: String,
    /// The hub's further conditions for any peer.
    pub needs: Vec<String>,
}

/// The peers that a manager would ask.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct Asked {
    /// In words.
    pub who: String,
    /// The users of the users file that could answer.
    pub users: Vec<String>,
    /// How long they have, in ms.
    pub within: u64,
}

impl Config {
    /// How a hub of this configuration would answer a request.
    ///
    /// # Errors
    /// A user that is not known, a verb that no manager is asked about, a configuration that is wrong.
    pub fn explain(
        &self,
        supposed: &Supposed,
        verb: Verb,
        message: Option<&str>,
    ) -> Result<Explanation, ConfigError> {
        if verb.family() == Family::Message && verb != Verb::Send && message.is_some() {
            return Err(plain(format!("{verb} is a message itself; leave the name out")));
        }
        match verb {
            Verb::Login | Verb::Answer | Verb::Logout | Verb::Verdict | Verb::Ping | Verb::Pong => {
                Err(plain(format!("no manager is asked about {verb}")))
            }
            _ => self.judge(supposed, verb, message),
        }
    }

    /// The same for all requests to a context: each verb, and each message that a rule names.
    ///
    /// # Errors
    /// As [`Config::explain`].
    pub fn explain_all(&self, supposed: &Supposed) -> Result<Vec<Explanation>, ConfigError> {
        let place = self.hub()?.place(&supposed.context);
        let askings = self.askings(&supposed.context, place.as_ref());
        let explained = askings.into_iter().map(|asking| {
            let there = Supposed {
                context: asking.context,
                ..supposed.clone()
            };
            self.judge(&there, asking.verb, asking.message.as_deref())
        });
        explained.collect()
    }

    /// The users of the users file, and a guest where guests may log in, whom a hub of this configuration allows a verb at each of
    /// these contexts.
    ///
    /// # Errors
    /// A configuration that is wrong.
    pub fn allowed(&self, verb: Verb, paths: &[Path]) -> Result<Vec<Vec<String>>, ConfigError> {
        let guests = self.login.guests.then(guest);
        let users = self.users.iter().map(UserEntry::to_user).chain(guests);
        let mut allowed = vec![Vec::new(); paths.len()];
        for user in users {
            let judgements = self.hub()?.judge_at(
                &Case {
                    user: &user,
                    verb,
                    path: &Path::root(),
                    kind: None,
                    message: message_of(verb, None),
                    owners: &[],
                    invited: false,
                },
                paths,
            );
            for (allowed, judgement) in allowed.iter_mut().zip(judgements) {
                if judgement.refusal.is_none() && judgement.verdict.is_allow() {
                    allowed.push(user.name.clone());
                }
            }
        }
        Ok(allowed)
    }

    fn judge(
        &self,
        supposed: &Supposed,
        verb: Verb,
        message: Option<&str>,
    ) -> Result<Explanation, ConfigError> {
        let user = self.supposed_user(supposed)?;
        let owners: Result<Vec<(Path, User)>, ConfigError> = supposed
            .owners
            .iter()
            .map(|(token, owner)| Ok((token.clone(), self.user(owner)?)))
            .collect();
        let owners = owners?;
        let message = message_of(verb, message);
        let anchor = supposed.at.unwrap_or_else(|| Clock::system().wall());
        let hub = self.make_hub(Settings {
            anchor,
            limits: self.limits.clone(),
            ..Settings::default()
        })?;
        for (token, _) in &owners {
            if hub.place(token).map(|place| place.kind) != Some(ContextKind::Token) {
                return Err(plain(format!("{token} is not a token, so nobody owns it")));
            }
        }
        let judgement = hub.judge(&Case {
            user: &user,
            verb,
            path: &supposed.context,
            kind: supposed.kind,
            message,
            owners: &owners,
            invited: supposed.invited,
        });
        let asking = Asking {
            verb,
            context: supposed.context.clone(),
            message: message.filter(|_| verb == Verb::Send).map(str::to_owned),
        };
        Ok(self.explained(user, asking, &judgement, anchor))
    }

    /// A hub's answer to a request of a user, with the place of the rule that decided; `anchor` is the time when the hub began.
    pub fn explained(&self, user: User, asking: Asking, judgement: &Judgement, anchor: Time) -> Explanation {
        let Judgement {
            verdict,
            refusal,
            managed_at,
            ..
        } = judgement;
        let answer = match (&verdict.answer, refusal) {
            (Answer::Defer(_), _) => "ask",
            (Answer::Queue(_), _) => "wait",
            (_, Some(_)) => "deny",
            (Answer::Allow(_) | Answer::Deny(_), None) => "allow",
        };
        let grant = match &verdict.answer {
            Answer::Allow(grant) => Some(grant),
            _ => None,
        };
        // A refusal by the hub after the manager has allowed does not come from the configuration.
        let by_hub = answer == "deny" && verdict.is_allow();
        let rule = match refusal.as_ref().and_then(|error| error.get("rule")?.as_str()) {
            Some(rule) => Some(rule.to_owned()),
            None => verdict.rule.as_deref().filter(|_| !by_hub).map(str::to_owned),
        };
        let place = rule
            .as_ref()
            .and_then(|rule| self.locate_rule(rule, managed_at))
            .or_else(|| self.locate_manager_of(managed_at))
            .filter(|_| !by_hub);
        let refused = rule.as_ref().filter(|_| answer == "deny");
        let uncovered = refused.is_some_and(|rule| {
            let managers = self.managers_at(managed_at);
            let mut rules = managers.iter().filter(|manager| manager.kind == "roles");
            rules.any(|manager| manager.label == *rule)
        });
        Explanation {
            user: user.name,
            level: user.level,
            groups: user.groups,
            verb: asking.verb.word(),
            context: asking.context.to_string(),
            kind: judgement.place.as_ref().map(|place| place.kind.word()),
            answer,
            rule,
            uncovered,
            place,
            manager: judgement.manager.clone(),
            managed_at: managed_at.to_string(),
            error: refusal.as_ref().map(WireError::to_map),
            asks: match &verdict.answer {
                Answer::Defer(defer) => Some(self.asked(defer)),
                _ => None,
            },
            displaces: grant.is_some_and(|grant| grant.displace)
                && answer == "allow"
                && judgement.owner.is_some(),
            until: grant.and_then(|grant| later(anchor, grant.until?)),
            stands: stands(verdict.standing),
            needs: needs(&asking.context, asking.verb, judgement),
            message: asking.message,
        }
    }

    fn supposed_user(&self, supposed: &Supposed) -> Result<User, ConfigError> {
        let mut user = match self.user(&supposed.user) {
            Ok(user) => user,
            Err(_) if supposed.level.is_some() || supposed.groups.is_some() => User {
                name: supposed.user.clone(),
                level: 0,
                groups: Vec::new(),
                details: Map::new(),
            },
            Err(error) => return Err(error),
        };
        user.level = supposed.level.unwrap_or(user.level);
        if let Some(groups) = &supposed.groups {
            user.groups.clone_from(groups);
        }
        Ok(user)
    }

    /// The user of this name, as it logs in.
    ///
    /// # Errors
    /// There is none; the nearest is named.
    pub fn user(&self, name: &str) -> Result<User, ConfigError> {
        if self.login.guests && name == GUEST {
            return Ok(guest());
        }
        let entry = self.users.iter().find(|entry| entry.name == name);
        entry.map(|entry| entry.to_user()).ok_or_else(|| {
            let near = nearest(name, self.users.iter().map(|entry| entry.name.as_str()));
            let hint = near.map(|near| format!(" (did you mean {near}?)"));
            plain(format!("there is no user {name:?}{}", hint.unwrap_or_default()))
        })
    }

    fn asked(&self, defer: &Defer) -> Asked {
        let (who, users) = match &defer.ask {
            Ask::Creator => ("the peer that made the context".to_owned(), Vec::new()),
            Ask::Chairs {
                users,
                groups,
                min_level,
            } => {
                let chairs = self.users.iter().filter(|user| {
                    let named = users.is_empty() && groups.is_empty();
                    let listed = users.contains(&user.name);
                    let grouped = user.groups.iter().any(|group| groups.contains(group));
                    (named || listed || grouped) && min_level.is_none_or(|least| user.level >= least)
                });
                let who = "the first to answer of these who is in the context, or in the one above it";
                (who.to_owned(), chairs.map(|user| user.name.clone()).collect())
            }
        };
        Asked {
            who,
            users,
            within: defer.within / 1000,
        }
    }
}

fn plain(text: String) -> ConfigError {
    ConfigError::of_program(None, text)
}
