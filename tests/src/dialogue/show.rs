//! Parcels and values in the notation of dialogues.

use mom_proto::{Family, Fence, Map, Parcel, Value, write_slots};

/// A parcel as a peer hears it.
pub(crate) fn parcel(parcel: &Parcel) -> String {
    let content = parcel.value();
    let mut line = match parcel.family {
        Family::Reply => parcel.name().to_owned(),
        Family::Error => format!("error {}", parcel.name()),
        Family::Event => format!("event {} {}", parcel.name(), context(parcel)),
        Family::Message => format!("message {}", parcel.name()),
        Family::Manager => format!(
            "{} {} id={}",
            parcel.name(),
            context(parcel),
            parcel.id.unwrap_or_default()
        ),
        family => format!("{family} {}", parcel.name()),
    };
    match (&content, parcel.family) {
        (Value::Null, Family::Message) if parcel.content.is_some() => line.push_str(" null"),
        (Value::Null, _) => {}
        (Value::Map(map), Family::Reply | Family::Error | Family::Event | Family::Manager) => {
            line.push_str(&format!(" {}", members(map)));
        }
        (Value::String(text), _) => line.push_str(&format!(" {text:?}")),
        (content, _) => line.push_str(&format!(" {}", value(content))),
    }
    if parcel.family == Family::Message {
        let mut slots = Map::new();
        write_slots(parcel, |key, slot| slots.set(slot_word(key), slot.into_value()));
        slots.remove("family");
        slots.remove("name");
        line.push_str(&format!(" {}", members(&slots)));
    }
    line
}

/// The word for a slot in dialogues.
pub(crate) fn slot_word(key: &str) -> &str {
    match key {
        "sender" => "from",
        "address" => "to",
        "context" => "in",
        key => key,
    }
}

/// A value.
pub(crate) fn value(value: &Value) -> String {
    match value {
        Value::Null => "null".to_owned(),
        Value::Bool(truth) => truth.to_string(),
        Value::Int(number) => number.to_string(),
        Value::Double(number) => format!("{number:?}"),
        Value::String(text) if is_word(text) => text.clone(),
        Value::String(text) => format!("{text:?}"),
        Value::Time(time) => time.to_string(),
        Value::Binary(bytes) => {
            let digits: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
            format!("hex:{digits}")
        }
        Value::List(list) => {
            let items: Vec<String> = list.iter().map(self::value).collect();
            format!("[{}]", items.join(" "))
        }
        Value::Map(map) => format!("{{{}}}", members(map)),
    }
}

fn members(map: &Map) -> String {
    let members: Vec<String> = map
        .iter()
        .map(|(key, member)| match (key, member) {
            (key, Value::Int(fence)) if HAS_EPOCH.contains(&key) => format!("{key}={}", number_of(*fence)),
            _ => format!("{key}={}", value(member)),
        })
        .collect();
    members.join(" ")
}

/// Fences, and the numbers of stops.
pub(crate) const HAS_EPOCH: [&str; 2] = ["fence", "stop"];

/// What people see of a fence.
pub(crate) fn number_of(fence: i64) -> i64 {
    let fence = Fence::from(u64::try_from(fence).unwrap_or_default());
    i64::try_from(fence.number()).unwrap_or_default()
}

fn context(parcel: &Parcel) -> &str {
    parcel.context.as_ref().map_or("-", |path| path.as_str())
}

/// Whether a string can stand without quotes: not empty, nothing special, no other value.
fn is_word(text: &str) -> bool {
    let plain = |c: char| c.is_alphanumeric() || matches!(c, '/' | '-' | '_' | '.' | '~' | ':' | '*');
    let other = matches!(text, "null" | "true" | "false") || text.starts_with("hex:");
    let number = text
        .trim_start_matches('-')
        .starts_with(|c: char| c.is_ascii_digit());
    !text.is_empty() && text.chars().all(plain) && !other && !number
}
