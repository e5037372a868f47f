//! Trains the networks of gs3 on frames rendered from scenes.
//!
//! A [`Clip`] holds what a network is fed along a camera path, and the native frames it should give. A [`Trainer`] runs
//! the network through parts of clips, differentiates its loss through time and moves its weights; [`validate()`] says
//! what they gain over reconstruction without learning on clips kept apart.

mod batch;
mod checkpoint;
pub mod clip;
pub mod clips;
mod error;
mod form;
mod log;
pub mod losses;
mod optimise;
mod plot;
mod provenance;
mod psnr;
mod session;
mod settings;
mod state;
mod trained_network;
mod trainer;
mod unroll;
mod validate;

pub use batch::ClipFolder;
pub use checkpoint::save_weights;
pub use clip::{Clip, ClipError, ClipFile, ClipFrame, ClipPlane, ClipWindow, Network};
pub use error::TrainError;
pub use log::{Log, Row};
pub use plot::draw as draw_log;
pub use provenance::continued;
pub use session::{Ending, Places, TrainEvent, train};
pub use settings::{Length, MARGIN, Settings, Symmetries};
pub use state::{Best, State};
pub use trained_network::TrainedNetwork;
pub use trainer::{TrainStep, Trainer};
pub use validate::{Gain, Validation, validate};
