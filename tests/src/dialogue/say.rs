//! What peers say: from a line to a parcel.

use std::sync::Arc;

use mom_proto::{Content, ContextKind, Family, Map, Parcel, Path, ReadSlots, Value, Verb};

use super::notation::{Field, Terms};

/// A request as written: its parcel, but for the id and the fence's epoch.
#[derive(Debug)]
pub(crate) struct Request {
    pub(crate) parcel: Parcel,
    /// Whether it is answered even if it is accepted.
    pub(crate) answered: bool,
}

impl Request {
    pub(crate) fn parse(text: &str) -> Result<Request, String> {
        let mut terms = Terms::parse(text)?;
        let word = terms.take_word("a verb")?;
        let (parcel, answered) = match word.as_str() {
            "parcel" => (any(&mut terms)?, true),
            "send" => send(&mut terms)?,
            "login" => (login(&mut terms)?, true),
            "create" => (create(&mut terms)?, true),
            word => (plain(word, &mut terms)?, true),
        };
        terms.nothing_left()?;
        Ok(Request { parcel, answered })
    }
}

fn any(terms: &mut Terms) -> Result<Parcel, String> {
    let word = terms.take_word("a family")?;
    let family = Family::from_word(&word).ok_or_else(|| format!("{word} is not a family"))?;
    let parcel = Parcel::new(family, terms.take_word("a name")?);
    slots(&parcel, terms)
}

fn send(terms: &mut Terms) -> Result<(Parcel, bool), String> {
    let path = path(terms)?;
    let name = terms.take_word("a message's name")?;
    let receipt = terms.take_flag("receipt");
    let mut parcel = slots(&Parcel::new(Family::Message, name).context(path), terms)?;
    if receipt {
        parcel.receipt = Some(true);
    }
    if terms.take_flag("no-echo") {
        parcel.echo = Some(false);
    }
    Ok((parcel, receipt))
}

fn login(terms: &mut Terms) -> Result<Parcel, String> {
    let name = terms.take_word("a user")?;
    let mut content = Map::new().with("name", name);
    for Field { key, value, .. } in terms.fields.drain(..) {
        content.set(&key, value);
    }
    Ok(login_parcel(content))
}

/// A login with this content.
pub(crate) fn login_parcel(content: Map) -> Parcel {
    Parcel::new(Family::Login, Verb::Login.word())
        .context(Path::root())
        .content(content)
}

fn create(terms: &mut Terms) -> Result<Parcel, String> {
    let path = path(terms)?;
    let kind = terms.take_word("a kind")?;
    if ContextKind::from_word(&kind).is_none() {
        return Err(format!(
            "{kind} is not a kind of context; write others as a parcel"
        ));
    }
    let mut content = Map::new().with("kind", kind);
    for Field { key, value, .. } in terms.fields.drain(..) {
        content.set(&key, value);
    }
    Ok(Parcel::new(Family::Context, Verb::Create.word())
        .context(path)
        .content(content))
}

/// A verb whose parcel has the fields of the line as its content, or none.
fn plain(word: &str, terms: &mut Terms) -> Result<Parcel, String> {
    let verb = Verb::from_word(word).ok_or_else(|| format!("{word} is not a verb; write it as a parcel"))?;
    let parcel = Parcel::new(verb.family(), verb.word());
    let parcel = match verb {
        // The number of its question says what a verdict is about.
        Verb::Verdict => parcel,
        Verb::Logout | Verb::Ping | Verb::Pong => parcel.context(Path::root()),
        _ => parcel.context(path(terms)?),
    };
    if terms.fields.is_empty() {
        return Ok(parcel);
    }
    let mut content = Map::new();
    for Field { key, value, .. } in terms.fields.drain(..) {
        content.set(&key, value);
    }
    Ok(parcel.content(content))
}

fn path(terms: &mut Terms) -> Result<Path, String> {
    Path::parse(&terms.take_word("a path")?).map_err(|error| error.to_string())
}

/// Puts the fields of a line into slots, as a codec does, but for an address that may be wrong on purpose.
fn slots(parcel: &Parcel, terms: &mut Terms) -> Result<Parcel, String> {
    let mut slots = ReadSlots::new();
    let mut insert = |key: &str, value: Value| {
        slots
            .insert(key.to_owned(), value)
            .map_err(|error| error.to_string())
    };
    insert("family", parcel.family.word().into())?;
    insert("name", parcel.name().into())?;
    if let Some(path) = &parcel.context {
        insert("context", path.as_str().into())?;
    }
    let address = terms.take_field("to").as_ref().map(names).transpose()?;
    for Field { key, value, .. } in terms.fields.drain(..) {
        insert(&key, value)?;
    }
    let mut parcel = slots.finish().map_err(|error| error.to_string())?;
    parcel.address = address;
    parcel.content = terms.content.take().map(Content::Value).or(parcel.content);
    Ok(parcel)
}

fn names(value: &Value) -> Result<Vec<Arc<str>>, String> {
    let list = value.as_list().ok_or("an address is a list: to=[bob]")?;
    list.iter()
        .map(|name| {
            name.as_str()
                .map(Arc::from)
                .ok_or_else(|| "names are words".to_owned())
        })
        .collect()
}
