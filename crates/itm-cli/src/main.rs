//! The `itm` program.
fn main() {}
