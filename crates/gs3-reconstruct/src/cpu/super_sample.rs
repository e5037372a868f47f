//! Temporal super sampling without learning.

mod bands;

use fearless_simd::{Level, dispatch};
use gs3_scene::{BLOCK_SIDE, Camera, ExactBlocks, GBuffer, Geometry, Gradients, Image, Planes, block_grid};
use rayon::prelude::*;

use crate::cpu::carry::{add_surface_shifts, advance};
use crate::cpu::hermite::Surface;
use crate::cpu::past::Past;
use crate::cpu::rectification::Rectification;
use crate::cpu::samples::CHUNK;
use crate::cpu::select::write_blocks;
use crate::cpu::surface_motion::{Frames, SurfaceMotion};
use crate::cpu::tile::Tiles;
use crate::depth_lattice::DepthLattice;
use crate::error::{ReconstructError, check_finite, check_gbuffer, check_padded, check_scale};
use crate::reprojection::{Reprojection, parallax};
use crate::sequence::ResetReason;
use crate::settings::Kriging;
use crate::staleness::{are_blocks_stale, count_remembered};

/// Changes since the previous frame.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Since<'a> {
    /// Why there is no history; none if there is one.
    pub reset: Option<ResetReason>,
    /// Motion vectors in LR pixels, from the places of surfaces in the current frame (margin included) to their
    /// places in the previous frame; none if everything stands still.
    pub vectors: Option<&'a Planes<2>>,
}

/// Super-samples a sequence of jittered LR frames on the HR grid.
///
/// The history is the last LR frames themselves, at most S²: exact samples, splatted again for every frame (see the module
/// `splat`). With exact blocks it forgets frames sooner in motion (`staleness`). A resting camera with jitter on the exact S×S
/// grid gives the native image after S² frames.
///
/// Memory: 58 B per LR pixel (margins included) and remembered frame, which is 58 B per HR pixel with a full history.
/// A third more once something moves, which only a [`crate::Reconstructor`] follows.
#[derive(Debug)]
pub struct SuperSampler {
    scale: u32,
    kriging: Kriging,
    /// The last LR frames, newest first. After each frame come its exact blocks that are still remembered.
    past: Vec<Past>,
    /// Memory of LR frames and of exact blocks that have left the history ([`Self::spare_of`]).
    spare: Vec<Past>,
    /// `[block rows, block columns]`.
    errors: Vec<f32>,
    surface: Surface,
    rectification: Rectification,
    /// `[LR height, LR width]`.
    innovation: Vec<[f32; 4]>,
    /// Motion of moving surfaces since the previous frame.
    motion: SurfaceMotion,
    invalid: Option<ResetReason>,
    tiles: Tiles,
    level: Level,
}

/// Largest expected error of a block, summed over its pixels and over RGB, that is not visible: half a step of 8 bits of each
/// number. (In a first frame 20 to 73 % of the blocks of `fungi_drift`, `flowers_drift`, `lacadiere_drift` and the demo have
/// larger errors, and 83 % of `hqgarden_pan`. Remembering all blocks in motion changes the PSNR of frames 0 to 39 by −0.06
/// to 0.03 dB. Super sampling of `lacadiere_drift` then takes 27.7 instead of 23.1 ms, by `gs3 bench` of twelve frames.)
const INVISIBLE: f32 = (3 * BLOCK_SIDE * BLOCK_SIDE) as f32 * (0.5 / 255.0) * (0.5 / 255.0);

/// The planes of `gbuffer` besides colour that super sampling reads, if all numbers of the colour and these planes
/// are finite.
fn usable_planes(gbuffer: &GBuffer) -> Result<(&Gradients, &Geometry), ReconstructError> {
    let GBuffer { color, gradients, geometry, .. } = gbuffer;
    let geometry = geometry.as_ref().ok_or(ReconstructError::Missing { what: "depth" })?;
    let gradients = gradients.as_ref().ok_or(ReconstructError::Missing { what: "image gradients" })?;
    // Checked once, here: a number that is not finite would stay as long as its frame is remembered.
    check_finite("G-buffer colour", color)?;
    check_finite("G-buffer gradients", &gradients.color_dx)?;
    check_finite("G-buffer gradients", &gradients.color_dy)?;
    if let Some(mixed) = &gradients.color_dxy {
        check_finite("G-buffer gradients", mixed)?;
    }
    Ok((gradients, geometry))
}

