//! gs3-evaluate
