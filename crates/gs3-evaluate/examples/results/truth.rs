//! What frames of a path should show.

use std::collections::{BTreeMap, BTreeSet};

use gs3::Stage;
use gs3_evaluate::methods::{Method, MethodError, MethodSettings, MethodSpec, build};
use gs3_evaluate::protocol::Moment;
use gs3_scene::{Camera, CameraPath, Image};

use crate::score::milliseconds;

/// Native rendering along a path, each frame once.
pub struct Truth<'a> {
    path: &'a CameraPath,
    native: Box<dyn Method>,
    /// The numbers of frames that methods show between two rendered ones.
    counts: BTreeSet<u32>,
    /// The frame rendered last, and its number on the path.
    pub current: Image,
    k: usize,
    /// The frames that methods show between it and the one before.
    between: BTreeMap<Moment, (Camera, Image)>,
}

impl<'a> Truth<'a> {
    pub fn new(
        path: &'a CameraPath,
        settings: &MethodSettings,
        counts: impl Iterator<Item = u32>,
    ) -> Result<Self, MethodError> {
        Ok(Self {
            path,
            native: build(MethodSpec::NATIVE, settings)?,
            counts: counts.collect(),
            current: Image::default(),
            k: 0,
            between: BTreeMap::new(),
        })
    }

    /// Renders frame `k` of the path, and before it all frames that methods show between it and the one before. Gives the
    /// milliseconds of frame `k`.
    pub fn render(&mut self, k: usize) -> Result<f64, MethodError> {
        self.k = k;
        self.between.clear();
        for moment in self.counts.iter().flat_map(|count| Moment::before(k, *count)) {
            if !self.between.contains_key(&moment) {
                let camera = self.path.at(moment.time());
                let image = self.native.render(&camera, &[])?.current.clone();
                self.between.insert(moment, (camera, image));
            }
        }
        self.current.clone_from(self.native.render(&self.path.cameras()[k], &[])?.current);
        Ok(milliseconds(self.native.as_ref(), &Stage::ALL))
    }

    /// Cameras and images of the `count` frames between the frame rendered last and the one before, in order.
    pub fn between(&self, count: u32) -> (Vec<Camera>, Vec<&Image>) {
        let frames = Moment::before(self.k, count).filter_map(|moment| self.between.get(&moment));
        frames.map(|(camera, image)| (*camera, image)).unzip()
    }
}