impl SuperSampler {
    /// A super sampler of `scale` (1 to [`crate::MAX_SCALE`]) without history.
    ///
    /// # Errors
    /// [`ReconstructError::Scale`] if `scale` is not supported.
    pub fn new(scale: u32, kriging: Kriging) -> Result<Self, ReconstructError> {
        check_scale(scale)?;
        Ok(Self {
            scale,
            kriging,
            past: Vec::new(),
            spare: Vec::new(),
            errors: Vec::new(),
            surface: Surface::default(),
            rectification: Rectification::default(),
            innovation: Vec::new(),
            motion: SurfaceMotion::default(),
            invalid: Some(ResetReason::FirstFrame),
            tiles: Tiles::default(),
            level: gs3_simd::level(),
        })
    }

    /// Drops the history. The next frame is reconstructed from its own samples alone.
    pub fn reset(&mut self, reason: ResetReason) {
        self.invalid = Some(reason);
    }

    /// Why the next frame will have no history; none if it will have one.
    #[must_use]
    pub const fn history_invalid(&self) -> Option<ResetReason> {
        self.invalid
    }

    /// The innovation of the last frame, `[LR height, LR width]`: the difference of its samples from the history.
    /// Channels 0 to 2 are RGB less the RGB that the history predicts at the sample. Channel 3 is the confidence of
    /// the prediction, `[0, 1]`: Σw / (1 + Σw), where Σw is the sum of the inverse variances (pixel⁻⁴) of the past
    /// samples' predictions. RGB is 0 where the confidence is next to nothing. All channels are 0 if samples do not
    /// lie on pixel centres.
    #[must_use]
    pub fn innovation(&self) -> &[[f32; 4]] {
        &self.innovation
    }

    /// Reconstructs the image of `camera` from its LR frame `gbuffer` and the history, into `out`, which is resized.
    /// Another size than before resets the history.
    ///
    /// The fourth channel of `out` is the uncertainty, `[0, 1]`, in pixel²: √(1/Σw) less the value of one exact
    /// sample. Σw is the sum of the inverse variances (pixel⁻⁴) of all predictions of the pixel. The uncertainty
    /// times the image's curvature is the expected error. The uncertainty is
    ///
    /// * 0 where a pixel has a sample of its own, so everywhere at rest with a full history;
    /// * 0 where the current frame and the history show only background of one colour;
    /// * larger where samples are far away, old, doubtful or missing.
    ///
    /// `gbuffer` is the frame of [`Camera::low_resolution`] of `camera`, with gradients and geometry, point-sampled
    /// at its jitter (`dilation` matched to the scale).
    ///
    /// # Errors
    /// [`ReconstructError`] if `gbuffer` is not the LR frame of `camera`, lacks gradients or geometry, or has colours
    /// or gradients that are not finite. The history stays unchanged then.
    pub fn super_sample(
        &mut self,
        camera: &Camera,
        gbuffer: &GBuffer,
        out: &mut Image,
    ) -> Result<(), ReconstructError> {
        self.super_sample_padded(camera, gbuffer, gbuffer, out)
    }

    /// As [`Self::super_sample`] from `gbuffer`, the LR frame of `camera`, but the history also remembers the margin:
    /// `padded` is the same frame with a margin ([`GBuffer::crop`] makes `gbuffer` from `padded`). The parts that
    /// come into view when the camera turns then have past samples.
    ///
    /// # Errors
    /// As [`Self::super_sample`]; also if `padded` without its margin has not the size and jitter of `gbuffer`.
    pub fn super_sample_padded(
        &mut self,
        camera: &Camera,
        gbuffer: &GBuffer,
        padded: &GBuffer,
        out: &mut Image,
    ) -> Result<(), ReconstructError> {
        self.super_sample_since(Since::default(), camera, gbuffer, padded, out)
    }

