//! Where compression pays: bytes saved against processor time, for what robots and their users say.
//!
//! A link is slow enough if it takes longer for the bytes that are saved than both ends take for saving them.

use std::hint::black_box;
use std::io::{self, Write};
use std::time::{Duration, Instant};

use mom_proto::{Content, Map, Packed, Value};

/// Each time is the shortest of so many: others use this machine, too.
const ROUNDS: usize = 200;

/// The levels that are compared with the one in use.
const LEVELS: [i32; 4] = [-5, 1, 3, 9];

fn main() -> io::Result<()> {
    let mut out = io::stdout();
    writeln!(
        out,
        "| content | bytes | compressed | of it | compress µs | decompress µs | pays below Mbit/s |\n|---|---:|---:|---:|---:|---:|---:|"
    )?;
    for (name, content) in contents() {
        let bytes = content.to_msgpack().map_err(io::Error::other)?;
        let pack = shortest(|| Packed::pack(&bytes));
        let Some(packed) = Packed::pack(&bytes) else {
            writeln!(
                out,
                "| {name} | {} | as it is | | {} | | |",
                bytes.len(),
                micros(pack)
            )?;
            continue;
        };
        let unpack = shortest(|| packed.unpack());
        let (saved, time) = (bytes.len() - packed.bytes().len(), pack + unpack);
        writeln!(
            out,
            "| {name} | {} | {} | {:.0} % | {} | {} | {:.0} |",
            bytes.len(),
            packed.bytes().len(),
            100.0 * packed.bytes().len() as f64 / bytes.len() as f64,
            micros(pack),
            micros(unpack),
            saved as f64 * 8.0 / time.as_secs_f64() / 1e6
        )?;
    }
    writeln!(
        out,
        "\n| level | of all bytes | compress µs in all |\n|---|---:|---:|"
    )?;
    for level in LEVELS {
        let mut packer = zstd::bulk::Compressor::new(level)?;
        let (mut before, mut after, mut time) = (0, 0, Duration::ZERO);
        for (_, content) in contents() {
            let bytes = content.to_msgpack().map_err(io::Error::other)?;
            if Packed::pack(&bytes).is_some() {
                time += shortest(|| packer.compress(&bytes));
                (before, after) = (before + bytes.len(), after + packer.compress(&bytes)?.len());
            }
        }
        let part = 100.0 * after as f64 / before as f64;
        writeln!(out, "| {level} | {part:.1} % | {} |", micros(time))?;
    }
    Ok(())
}

fn shortest<T>(mut work: impl FnMut() -> T) -> Duration {
    (0..ROUNDS)
        .map(|_| {
            let begin = Instant::now();
            black_box(work());
            begin.elapsed()
        })
        .min()
        .unwrap_or_default()
}

fn micros(time: Duration) -> String {
    format!("{:.1}", time.as_secs_f64() * 1e6)
}

fn contents() -> Vec<(&'static str, Content)> {
    let mut random = fastrand::Rng::with_seed(7);
    let mut noise = |bytes: usize| -> Vec<u8> { (0..bytes).map(|_| random.u8(..)).collect() };
    let picture = [vec![0xff; 600], noise(60_000)].concat();
    let mut random = fastrand::Rng::with_seed(8);
    let mut real = |from: f64, to: f64| from + (to - from) * random.f64();
    let joints = |real: &mut dyn FnMut(f64, f64) -> f64| -> Vec<Value> {
        (0..6).map(|_| Value::Double(real(-3.0, 3.0))).collect()
    };
    let state = Map::new()
        .with("joints", joints(&mut real))
        .with("speed", 150)
        .with("grip", "open");
    let script: String = (0..400)
        .map(|line| {
            let (x, y) = (real(300.0, 900.0), real(-400.0, 400.0));
            format!(
                "MoveL [[{x:.1},{y:.1},{}.0],[0.7071,0,0.7071,0]], vslow, fine, gripper;\n",
                line % 100
            )
        })
        .collect();
    let objects = |count: i64, real: &mut dyn FnMut(f64, f64) -> f64| -> Vec<Value> {
        (0..count)
            .map(|id| {
                let pose: Vec<Value> = joints(real);
                Map::new()
                    .with("id", id)
                    .with("kind", "block")
                    .with("colour", "red")
                    .with("pose", pose)
                    .into()
            })
            .collect()
    };
    let scan = |real: &mut dyn FnMut(f64, f64) -> f64| -> Vec<Value> {
        (0..1080)
            .map(|_| Value::Int((real(0.3, 8.0) * 1000.0) as i64))
            .collect()
    };
    vec![
        ("state of an arm", state.into()),
        (
            "12 objects of a model",
            Map::new().with("objects", objects(12, &mut real)).into(),
        ),
        (
            "200 objects of a model",
            Map::new().with("objects", objects(200, &mut real)).into(),
        ),
        (
            "laser scan, 1080 ranges in mm",
            Map::new().with("ranges", scan(&mut real)).into(),
        ),
        (
            "script of 20 lines",
            script.lines().take(20).collect::<Vec<_>>().join("\n").into(),
        ),
        ("script of 400 lines", script.into()),
        (
            "JPEG in a message of any name",
            Map::new().with("picture", Value::Binary(picture.into())).into(),
        ),
    ]
}
