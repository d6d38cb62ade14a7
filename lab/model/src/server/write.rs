//! Objects that peers write (M62).

use mom_client::{Code, Map, Parcel, Path, Time, Value, WireError};

use super::ModelServer;
use crate::Object;
use crate::object::{as_number, colour_of};

/// The most objects.
const MOST: usize = 64;
/// The most letters of a name.
const LONGEST: usize = 40;
/// Where an object may be, mm: beyond the table and down to the floor.
const LEVEL: f64 = 2000.0;
const HEIGHTS: std::ops::RangeInclusive<f64> = -500.0..=2000.0;
/// How large it may be, mm.
const SIZES: std::ops::RangeInclusive<f64> = 5.0..=500.0;
/// What may be written.
const KEYS: [&str; 8] = ["name", "x", "y", "z", "yaw", "size", "colour", "remove"];
/// A colour that no camera looks for.
const GREY: [u8; 3] = [150, 156, 166];

impl ModelServer {
    /// Writes what a message says, by the right of a peer, and gives the object as it is then.
    pub(super) fn write(&mut self, parcel: &Parcel, right: &str, now: Time) -> Result<Map, WireError> {
        let content = parcel.value();
        let name = name_of(&content)?;
        let sender = parcel.sender.as_deref().unwrap_or_default();
        self.owners.check(right, &self.tokens_of(name), name)?;
        if content.get("remove").and_then(Value::as_bool) == Some(true) {
            let_go(self.named(name, now)?)?;
            self.objects.remove(name);
            return Ok(self.snapshot([], now));
        }
        let mut object = self.object_to_write(name, &content, now)?;
        change(&mut object, &content)?;
        self.check_kind(&object)?;
        let moved = ["x", "y", "z", "yaw"]
            .iter()
            .any(|key| content.get(key).is_some());
        if moved || object.since().is_none() {
            object.error = 0.0;
            object.seen = None;
            object.cameras.clear();
            (object.written_by, object.written) = (Some(sender.to_owned()), Some(now));
        }
        self.objects.insert(object.clone());
        Ok(self.snapshot([&object], now))
    }

    /// The tokens whose owners may write an object: that of all, and its own beside the model's channel.
    pub(super) fn tokens_of(&self, name: &str) -> Vec<Path> {
        let channel = self.options.channel.to_string();
        let session = channel.rsplit_once('/').map_or("", |(session, _)| session);
        let own = Path::parse(&format!("{session}/{name}")).ok();
        std::iter::once(self.options.token.clone()).chain(own).collect()
    }

    /// By its size and colour a block of a kind is found in images: nobody changes them.
    fn check_kind(&self, object: &Object) -> Result<(), WireError> {
        let Some(kind) = self.options.kinds.iter().find(|kind| kind.name == object.name) else {
            return Ok(());
        };
        let slot = match (object.size == kind.size, object.colour == kind.colour) {
            (true, true) => return Ok(()),
            (false, _) => "content/size",
            (true, false) => "content/colour",
        };
        let [red, green, blue] = kind.colour;
        let text = format!(
            "{} is looked for as a block of {} mm and of the colour [{red}, {green}, {blue}], as the model was told when it \
             was started; write another one under a name of its own",
            kind.name, kind.size
        );
        Err(WireError::new(Code::BAD_CONTENT, text).slot(slot))
    }

    /// The object of this name, or a new one.
    fn object_to_write(&self, name: &str, content: &Value, now: Time) -> Result<Object, WireError> {
        if let Some(known) = self.objects.get(name) {
            let_go(known)?;
            return Ok(known.clone());
        }
        if self.objects.len() >= MOST {
            let text = format!("the model has {MOST} objects already; remove one first");
            return Err(WireError::new(Code::FULL, text));
        }
        if content.get("x").is_none() || content.get("y").is_none() {
            let text = format!("{}; a new one needs x and y", self.objects.no_such(name, now));
            return Err(WireError::new(Code::BAD_CONTENT, text).slot("content/x"));
        }
        let kind = self.options.kinds.iter().find(|kind| kind.name == name);
        let (size, colour) = kind.map_or((40.0, GREY), |kind| (kind.size, kind.colour));
        let size = content.get("size").and_then(as_number).unwrap_or(size);
        Ok(Object::new(name, size, colour))
    }
}

/// What the jaws hold is not written.
fn let_go(object: &Object) -> Result<(), WireError> {
    if !object.held {
        return Ok(());
    }
    let text = format!(
        "{} is in the jaws, which know better where it is; let it go first",
        object.name
    );
    Err(WireError::new(Code::HELD, text))
}

pub(super) fn name_of(content: &Value) -> Result<&str, WireError> {
    let bad = |text: String, slot: &str| Err(WireError::new(Code::BAD_CONTENT, text).slot(slot));
    let Some(map) = content.as_map() else {
        return bad(
            "what is written is a map with name, x, y and so on".to_owned(),
            "content",
        );
    };
    if let Some(key) = map.keys().find(|key| !KEYS.contains(key)) {
        let text = format!("an object has no {key:?}; it has {}", KEYS.join(", "));
        return bad(text, &format!("content/{key}"));
    }
    let name = map.get("name").and_then(Value::as_str).unwrap_or_default();
    let plain = |letter: char| letter.is_alphanumeric() || letter == '-' || letter == '_';
    match (1..=LONGEST).contains(&name.chars().count()) && name.chars().all(plain) {
        true => Ok(name),
        false => bad(
            format!("name must be 1 to {LONGEST} letters, digits, - and _"),
            "content/name",
        ),
    }
}

/// Changes what the content says.
fn change(object: &mut Object, content: &Value) -> Result<(), WireError> {
    let number = |key: &str, allowed: std::ops::RangeInclusive<f64>, present: f64| match content.get(key) {
        None => Ok(present),
        Some(value) => as_number(value)
            .filter(|number| allowed.contains(number))
            .ok_or_else(|| {
                let text = format!(
                    "{key} must be a number from {} to {}",
                    allowed.start(),
                    allowed.end()
                );
                WireError::new(Code::BAD_CONTENT, text).slot(&format!("content/{key}"))
            }),
    };
    object.x = number("x", -LEVEL..=LEVEL, object.x)?;
    object.y = number("y", -LEVEL..=LEVEL, object.y)?;
    object.z = number("z", HEIGHTS, object.z)?;
    object.yaw = number("yaw", -360.0..=360.0, object.yaw)?.rem_euclid(90.0);
    object.size = number("size", SIZES, object.size)?;
    if let Some(colour) = content.get("colour") {
        object.colour = colour_of(colour).ok_or_else(|| {
            let text = "colour is [red, green, blue], 0 to 255 each";
            WireError::new(Code::BAD_CONTENT, text).slot("content/colour")
        })?;
    }
    if let Some(remove) = content.get("remove")
        && remove.as_bool().is_none()
    {
        return Err(WireError::new(Code::BAD_CONTENT, "remove is true or false").slot("content/remove"));
    }
    Ok(())
}
