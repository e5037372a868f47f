//! The C interface of gs3: `include/gs3.h`, which cbindgen makes of this crate; `docs/c.md` tells how to use it.
//!
//! Everything here is a border. What a caller passes is checked and turned into the library's own types, the library is
//! called, and what it gives is written into the caller's memory. Types bear their C names, and documents are written for
//! readers of the header.
//!
//! | module | does |
//! |---|---|
//! | `status` | status codes, the text of the last error, the wall that no panic crosses |
//! | `descriptor` | reads descriptors of any length, writes results of any length |
//! | `memory`, `workers`, `handle` | counts what handles allocate; their threads; one call at a time |
//! | `pixels`, `frame` | planes and images in the caller's memory; what frames of both kinds have in common |
//! | `choice` | the numbers of enumerations |
//! | `camera`, `scene`, `renderer`, `reconstructor`, `query`, `log` | the functions |

// The names are C's.
#![allow(non_camel_case_types)]

mod camera;
mod choice;
mod descriptor;
mod frame;
mod handle;
mod log;
mod memory;
mod pixels;
mod query;
mod reconstructor;
mod renderer;
mod scene;
mod status;
mod workers;

#[global_allocator]
static ALLOCATOR: memory::Counting = memory::Counting;
