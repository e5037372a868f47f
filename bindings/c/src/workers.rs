//! The threads of a handle.

use std::sync::{Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use rayon::{ThreadBuilder, ThreadPool, ThreadPoolBuilder};

use crate::memory::{self, Account};
use crate::status::Fault;
use crate::status::gs3_status::GS3_ERROR_ARGUMENT;

/// Most threads of a handle.
const MOST: u32 = 1024;

/// Threads that work for one handle and on its account. They have ended when this is dropped.
#[derive(Debug)]
pub struct Workers {
    /// None once it is being dropped.
    pool: Option<ThreadPool>,
    threads: Vec<JoinHandle<()>>,
    account: Account,
}

impl Workers {
    /// `threads` of them, 0 for as many as the machine runs at once.
    pub fn new(threads: u32) -> Result<Self, Fault> {
        if threads > MOST {
            return Err(Fault::argument("threads", format_args!("0 to {MOST}"), threads));
        }
        let account = Account::open()?;
        let number = account.number();
        let work = memory::work_on(number);
        let handles = Mutex::new(Vec::new());
        let start = |worker: ThreadBuilder| {
            let name = format!("gs3 {}", worker.index());
            let handle = thread::Builder::new().name(name).spawn(move || {
                let _work = memory::work_on(number);
                worker.run();
            })?;
            handles.lock().unwrap_or_else(PoisonError::into_inner).push(handle);
            Ok(())
        };
        let pool = ThreadPoolBuilder::new().num_threads(threads as usize).spawn_handler(start).build();
        let threads = handles.into_inner().unwrap_or_else(PoisonError::into_inner);
        drop(work);
        let refused = |error| {
            let text = format!("threads: expected {} to start, found {error}", threads.len());
            Fault::new(GS3_ERROR_ARGUMENT, text)
        };
        let pool = Some(pool.map_err(refused)?);
        Ok(Self { pool, threads, account })
    }

    /// Runs `work` on them, and gives what it gives. What is allocated meanwhile, here and there, is on their account.
    pub fn run<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        let _work = self.enter();
        match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }

    /// Lets this thread work on their account until the value is dropped.
    pub fn enter(&self) -> memory::Shift {
        memory::work_on(self.account.number())
    }

    /// As [`Self::run`]. What a fault says is on nobody's account, as it outlives the call.
    pub fn try_run<T: Send, E: Send + Into<Fault>>(
        &self,
        work: impl FnOnce() -> Result<T, E> + Send,
    ) -> Result<T, Fault> {
        let _work = self.enter();
        self.run(work).map_err(|error| memory::outlive(error.into()))
    }

    /// What they have allocated and not freed.
    pub fn bytes(&self) -> u64 {
        self.account.bytes()
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        let _work = self.enter();
        drop(self.pool.take());
        for thread in self.threads.drain(..) {
            // One that panicked has ended as well.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use rayon::prelude::*;

    use super::*;

    #[test]
    fn what_workers_allocate_is_theirs_until_they_free_it() {
        let workers = Workers::new(3).unwrap();
        let before = workers.bytes();
        let buffers: Vec<Vec<u8>> =
            workers.run(|| (0..64).into_par_iter().map(|k| vec![0; 1000 + k]).collect());
        let made = workers.bytes() - before;
        let expected: u64 = buffers.iter().map(|buffer| buffer.capacity() as u64).sum();
        // Rayon keeps a few queues.
        assert!((expected..expected + 16_384).contains(&made), "{made}, expected {expected}");
        workers.run(|| drop(buffers));
        assert!(workers.bytes() - before < 16_384);
    }

    #[test]
    fn numbers_of_threads_are_checked() {
        assert_eq!(Workers::new(1025).unwrap_err().text, "threads: expected 0 to 1024, found 1025");
        assert_eq!(Workers::new(2).unwrap().run(rayon::current_num_threads), 2);
    }
}
