//! Rows of the store's tables as bytes: a CRC-32 of key and body, then the body.
//!
//! The database checks its pages; the sum of each row also finds what went wrong on the way there and back.

use bytes::{Buf, BufMut, TryGetError};
use mom_hub::{Holder, Record};
use mom_proto::Path;

/// The layout of rows; another one is refused.
const FORMAT: u8 = 1;

/// What a lane knows of itself and of the others; written with every commit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct LaneMeta {
    /// Which lane this is, from 0.
    pub(super) lane: usize,
    /// The epoch of the broker that wrote it.
    pub(super) epoch: u64,
    /// Per lane the highest sequence known to be durable there; its own is that of this commit. A lane that
    /// turns out to end before what another has seen of it was cut or replaced.
    pub(super) seen: Vec<u64>,
}

impl LaneMeta {
    /// The sequence of the lane's latest commit.
    pub(super) fn last(&self) -> u64 {
        self.seen.get(self.lane).copied().unwrap_or_default()
    }

    pub(super) fn encode(&self, key: &str) -> Vec<u8> {
        let mut body = vec![FORMAT];
        body.put_u32(u32::try_from(self.lane).unwrap_or(u32::MAX));
        body.put_u64(self.epoch);
        body.put_u32(u32::try_from(self.seen.len()).unwrap_or(u32::MAX));
        self.seen.iter().for_each(|sequence| body.put_u64(*sequence));
        sealed(key, &body)
    }

    pub(super) fn decode(key: &str, row: &[u8]) -> Result<LaneMeta, String> {
        let mut body = opened(key, row)?;
        let mut read = || -> Result<LaneMeta, TryGetError> {
            let lane = body.try_get_u32()? as usize;
            let epoch = body.try_get_u64()?;
            let lanes = body.try_get_u32()?;
            let seen = (0..lanes).map(|_| body.try_get_u64()).collect::<Result<_, _>>()?;
            Ok(LaneMeta { lane, epoch, seen })
        };
        let meta = read().map_err(|error| format!("the row {key:?} is truncated: {error}"))?;
        whole(key, body, meta)
    }
}

/// The row of a record; its key is the token's path.
pub(super) fn encode(sequence: u64, record: &Record) -> Vec<u8> {
    let mut body = vec![FORMAT];
    body.put_u64(sequence);
    body.put_u64(record.fence);
    put_option(&mut body, record.lease.as_ref(), |body, lease| {
        body.put_u64(*lease);
    });
    put_option(&mut body, record.owner.as_ref(), put_holder);
    put_option(&mut body, record.before.as_ref(), put_holder);
    sealed(record.path.as_str(), &body)
}

/// The sequence and the record of a row.
pub(super) fn decode(key: &str, row: &[u8]) -> Result<(u64, Record), String> {
    let path = Path::parse(key).map_err(|error| format!("the key {key:?} is not a path: {error}"))?;
    let mut body = opened(key, row)?;
    let read = || -> Result<(u64, Record), String> {
        let sequence = body.try_get_u64().map_err(|error| cut(&error))?;
        let fence = body.try_get_u64().map_err(|error| cut(&error))?;
        let lease = get_option(&mut body, |body| body.try_get_u64().map_err(|error| cut(&error)))?;
        let owner = get_option(&mut body, get_holder)?;
        let before = get_option(&mut body, get_holder)?;
        let record = Record {
            path,
            fence,
            owner,
            before,
            lease,
        };
        Ok((sequence, record))
    };
    let found = read().map_err(|error| format!("the row {key:?}: {error}"))?;
    whole(key, body, found)
}

fn sum(key: &str, body: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(key.as_bytes());
    hasher.update(body);
    hasher.finalize()
}

fn sealed(key: &str, body: &[u8]) -> Vec<u8> {
    let mut row = Vec::with_capacity(4 + body.len());
    row.put_u32(sum(key, body));
    row.extend_from_slice(body);
    row
}

/// The body of a row whose sum is right, after the format's number.
fn opened<'a>(key: &str, mut row: &'a [u8]) -> Result<&'a [u8], String> {
    let expected = row.try_get_u32().map_err(|error| cut(&error))?;
    if sum(key, row) != expected {
        return Err(format!(
            "the checksum of the row {key:?} is wrong: it was modified"
        ));
    }
    match row.try_get_u8() {
        Ok(FORMAT) => Ok(row),
        Ok(other) => Err(format!(
            "the row {key:?} has the format {other}; this broker knows {FORMAT}"
        )),
        Err(error) => Err(cut(&error)),
    }
}

fn whole<T>(key: &str, rest: &[u8], found: T) -> Result<T, String> {
    match rest.is_empty() {
        true => Ok(found),
        false => Err(format!("the row {key:?} has data after its end")),
    }
}

fn put_option<T: ?Sized>(body: &mut Vec<u8>, value: Option<&T>, put: impl FnOnce(&mut Vec<u8>, &T)) {
    body.put_u8(u8::from(value.is_some()));
    if let Some(value) = value {
        put(body, value);
    }
}

fn put_holder(body: &mut Vec<u8>, holder: &Holder) {
    put_text(body, &holder.user);
    put_text(body, &holder.name);
}

fn put_text(body: &mut Vec<u8>, text: &str) {
    // Names are far below 4 GiB: a parcel brought them.
    body.put_u32(u32::try_from(text.len()).unwrap_or(u32::MAX));
    body.extend_from_slice(text.as_bytes());
}

fn get_option<T>(
    body: &mut &[u8],
    get: impl FnOnce(&mut &[u8]) -> Result<T, String>,
) -> Result<Option<T>, String> {
    match body.try_get_u8().map_err(|error| cut(&error))? {
        0 => Ok(None),
        1 => get(body).map(Some),
        other => Err(format!("{other} is neither there nor absent")),
    }
}

fn get_holder(body: &mut &[u8]) -> Result<Holder, String> {
    let user = get_text(body)?;
    let name = get_text(body)?;
    Ok(Holder { user, name })
}

fn get_text(body: &mut &[u8]) -> Result<String, String> {
    let length = body.try_get_u32().map_err(|error| cut(&error))? as usize;
    let (bytes, rest) = body.split_at_checked(length).ok_or("a name is cut")?;
    *body = rest;
    String::from_utf8(bytes.to_vec()).map_err(|_| "a name is not UTF-8".to_owned())
}

fn cut(error: &TryGetError) -> String {
    format!("cut: {error}")
}
