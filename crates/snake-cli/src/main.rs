//! `snake-cli`.
fn main() {}
