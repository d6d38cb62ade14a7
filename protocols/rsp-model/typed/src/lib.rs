//! Generated Rust compiles without a warning. `tests/typed.rs` brings its values from one end to the other.

#![deny(missing_docs, warnings)]

/// CUBO.
#[allow(dead_code, reason = "a program need not use all of its model")]
pub mod cubo {
    include!(concat!(env!("OUT_DIR"), "/cubo.rs"));
}

/// The robot of figure 8.
#[allow(dead_code, reason = "a program need not use all of its model")]
pub mod ir_robot {
    include!(concat!(env!("OUT_DIR"), "/ir-robot.rs"));
}

/// Every kind with every shape of data.
#[allow(dead_code, reason = "it is compiled, and that is all")]
pub mod kinds {
    include!(concat!(env!("OUT_DIR"), "/kinds.rs"));
}

/// Nothing that has data.
#[allow(dead_code, reason = "it is compiled, and that is all")]
pub mod bare {
    include!(concat!(env!("OUT_DIR"), "/bare.rs"));
}
