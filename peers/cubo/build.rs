//! Makes both ends of CUBO's model.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    Ok(mom_rsp_model::build::generate("../../config/cubo.toml")?)
}
