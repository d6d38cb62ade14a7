//! How many packets of 34 bytes are encoded and decoded in a second on one core (S26: 34 bytes are the paper's packet without music).
//!
//! ```sh
//! cargo run --release -p mom-rsp --example speed
//! ```

use std::hint::black_box;
use std::io::Write as _;
use std::time::Instant;

use mom_rsp::{
    Direction, Element, Header, Item, Items, Kind, Layout, Motion, Number, Payload, Type, VERSION, Writer,
};

const fn motor(name: &str) -> Element<'_> {
    Element {
        name,
        kind: Kind::Effector,
        payload: Payload::Numbers(Number::I16, 1),
        motion: Motion::Absolute {
            interpolate: false,
            rate: None,
        },
        safe: &[0, 0],
        period: 0,
        module: None,
        of: None,
        digest: 0,
    }
}

/// 16 elements, six of which have two bytes to say.
static LAYOUT: Layout<'static> = Layout::new(
    7,
    [0; 32],
    &[
        motor("m00"),
        motor("m01"),
        motor("m02"),
        motor("m03"),
        motor("m04"),
        motor("m05"),
        motor("m06"),
        motor("m07"),
        motor("m08"),
        motor("m09"),
        motor("m10"),
        motor("m11"),
        motor("m12"),
        motor("m13"),
        motor("m14"),
        motor("m15"),
    ],
);

const PLACES: [u8; 6] = [0, 1, 5, 8, 11, 15];

fn once(number: u32, packet: &mut [u8; 64]) -> Option<usize> {
    let header = Header {
        version: VERSION,
        model: LAYOUT.id(),
        encryption: 0,
        kind: Type::Data,
        sequence: number as u16,
        stamp: number,
        session: [1; 6],
        last: number as u16,
        buffers: 0,
    };
    let (head, body) = packet.split_first_chunk_mut::<{ Header::LEN }>()?;
    *head = header.encode();
    let mut writer = Writer::new(&LAYOUT, Direction::Down, body)?;
    for place in PLACES {
        writer
            .put(place, Item::Value(&(number as u16).to_be_bytes()))
            .ok()?;
    }
    let len = Header::LEN + writer.finish();
    let packet = black_box(packet.get(..len)?);
    black_box(Header::decode(packet).ok()?);
    let items = Items::parse(&LAYOUT, Direction::Down, packet.get(Header::LEN..)?).ok()?;
    for item in items {
        black_box(item);
    }
    Some(len)
}

fn main() -> std::io::Result<()> {
    const COUNT: u32 = 20_000_000;
    let mut packet = [0; 64];
    let mut bytes = 0;
    let begin = Instant::now();
    for number in 0..COUNT {
        bytes += once(black_box(number), &mut packet).unwrap_or(0);
    }
    let rate = f64::from(COUNT) / begin.elapsed().as_secs_f64();
    let each = bytes / COUNT as usize;
    writeln!(
        std::io::stdout(),
        "{:.1} million packets of {each} bytes a second, encoded and decoded",
        rate / 1e6
    )
}
