//! A camera whose matrix is known, for experiments and tests.

/// The matrix of the lab's camera x at 640×480, rounded: an example.
pub const LAB_X: [f64; 12] = [
    -302.44, 832.0, -101.09, 560_733.0, //
    -25.8, 0.0, -887.6, 715_856.0, //
    -0.945_12, 0.0, -0.315_92, 1_752.29,
];
