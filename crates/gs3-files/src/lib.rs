//! Files that appear whole or not at all ([`write_atomically`], [`AtomicFile`]), and files that are read whole within a bound
//! ([`read_within`]): what every crate that touches files needs of them, once.

mod atomic;
mod place;
mod read;

pub use atomic::{AtomicFile, check_writable, discard_temporaries, write_atomically, write_new};
pub use place::end_of_links;
pub use read::{ReadError, read_within};
