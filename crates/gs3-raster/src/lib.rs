//! gs3-raster
