//! How many small parcels the XML codec reads and writes per second on one core.
//!
//! `cargo run --release -p mom-proto --example xml_speed`

use std::hint::black_box;
use std::io::{self, Write};
use std::time::{Duration, Instant};

use bytes::BytesMut;
use mom_proto::codec::Frame;
use mom_proto::xml::{XmlDecoder, encode};
use mom_proto::{Family, Limits, Map, Parcel, Path, Time, Value, WireError};

const ROUND: usize = 256;
const TIME: Duration = Duration::from_secs(1);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let content = Map::new()
        .with("x", Value::Double(0.125))
        .with("y", Value::Double(-1.5))
        .with("gripper", "open");
    let mut parcel = Parcel::new(Family::Message, "command")
        .id(1_234_567)
        .context(Path::parse("/robot/arm")?)
        .content(content);
    parcel.timestamp = Time::from_micros(1_795_255_200_000_123);
    let encoded = encode(&parcel)?.to_vec();
    let round = encoded.repeat(ROUND);
    let mut input = BytesMut::new();
    let mut decoder = XmlDecoder::new(&Limits::default());

    let written = per_second(|| {
        for _ in 0..ROUND {
            black_box(encode(black_box(&parcel))?);
        }
        Ok(())
    })?;
    let read = per_second(|| {
        input.extend_from_slice(&round);
        for _ in 0..ROUND {
            let frame = decoder.decode(&mut input)?;
            assert!(matches!(black_box(frame), Some(Frame::Parcel(_))));
        }
        Ok(())
    })?;
    let size = encoded.len();
    writeln!(
        io::stdout(),
        "{size} B per parcel: {written:.0} written/s, {read:.0} read/s"
    )?;
    Ok(())
}

fn per_second(mut round: impl FnMut() -> Result<(), WireError>) -> Result<f64, WireError> {
    let start = Instant::now();
    let mut count = 0.0;
    while start.elapsed() < TIME {
        round()?;
        count += ROUND as f64;
    }
    Ok(count / start.elapsed().as_secs_f64())
}
