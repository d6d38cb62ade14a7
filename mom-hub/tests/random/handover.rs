//! Offers, requests and shared holds, as they are told.

use std::collections::{BTreeMap, BTreeSet};

use mom_proto::{Parcel, Path, Value};

use crate::look::{Look, Looks};
use crate::seen::Seen;

/// An offer of an owner.
#[derive(Clone, Debug, PartialEq)]
struct Offer {
    by: String,
    to: String,
    until: u64,
}

/// A request to an owner.
#[derive(Clone, Debug, PartialEq)]
struct Request {
    /// Which of its peer's requests on their way it may be.
    ids: BTreeSet<u64>,
    /// Whether there were several.
    unclear: bool,
    to: String,
    until: u64,
}

/// What is between owners and others.
#[derive(Debug, Default)]
pub(crate) struct HandOver {
    offers: BTreeMap<Path, Offer>,
    /// Who asks.
    requests: BTreeMap<Path, BTreeMap<String, Request>>,
    pub(crate) holders: BTreeMap<Path, BTreeSet<String>>,
    /// Who holds no more because it is about to own.
    converted: BTreeMap<Path, String>,
}

impl HandOver {
    /// Takes in an event about a token. `owner` = who owns it now, or did until a moment ago.
    pub(crate) fn event(
        &mut self,
        parcel: &Parcel,
        owner: Option<&str>,
        ids: &[u64],
        now: u64,
        seen: &mut Seen,
    ) {
        let path = parcel.context.clone().unwrap();
        let content = parcel.value();
        let word = |key: &str| content.get(key).and_then(Value::as_str).map(str::to_owned);
        let until = || {
            let within = content.get("within").and_then(Value::as_int).unwrap();
            now + u64::try_from(within * 1000).unwrap()
        };
        match parcel.name() {
            "offer" => {
                let (by, to) = (word("by").unwrap(), word("to").unwrap());
                assert_eq!(owner, Some(&*by), "only the owner offers {path}");
                let offer = Offer {
                    by,
                    to,
                    until: until(),
                };
                let before = self.offers.insert(path, offer);
                assert_eq!(before, None, "one offer at a time");
            }
            "requested" => {
                let request = Request {
                    ids: ids.iter().copied().collect(),
                    unclear: ids.len() > 1,
                    to: owner.unwrap().to_owned(),
                    until: until(),
                };
                let asking = self.requests.entry(path).or_default();
                let before = asking.insert(word("peer").unwrap(), request);
                assert_eq!(before, None, "one request at a time");
            }
            "lapsed" => {
                let reason = word("reason").unwrap();
                seen.note(format!("lapsed {}", reason));
                let (by, to) = (word("by"), word("to"));
                let until = match word("what").as_deref() {
                    Some("offer") => {
                        let offer = self.offers.remove(&path).unwrap();
                        assert_eq!(
                            (by, to),
                            (Some(offer.by), Some(offer.to)),
                            "the offer of {path} lapsed: {reason}"
                        );
                        offer.until
                    }
                    _ => {
                        let asking = self.requests.get_mut(&path).unwrap();
                        let by = by.unwrap();
                        let request = asking.remove(&by).unwrap();
                        assert_eq!(
                            to,
                            Some(request.to),
                            "the request of {by} for {path} lapsed: {reason}"
                        );
                        request.until
                    }
                };
                assert!(reason != "timed-out" || now >= until, "nothing lapses early");
            }
            "inhibited" | "uninhibited" => {
                let holders = content.get("holders").and_then(Value::as_list).unwrap();
                let holders = holders.iter().filter_map(|name| name.as_str().map(str::to_owned));
                self.holders.insert(path.clone(), holders.collect());
                if word("reason").as_deref() == Some("grabbed") {
                    self.converted.insert(path, word("peer").unwrap());
                }
            }
            _ => {}
        }
    }

    /// A request to an owner was answered.
    pub(crate) fn answered(&mut self, path: &Path, id: u64) {
        if let Some(asking) = self.requests.get_mut(path) {
            asking.retain(|_, request| {
                request.ids.remove(&id);
                !request.ids.is_empty()
            });
        }
    }

    /// Whether a peer has just made its part of a shared hold an ownership.
    pub(crate) fn converted(&self, path: &Path, name: &str) -> bool {
        self.converted.get(path).is_some_and(|known| known == name)
    }

    /// An offer was accepted: it is over, whatever comes of it.
    pub(crate) fn accepted(&mut self, path: &Path, name: &str) {
        if self.offers.get(path).is_some_and(|offer| offer.to == name) {
            self.offers.remove(path);
        }
    }

    /// Nobody drives a device while several hold its token.
    pub(crate) fn check_sent(&self, token: &Path) {
        let holders = self.holders.get(token);
        assert!(
            holders.is_none_or(BTreeSet::is_empty),
            "a command passes while {holders:?} hold {token}"
        );
    }

    /// All is as the hub says. `stored` = a change of owner waits until it is durable.
    pub(crate) fn check(&mut self, path: &Path, look: &Look, stored: bool, now: u64) {
        if let Some(asking) = self.requests.get_mut(path) {
            asking.retain(|name, request| !request.unclear || look.requests.contains(name));
        }
        let offer = self.offers.get(path);
        let offered = offer.map(|offer| offer.to.clone());
        let accepted = stored && look.offered.is_none();
        assert!(
            offered == look.offered || accepted,
            "who is offered {path}: {offer:?}, {look:?}"
        );
        assert!(
            offer.is_none_or(|offer| now < offer.until) || accepted,
            "{offer:?} is over"
        );
        let none = BTreeMap::new();
        let asking = self.requests.get(path).unwrap_or(&none);
        let names: BTreeSet<&String> = asking.keys().collect();
        let said: BTreeSet<&String> = look.requests.iter().collect();
        assert!(
            names == said || (stored && said.is_subset(&names)),
            "who asks for {path}: {names:?}, {said:?}"
        );
        let over = |(name, request): &(&String, &Request)| said.contains(name) && now >= request.until;
        assert_eq!(asking.iter().find(over), None, "a request for {path} is over");
        let holders: BTreeSet<String> = look.holders.iter().cloned().collect();
        let held = self.holders.get(path).cloned().unwrap_or_default();
        assert_eq!(held, holders, "who holds {path}");
    }

    /// After a step: forgets the tokens that are no more, after all were told.
    pub(crate) fn keep(&mut self, looks: &Looks) {
        self.converted.clear();
        let gone = |path: &Path| looks.lack(path);
        for (path, offer) in &self.offers {
            assert!(!gone(path), "{path} is gone, and yet there is {offer:?}");
        }
        for (path, asking) in &self.requests {
            assert!(
                !gone(path) || asking.is_empty(),
                "{path} is gone, and yet these ask: {asking:?}"
            );
        }
        self.requests.retain(|_, asking| !asking.is_empty());
        self.holders.retain(|_, holders| !holders.is_empty());
    }
}
