//! Entries of the fuzz targets.

pub mod entry;
pub mod frames;
pub mod readers;
