//! The command `gs3`.
fn main() {}
