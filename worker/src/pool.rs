//! The one bridge from tokio to rayon: units go in, results come out of a channel. No other CPU work runs anywhere else.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tilecast_core::trace::{SampleError, Tracer};
use tilecast_proto::sums;
use tilecast_proto::types::{Failure, REPLAY_COMMAND, Unit};
use tokio::sync::{mpsc, oneshot};

/// Threads that trace, one unit each at a time, in the order the units came.
#[derive(Debug)]
pub(crate) struct Pool {
    threads: rayon::ThreadPool,
    results: mpsc::UnboundedSender<Traced>,
}

/// Names a unit within this process.
pub(crate) type Ticket = u64;

/// What a unit in the pool is told, and tells.
#[derive(Debug, Default)]
pub(crate) struct Flags {
    /// Nobody wants it any more.
    pub stop: AtomicBool,
    /// A thread has taken it up.
    pub begun: AtomicBool,
}

/// A unit that left the pool.
#[derive(Debug)]
pub(crate) struct Traced {
    pub ticket: Ticket,
    /// When it did.
    pub at: Instant,
    /// The encoded sums and the time it took; `None` if it was told to stop.
    pub result: Result<Option<(Vec<u8>, Duration)>, Failure>,
}

impl Pool {
    /// Starts the threads. Results come from the receiver; their number is bounded by that of the units given in.
    pub fn new(threads: usize) -> Result<(Self, mpsc::UnboundedReceiver<Traced>), rayon::ThreadPoolBuildError> {
        let threads =
            rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("trace-{i}")).build()?;
        let (results, receiver) = mpsc::unbounded_channel();
        Ok((Self { threads, results }, receiver))
    }

    /// Traces a unit when a thread is free.
    pub fn trace(&self, ticket: Ticket, tracer: Arc<Tracer>, unit: Unit, flags: Arc<Flags>) {
        let results = self.results.clone();
        self.threads.spawn_fifo(move || {
            flags.begun.store(true, Ordering::Relaxed);
            let result = catch_unwind(AssertUnwindSafe(|| trace(&tracer, &unit, &flags.stop)));
            let result = result.unwrap_or_else(|panic| {
                let Unit { tile, samples, .. } = &unit;
                let text = panic_text(panic.as_ref());
                Err(Failure::Panic(format!("the tracer panicked over samples {samples:?} of {tile:?}: {text}")))
            });
            // Nobody listens any more when the worker has ended.
            let _ = results.send(Traced { ticket, at: Instant::now(), result });
        });
    }

    /// Does other CPU work on the pool, such as compiling a scene, which uses all its threads. `None` if it panicked.
    pub async fn run<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Option<T> {
        let (sender, receiver) = oneshot::channel();
        self.threads.spawn(move || {
            if let Ok(result) = catch_unwind(AssertUnwindSafe(work)) {
                let _ = sender.send(result);
            }
        });
        receiver.await.ok()
    }
}

fn trace(tracer: &Tracer, unit: &Unit, stop: &AtomicBool) -> Result<Option<(Vec<u8>, Duration)>, Failure> {
    if stop.load(Ordering::Relaxed) {
        return Ok(None);
    }
    let start = Instant::now();
    match tracer.trace(unit.tile, unit.samples.clone(), stop) {
        Ok(Some(tile)) => Ok(Some((sums::encode(&tile.pixels), start.elapsed()))),
        Ok(None) => Ok(None),
        Err(error) => {
            let SampleError { x, y, index, .. } = error;
            Err(Failure::Sample(format!(
                "{error}; see its path with: {REPLAY_COMMAND} --pixel {x},{y} --sample {index}"
            )))
        }
    }
}

fn panic_text(panic: &(dyn Any + Send)) -> &str {
    let owned = || panic.downcast_ref::<String>().map(String::as_str);
    panic.downcast_ref::<&str>().copied().or_else(owned).unwrap_or("without a message")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_panic_costs_its_own_work_only() {
        let (pool, _results) = Pool::new(1).unwrap();
        assert_eq!(pool.run(|| panic!("on purpose")).await, None::<()>);
        assert_eq!(pool.run(|| 7).await, Some(7));
        let panic = catch_unwind(|| panic!("number {}", 5)).unwrap_err();
        assert_eq!(panic_text(panic.as_ref()), "number 5");
    }
}
