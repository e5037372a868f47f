//! Entries of the fuzz targets of gs3-scene.

pub mod entry;
