//! Makes both ends of CUBO's model; with the feature `opus`, of one whose loudspeaker takes Opus.

use std::path::Path;
use std::{env, fs};

use mom_rsp_model::{Model, generate};

const MODEL: &str = "../../config/cubo.toml";
const PCM: &str = "sound = \"pcm 48900\"";
const OPUS: &str = "sound = \"opus 48000\"";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-changed={MODEL}");
    let mut text = fs::read_to_string(MODEL)?;
    if env::var_os("CARGO_FEATURE_OPUS").is_some() {
        if !text.contains(PCM) {
            return Err(format!("{MODEL} has no loudspeaker with {PCM}").into());
        }
        text = text.replace(PCM, OPUS);
    }
    let folder = env::var("OUT_DIR")?;
    let into = |name: &str| Path::new(&folder).join(name);
    let model = Model::read(&text).map_err(|error| format!("{MODEL}: {error}"))?;
    fs::write(into("cubo.rs"), generate::rust(&model))?;
    Ok(fs::write(into("cubo.toml"), text)?)
}