    /// As [`Self::super_sample_padded`], with the changes `since` the previous frame. After an error these are
    /// ignored.
    pub(crate) fn super_sample_since(
        &mut self,
        since: Since<'_>,
        camera: &Camera,
        gbuffer: &GBuffer,
        padded: &GBuffer,
        out: &mut Image,
    ) -> Result<(), ReconstructError> {
        let size = camera.size();
        check_gbuffer(gbuffer, self.scale, size)?;
        check_padded(padded, gbuffer)?;
        let (gradients, geometry) = usable_planes(gbuffer)?;
        if !std::ptr::eq(padded, gbuffer) {
            usable_planes(padded)?;
        }
        if let Some(vectors) = since.vectors {
            check_finite("G-buffer motion", vectors)?;
        }
        if self.past.first().is_some_and(|newest| newest.camera.size() != size) {
            self.reset(ResetReason::SizeOrTierChange);
        }
        if self.invalid.take().is_some() || since.reset.is_some() {
            self.forget();
        }
        self.surface.set(gbuffer, gradients, self.scale);
        self.rectification.set(self.level, gbuffer, gradients, &geometry.depth_median, self.scale);
        let moves = self.follow(since.vectors, camera, padded);
        self.remember(camera, gbuffer, padded)?;
        self.find_boxes(camera);
        if moves {
            self.add_surface_shifts();
        }
        let [width, height] = size.to_usize();
        out.resize(width, height);
        self.accumulate(out);
        Ok(())
    }

    /// Moves the history along `vectors` to the places of its surfaces in the current frame, `padded`. Returns
    /// whether anything moves.
    fn follow(&mut self, vectors: Option<&Planes<2>>, camera: &Camera, padded: &GBuffer) -> bool {
        let (Some(vectors), Some(newest)) = (vectors, self.past.first()) else {
            self.motion.clear();
            return false;
        };
        let before = newest.camera;
        let frames =
            Frames { cameras: [&before, camera], before: &newest.frame, now: padded, scale: self.scale };
        self.motion.set(&frames, vectors);
        let (motion, level, scale) = (&self.motion, self.level, self.scale as f32);
        // Exact blocks are only made for scenes that stand still.
        let lr_frames = self.past.par_iter_mut().filter(|past| !past.frame.is_blocks());
        // Boxes and reprojections still belong to the previous frame.
        lr_frames.for_each(|Past { frame, reprojection, boxes, .. }| {
            advance(level, frame, reprojection, boxes, scale, motion);
        });
        true
    }

    /// Marks where something moves in the current frame in the history, and in the newest frame its moving surfaces.
    fn add_surface_shifts(&mut self) {
        let (motion, level, scale) = (&self.motion, self.level, self.scale as f32);
        let Some((newest, past)) = self.past.split_first_mut() else { return };
        for [x, y] in motion.movers() {
            if let Some(displacement) = newest.frame.displacement_mut(y, x / CHUNK) {
                displacement.mark(x % CHUNK);
            }
        }
        let lr_frames = past.par_iter_mut().filter(|past| !past.frame.is_blocks());
        lr_frames.for_each(|Past { frame, reprojection, boxes, .. }| {
            add_surface_shifts(level, frame, reprojection, boxes, scale, motion);
        });
    }

    /// Displacements of the LR samples of the previous frame and of the last frame, from then to now, in world units,
    /// `[LR height, LR width]`; none if nothing moves.
    pub(crate) fn displacements(&self) -> Option<[&[[f32; 3]]; 2]> {
        self.motion.displacements()
    }

    /// Adds the current frame to the history, as its newest frame.
    fn remember(
        &mut self,
        camera: &Camera,
        gbuffer: &GBuffer,
        padded: &GBuffer,
    ) -> Result<(), ReconstructError> {
        let mut newest = self.spare_of(false, camera);
        (newest.camera, newest.age) = (*camera, 0);
        newest.mean_inverse_depth = DepthLattice::of(gbuffer).mean_inverse_depth();
        newest.frame.fill(self.level, padded, self.scale)?;
        let remembered = (self.scale * self.scale) as usize;
        self.past.iter_mut().for_each(|past| past.age += 1);
        let mut oldest = remembered - 1;
        // With exact blocks, frames are forgotten as `staleness` says. Without them, as below networks, all frames stay.
        if self.past.iter().any(|past| past.frame.is_blocks()) {
            // The ages of LR frames are 1, 2, 3, … up to the oldest.
            let lr_frames = self.past.iter().filter(|past| !past.frame.is_blocks());
            let lr_frames: Vec<_> = lr_frames.map(|past| (past.camera, past.mean_inverse_depth)).collect();
            oldest = oldest.min(count_remembered(&lr_frames, camera, remembered));
        }
        let is_dropped = |past: &Past| {
            let Past { camera: then, age, mean_inverse_depth, .. } = past;
            *age > oldest
                || past.is_faint && then != camera
                || past.frame.is_blocks() && are_blocks_stale(*age, then, *mean_inverse_depth, camera)
        };
        let dropped: Vec<_> = self.past.extract_if(.., |past| is_dropped(past)).collect();
        dropped.into_iter().for_each(|past| self.keep_memory_of(past));
        self.pack();
        self.past.insert(0, newest);
        Ok(())
    }

