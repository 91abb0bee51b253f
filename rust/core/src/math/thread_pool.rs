//! Thread pool for batches: as many threads as the process has cores, started with the first large batch.

use std::mem;
use std::sync::{Arc, Mutex, PoisonError};

use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::{Error, Result};

/// Id of the process in which the threads of the pool run, and the pool.
static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// Runs `work` in the pool, so that `rayon`'s parallel iterators use all cores. The environment variable
/// `RAYON_NUM_THREADS` sets the number of threads.
///
/// A forked process (for example of Python's `multiprocessing`) inherits the pool without its threads and would block
/// forever, so it gets a new pool.
///
/// # Errors
/// [`Error::Config`] if the system refuses to start a thread.
pub(crate) fn install<T: Send>(work: impl FnOnce() -> T + Send) -> Result<T> {
    Ok(pool()?.install(work))
}

fn pool() -> Result<Arc<ThreadPool>> {
    let mut slot = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    if let Some((owner, pool)) = &*slot
        && *owner == process
    {
        return Ok(Arc::clone(pool));
    }
    let made = ThreadPoolBuilder::new().thread_name(|i| format!("pliant {i}")).build();
    let pool = Arc::new(made.map_err(|cause| {
        let message = format!("no thread can be started ({cause}); set RAYON_NUM_THREADS to fewer");
        Error::config("threads", message)
    })?);
    // After a fork the threads of the old pool exist only in the parent. Leak the pool: dropping it would signal
    // these threads, and might block on a lock that one of them held at the fork.
    mem::forget(slot.replace((process, Arc::clone(&pool))));
    Ok(pool)
}
