//! Rows say what was put into them, or that they do not.

use mom_hub::Record;

use super::{holder, owned, path};
use crate::row::{self, LaneMeta};

fn records() -> Vec<Record> {
    let plain = owned("/robot/token", (1_795_000_000 << 20) + 7);
    vec![
        plain.clone(),
        Record {
            before: Some(holder("müller")),
            lease: None,
            ..plain.clone()
        },
        Record {
            owner: None,
            before: Some(holder("")),
            lease: Some(u64::MAX),
            path: path("/"),
            fence: 0,
        },
    ]
}

#[test]
fn rows_come_back_as_they_were() {
    for record in records() {
        let row = row::encode(42, &record);
        assert_eq!(row::decode(record.path.as_str(), &row), Ok((42, record)));
    }
    let meta = LaneMeta {
        lane: 2,
        epoch: 1_795_000_000,
        seen: vec![1, 0, u64::MAX, 9],
    };
    assert_eq!(LaneMeta::decode("meta", &meta.encode("meta")), Ok(meta.clone()));
    assert_eq!(meta.last(), u64::MAX);
}

/// Threat 29: every flipped bit, every cut, and every row under another key is found.
#[test]
fn changed_rows_are_refused() {
    for record in records() {
        let (key, row) = (record.path.as_str(), row::encode(42, &record));
        for bit in 0..row.len() * 8 {
            let mut flipped = row.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            assert!(row::decode(key, &flipped).is_err(), "bit {bit} of {record:?}");
        }
        for length in 0..row.len() {
            assert!(
                row::decode(key, &row[..length]).is_err(),
                "{length} bytes of {record:?}"
            );
        }
        assert!(row::decode("/other", &row).is_err());
        assert!(row::decode("no path", &row).is_err());
        let longer = [&row[..], &[0]].concat();
        assert!(row::decode(key, &longer).is_err());
    }
}
