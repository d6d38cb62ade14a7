//! `context audit`: the facts of the audit log that a peer may hear of, the newest first.

use std::collections::BTreeMap;

use mom_hub::PeerId;
use mom_journal::{AuditQuery, AuditScan};
use mom_proto::{Code, Content, Map, Path, Time, Value, WireError};
use serde::Deserialize;

use super::{Answering, MOST_BYTES, bad, int, on, read, size};

/// Facts of one reply.
const MOST: usize = 200;
const USUAL: usize = 100;

/// What is chosen.
#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Args {
    peer: Option<String>,
    user: Option<String>,
    what: Option<Words>,
    verb: Option<String>,
    rule: Option<String>,
    code: Option<String>,
    since: Option<Value>,
    until: Option<Value>,
    text: Option<String>,
    before: Option<u64>,
    after: Option<u64>,
    most: Option<usize>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Words {
    One(String),
    Several(Vec<String>),
}

impl Args {
    fn query(self, path: Path) -> Result<AuditQuery, WireError> {
        Ok(AuditQuery {
            path,
            peer: self.peer,
            user: self.user,
            what: match self.what {
                None => Vec::new(),
                Some(Words::One(word)) => vec![word],
                Some(Words::Several(words)) => words,
            },
            verb: self.verb,
            rule: self.rule,
            code: self.code,
            since: time("since", self.since)?,
            until: time("until", self.until)?,
            text: self.text,
            before: self.before,
            after: self.after,
        })
    }
}

fn time(key: &str, value: Option<Value>) -> Result<Option<Time>, WireError> {
    match value {
        None => Ok(None),
        Some(Value::Time(time)) => Ok(Some(time)),
        Some(Value::String(text)) => match text.parse() {
            Ok(time) => Ok(Some(time)),
            Err(error) => Err(bad(key, format!("{key}: {error}"))),
        },
        Some(_) => Err(bad(key, format!("{key} is a time"))),
    }
}

impl Answering {
    pub(super) async fn audit(
        &self,
        to: PeerId,
        path: Path,
        content: Option<Content>,
    ) -> Result<Map, WireError> {
        let args: Args = read(content.as_ref())?;
        let most = args.most.unwrap_or(USUAL);
        if !(1..=MOST).contains(&most) {
            return Err(bad("most", format!("most must be a number from 1 to {MOST}")));
        }
        let query = args.query(path)?;
        let log = &self.board.tap.audit;
        log.written().await;
        let mut page = Page {
            facts: Vec::new(),
            bytes: 0,
            next: None,
            known: BTreeMap::new(),
        };
        let mut scan = log.scan(query);
        loop {
            let wanted = most - page.facts.len();
            let (scanned, found) = self.look(scan, wanted).await?;
            scan = scanned;
            let full = found.into_iter().any(|fact| self.take(to, fact, &mut page));
            if full || page.facts.len() >= most || scan.is_over() {
                break;
            }
        }
        Ok(page.reply(&scan))
    }

    /// Looks for more facts, on a thread that gives way.
    async fn look(&self, mut scan: AuditScan, wanted: usize) -> Result<(AuditScan, Vec<Map>), WireError> {
        let looked = on(&self.reading, move || {
            let found = scan.look(wanted);
            (scan, found)
        });
        let (scan, found) = looked.await?;
        let found = found.map_err(|error| {
            // Not where it lies: that concerns only who sits at this machine.
            let text = format!("the audit log cannot be read: {}", error.kind());
            WireError::new(Code::STORAGE_FAILED, text)
        })?;
        Ok((scan, found))
    }

    /// Adds a fact, if the peer may hear of it; true if no more have room.
    fn take(&self, to: PeerId, fact: Map, page: &mut Page) -> bool {
        let context = fact.get("context").and_then(Value::as_str);
        if let Some(context) = context {
            let known = page.known.get(context).copied();
            let may = known.unwrap_or_else(|| self.may_hear(to, context));
            if known.is_none() {
                page.known.insert(context.to_owned(), may);
            }
            if !may {
                return false;
            }
        }
        page.bytes += size(&fact);
        let full = page.bytes >= MOST_BYTES;
        if full {
            page.next = fact.get("seq").and_then(Value::as_int);
        }
        page.facts.push(fact.into());
        full
    }

    fn may_hear(&self, to: PeerId, context: &str) -> bool {
        // Of a path that was cut off nobody knows whose it is.
        let path = Some(context).filter(|context| !context.ends_with('…'));
        let path = path.and_then(|context| Path::parse(context).ok());
        path.is_some_and(|path| self.board.ask_hub(|hub, now| hub.may_audit(now, to, &path)))
    }
}

/// What the peer is told.
struct Page {
    facts: Vec<Value>,
    bytes: usize,
    /// Where the next page begins, if this one is full before what was found is told.
    next: Option<i64>,
    /// Whether the peer may hear of a context.
    known: BTreeMap<String, bool>,
}

impl Page {
    fn reply(self, scan: &AuditScan) -> Map {
        let mut reply = Map::new().with("facts", self.facts).with(
            "source",
            match scan.is_of_files() {
                true => "file",
                false => "memory",
            },
        );
        if let Some(latest) = scan.latest() {
            reply.set("latest", int(latest));
        }
        if let Some(next) = self.next.or_else(|| scan.next().map(int)) {
            reply.set("more", true);
            reply.set("next", next);
        }
        reply
    }
}
