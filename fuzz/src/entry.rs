//! What all targets have in common.

/// What a fuzz target calls with each input.
pub type Entry = fn(&[u8]);

/// Panics unless `message` is one readable line.
pub fn check_message(message: &str) {
    assert!(!message.contains('\n') && message.len() < 2000, "not one readable line: {message}");
}
