//! Generates the Rust of the models that come with MOM, and of two that are for tests alone.

fn main() -> Result<(), mom_rsp_model::build::BuildError> {
    for model in [
        "../../../config/cubo.toml",
        "../../../config/ir-robot.toml",
        "../tests/models/kinds.toml",
        "../tests/models/bare.toml",
    ] {
        mom_rsp_model::build::generate(model)?;
    }
    Ok(())
}
