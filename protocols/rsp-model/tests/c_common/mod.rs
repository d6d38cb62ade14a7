//! What tests of robots in C share.
#![allow(dead_code, unreachable_pub, reason = "each test program uses some of it")]

use std::fs;
use std::path::{Path, PathBuf};

use mom_rsp_model::{Model, generate};

#[path = "../../../rsp/tests/common/both.rs"]
pub mod both;
#[path = "../../../rsp/tests/common/c_end.rs"]
pub mod c_end;

pub const CUBO: &str = include_str!("../../../../config/cubo.toml");

/// The header of a model.
pub fn header(model: &Model) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("c-headers-{}", hash(model)));
    fs::create_dir_all(&folder).expect("a folder");
    let header = folder.join(format!("{}.h", model.name()));
    // Tests run side by side: what another one reads is whole.
    let begun = folder.join(format!("{}-{:?}", model.name(), std::thread::current().id()));
    fs::write(&begun, generate::c(model)).expect("a header");
    fs::rename(&begun, &header).expect("a header");
    header
}

/// The first digits of a model's hash.
fn hash(model: &Model) -> String {
    model.hash()[..4]
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}
