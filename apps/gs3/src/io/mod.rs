//! What is read and written: scenes, cameras and weights; frames, videos, manifests, reports. It uses `cli` and knows no
//! command.

pub mod alpha;
pub mod destination;
pub mod exr;
pub mod frame_files;
pub mod inputs;
pub mod layers;
pub mod manifest;
pub mod npz;
pub mod output;
pub mod report;
pub mod video;
