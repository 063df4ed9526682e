//! How much of the machine looking on may take: one part in [`SHARE`], averaged over time, however many look and however fast; and for
//! how long the end waits for it.
//!
//! Work is metered as it is done, and what was overdrawn is waited for (a generic cell rate algorithm on processor time).

use std::time::Duration;
use tokio::sync::Mutex;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// Of the machine's processor time. What is not metered (sending, formatting) takes about as much again: together at most 1 %.
const SHARE: f64 = 200.0;
/// Processor time that may be taken at once after a pause: a few megapixels, so that whoever opens the page sees the whole image.
const BURST: Duration = Duration::from_millis(300);

/// See the module. One at a time works.
pub struct Pace {
    /// Waited for, for each second worked.
    factor: f64,
    /// When all that was taken is made up for.
    paid: Mutex<Option<Instant>>,
}

impl Default for Pace {
    fn default() -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Self { factor: SHARE / cores as f64, paid: Mutex::new(None) }
    }
}

impl Pace {
    /// Does something, when its turn has come and not before.
    pub async fn work<T>(&self, work: impl AsyncFnOnce() -> T) -> T {
        let mut paid = self.paid.lock().await;
        if let Some(paid) = *paid {
            let burst = BURST.mul_f64(self.factor);
            tokio::time::sleep_until(paid.checked_sub(burst).unwrap_or(paid)).await;
        }
        let begun = Instant::now();
        let result = work().await;
        let taken = begun.elapsed().mul_f64(self.factor);
        *paid = Some(paid.map_or(begun, |paid| paid.max(begun)) + taken);
        result
    }
}

/// Does something that goes on beside the service until that ends, and for `linger` after it at the most.
pub async fn until_closed(closing: &CancellationToken, linger: Duration, work: impl Future<Output = ()>) {
    let over = async {
        closing.cancelled().await;
        tokio::time::sleep(linger).await;
    };
    tokio::select! {
        () = work => {}
        () = over => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whatever is asked for, in the long run one part in two hundred is taken; after a pause, some at once.
    #[tokio::test(start_paused = true)]
    async fn looking_on_takes_its_share_and_no_more() {
        let pace = Pace { factor: SHARE, ..Pace::default() };
        let begun = Instant::now();
        let step = Duration::from_millis(10);
        for _ in 0..1000 {
            pace.work(async || tokio::time::sleep(step).await).await;
        }
        let all = begun.elapsed().as_secs_f64();
        // 10 s of work; 0.3 s of it were free.
        assert!((1920.0..2020.0).contains(&all), "{all} s");
        tokio::time::sleep(Duration::from_secs(200)).await;
        let begun = Instant::now();
        for _ in 0..30 {
            pace.work(async || tokio::time::sleep(step).await).await;
        }
        assert!(begun.elapsed() < Duration::from_millis(400), "{:?}", begun.elapsed());
    }
}
