//! One case of the hot path so many times, for a counter of instructions: `hot-path CASE TIMES`. What is counted of
//! one run less what is counted of a shorter one, by the difference of their times, is what one time costs.

use std::hint::black_box;

use anyhow::{Context, Result, bail};
use mom_benches::codecs::Coding;
use mom_benches::decisions::Admissions;
use mom_benches::hot_path::Delivery;
use mom_proto::codec::Form;

fn main() -> Result<()> {
    let mut args = std::env::args().skip(1);
    let case = args.next().context(
        "which case? decode, decode-xml, decode-json, admit, encode, encode-xml, encode-json or deliver",
    )?;
    let times: u64 = args
        .next()
        .context("how many times?")?
        .parse()
        .context("how many times?")?;
    match case.as_str() {
        "decode" | "decode-xml" | "decode-json" => {
            let mut coding = Coding::new(form(&case), 16)?;
            let (mut decoded, size) = (0, coding.size() as u64);
            while decoded < times {
                decoded += black_box(coding.decode_many()?) as u64 / size;
            }
        }
        "encode" | "encode-xml" | "encode-json" => {
            let coding = Coding::new(form(&case), 16)?;
            for _ in 0..times {
                black_box(coding.encode()?);
            }
        }
        "admit" => {
            let mut admissions = Admissions::new(10, false)?;
            for _ in 0..times {
                black_box(admissions.admit()?);
            }
        }
        "deliver" => Delivery::run(10, times)?,
        other => bail!(
            "there is no case {other}: decode, decode-xml, decode-json, admit, encode, encode-xml, encode-json, deliver"
        ),
    }
    Ok(())
}

fn form(case: &str) -> Form {
    match case.split_once('-') {
        Some((_, "xml")) => Form::Xml,
        Some((_, "json")) => Form::Json,
        _ => Form::Binary,
    }
}
