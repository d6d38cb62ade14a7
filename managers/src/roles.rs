//! `roles`: who may do which verb where, by user, group and level.

use mom_proto::nearest::nearest;
use mom_proto::{Code, Pattern, Verb, WireError};
use serde::Deserialize;

use crate::{Manager, PeerFacts, Question, Scope, Setup, Verdict};

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
}

/// Asks its rules in order: the first that covers the question decides, and no rule is a denial.
#[derive(Debug)]
struct Roles {
    label: String,
    rules: Vec<Rule>,
    // A rule that tells messages apart makes every verdict one for that message alone.
    scope: Scope,
}

#[derive(Debug)]
struct Rule {
    name: String,
    allow: bool,
    verbs: Verbs,
    users: Vec<String>,
    groups: Vec<String>,
    min_level: Option<i32>,
    places: Vec<Pattern>,
    messages: Vec<String>,
}

#[derive(Debug)]
enum Verbs {
    All,
    These(Vec<Verb>),
}

pub(crate) fn make(setup: &Setup<'_>) -> Result<Box<dyn Manager>, WireError> {
    let params: Params = setup.params()?;
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
        label: setup.label.to_owned(),
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
    Ok(Rule {
        name: format!(
            "{}/{}",
            setup.label,
            params.name.unwrap_or_else(|| format!("rule {}", index + 1))
        ),
        allow,
        verbs: make_verbs(setup, &key(word_key), &words)?,
        users: params.users,
        groups: params.groups,
        min_level: params.min_level,
        places: params.r#where,
        messages: params.messages,
    })
}

fn make_verbs(setup: &Setup<'_>, key: &str, words: &[String]) -> Result<Verbs, WireError> {
    if words.iter().any(|word| word == "*") {
        return Ok(Verbs::All);
    }
    let verbs: Result<Vec<Verb>, WireError> = words
        .iter()
        .map(|word| {
            Verb::from_word(word).ok_or_else(|| {
                let near = nearest(word, Verb::ALL.iter().map(|verb| verb.word()));
                setup
                    .error(key, &format!("there is no verb {word:?}; * stands for all"))
                    .nearest_opt(near)
            })
        })
        .collect();
    verbs.map(Verbs::These)
}

impl Manager for Roles {
    fn decide(&mut self, question: &Question<'_>) -> Verdict {
        if question.verb.gives_up() {
            return Verdict::allow();
        }
        let rule = match self.rules.iter().find(|rule| rule.covers(question)) {
            Some(rule) if rule.allow => return Verdict::allow().stands(self.scope),
            Some(rule) => &rule.name,
            None => &self.label,
        };
        // A refusal names the message, so it stands for no other.
        Verdict::deny(Code::DENIED, rule, refusal(question)).stands(Scope::ThisName)
    }
}

impl Rule {
    fn covers(&self, question: &Question<'_>) -> bool {
        let verb = match &self.verbs {
            Verbs::All => true,
            Verbs::These(verbs) => verbs.contains(&question.verb),
        };
        let place = self.places.is_empty() || self.places.iter().any(|place| place.matches(question.context));
        let message = self.messages.is_empty()
            || question
                .message
                .is_some_and(|name| self.messages.iter().any(|listed| listed == name));
        verb && place && message && self.means(question.peer)
    }

    fn means(&self, peer: &PeerFacts) -> bool {
        let named = self.users.is_empty() && self.groups.is_empty();
        let user = self.users.iter().any(|user| **user == *peer.user);
        let group = self.groups.iter().any(|group| peer.groups.contains(group));
        (named || user || group) && self.min_level.is_none_or(|least| peer.level >= least)
    }
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
        None => format!("{} may not {verb} {context}", peer.user),
    }
}
