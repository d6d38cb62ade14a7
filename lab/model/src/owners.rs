//! Who owns the tokens by which objects are written (M33).

use std::collections::BTreeMap;

use mom_client::{Code, Event, Map, Path, Value, WireError};

/// The owners of some tokens, as far as was heard.
#[derive(Debug, Clone, Default)]
pub(crate) struct Owners {
    tokens: BTreeMap<Path, TokenOwner>,
}

#[derive(Debug, Clone, Default)]
struct TokenOwner {
    name: Option<String>,
    /// The newest known fence. Late reports about older ones change nothing.
    fence: u64,
}

impl TokenOwner {
    fn set(&mut self, name: Option<&str>, fence: u64) {
        if fence >= self.fence {
            self.fence = fence;
            self.name = name.map(str::to_owned);
        }
    }
}

impl Owners {
    /// Takes an event of a token.
    pub(crate) fn handle(&mut self, token: &Path, event: &Event) {
        let known = self.tokens.entry(token.clone()).or_default();
        match event {
            Event::Grabbed { owner, fence, .. } => known.set(Some(owner), *fence),
            Event::Released { fence, .. } => known.set(None, *fence),
            // After a lost link the hub is asked again; a restarted one may have other fences.
            Event::LinkDown => *known = TokenOwner::default(),
            _ => {}
        }
    }

    /// Takes a token's facts as the hub tells them.
    pub(crate) fn handle_info(&mut self, token: &Path, info: &Map) {
        let fence = info.get("fence").and_then(Value::as_int).unwrap_or_default();
        let owner = info.get("owner").and_then(Value::as_str);
        let known = self.tokens.entry(token.clone()).or_default();
        known.set(owner, u64::try_from(fence).unwrap_or_default());
    }

    /// The peers that own these tokens, as far as they are known here.
    pub(crate) fn of<'a>(&'a self, tokens: &'a [Path]) -> impl Iterator<Item = &'a str> {
        let known = tokens.iter().filter_map(|token| self.tokens.get(token));
        known.filter_map(|owner| owner.name.as_deref())
    }

    /// Whether a peer owns one of these tokens, as far as they are known here; the error says who does.
    pub(crate) fn check(&self, peer: &str, tokens: &[Path], object: &str) -> Result<(), WireError> {
        let known: Vec<(&Path, &TokenOwner)> = tokens
            .iter()
            .filter_map(|token| Some((token, self.tokens.get(token)?)))
            .collect();
        if known.iter().any(|(_, owner)| owner.name.as_deref() == Some(peer)) {
            return Ok(());
        }
        let names: Vec<String> = known.iter().map(|(token, _)| token.to_string()).collect();
        let owners = known.iter().map(|(token, owner)| match &owner.name {
            Some(name) => format!("{token} is {name}'s"),
            None => format!("{token} is free"),
        });
        let owners: Vec<String> = owners.collect();
        let text = format!(
            "only the owner of {} writes {object}: {}",
            names.join(" or "),
            owners.join(", ")
        );
        let error = WireError::new(Code::NOT_OWNER, text);
        let owner = known.iter().find_map(|(_, owner)| owner.name.as_deref());
        Err(match owner {
            Some(owner) => error.detail("owner", owner),
            None => error,
        })
    }
}