    /// Forgets all frames, and gives their memory back: the next frame may be exact as a whole, which takes the most memory of
    /// all frames.
    fn forget(&mut self) {
        self.past.clear();
        self.spare.clear();
    }

    /// Keeps the memory of a forgotten frame for the next ones: of LR frames, and of the largest number of exact blocks.
    fn keep_memory_of(&mut self, past: Past) {
        let rival = self.spare.iter_mut().find(|spare| spare.frame.is_blocks() && past.frame.is_blocks());
        match rival {
            Some(rival) if rival.frame.capacity() >= past.frame.capacity() => {}
            Some(rival) => *rival = past,
            None => self.spare.push(past),
        }
    }

    /// Moves exact blocks into smaller memory where newer blocks have replaced more than half of a frame's blocks.
    fn pack(&mut self) {
        for k in 0..self.past.len() {
            if let Some(packed) = self.past[k].frame.packed() {
                let past = &mut self.past[k];
                let large =
                    Past { frame: std::mem::replace(&mut past.frame, packed), ..Past::empty(&past.camera) };
                self.keep_memory_of(large);
            }
        }
    }

    /// The memory of a forgotten LR frame, or of forgotten exact blocks; new memory if there is none. Memory of the other kind
    /// has another size: it would grow into new pages, which takes longer than filling it.
    fn spare_of(&mut self, is_blocks: bool, camera: &Camera) -> Past {
        let place = self.spare.iter().rposition(|past| past.frame.is_blocks() == is_blocks);
        place.map_or_else(|| Past::empty(camera), |place| self.spare.swap_remove(place))
    }

    /// The squared errors that are expected of the last image, in blocks of 4×4 pixels, `[rows, columns]` of
    /// [`block_grid`]. Each is a sum over the block's pixels and over RGB.
    #[must_use]
    pub fn expected_errors(&self) -> &[f32] {
        &self.errors
    }

    /// Number of exact blocks in the history.
    #[must_use]
    pub fn remembered_blocks(&self) -> usize {
        self.past.iter().map(|past| past.frame.block_count()).sum()
    }

    /// Writes exact blocks of the last frame into `image`, the image that [`Self::super_sample`] made, with an
    /// uncertainty of 0. The blocks are remembered: the next frames reproject their samples. Blocks of a frame without
    /// history, which may be exact as a whole, are forgotten once the camera moves where their expected error is not visible.
    /// The blocks of a frame may come in several calls, each block once.
    pub fn refine(&mut self, blocks: &ExactBlocks, image: &mut Image) {
        let Some(current) = self.past.first() else { return };
        let (camera, mean_inverse_depth) = (current.camera, current.mean_inverse_depth);
        let size = image.size();
        let [columns, rows] = block_grid(size);
        write_blocks(blocks, image);
        // New exact blocks replace the remembered blocks at the same places.
        let mut is_new = vec![false; columns * rows];
        for [column, row] in &blocks.places {
            is_new[usize::from(*row) * columns + usize::from(*column)] = true;
        }
        let earlier = self.past.par_iter_mut().filter(|past| past.frame.is_blocks() && past.age > 0);
        earlier.for_each(|past| {
            let boxes = &past.boxes;
            past.frame.retain_blocks(|row, chunk| {
                let [x, y] = boxes.middle(row, chunk).map(|v| (v / 4.0).floor());
                let is_in = x >= 0.0 && y >= 0.0 && x < columns as f32 && y < rows as f32;
                is_in && !is_new[y as usize * columns + x as usize]
            });
        });
        let is_empty = |past: &mut Past| past.frame.is_blocks() && past.frame.block_count() == 0;
        let empty: Vec<_> = self.past.extract_if(.., is_empty).collect();
        empty.into_iter().for_each(|past| self.keep_memory_of(past));
        let is_first = self.past.iter().all(|past| past.age == 0);
        let is_faint = |[column, row]: [u16; 2]| {
            let error = self.errors.get(usize::from(row) * columns + usize::from(column));
            is_first && error.is_some_and(|error| *error <= INVISIBLE)
        };
        let blocks = blocks.places.iter().copied().zip(&blocks.blocks);
        let (faint, others): (Vec<_>, Vec<_>) = blocks.partition(|(place, _)| is_faint(*place));
        for (blocks, is_faint) in
            [(faint, true), (others, false)].iter().filter(|(blocks, _)| !blocks.is_empty())
        {
            let mut newest = self.spare_of(true, &camera);
            if newest.frame.capacity() > 2 * blocks.len() {
                // Memory of a frame that was exact as a whole would be kept by frames with few blocks.
                newest = Past::empty(&camera);
            }
            (newest.camera, newest.age, newest.is_faint) = (camera, 0, *is_faint);
            newest.mean_inverse_depth = mean_inverse_depth;
            newest.frame.fill_blocks(self.level, blocks, size, &self.past[0].frame, self.scale);
            self.past.insert(1, newest);
        }
    }

