//! How many workers are worth having for what there is to do. No Slurm here, and no clock.

use std::time::Duration;

/// Between how many, and by what measure.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    /// So many always.
    pub min: u32,
    /// Never more.
    pub max: u32,
    /// A worker is worth starting for so much work.
    pub work_each: Duration,
    /// Workers that run and are too many may stay for so long: the next job may be on its way.
    pub patience: Duration,
}

/// What a coordinator has to do.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    /// Samples that jobs lack.
    pub samples: u64,
    /// Of one worker, as far as there are any to know it by.
    pub samples_per_second: Option<f64>,
}

impl Scale {
    /// How many workers there should be.
    pub fn wanted(&self, load: &Load) -> u32 {
        if load.samples == 0 {
            return self.min;
        }
        // As long as nobody knows how long the work takes, all that were asked for.
        let Some(rate) = load.samples_per_second else { return self.max };
        let seconds = load.samples as f64 / rate;
        let worth = (seconds / self.work_each.as_secs_f64()).ceil().clamp(1.0, f64::from(self.max));
        // Between 1 and `max`.
        (worth as u32).max(self.min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if the last worker is taken from work that is nearly done, or if there are more than were asked for.
    #[test]
    fn as_many_as_there_is_work_for_between_the_bounds() {
        let scale = Scale { min: 0, max: 10, work_each: Duration::from_secs(60), patience: Duration::from_secs(30) };
        let wanted = |samples, rate| scale.wanted(&Load { samples, samples_per_second: rate });
        assert_eq!(wanted(0, None), 0);
        assert_eq!(wanted(1, None), 10);
        assert_eq!(wanted(1, Some(1000.0)), 1);
        assert_eq!(wanted(180_001, Some(1000.0)), 4);
        assert_eq!(wanted(u64::MAX, Some(0.1)), 10);
        let kept = Scale { min: 2, ..scale };
        assert_eq!(kept.wanted(&Load { samples: 0, samples_per_second: None }), 2);
        assert_eq!(kept.wanted(&Load { samples: 1, samples_per_second: Some(9.0) }), 2);
    }
}
