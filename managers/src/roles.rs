//! `roles`: who may do which verb where, by user, group and level.

use std::sync::Arc;

use mom_proto::{Code, Micros, PRIORITY, Pattern, Verb, WireError};
use serde::Deserialize;

use crate::params::Verbs;
use crate::who::Who;
use crate::{Manager, Question, Scope, Setup, Standing, Verdict};

/// The most rules of one manager: each question checks them in order.
const MOST: usize = 1000;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    rules: Vec<RuleParams>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct RuleParams {
    name: Option<String>,
    #[serde(default)]
    allow: Vec<String>,
    #[serde(default)]
    deny: Vec<String>,
    #[serde(default)]
    users: Vec<String>,
    #[serde(default)]
    groups: Vec<String>,
    min_level: Option<i32>,
    #[serde(default)]
    r#where: Vec<Pattern>,
    #[serde(default)]
    messages: Vec<String>,
    invited: Option<bool>,
    max_age: Option<u64>,
    priority: Option<i32>,
}

/// Checks its rules in order: the first that covers the question decides; without one it is denied.
#[derive(Debug)]
struct Roles {
    label: Arc<str>,
    rules: Vec<Rule>,
    // If any rule names messages, every verdict is for one message name.
    scope: Scope,
}

#[derive(Debug)]
struct Rule {
    name: Arc<str>,
    allow: bool,
    verbs: Verbs,
    who: Who,
    places: Vec<Pattern>,
    messages: Vec<String>,
    /// Only invited peers, or only others; none = both.
    invited: Option<bool>,
    /// The age beyond which messages are refused, µs; none = any.
    max_age: Option<Micros>,
    /// The highest priority of messages that no token guards.
    priority: i32,
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let params: Params = setup.params()?;
    if params.rules.len() > MOST {
        return Err(setup.error("rules", &format!("roles have at most {MOST} rules")));
    }
    let rules: Result<Vec<Rule>, WireError> = params
        .rules
        .into_iter()
        .enumerate()
        .map(|(index, rule)| make_rule(setup, index, rule))
        .collect();
    let rules = rules?;
    let scope = match rules.iter().all(|rule| rule.messages.is_empty()) {
        true => Scope::AnyName,
        false => Scope::ThisName,
    };
    Ok(Box::new(Roles {
        label: setup.label.into(),
        rules,
        scope,
    }))
}

fn make_rule(setup: &Setup<'_>, index: usize, params: RuleParams) -> Result<Rule, WireError> {
    let key = |key: &str| format!("rules/{index}/{key}");
    let (allow, words, word_key) = match (params.allow.is_empty(), params.deny.is_empty()) {
        (false, true) => (true, params.allow, "allow"),
        (true, false) => (false, params.deny, "deny"),
        _ => {
            return Err(setup.error(
                &key("allow"),
                "a rule has either allow or deny, with at least one verb",
            ));
        }
    };
    let max_age = params.max_age.map(|millis| setup.micros(&key("max-age"), millis));
    if max_age.is_some() && !allow {
        let text = "`max-age` requires `allow`: only allowed messages have a greatest age";
        return Err(setup.error(&key("max-age"), text));
    }
    if params.priority.is_some() && !allow {
        let text = "priority needs allow: only allowed messages can have a highest priority";
        return Err(setup.error(&key("priority"), text));
    }
    if let Some(priority) = params.priority.filter(|priority| !PRIORITY.contains(priority)) {
        let text = format!(
            "{priority} is not a priority: they go from {} to {}",
            PRIORITY.start(),
            PRIORITY.end()
        );
        return Err(setup.error(&key("priority"), &text));
    }
    Ok(Rule {
        name: format!(
            "{}/{}",
            setup.label,
            params.name.unwrap_or_else(|| format!("rule {}", index + 1))
        )
        .into(),
        allow,
        verbs: Verbs::read(setup, &key(word_key), &words)?,
        who: Who::new(params.users, params.groups, params.min_level),
        places: params.r#where,
        messages: params.messages,
        invited: params.invited,
        max_age: max_age.transpose()?,
        priority: params.priority.unwrap_or_default(),
    })
}

impl Manager for Roles {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        if question.verb.gives_up() {
            return Verdict::allow().by(&self.label);
        }
        let mut by_invitation = false;
        let rule = self
            .rules
            .iter()
            .filter(|rule| rule.covers(question))
            .find(|rule| {
                by_invitation |= rule.invited.is_some();
                rule.invited.is_none_or(|invited| invited == question.invited)
            });
        let mut verdict = match rule {
            Some(rule) if rule.allow => rule.too_old(question).unwrap_or_else(|| {
                let allow = Verdict::allow().stands(self.scope).by(&rule.name);
                match question.verb {
                    Verb::Send => allow.up_to_age(rule.max_age).up_to_priority(Some(rule.priority)),
                    _ => allow,
                }
            }),
            Some(rule) => deny(question, &rule.name),
            None => deny(question, &self.label),
        };
        if by_invitation {
            // Invitations come and go while the peer's membership stays.
            verdict.standing = Standing::Once;
        }
        verdict
    }
}

impl Rule {
    /// Whether the rule covers this question, ignoring invitations.
    fn covers(&self, question: &Question<'_>) -> bool {
        let place = self.places.is_empty() || self.places.iter().any(|place| place.matches(question.context));
        let message = self.messages.is_empty()
            || question
                .message
                .is_some_and(|name| self.messages.iter().any(|listed| listed == name));
        self.verbs.covers(question.verb) && place && message && self.who.fits(question.peer)
    }

    /// The refusal of a message that is, or may be, older than the rule allows. It does not stand.
    fn too_old(&self, question: &Question<'_>) -> Option<Verdict> {
        let most = self.max_age.filter(|_| question.verb == Verb::Send)?;
        let (code, found) = match question.age {
            Some((age, error)) if i128::from(age) + i128::from(error) <= i128::from(most) => return None,
            Some((age, error)) => {
                let (age, error) = (age / 1000, error.div_ceil(1000));
                (Code::DENIED, format!("this one is {age} ms old, ± {error} ms"))
            }
            None => {
                let found =
                    "the age of this one is unknown: add a timestamp, and answer the hub's pings with stamps";
                (Code::TRY_LATER, found.to_owned())
            }
        };
        let Question {
            peer,
            context,
            message,
            ..
        } = question;
        let text = format!(
            "{} may send {} to {context} only up to an age of {} ms, and {found}",
            peer.user,
            message.unwrap_or("messages"),
            most / 1000
        );
        Some(Verdict::deny(code, &*self.name, text).by(&self.name))
    }
}

/// A refusal names the message, so it stands for that name only.
fn deny(question: &Question<'_>, rule: &Arc<str>) -> Verdict {
    Verdict::deny(Code::DENIED, &**rule, refusal(question))
        .stands(Scope::ThisName)
        .by(rule)
}

fn refusal(question: &Question<'_>) -> String {
    let Question {
        peer,
        verb,
        context,
        message,
        ..
    } = question;
    match message {
        Some(message) => format!("{} may not send {message} to {context}", peer.user),
        None if *verb == Verb::Device => format!("{} may not be a device in {context}", peer.user),
        None => format!("{} may not {verb} {context}", peer.user),
    }
}