    /// Finds where the past samples are in the current frame.
    fn find_boxes(&mut self, camera: &Camera) {
        let (scale, level) = (self.scale as f32, self.level);
        self.past.par_iter_mut().for_each(|past| {
            past.reprojection = Reprojection::new(&past.camera, camera);
            past.parallax = parallax(&past.camera, camera);
            past.focal = camera.intrinsics().fx as f32;
            dispatch!(level, simd => past.boxes.set(simd, &past.frame, &past.reprojection, scale));
        });
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering::Relaxed;

    use gs3_scene::{ExactBlock, demo};

    use super::*;

    #[test]
    fn memory_of_lr_frames_and_of_exact_blocks_is_kept_apart() {
        let camera = demo::path().cameras()[0];
        let mut sampler = SuperSampler::new(4, Kriging::Off).unwrap();
        let blocks = [([0, 0], &ExactBlock::EMPTY)];
        let mut of_blocks = Past { age: 1, ..Past::empty(&camera) };
        let mut of_frame = Past { age: 2, ..Past::empty(&camera) };
        of_frame.frame.fill(sampler.level, &GBuffer::zeroed(1, 1), 4).unwrap();
        of_blocks.frame.fill_blocks(sampler.level, &blocks, camera.size(), &of_frame.frame, 4);
        for spare in [[of_blocks.clone(), of_frame.clone()], [of_frame.clone(), of_blocks.clone()]] {
            sampler.spare = spare.into();
            // A new frame has age 0.
            let ages = [false, true, false, true].map(|is_blocks| sampler.spare_of(is_blocks, &camera).age);
            assert_eq!(ages, [2, 1, 0, 0]);
        }
    }

    /// Of exact blocks the largest memory is kept.
    #[test]
    fn memory_follows_the_remembered_blocks() {
        let camera = demo::path().cameras()[0];
        let mut sampler = SuperSampler::new(4, Kriging::Off).unwrap();
        let mut of_frame = Past::empty(&camera);
        of_frame.frame.fill(sampler.level, &GBuffer::zeroed(1, 1), 4).unwrap();
        let blocks: Vec<_> = (0..200).map(|k| ([k, 0], &ExactBlock::EMPTY)).collect();
        let mut of_blocks = Past::empty(&camera);
        of_blocks.frame.fill_blocks(sampler.level, &blocks, camera.size(), &of_frame.frame, 4);
        let capacity = of_blocks.frame.capacity();
        sampler.past = vec![of_frame, of_blocks];
        for (kept, is_packed) in [(100, false), (70, true), (40, false), (30, true)] {
            let before = sampler.past[1].frame.block_count();
            let dropped = std::sync::atomic::AtomicUsize::new(before - kept);
            sampler.past[1].frame.retain_blocks(|_, _| {
                dropped.fetch_update(Relaxed, Relaxed, |left| left.checked_sub(1)).is_err()
            });
            let corners = |sampler: &SuperSampler| {
                let frame = &sampler.past[1].frame;
                let places = (0..frame.height)
                    .flat_map(|row| (0..frame.extents(row).len()).map(move |k| (row, k)))
                    .map(|(row, k)| dispatch!(sampler.level, s => frame.places(s, row, k, 4.0).x[0]));
                places.collect::<Vec<_>>()
            };
            let expected = corners(&sampler);
            assert_eq!(expected.len(), kept);
            sampler.pack();
            assert_eq!(corners(&sampler), expected, "packed blocks are in the same order");
            let held = sampler.past[1].frame.capacity();
            assert_eq!(held == kept, is_packed, "{held} for {kept}");
        }
        assert_eq!(sampler.spare.iter().map(|past| past.frame.capacity()).collect::<Vec<_>>(), [capacity]);
        sampler.forget();
        assert!(sampler.past.is_empty() && sampler.spare.is_empty());
    }
}
