//! Many clips at once, as files.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed};
use std::sync::mpsc;

use gs3::scene::Size;

use super::analytic::analytic_psnr;
use super::draw::Draw;
use super::error::MakeError;
use super::recorder::Recorder;
use super::{ClipSettings, ClipSource};
use crate::clip::{Clip, ClipFile};

/// Clips of a scene that are to be in a folder.
#[derive(Clone, Debug)]
pub struct Batch<'a> {
    /// The scene.
    pub source: &'a ClipSource,
    /// What they are like.
    pub settings: &'a ClipSettings,
    /// Clips for training.
    pub training: usize,
    /// Clips kept from training.
    pub held_out: usize,
    /// Where they go: `NAME_0000.clip` and `held_NAME_0000.clip`. Files that are there already stay as they are.
    pub folder: &'a Path,
}

/// A clip that was made.
#[derive(Clone, Debug, PartialEq)]
pub struct MadeClip {
    /// Its file.
    pub file: PathBuf,
    /// PSNR of the frames without networks against native ones, in dB.
    pub analytic_psnr: f64,
}

/// A clip to be made.
#[derive(Clone, Debug)]
struct Task {
    file: PathBuf,
    seed: u64,
    is_held_out: bool,
}

impl Batch<'_> {
    /// All clips, those that are there included.
    fn all(&self) -> Vec<Task> {
        let kinds = [(false, self.training, ""), (true, self.held_out, "held_")];
        let mut tasks = Vec::new();
        for (is_held_out, count, prefix) in kinds {
            for number in 0..count {
                let name = format!("{prefix}{}_{number:04}", self.source.name);
                let seed = seed(self.settings.seed, &name);
                tasks.push(Task { file: self.folder.join(name + ".clip"), seed, is_held_out });
            }
        }
        tasks
    }

    /// The clips that are still to be made.
    fn tasks(&self) -> Vec<Task> {
        let mut tasks = self.all();
        tasks.retain(|task| !task.file.exists());
        tasks
    }

    /// Checks that the clips that are there are like those to be made, as far as their headers tell.
    fn check_kept(&self) -> Result<(), MakeError> {
        let ClipSettings { network, scale, size, frames, .. } = self.settings;
        for Task { file, .. } in self.all().into_iter().filter(|task| task.file.exists()) {
            let kept = ClipFile::open(&file)?;
            let [rows, columns] = kept.lr().map(|side| side * kept.scale() as usize);
            let fields = [
                ("network", network.name().to_owned(), kept.network().name().to_owned()),
                ("scale", scale.to_string(), kept.scale().to_string()),
                ("size", size.to_string(), Size::of(columns, rows).to_string()),
                ("frames", frames.to_string(), kept.frames().to_string()),
            ];
            if let Some((field, expected, actual)) = fields.into_iter().find(|(_, a, b)| a != b) {
                return Err(MakeError::Mixed { file, field, expected, actual });
            }
        }
        Ok(())
    }

    /// How many clips are still to be made.
    #[must_use]
    pub fn missing(&self) -> usize {
        self.tasks().len()
    }

    /// Makes all clips that do not exist yet, as many at once as the current rayon pool has threads. `done` is called
    /// for each finished clip, in the order of finishing, and returns whether to continue. Clips already begun are
    /// finished in any case.
    ///
    /// # Errors
    /// [`MakeError`] of the first clip that cannot be made, or that is there with other settings.
    pub fn make(&self, mut done: impl FnMut(MadeClip) -> bool) -> Result<(), MakeError> {
        self.settings.check()?;
        self.check_kept()?;
        let tasks = self.tasks();
        let (next, stop) = (AtomicUsize::new(0), AtomicBool::new(false));
        let (sender, receiver) = mpsc::channel();
        // A clip is small: each is made by one thread, in a pool of its own, so that none waits for another.
        let worker = || -> Result<rayon::ThreadPool, MakeError> {
            Ok(rayon::ThreadPoolBuilder::new().num_threads(1).build()?)
        };
        let threads = rayon::current_num_threads().clamp(1, tasks.len().max(1));
        let workers = (0..threads).map(|_| worker()).collect::<Result<Vec<_>, _>>()?;
        std::thread::scope(|scope| {
            for pool in &workers {
                let (sender, tasks, next, stop) = (sender.clone(), &tasks, &next, &stop);
                scope.spawn(move || {
                    let result = pool.install(|| self.work(tasks, next, stop, &sender));
                    if let Err(error) = result {
                        stop.store(true, Relaxed);
                        // The receiver lives as long as this scope.
                        let _ = sender.send(Err(error));
                    }
                });
            }
            drop(sender);
            let mut result = Ok(());
            for made in receiver {
                match made {
                    Ok(made) => {
                        if !done(made) {
                            stop.store(true, Relaxed);
                        }
                    }
                    Err(error) => result = result.and(Err(error)),
                }
            }
            result
        })
    }

    /// Makes one clip after another, until none are left or it is stopped.
    fn work(
        &self,
        tasks: &[Task],
        next: &AtomicUsize,
        stop: &AtomicBool,
        sender: &mpsc::Sender<Result<MadeClip, MakeError>>,
    ) -> Result<(), MakeError> {
        let mut recorder = Recorder::new(self.source, self.settings)?;
        while !stop.load(Relaxed) {
            let Some(task) = tasks.get(next.fetch_add(1, Relaxed)) else { break };
            let clip = recorder.record(task.seed, task.is_held_out)?;
            clip.save(&task.file)?;
            // The receiver lives as long as the workers.
            let _ =
                sender.send(Ok(MadeClip { file: task.file.clone(), analytic_psnr: analytic_psnr(&clip) }));
        }
        Ok(())
    }
}

impl ClipSource {
    /// The clip with that number, as [`Batch::make`] makes it.
    ///
    /// # Errors
    /// [`MakeError`] if it cannot be made.
    pub fn clip(&self, settings: &ClipSettings, number: usize) -> Result<Clip, MakeError> {
        settings.check()?;
        Recorder::new(self, settings)?
            .record(seed(settings.seed, &format!("{}_{number:04}", self.name)), false)
    }
}

/// The seed of the clip `name`: FNV-1a of its name, scattered.
fn seed(seed: u64, name: &str) -> u64 {
    let hash = name.bytes().fold(0xCBF2_9CE4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01B3)
    });
    Draw::new(hash ^ Draw::new(seed).bits()).bits()
}
