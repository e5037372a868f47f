//! gs3-reconstruct
